# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Third step: what stands in the scene, and how it is shown."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..languages import translated
from ..scene import comparison, site
from ..scene.notes import TEXT_KEY, is_note
from ..scene.surface import surfaces_of
from ..scene.workspace import clouds_of
from .layout import Panel, counted, paragraph


class CURECON_PT_result(Panel, bpy.types.Panel):
    bl_idname = "CURECON_PT_result"
    bl_label = "Result"

    def draw(self, context: bpy.types.Context) -> None:
        layout, properties = self.layout, context.scene.curecon
        result, clouds = properties.result, clouds_of(context.scene)
        if not result.workspace:
            paragraph(layout, context, "Nothing yet. Reconstruct photos, or import a workspace.")
            layout.operator("curecon.import_workspace", icon="IMPORT")
            return
        box = layout.box()
        column = box.column(align=True)
        count = sum(len(cloud.data.points) for cloud in clouds)
        column.label(text=counted(count, "{:,} point", "{:,} points"), icon="POINTCLOUD_DATA", translate=False)
        if result.photos:
            placed = iface_("{} of {} photos placed").format(result.cameras, result.photos)
        else:
            placed = counted(result.cameras, "{:,} photo placed", "{:,} photos placed")
        column.label(text=placed, icon="CAMERA_DATA", translate=False)
        if result.parts > 1:
            parts = iface_("In {} parts that do not connect").format(result.parts)
            column.label(text=parts, icon="ERROR", translate=False)
        known = site.known(context.scene)
        if known.metres:
            source = iface_("True scale from {}").format(translated(known.scale_source))
            paragraph(box, context, source, icon="DRIVER_DISTANCE")
        else:
            column.label(text="Scale unknown: do not measure", icon="ERROR")
        if known.doubt:
            paragraph(box, context, known.doubt, icon="ERROR")
        if known.note:
            paragraph(box, context, known.note)
        if clouds and properties.show_cloud:
            column = layout.column(align=True)
            column.prop(properties, "display_fraction", slider=True)
            column.prop(properties, "point_size", slider=True)
        if clouds or surfaces_of(context.scene):
            layout.operator("curecon.frame_cloud", icon="VIEWZOOM")
            layout.operator("curecon.accuracy_report", icon="TEXT")
            layout.operator("curecon.export_deliverables", icon="EXPORT")
            _draw_publish(layout, context, result)
            row = layout.row(align=True)
            row.operator("curecon.compare", icon="MOD_DATA_TRANSFER")
            row.operator("curecon.import_comparison", text="", icon="IMPORT")
        if comparison.is_compared(context.active_object):
            _draw_distances(layout, context.active_object)
        row = layout.row(align=True)
        if clouds:
            row.prop(properties, "show_cloud", toggle=True, icon="POINTCLOUD_DATA")
        row.prop(properties, "show_cameras", toggle=True, icon="CAMERA_DATA")


def _draw_distances(layout: bpy.types.UILayout, compared: bpy.types.Object) -> None:
    column = layout.column(align=True)
    column.operator("curecon.colour_comparison", icon="COLOR")
    bars = comparison.histogram(compared)
    most = max(bar.share for bar in bars) or 1.0
    for bar in bars:
        column.progress(factor=bar.share / most, text=f"{bar.low:.3g} – {bar.high:.3g} m: {bar.share:.0%}",
                        translate=False)


def _draw_publish(layout: bpy.types.UILayout, context: bpy.types.Context, result: bpy.types.PropertyGroup) -> None:
    column = layout.column(align=True)
    row = column.row(align=True)
    row.operator("curecon.publish", icon="WORLD")
    if result.published:
        row.operator("curecon.view_pages", text="", icon="URL")
        column.operator("curecon.upload", icon="EXPORT")
    column.operator("curecon.add_note", icon="TEXT")
    note = context.active_object
    if is_note(note):
        column = layout.column(align=True)
        column.prop(note, "name", text="Title")
        column.prop(note, f'["{TEXT_KEY}"]', text="Text")


CLASSES = (CURECON_PT_result,)
