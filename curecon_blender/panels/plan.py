# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Before the photos: a flight for the building."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..scene import flight_plan
from .layout import Panel, action, counted, paragraph


class CURECON_PT_plan(Panel, bpy.types.Panel):
    bl_idname = "CURECON_PT_plan"
    bl_label = "Plan"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout, plan = self.layout, context.scene.curecon.plan
        layout.use_property_split = True
        layout.use_property_decorate = False
        row = layout.row(align=True)
        row.prop(plan, "building")
        row.operator("curecon.add_outline", text="", icon="MESH_CUBE").ring = False
        row.operator("curecon.add_outline", text="", icon="MESH_TORUS").ring = True
        if plan.building is None:
            paragraph(layout, context, "Choose a cloud, or add an outline and scale it onto the building.")
        layout.prop(plan, "kind")
        if plan.kind == "tulou":
            layout.prop(plan, "court")
        layout.prop(plan, "drone")
        layout.prop(plan, "pixel")
        action(layout, "curecon.plan_flight", icon="OUTLINER_OB_CAMERA")
        if plan.photos:
            box = layout.box()
            found = [counted(plan.photos, "{:,} photo", "{:,} photos"),
                     counted(plan.batteries, "{:,} battery", "{:,} batteries"),
                     iface_("{:.0f} min").format(plan.minutes)]
            box.label(text=", ".join(found), icon="CHECKMARK", translate=False)
            paragraph(box, context, iface_("{:.0%} of walls and roofs in three photos or more").format(plan.covered))
            for note in plan.said.splitlines():
                paragraph(box, context, note)
            layout.operator("curecon.fly_along", icon="PLAY", depress=flight_plan.is_flown(context.scene))
            layout.operator("curecon.export_flight", icon="EXPORT")


class CURECON_PT_plan_limits(Panel, bpy.types.Panel):
    bl_idname = "CURECON_PT_plan_limits"
    bl_parent_id = "CURECON_PT_plan"
    bl_label = "Limits and Place"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout, plan = self.layout, context.scene.curecon.plan
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(plan, "forward")
        layout.prop(plan, "side")
        layout.prop(plan, "clearance")
        layout.prop(plan, "ceiling")
        layout.prop(plan, "position")
        layout.prop(plan, "takeoff")
        layout.operator("curecon.take_off_here", icon="PIVOT_CURSOR")


CLASSES = (CURECON_PT_plan, CURECON_PT_plan_limits)
