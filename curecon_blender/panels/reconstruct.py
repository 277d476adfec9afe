# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Second step: from the photos to the cloud, with its progress."""

from __future__ import annotations

import bpy

from .. import ADDON
from ..job import duration
from ..operators import running
from .layout import AdvancedPanel, Panel, draw_outcome, draw_progress, gibibytes, paragraph


class CURECON_PT_reconstruct(Panel, bpy.types.Panel):
    bl_idname = "CURECON_PT_reconstruct"
    bl_label = "Reconstruct"

    def draw(self, context: bpy.types.Context) -> None:
        layout, properties, status = self.layout, context.scene.curecon, running.status
        column = layout.column()
        column.enabled = not status.running
        column.row().prop(properties, "quality", text="")
        column.row().prop(properties, "goal", text="")
        cost = properties.check.costs.get(properties.quality)
        if cost is not None and properties.check.folder == properties.photos and not status.running:
            paragraph(
                layout, context, f"About {duration(cost.seconds)}, {gibibytes(cost.memory_gib)} of memory and "
                f"{gibibytes(cost.disk_gib)} of disk",
            )
        if status.running and running.step == "reconstruct":
            draw_progress(layout, status)
        else:
            row = layout.row()
            row.scale_y = 1.6
            row.enabled = bool(properties.photos)
            row.operator("curecon.reconstruct", icon="PLAY")
        if running.step == "reconstruct":
            draw_outcome(layout, context, status)


class CURECON_PT_advanced(AdvancedPanel, bpy.types.Panel):
    bl_idname = "CURECON_PT_advanced"
    bl_parent_id = "CURECON_PT_reconstruct"

    def draw_settings(self, context: bpy.types.Context, properties: bpy.types.PropertyGroup) -> None:
        layout = self.layout
        layout.prop(properties, "max_image_size")
        layout.prop(properties, "views")
        layout.prop(properties, "workspace", placeholder="Beside the photos")
        layout.prop(properties, "model", placeholder="Find the cameras")
        column = layout.column(align=True)
        column.operator("curecon.import_workspace", icon="IMPORT")
        column.operator("curecon.import_model", icon="IMPORT")
        layout.operator("preferences.addon_show", text="Device and Memory...", icon="PREFERENCES").module = ADDON


CLASSES = (CURECON_PT_reconstruct, CURECON_PT_advanced)
