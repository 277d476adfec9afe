# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings kept under a name, in Blender's own manner."""

from __future__ import annotations

import bpy
from bl_operators.presets import AddPresetBase

SUBFOLDER = "curecon"  # in the user's presets


class CURECON_OT_add_preset(AddPresetBase, bpy.types.Operator):
    """Keep the settings of Reconstruct and Surface under a name, or remove a kept one"""

    bl_idname = "curecon.add_preset"
    bl_label = "Add Reconstruct Preset"

    preset_menu = "CURECON_PT_presets"
    preset_subdir = SUBFOLDER
    preset_defines = ["properties = bpy.context.scene.curecon"]
    preset_values = [
        f"properties.{name}"
        for name in ("quality", "goal", "max_image_size", "views", "fill_holes", "extent", "max_faces",
                     "texture_size", "texture_format")
    ]


CLASSES = (CURECON_OT_add_preset,)
