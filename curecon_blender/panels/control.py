# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Control points: the list, the chosen point, and marking it."""

from __future__ import annotations

from math import hypot

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..core.adjust.control import ControlPoint
from ..core.adjust.coordinates import WGS84
from ..core.adjust.record import rms
from ..operators import running
from ..scene import control
from .layout import Panel, counted, paragraph

ENOUGH = 3  # control points with two marks each, from which on they alone place the site
MOST_MARKS = 6  # of the chosen point that are listed, the worst first
ICONS = {"control": "PINNED", "check": "CHECKMARK", "off": "UNPINNED"}


class CURECON_UL_control_points(bpy.types.UIList):
    """Control points."""

    def draw_item(
        self, context: bpy.types.Context, layout: bpy.types.UILayout, data: object, item: bpy.types.PropertyGroup,
        icon: int, active_data: object, active_property: str, index: int,
    ) -> None:
        scene = context.scene
        point = control.of(scene).point(item.name)
        if point is None:
            return
        row = layout.row(align=True)
        row.label(text=item.name, icon=ICONS[point.role], translate=False)
        marks = len(control.of(scene).marks_of(item.name))
        right = row.row()
        right.alignment = "RIGHT"
        right.alert = marks == 1
        off = {one.name: one for kind in ("control", "check") for one in control.residuals(scene)[kind]}.get(item.name)
        text = counted(marks, "{} mark", "{} marks")
        if off is not None:
            text = iface_("{:.3f} m, {}").format(hypot(*off.off), text)
        right.label(text=text, translate=False)


class CURECON_PT_control(Panel, bpy.types.Panel):
    bl_idname = "CURECON_PT_control"
    bl_label = "Control Points"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout, scene = self.layout, context.scene
        properties = scene.curecon.control
        row = layout.row(align=True)
        row.operator("curecon.import_control", text="Import", icon="IMPORT")
        row.operator("curecon.export_control", text="Export", icon="EXPORT")
        if not properties.points:
            paragraph(layout, context, "Points that were measured on the site make it true and show how true it is.")
            return
        row = layout.row()
        row.template_list("CURECON_UL_control_points", "", properties, "points", properties, "index",
                          rows=min(8, max(3, len(properties.points))))
        column = row.column(align=True)
        column.operator("curecon.delete_control_point", text="", icon="REMOVE")
        column.prop(properties, "show", text="", icon="HIDE_OFF" if properties.show else "HIDE_ON")
        point = control.of(scene).point(control.active(scene))
        if point is not None:
            self._draw_point(context, point, properties.points[properties.index])
        self._draw_marking(context, properties)
        self._draw_accuracy(context)

    def _draw_point(self, context: bpy.types.Context, point: ControlPoint, item: bpy.types.PropertyGroup) -> None:
        self.layout.row(align=True).prop(item, "role", expand=True)
        column = self.layout.column(align=True)
        column.use_property_split, column.use_property_decorate = True, False
        column.prop(item, "sigma_plan")
        if point.place[2] is not None:
            column.prop(item, "sigma_height")
        paragraph(self.layout, context, coordinates(point), icon="EMPTY_AXIS")
        found = control.errors(context.scene, point.name)
        marks = self.layout.column(align=True)
        listed = control.of(context.scene).marks_of(point.name)
        for mark in sorted(listed, key=lambda mark: -found.get(mark.photo, 0.0))[:MOST_MARKS]:
            row = marks.row(align=True)
            row.label(text=mark.photo, icon="DOT", translate=False)
            off = found.get(mark.photo)
            right = row.row()
            right.alignment = "RIGHT"
            right.label(text="" if off is None else iface_("{:.1f} px").format(off), translate=False)
            remove = row.operator("curecon.set_mark", text="", icon="X", emboss=False)
            remove.point, remove.photo = point.name, mark.photo
        if len(listed) > MOST_MARKS:
            marks.label(text=iface_("and {} that fit better").format(len(listed) - MOST_MARKS), translate=False)

    def _draw_marking(self, context: bpy.types.Context, properties: bpy.types.PropertyGroup) -> None:
        layout = self.layout
        row = layout.row()
        row.scale_y = 1.3
        row.operator("curecon.mark_points", icon="CURSOR")
        layout.operator_menu_enum("curecon.find_targets", "dictionary", icon="VIEWZOOM")
        row = layout.row(align=True)
        row.operator("curecon.show_point", text="Previous Photo", icon="TRIA_LEFT").step = -1
        row.operator("curecon.show_point", text="Next Photo", icon="TRIA_RIGHT").step = 1
        holding, checking = control.ready(context.scene)
        if holding < ENOUGH:
            text = iface_("{} of {} control points are marked in two photos or more.")
            paragraph(layout, context, text.format(holding, ENOUGH), icon="INFO")
        if not checking:
            paragraph(layout, context, "Set one point or more to Check: only they tell how true the site is.",
                      icon="INFO")
        if properties.changed and holding and not running.status.running:
            paragraph(layout, context, "Reconstruct again to use them: matching and mapping are kept.", icon="INFO")
            layout.operator("curecon.reconstruct", text="Reconstruct Again", icon="PLAY")


    def _draw_accuracy(self, context: bpy.types.Context) -> None:
        """Control, check points and points left out stand apart: they tell different things."""
        found = control.residuals(context.scene)
        for kind, icon, words in (
            ("control", "PINNED", "{} control points: {:.3f} m off in plan, {:.3f} m in height (RMS), held by them"),
            ("left_out", "PINNED", "{} left out one by one: {:.3f} m off in plan, {:.3f} m in height (RMS)"),
            ("check", "CHECKMARK", "{} check points: {:.3f} m off in plan, {:.3f} m in height (RMS): so true is it"),
        ):
            if found[kind]:
                plan, height = rms(found[kind])
                paragraph(self.layout, context, iface_(words).format(len(found[kind]), plan, height), icon=icon)


def coordinates(point: ControlPoint) -> str:
    """"UTM 50N: 502345.120, 2728112.334, 423.100", as they were read."""
    x, y, z = point.given
    digits = 8 if point.system == WGS84 else 3
    height = "" if z is None else f", {z:.3f}"
    return f"{iface_(point.system)}: {x:.{digits}f}, {y:.{digits}f}{height}"


CLASSES = (CURECON_UL_control_points, CURECON_PT_control)
