# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The ground at Z = 0."""

from __future__ import annotations

from datetime import datetime

import bpy
import numpy as np
from bpy.app.translations import pgettext_rpt as rpt_

from ..core.site.adjustment import FrameError, with_ground
from ..scene import frame, site
from .picking import PickingOperator


class CURECON_OT_frame_ground(PickingOperator, bpy.types.Operator):
    """Lower or lift the whole site until the ground, the lowest level that spreads wide in its cloud, lies at Z = 0"""

    bl_idname = "curecon.frame_ground"
    bl_label = "Ground to Z = 0"
    bl_options = {"REGISTER", "UNDO"}

    def apply(self, context: bpy.types.Context, places: list[np.ndarray]) -> str:
        part = frame.part_of(context)
        if not part.clouds:
            raise FrameError("This part of the site has no cloud.", remedy="Reconstruct its photos to the end first.")
        before = part.adjustment
        height = site.ground(part.clouds[0], np.array(part.moved) @ before.matrix) / part.metre
        after = with_ground(before, height, when=datetime.now())
        frame.adjust(context.scene, part, after)
        return rpt_("The ground lay at Z = {:.2f} and is at Z = 0 now.").format(round(height, 2) + 0.0)  # no -0.00


CLASSES = (CURECON_OT_frame_ground,)
