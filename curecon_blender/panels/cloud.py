# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Part of Result: which points of the clouds are shown, in which colours, and taking some out."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..scene import cloud_edits, display
from ..scene.workspace import clouds_of
from .layout import Panel, counted, paragraph


class CURECON_PT_cloud(Panel, bpy.types.Panel):
    bl_idname = "CURECON_PT_cloud"
    bl_label = "Cloud"
    bl_parent_id = "CURECON_PT_result"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return bool(clouds_of(context.scene)) and context.scene.curecon.show_cloud

    def draw(self, context: bpy.types.Context) -> None:
        layout, properties = self.layout, context.scene.curecon
        cloud = properties.cloud
        column = layout.column(align=True)
        column.prop(cloud, "min_confidence", slider=True)
        column.prop(cloud, "min_views", slider=True)
        layout.prop(cloud, "colour_by")
        if cloud.colour_by == display.NORMAL:
            paragraph(layout, context, "Red looks east, green north, blue up")
        elif cloud.colour_by == display.SIGMA and not display.knows_precision(clouds_of(context.scene)):
            paragraph(layout, context, "The precision is not known: run Reconstruct again, without a given model")
        elif cloud.colour_by != display.PHOTO and (node := display.ramp_node()) is not None:
            column = layout.column(align=True)
            row = column.row(align=True)
            for element in node.color_ramp.elements:
                row.prop(element, "color", text="")
            row = column.row(align=True)
            row.prop(cloud, "low", text="")
            row.prop(cloud, "high", text="")
        self._draw_region(properties)
        taken = sum(item.data.get(cloud_edits.COUNT_KEY, 0) for item in clouds_of(context.scene))
        column = layout.column(align=True)
        row = column.row(align=True)
        row.operator("curecon.cloud_crop")
        row.operator("curecon.cloud_delete_region")
        column.operator("curecon.cloud_delete_selected")
        column.operator("curecon.cloud_restore", icon="LOOP_BACK")
        if taken:
            points = counted(taken, "{:,} point", "{:,} points")
            paragraph(layout, context, iface_("{} taken out; the workspace's cloud file is unchanged.").format(points))

    def _draw_region(self, properties: bpy.types.PropertyGroup) -> None:
        row = self.layout.row(align=True)
        row.prop(properties, "region", text="", placeholder="Region Box")
        row.operator("curecon.add_region", text="", icon="ADD")
        row = self.layout.row()
        row.enabled = properties.region is not None
        row.prop(properties.cloud, "only_region")


CLASSES = (CURECON_PT_cloud,)
