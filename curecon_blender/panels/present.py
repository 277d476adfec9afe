# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Fifth step: light, camera moves, sheets and films of what was reconstructed."""

from __future__ import annotations

from collections.abc import Callable

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..languages import translated
from ..operators import rendering
from ..operators.present_moves import KINDS
from ..scene import cameras, daylight, ground, render_scene, site
from .layout import Panel, paragraph


class CURECON_PT_present(Panel, bpy.types.Panel):
    bl_idname = "CURECON_PT_present"
    bl_label = "Present"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return bool(context.scene.curecon.result.workspace)  # the step after the cloud

    def draw(self, context: bpy.types.Context) -> None:
        progress = rendering.progress
        if progress.running:
            label = f"{translated(progress.name)}  {progress.done}/{progress.total}"
            self.layout.progress(factor=max(progress.done - 1, 0) / progress.total, text=label)
            self.layout.label(text="Esc cancels")


class _Part(Panel):
    """A part of the step, folded on its own. A subclass gives `draw_part`."""

    draw_part: Callable[[bpy.types.Context, bpy.types.PropertyGroup], None]
    bl_parent_id = "CURECON_PT_present"

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.use_property_split = True
        self.layout.use_property_decorate = False
        self.draw_part(context, context.scene.curecon.present)


class CURECON_PT_present_sun(_Part, bpy.types.Panel):
    bl_idname = "CURECON_PT_present_sun"
    bl_label = "Sun and Sky"

    def draw_part(self, context: bpy.types.Context, present: bpy.types.PropertyGroup) -> None:
        layout, known = self.layout, site.known(context.scene)
        if known.origin is None:
            paragraph(layout, context, "The photos have no GPS: type in where the site is.", icon="INFO")
            column = layout.column(align=True)
            column.prop(present, "latitude")
            column.prop(present, "longitude")
        if not known.north:
            layout.prop(present, "north")
        layout.prop(present, "hour_correction")
        row = layout.row(align=True)
        row.operator("curecon.set_sun", icon="LIGHT_SUN")
        if daylight.is_shining(context.scene):
            row.operator("curecon.remove_sun", text="", icon="X")
            layout.prop(present, "sky_only")
            if not present.sky_only:
                layout.label(text="Adds to the photos' shadows", icon="INFO")
        row = layout.row(align=True)
        row.operator("curecon.lay_ground", icon="MESH_GRID")
        if ground.is_there(context.scene):
            row.operator("curecon.remove_ground", text="", icon="X")


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
        row.operator("curecon.look_through", text="", icon="TRIA_LEFT").which = "PREVIOUS"
        shown = camera.name if cameras.is_photo_camera(camera) else iface_("No photo")
        row.label(text=shown, translate=False)
        row.operator("curecon.look_through", text="", icon="TRIA_RIGHT").which = "NEXT"
        row = row.row()
        row.enabled = cameras.is_photo_camera(context.active_object)
        row.operator("curecon.look_through", text="", icon="RESTRICT_SELECT_OFF").which = "SELECTED"
        layout.prop(present, "photo_opacity", slider=True)


class CURECON_PT_present_elevations(_Part, bpy.types.Panel):
    bl_idname = "CURECON_PT_present_elevations"
    bl_label = "Elevations"

    def draw_part(self, context: bpy.types.Context, present: bpy.types.PropertyGroup) -> None:
        layout = self.layout
        if site.known(context.scene).metres:
            layout.prop(present, "sheet_scale")
        else:
            paragraph(layout, context, "Scale unknown: the sheets will say so and carry no scale bar.", icon="INFO")
        layout.prop(present, "facade_turn")
        layout.row().prop(present, "sheet_light", expand=True)
        layout.prop(present, "sheet_lines")
        layout.operator("curecon.render_elevations", icon="SNAP_PERPENDICULAR")


class CURECON_PT_present_output(_Part, bpy.types.Panel):
    bl_idname = "CURECON_PT_present_output"
    bl_label = "Pictures and Film"

    def draw_part(self, context: bpy.types.Context, present: bpy.types.PropertyGroup) -> None:
        layout = self.layout
        layout.row().prop(present, "quality", expand=True)
        layout.row().prop(present, "engine", expand=True)
        if (missing := render_scene.missing(context.scene)):
            paragraph(layout, context, missing, icon="ERROR")
        layout.prop(present, "title", placeholder="The workspace's name")
        layout.prop(context.scene.curecon, "credit")
        layout.prop(context.scene.curecon, "licence")
        layout.prop(present, "folder", placeholder="In the workspace")
        layout.operator("curecon.render_still", icon="RENDER_STILL")
        layout.operator("curecon.render_showreel", icon="RENDER_ANIMATION")
        layout.operator("curecon.open_presentation", icon="FILE_FOLDER")


CLASSES = (
    CURECON_PT_present, CURECON_PT_present_sun, CURECON_PT_present_moves, CURECON_PT_present_photos,
    CURECON_PT_present_elevations, CURECON_PT_present_output,
)
