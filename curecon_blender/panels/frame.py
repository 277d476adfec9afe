# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the site's scale, level and north rest on, setting them right, and measuring."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..core.site.adjustment import LEVEL, NORTH, describe
from ..languages import translated
from ..scene import frame, measurements
from .layout import Panel, paragraph


class CURECON_PT_frame(Panel, bpy.types.Panel):
    bl_idname = "CURECON_PT_frame"
    bl_label = "Scale and Position"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return bool(frame.parts_of(context.scene))

    def draw(self, context: bpy.types.Context) -> None:
        layout, part = self.layout, frame.part_of(context)
        adjustment, known = part.adjustment, part.frame
        box = layout.box()
        if len(frame.parts_of(context.scene)) > 1:
            box.label(text=part.collection.name, icon="OUTLINER_COLLECTION", translate=False)
        scale = "Scale unknown: do not measure"
        if part.scale_source:
            scale = iface_("True scale from {}").format(translated(part.scale_source))
        paragraph(box, context, scale, icon="DRIVER_DISTANCE" if part.scale_source else "ERROR")
        level = adjustment.of(LEVEL)
        if level is not None:
            up = iface_("Level from {}").format(translated(level.how))
        else:
            up = {"gps": "Level by GPS", "gravity": "Level as the cameras were held",
                  "given": "Up as the model has it", "control": "Level by control points"}[known.up]
        paragraph(box, context, up, icon="EMPTY_SINGLE_ARROW")
        turn = adjustment.of(NORTH)
        if known.north:
            north = "Y is north"
            if turn is not None:
                north = iface_("Y is north from {}").format(translated(describe(turn)))
        else:
            north = "North unknown"
        paragraph(box, context, north, icon="ORIENTATION_GLOBAL" if known.north else "QUESTION")

        column = layout.column(align=True)
        column.operator("curecon.frame_scale", icon="DRIVER_DISTANCE")
        row = column.row(align=True)
        row.operator("curecon.frame_level", text="Level Floor", icon="MESH_PLANE").plane = "FLOOR"
        row.operator("curecon.frame_level", text="Upright Wall", icon="MOD_SOLIDIFY").plane = "WALL"
        row = column.row(align=True)
        row.operator("curecon.frame_north", text="North", icon="ORIENTATION_GLOBAL")
        row.operator("curecon.frame_turn", icon="LOOP_FORWARDS")
        column.operator("curecon.frame_ground", icon="EMPTY_SINGLE_ARROW")
        column.operator("curecon.frame_reset", icon="LOOP_BACK")
        said = "This .blend holds the site's GPS position." if frame.has_position() else (
            "This .blend holds no GPS position.")
        paragraph(layout, context, said, icon="WORLD")
        layout.operator("curecon.forget_position", icon="X")


class CURECON_UL_measurements(bpy.types.UIList):
    """Measured distances."""

    def draw_item(
        self, context: bpy.types.Context, layout: bpy.types.UILayout, data: object, item: bpy.types.PropertyGroup,
        icon: int, active_data: object, active_property: str, index: int,
    ) -> None:
        layout.label(text=f"{index + 1}   {measurements.in_words(context.scene, item)}", translate=False)


class CURECON_PT_measure(Panel, bpy.types.Panel):
    bl_idname = "CURECON_PT_measure"
    bl_label = "Measure"
    bl_parent_id = "CURECON_PT_frame"

    def draw(self, context: bpy.types.Context) -> None:
        layout, properties = self.layout, context.scene.curecon
        row = layout.row(align=True)
        row.scale_y = 1.3
        row.operator("curecon.measure", icon="ARROW_LEFTRIGHT")
        if not properties.measurements:
            return
        row = layout.row()
        row.template_list("CURECON_UL_measurements", "", properties, "measurements", properties, "measurement_index",
                          rows=min(5, max(2, len(properties.measurements))))
        column = row.column(align=True)
        column.operator("curecon.delete_measurement", text="", icon="REMOVE")
        column.operator("curecon.delete_measurement", text="", icon="TRASH").all = True
        column.operator("curecon.copy_measurements", text="", icon="COPYDOWN")
        layout.prop(properties, "show_measurements", toggle=True, icon="HIDE_OFF")
        paragraph(layout, context, "± holds 19 times out of 20: the points' spacing and scatter, and the scale.")


CLASSES = (CURECON_PT_frame, CURECON_UL_measurements, CURECON_PT_measure)
