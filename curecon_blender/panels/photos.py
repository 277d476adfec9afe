# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""First step: which photos, and what the photo check says of them."""

from __future__ import annotations

import bpy

from .layout import Panel, counted, paragraph

SHOWN_SKIPPED = 6


class CURECON_PT_photos(Panel, bpy.types.Panel):
    bl_idname = "CURECON_PT_photos"
    bl_label = "Photos"

    def draw(self, context: bpy.types.Context) -> None:
        layout, properties = self.layout, context.scene.curecon
        layout.operator("curecon.choose_photos", icon="FILE_FOLDER")
        if not properties.photos:
            paragraph(layout, context, "Or drop photos on the viewport: their whole folder is taken.")
            return
        layout.prop(properties, "photos", text="")
        check = properties.check
        if check.folder != properties.photos:
            layout.operator("curecon.check_photos", icon="VIEWZOOM")
            return
        self._draw_check(context, check)
        layout.operator("curecon.check_photos", text="Check Again", icon="FILE_REFRESH")

    def _draw_check(self, context: bpy.types.Context, check: bpy.types.PropertyGroup) -> None:
        box = self.layout.box()
        column = box.column(align=True)
        column.label(text=f"{counted(check.photos, 'photo')}, {counted(check.cameras, 'camera')}", icon="CHECKMARK")
        if check.gps == check.photos:
            gps = "GPS on all"
        elif check.gps:
            gps = f"GPS on {check.gps} of {check.photos}"
        else:
            gps = "No GPS: scale will be unknown"
        column.label(text=gps, icon="WORLD")
        if check.gsd_mm:
            column.label(text=f"About {check.gsd_mm:.0f} mm on the ground a pixel", icon="DRIVER_DISTANCE")
        if check.blurred_count:
            column.label(text=f"{check.blurred_count} blurred:", icon="ERROR")
            paragraph(box, context, check.blurred if len(check.blurred) < 200 else f"{check.blurred[:200]}...")
            column = box.column(align=True)
        if check.skipped:
            column.label(text=f"{counted(len(check.skipped), 'file')} left out:", icon="ERROR")
            for file in check.skipped[:SHOWN_SKIPPED]:
                paragraph(box, context, f"{file.name}: {file.reason}")
            if len(check.skipped) > SHOWN_SKIPPED:
                box.label(text=f"and {len(check.skipped) - SHOWN_SKIPPED} more")


CLASSES = (CURECON_PT_photos,)
