# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The sidebar tab CU-Recon of the 3D viewport: Photos, Reconstruct, Result, Surface."""

from __future__ import annotations

import blf
import bpy

from . import ADDON
from .job import Status, duration
from .operators import running
from .operators.running import STAGE_NAMES
from .scene import cameras
from .scene.surface import surfaces_of
from .scene.workspace import clouds_of

SHOWN_SKIPPED = 6


def wrap(text: str, context: bpy.types.Context, indent: int = 0) -> list[str]:
    """`text` in lines that fit the sidebar; `indent` is taken off its width, in pixels at scale 1."""
    preferences = context.preferences
    scale = preferences.system.ui_scale
    blf.size(0, preferences.ui_styles[0].widget.points * scale)
    width = context.region.width - (76 + indent) * scale
    lines: list[str] = []
    for word in text.split():
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and blf.dimensions(0, longer)[0] <= width:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines


def paragraph(
    layout: bpy.types.UILayout, context: bpy.types.Context, text: str, *, icon: str = "NONE", alert: bool = False
) -> None:
    column = layout.column(align=True)
    column.alert = alert
    column.scale_y = 0.8
    for index, words in enumerate(wrap(text, context, indent=28 if icon != "NONE" else 0)):
        column.label(text=words, icon=(icon if index == 0 else "BLANK1") if icon != "NONE" else "NONE")


def counted(count: int, noun: str) -> str:
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {noun}s"


def gibibytes(amount: float) -> str:
    return f"{amount:.1f} GiB" if amount >= 1 else f"{max(amount * 1024, 1):.0f} MiB"


class _Panel:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "CU-Recon"


class CURECON_PT_photos(_Panel, bpy.types.Panel):
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


class CURECON_PT_reconstruct(_Panel, bpy.types.Panel):
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


def draw_outcome(layout: bpy.types.UILayout, context: bpy.types.Context, status: Status) -> None:
    """The last job's warnings, and how it failed if it did."""
    if status.warning_count:
        box = layout.box()
        for text in status.warnings:
            paragraph(box, context, text, icon="ERROR")
        if status.warning_count > len(status.warnings):
            box.label(text=f"and {status.warning_count - len(status.warnings)} earlier warnings")
    if status.failure is not None:
        box = layout.box()
        cancelled = status.failure.kind == "cancelled"
        paragraph(box, context, status.failure.message, icon="INFO" if cancelled else "CANCEL", alert=not cancelled)
        paragraph(box, context, status.failure.remedy)


def draw_progress(layout: bpy.types.UILayout, status: Status) -> None:
    column = layout.column(align=True)
    left = status.seconds_left
    overall = f"{status.overall:.0%}" + (f", {duration(left)} left" if left is not None else "")
    column.progress(factor=status.overall, text="Cancelling..." if status.cancelling else overall)
    column.separator()
    for stage in status.stages:
        name = STAGE_NAMES.get(stage.stage, stage.stage)
        column.progress(factor=stage.fraction, text=f"{name}  {stage.done}/{stage.total}" if stage.total else name)
    if not status.stages:
        column.label(text=f"{status.task}...")
    layout.operator("curecon.cancel", icon="X")


class CURECON_PT_advanced(_Panel, bpy.types.Panel):
    bl_idname = "CURECON_PT_advanced"
    bl_label = "Advanced"
    bl_parent_id = "CURECON_PT_reconstruct"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout, properties = self.layout, context.scene.curecon
        layout.enabled = not running.status.running
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(properties, "max_image_size")
        layout.prop(properties, "views")
        layout.prop(properties, "workspace", placeholder="Beside the photos")
        layout.prop(properties, "model", placeholder="Find the cameras")
        column = layout.column(align=True)
        column.operator("curecon.import_workspace", icon="IMPORT")
        column.operator("curecon.import_model", icon="IMPORT")
        layout.operator("preferences.addon_show", text="Device and Memory...", icon="PREFERENCES").module = ADDON


class CURECON_PT_result(_Panel, bpy.types.Panel):
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
        column.label(text=counted(sum(len(cloud.data.points) for cloud in clouds), "point"), icon="POINTCLOUD_DATA")
        placed = f"{result.cameras} of {result.photos} photos placed" if result.photos else (
            f"{counted(result.cameras, 'photo')} placed")
        column.label(text=placed, icon="CAMERA_DATA")
        if result.parts > 1:
            column.label(text=f"In {result.parts} parts that do not connect", icon="ERROR")
        if result.scale == "metres":
            column.label(text="True scale: 1 unit is 1 metre", icon="DRIVER_DISTANCE")
        else:
            column.label(text="Scale unknown: do not measure", icon="ERROR")
        if result.note:
            paragraph(box, context, result.note)
        if clouds and properties.show_cloud:
            column = layout.column(align=True)
            column.prop(properties, "display_fraction", slider=True)
            column.prop(properties, "point_size", slider=True)
        if clouds or surfaces_of(context.scene):
            layout.operator("curecon.frame_cloud", icon="VIEWZOOM")
        row = layout.row(align=True)
        if clouds:
            row.prop(properties, "show_cloud", toggle=True, icon="POINTCLOUD_DATA")
        row.prop(properties, "show_cameras", toggle=True, icon="CAMERA_DATA")
        row = layout.row()
        sub = row.row(align=True)
        sub.enabled = cameras.is_photo_camera(context.active_object)
        sub.operator("curecon.look_through", text="Look Through")


class CURECON_PT_surface(_Panel, bpy.types.Panel):
    bl_idname = "CURECON_PT_surface"
    bl_label = "Surface"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return bool(context.scene.curecon.result.workspace)  # the step after the cloud

    def draw(self, context: bpy.types.Context) -> None:
        layout, properties, status = self.layout, context.scene.curecon, running.status
        result, found = properties.result, surfaces_of(context.scene)
        if found:
            self._draw_state(result)
        else:
            paragraph(layout, context, "None yet. A mesh closes the cloud to a surface; the texture paints it with "
                      "the photos.")
        if status.running and running.step == "surface":
            draw_progress(layout, status)
        else:
            self._draw_actions(result, bool(found))
        if running.step == "surface":
            draw_outcome(layout, context, status)
        if found:
            row = layout.row(align=True)
            row.prop(properties, "show_surface", toggle=True, icon="MESH_DATA")
            row.prop(properties, "show_filled", toggle=True, icon="OVERLAY")
            row = layout.row(align=True)
            row.label(text="Light")
            row.prop(properties, "surface_light", expand=True)
            layout.operator("curecon.export_surface", icon="EXPORT")

    def _draw_state(self, result: bpy.types.PropertyGroup) -> None:
        column = self.layout.box().column(align=True)
        column.label(text=counted(result.faces, "face"), icon="MESH_DATA")
        column.label(text="Painted with the photos" if result.textured else "Colours at the vertices only",
                     icon="TEXTURE" if result.textured else "COLOR")
        column.label(text=f"{result.filled:.1f} % filled: no photo measured it" if result.filled >= 0.05 else
                     "All of it measured", icon="OVERLAY")

    def _draw_actions(self, result: bpy.types.PropertyGroup, found: bool) -> None:
        """The next action first and large."""
        mesh = ("curecon.build_mesh", "Build Mesh Again" if found else "Build Mesh", "MESH_ICOSPHERE")
        words = "Texture Again" if result.textured else "Texture" if found else "Build and Texture"
        texture = ("curecon.texture", words, "TEXTURE")
        column = self.layout.column(align=True)
        for index, (operator, text, icon) in enumerate(
            (texture, mesh) if found and not result.textured else (mesh, texture)
        ):
            row = column.row(align=True)
            row.scale_y = 1.6 if index == 0 and not result.textured else 1.0
            row.operator(operator, text=text, icon=icon)


class CURECON_PT_surface_advanced(_Panel, bpy.types.Panel):
    bl_idname = "CURECON_PT_surface_advanced"
    bl_label = "Advanced"
    bl_parent_id = "CURECON_PT_surface"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout, properties = self.layout, context.scene.curecon
        layout.enabled = not running.status.running
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(properties, "fill_holes")
        layout.prop(properties, "max_faces")
        row = layout.row(heading="Region")
        row.prop(properties, "use_region", text="")
        sub = row.row()
        sub.enabled = properties.use_region
        sub.prop(properties, "region", text="")
        row.operator("curecon.add_region", text="", icon="ADD")
        layout.separator()
        layout.prop(properties, "texture_size", text="Texture Page")
        layout.prop(properties, "texture_format", expand=True)
        layout.prop(properties, "pack_textures")
        layout.separator()
        layout.prop(properties, "licence")
        layout.prop(properties, "credit")
        if context.scene.view_settings.view_transform != "Standard":
            layout.separator()
            # What Blender starts with tones bright and saturated colours down, the photos' among them.
            layout.prop(context.scene.view_settings, "view_transform")
            paragraph(layout, context, "Standard shows the photos' colours as they are.", icon="INFO")


CLASSES = (
    CURECON_PT_photos, CURECON_PT_reconstruct, CURECON_PT_advanced, CURECON_PT_result, CURECON_PT_surface,
    CURECON_PT_surface_advanced,
)
