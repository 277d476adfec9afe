# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""`scene.curecon`: what a .blend file remembers of its reconstruction."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from ..core.base.options import PRESETS
from ..scene import cameras, marks, surface, view, viewport
from ..scene.workspace import clouds_of, hide
from . import cloud, control, frame, photos, plan, present, result
from .cloud import CURECON_PG_cloud
from .control import CURECON_PG_control
from .frame import CURECON_PG_measurement
from .photos import CURECON_PG_check
from .plan import CURECON_PG_plan
from .present import CURECON_PG_present
from .result import CURECON_PG_result


def _quality_item(name: str, use: str) -> tuple[str, str, str]:
    preset = PRESETS[name]
    size = "the photos' full size" if preset.image_size > 20_000 else f"photos at {preset.image_size} pixels"
    return name, name.capitalize(), f"{use} Depth from {size}, {preset.source_views} source views"


QUALITIES = (
    _quality_item("preview", "A quick look, to see whether the photos suffice."),
    _quality_item("standard", "A good cloud in reasonable time."),
    _quality_item("high", "Fine detail; several times slower than Standard."),
    _quality_item("ultra", "Everything that the photos hold; for a night's run."),
)
# What Reconstruct ends with, by the worker's last stage.
GOALS = (
    ("fusion", "Point Cloud", "Every measured point with its colour, and nothing else"),
    ("mesh", "Mesh", "A surface with the photos' colours at its vertices"),
    ("texture", "Textured Mesh", "A surface painted with the photos; takes longest"),
)
TEXTURE_SIZES = tuple(
    (str(size), f"{size} px", f"Pages of {size} x {size} pixels, {size * size * 4 / 2**20:.0f} MiB of memory each")
    for size in (1024, 2048, 4096, 8192)
)
TEXTURE_FORMATS = (
    ("png", "PNG", "Exact colours, large files"),
    ("jpeg", "JPEG", "A tenth of the size, with slight losses"),
)
EXTENTS = (
    ("site", "Site", "Without the background that photos saw only from afar: what no photo shows finer than three "
     "times the usual pixel size"),
    ("building", "Building Only", "What stands on the ground of the site, with its courts, without the ground around, "
     "trees and smaller things"),
    ("everything", "Everything Measured", "All that was measured"),
)
LIGHTS = (
    ("PHOTO", "Photos", "The photos' colours as they are, with the light of the day they were taken"),
    ("SCENE", "Scene", "A matte surface in the light of the scene's lamps and sky, on top of the photos' own shadows"),
)
LICENCES = ("All rights reserved", "CC BY 4.0", "CC BY-NC 4.0", "CC BY-SA 4.0", "CC0 1.0")


def _redraw(properties: CURECON_PG_scene, context: bpy.types.Context) -> None:
    viewport.redraw()


def _show_cameras(properties: CURECON_PG_scene, context: bpy.types.Context) -> None:
    cameras.show(context.scene, properties.show_cameras)


def _show_cloud(properties: CURECON_PG_scene, context: bpy.types.Context) -> None:
    hide(clouds_of(properties.id_data), not properties.show_cloud)


def _show_surface(properties: CURECON_PG_scene, context: bpy.types.Context) -> None:
    hide(surface.surfaces_of(properties.id_data), not properties.show_surface)


def _show_marks(properties: CURECON_PG_scene, context: bpy.types.Context) -> None:
    marks.show(surface.surfaces_of(properties.id_data), properties.shown_marks())


def _surface_light(properties: CURECON_PG_scene, context: bpy.types.Context) -> None:
    surface.light(properties.id_data, properties.surface_light == "SCENE")
    view.light(context, properties.surface_light == "SCENE")


def _licences(properties: CURECON_PG_scene, context: bpy.types.Context, typed: str) -> list[str]:
    return [name for name in LICENCES if typed.lower() in name.lower()]


def _can_be_region(properties: CURECON_PG_scene, candidate: bpy.types.Object) -> bool:
    return candidate.type == "MESH" and not surface.is_surface(candidate)


class CURECON_PG_scene(bpy.types.PropertyGroup):
    photos: StringProperty(
        name="Photos", description="The folder with the drone's photos", subtype="DIR_PATH",
    )
    workspace: StringProperty(
        name="Workspace",
        description="Where the work is kept, so that it can be resumed. Empty: the cache folder of the preferences, or "
                    "a folder beside the photos",
        subtype="DIR_PATH",
    )
    model: StringProperty(
        name="COLMAP Model",
        description="A COLMAP model of these photos, whose cameras are used as they are. Empty: find the cameras",
        subtype="DIR_PATH",
    )
    surplus: BoolProperty(
        name="Use Surplus Pictures",
        description="Use pictures, too, that are no photos of this job: thermal ones and single bands beside colour "
        "photos, panoramas, maps, screenshots, copies. Check the photos again after a change",
    )
    quality: EnumProperty(
        name="Quality", description="Detail against time. Preview is for a first look", items=QUALITIES,
        default="preview",
    )
    max_image_size: IntProperty(
        name="Max Image Size", description="Longest side of the depth maps in pixels; 0 takes the quality's own",
        default=0, min=0, soft_max=8000, subtype="PIXEL",
    )
    views: IntProperty(
        name="Source Views", description="Photos that each photo is matched with; 0 takes the quality's own",
        default=0, min=0, max=20,
    )
    display_fraction: FloatProperty(
        name="Display", description="How much of the cloud the viewports show, in per cent; renders show all of it",
        default=100.0, min=0.0, max=100.0, subtype="PERCENTAGE", precision=0, update=cloud.apply,
    )
    point_size: FloatProperty(
        name="Point Size", description="Size of the points in viewports and renders, relative to their spacing",
        default=1.0, min=0.1, soft_max=4.0, max=20.0, step=10, precision=1, update=cloud.apply,
    )
    show_cameras: BoolProperty(
        name="Cameras", description="Show the photos' cameras in the viewport", default=True, update=_show_cameras,
    )
    show_cloud: BoolProperty(
        name="Cloud", description="Show the point cloud in viewports and renders", default=True, update=_show_cloud,
    )
    show_surface: BoolProperty(
        name="Surface", description="Show the surface in viewports and renders", default=True, update=_show_surface,
    )
    show_filled: BoolProperty(
        name="Show Filled",
        description="Tint the faces that no photo measured, in every kind of view and in renders",
        default=False, update=_show_marks,
    )
    show_weak: BoolProperty(
        name="Show Weak",
        description="Tint the faces that one photo alone measured, in every kind of view and in renders",
        default=False, update=_show_marks,
    )
    surface_light: EnumProperty(
        name="Light", description="Whose light falls on the surface, in every kind of shading and in renders",
        items=LIGHTS, default="PHOTO", update=_surface_light,
    )
    goal: EnumProperty(
        name="Result", description="How far Reconstruct goes", items=GOALS, default="fusion",
    )
    fill_holes: BoolProperty(
        name="Fill Holes",
        description="Close the surface where nothing was measured; such faces are marked as filled. Off: holes stay",
        default=True,
    )
    extent: EnumProperty(
        name="Extent", description="How much of what was measured the mesh holds", items=EXTENTS, default="site",
    )
    max_faces: IntProperty(
        name="Max Faces",
        description="Triangles that the mesh may have, up to 50,000,000; 0 takes the quality's own: 250,000 for "
                    "Preview, else 1,000,000",
        default=0, min=0, soft_max=5_000_000, max=50_000_000, step=100_000,
    )
    use_region: BoolProperty(
        name="Region", description="Make the mesh only of what lies inside of the region box", default=False,
    )
    region: PointerProperty(
        type=bpy.types.Object, name="Region Box", poll=_can_be_region,
        description="An object whose bounds, along its own axes, enclose what the mesh is made of and what of the "
                    "cloud is shown or cropped",
        update=cloud.apply,
    )
    shown_detail: StringProperty(
        name="Detail", description="The level of detail at which surfaces come into the scene; empty: the full one",
        options={"HIDDEN"},
    )
    texture_size: EnumProperty(
        name="Page Size", description="Side of a page of the texture, from 1024 to 8192 pixels", items=TEXTURE_SIZES,
        default="4096",
    )
    texture_format: EnumProperty(
        name="Format", description="How the pages are kept in the workspace", items=TEXTURE_FORMATS, default="png",
    )
    pack_textures: BoolProperty(
        name="Pack into .blend",
        description="Keep the texture inside the .blend file, so that it can go without its workspace; the file grows "
                    "by the texture's size. Takes effect at the next import",
        default=False,
    )
    licence: StringProperty(
        name="Licence", description="Written into exported files, such as CC BY 4.0", search=_licences,
        search_options={"SUGGESTION"},
    )
    credit: StringProperty(
        name="Credit", description="Who is to be named with the model; written into exported files",
    )
    check: PointerProperty(type=CURECON_PG_check, name="Photo Check", description="What the photo check said")
    result: PointerProperty(type=CURECON_PG_result, name="Result", description="What the last import brought")
    cloud: PointerProperty(type=CURECON_PG_cloud, description="What of the clouds is shown")
    measurements: CollectionProperty(
        type=CURECON_PG_measurement, name="Distances", description="Distances that were measured in the scene",
    )
    measurement_index: IntProperty(name="Distance", description="The chosen distance on the list", default=0, min=0)
    show_measurements: BoolProperty(
        name="Show Distances", description="Draw the measured distances over the viewports, but not over a photo",
        default=True, update=_redraw,
    )
    control: PointerProperty(type=CURECON_PG_control, name="Control Points", description="Points that were measured")
    plan: PointerProperty(type=CURECON_PG_plan, name="Plan", description="What a flight is planned from")
    present: PointerProperty(type=CURECON_PG_present, name="Present", description="How the site is presented")

    def shown_marks(self) -> tuple[str, ...]:
        """Which of marks.MARKS the user wants tinted."""
        return tuple(mark for mark in marks.MARKS if getattr(self, f"show_{mark}"))


CLASSES = (*photos.CLASSES, *cloud.CLASSES, *result.CLASSES, *frame.CLASSES, *control.CLASSES, *plan.CLASSES,
           *present.CLASSES, CURECON_PG_scene)


def attach() -> None:
    bpy.types.Scene.curecon = PointerProperty(type=CURECON_PG_scene)


def detach() -> None:
    del bpy.types.Scene.curecon
