# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Fifth step: light, camera moves, sheets and films of what was reconstructed."""

from __future__ import annotations

import bpy

from ..operators.present_moves import KINDS
from ..scene import cameras, daylight, site
from .layout import Panel, paragraph


class CURECON_PT_present(Panel, bpy.types.Panel):
    bl_idname = "CURECON_PT_present"
    bl_label = "Present"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return bool(context.scene.curecon.result.workspace)  # the step after the cloud

    def draw(self, context: bpy.types.Context) -> None:
        pass  # its parts are panels of their own


class _Part(Panel):
    """A part of the step, folded on its own."""

    bl_parent_id = "CURECON_PT_present"

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.use_property_split = True
        self.layout.use_property_decorate = False
        self.draw_part(context, context.scene.curecon.present)

    def draw_part(self, context: bpy.types.Context, present: bpy.types.PropertyGroup) -> None:
        raise NotImplementedError


class CURECON_PT_present_sun(_Part, bpy.types.Panel):
    bl_idname = "CURECON_PT_present_sun"
    bl_label = "Sun and Sky"

    def draw_part(self, context: bpy.types.Context, present: bpy.types.PropertyGroup) -> None:
        layout, place = self.layout, site.place(context.scene)
        if place.latitude is None:
            paragraph(layout, context, "The photos have no GPS: type in where the site is.", icon="INFO")
            column = layout.column(align=True)
            column.prop(present, "latitude")
            column.prop(present, "longitude")
        if not place.north:
            layout.prop(present, "north")
        layout.prop(present, "hour_correction")
        row = layout.row(align=True)
        row.operator("curecon.set_sun", icon="LIGHT_SUN")
        if daylight.is_shining(context.scene):
            row.operator("curecon.remove_sun", text="", icon="X")


class CURECON_PT_present_moves(_Part, bpy.types.Panel):
    bl_idname = "CURECON_PT_present_moves"
    bl_label = "Camera Moves"

    def draw_part(self, context: bpy.types.Context, present: bpy.types.PropertyGroup) -> None:
        column = self.layout.column(align=True)
        column.prop(present, "seconds", text="Length (s)")
        column.prop(present, "height")
        column.prop(present, "start_angle")
        row = self.layout.row(align=True)
        for kind, label, _ in KINDS:
            row.operator("curecon.move_camera", text=label).kind = kind


class CURECON_PT_present_photos(_Part, bpy.types.Panel):
    bl_idname = "CURECON_PT_present_photos"
    bl_label = "Photo Overlay"

    def draw_part(self, context: bpy.types.Context, present: bpy.types.PropertyGroup) -> None:
        layout, camera = self.layout, context.scene.camera
        row = layout.row(align=True)
        row.operator("curecon.step_photo", text="", icon="TRIA_LEFT").back = True
        row.label(text=camera.name if cameras.is_photo_camera(camera) else "No photo")
        row.operator("curecon.step_photo", text="", icon="TRIA_RIGHT").back = False
        layout.prop(present, "photo_opacity", slider=True)


CLASSES = (
    CURECON_PT_present, CURECON_PT_present_sun, CURECON_PT_present_moves, CURECON_PT_present_photos,
)
