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

from .core.options import PRESETS
from .scene import cameras, viewport


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


class CURECON_PG_skipped(bpy.types.PropertyGroup):
    """A file that the photo check left out. `name` is the file's."""

    reason: StringProperty()


class CURECON_PG_cost(bpy.types.PropertyGroup):
    """What a quality would cost on this computer, roughly. `name` is the quality."""

    seconds: FloatProperty()
    memory_gib: FloatProperty()
    disk_gib: FloatProperty()


class CURECON_PG_check(bpy.types.PropertyGroup):
    """What the photo check said about the folder `folder`."""

    folder: StringProperty()
    photos: IntProperty()
    cameras: IntProperty()
    gps: IntProperty()
    blurred: StringProperty(description="Names of the blurred photos")
    blurred_count: IntProperty()
    gsd_mm: FloatProperty(description="Ground sampling distance in millimetres, 0 when unknown")
    skipped: CollectionProperty(type=CURECON_PG_skipped)
    costs: CollectionProperty(type=CURECON_PG_cost)


class CURECON_PG_result(bpy.types.PropertyGroup):
    """What the last import brought into the scene."""

    workspace: StringProperty(subtype="DIR_PATH")
    points: IntProperty()
    cameras: IntProperty()
    photos: IntProperty(description="Photos that were given; 0 when unknown")
    parts: IntProperty()
    scale: StringProperty()
    note: StringProperty()


def _redraw(properties: CURECON_PG_scene, context: bpy.types.Context) -> None:
    viewport.redraw()


def _show_cameras(properties: CURECON_PG_scene, context: bpy.types.Context) -> None:
    cameras.show(context.scene, properties.show_cameras)


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
    quality: EnumProperty(
        name="Quality", description="Detail against time", items=QUALITIES, default="standard",
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
        name="Display", description="How much of the cloud the viewport shows in Solid shading; renders show all of it",
        default=100.0, min=0.0, max=100.0, subtype="PERCENTAGE", precision=0, update=_redraw,
    )
    point_size: FloatProperty(
        name="Point Size", description="Size of the points in the viewport, relative to their spacing",
        default=1.0, min=0.1, soft_max=4.0, max=20.0, step=10, precision=1, update=_redraw,
    )
    show_cameras: BoolProperty(
        name="Cameras", description="Show the photos' cameras in the viewport", default=True, update=_show_cameras,
    )
    check: PointerProperty(type=CURECON_PG_check)
    result: PointerProperty(type=CURECON_PG_result)


CLASSES = (CURECON_PG_skipped, CURECON_PG_cost, CURECON_PG_check, CURECON_PG_result, CURECON_PG_scene)


def attach() -> None:
    bpy.types.Scene.curecon = PointerProperty(type=CURECON_PG_scene)


def detach() -> None:
    del bpy.types.Scene.curecon
