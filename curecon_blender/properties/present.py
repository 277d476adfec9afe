# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How the result is presented."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

from math import pi

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, StringProperty

from ..scene import cameras, daylight, render_scene

SCALES = tuple(
    (str(scale), f"1:{scale}", f"1 cm on the paper is {scale / 100:g} m on the building")
    for scale in (20, 50, 100, 200, 500, 1000)
)
QUALITIES = (
    ("DRAFT", "Draft", "Seconds a picture: films of 960 x 540 pixels, sheets of 4 pixels a millimetre (102 dpi)"),
    ("GOOD", "Good", "Minutes a picture: films of 1920 x 1080 pixels, sheets of 8 pixels a millimetre (203 dpi)"),
)
SHEET_LIGHTS = (
    ("PHOTO", "Photos", "An even record: the photos' colours as they are"),
    ("SCENE", "Scene", "With the light and shadows of the scene's lamps and sky, where the surface takes them"),
)
ENGINES = (
    ("CYCLES", "Cycles", "Works on every computer"),
    ("EEVEE", "EEVEE", "Several times faster, where there is a graphics card"),
)


def _overlay(present: CURECON_PG_present, context: bpy.types.Context) -> None:
    camera = present.id_data.camera
    if cameras.is_photo_camera(camera):
        cameras.overlay(camera, present.photo_opacity)


def _sky_only(present: CURECON_PG_present, context: bpy.types.Context) -> None:
    daylight.soften(present.id_data, present.sky_only)


def _quality(present: CURECON_PG_present, context: bpy.types.Context) -> None:
    render_scene.apply_quality(present.id_data)


class CURECON_PG_present(bpy.types.PropertyGroup):
    hour_correction: FloatProperty(
        name="Hour Correction",
        description="Hours from -14 to 14, added to the photos' clock: -1 for summer time where the photos tell no "
                    "time zone, or more for a zone that is not the longitude's or a clock that was wrong",
        default=0.0, min=-14.0, max=14.0, step=25, precision=2,
    )
    sky_only: BoolProperty(
        name="Soft Sky Only",
        description="Leave the sun lamp out and let the sky alone light the surface: no shadows beside those that the "
                    "photos hold already",
        default=False, update=_sky_only,
    )
    latitude: FloatProperty(
        name="Latitude", description="Of the site where the photos do not tell it, -90 to 90 degrees, north positive",
        default=0.0, min=-90.0, max=90.0, precision=4,
    )
    longitude: FloatProperty(
        name="Longitude", description="Of the site where the photos do not tell it, -180 to 180 degrees, east positive",
        default=0.0, min=-180.0, max=180.0, precision=4,
    )
    north: FloatProperty(
        name="North", description="Where north lies when the photos do not tell it, -180 to 180 degrees clockwise from "
                                  "the scene's Y axis, seen from above",
        default=0.0, min=-pi, max=pi, subtype="ANGLE",
    )
    seconds: FloatProperty(
        name="Length", description="Of a camera move, 1 to 600 seconds at the scene's frame rate",
        default=12.0, min=1.0, max=600.0, step=100, precision=1,
    )
    height: FloatProperty(
        name="Height",
        description="Of the camera above the ground, 0 to 10 times the height of the building or of the region box",
        default=2.5, min=0.0, max=10.0, step=10, precision=2,
    )
    start_angle: FloatProperty(
        name="Start Angle", description="Where an orbit begins and a crane stands, 0 to 360 degrees clockwise from the "
                                        "scene's Y axis, seen from above",
        default=pi * 3 / 4, min=0.0, max=2 * pi, subtype="ANGLE",
    )
    photo_opacity: FloatProperty(
        name="Opacity", description="Of the photo over the scene in its camera's view: 0 shows the scene alone, 1 the "
                                    "photo alone",
        default=0.5, min=0.0, max=1.0, subtype="FACTOR", update=_overlay,
    )
    title: StringProperty(
        name="Title", description="Heads the sheets. Empty: the workspace's name",
    )
    sheet_scale: EnumProperty(
        name="Scale", description="Of the elevations on paper, which takes the smallest from A4 to A0 that holds them",
        items=SCALES, default="100",
    )
    facade_turn: FloatProperty(
        name="Turn", description="Added to the building's main direction, -90 to 90 degrees, anticlockwise from above",
        default=0.0, min=-pi / 2, max=pi / 2, subtype="ANGLE",
    )
    sheet_light: EnumProperty(
        name="Light", description="In which the elevations are drawn", items=SHEET_LIGHTS, default="PHOTO",
    )
    sheet_lines: BoolProperty(
        name="Edge Lines", description="Draw a line where the surface ends, steps back or turns", default=False,
    )
    quality: EnumProperty(
        name="Quality", description="Of all that is rendered, with F12 too", items=QUALITIES, default="DRAFT",
        update=_quality,
    )
    engine: EnumProperty(
        name="Engine", description="What renders, with F12 too", items=ENGINES, default="CYCLES", update=_quality,
    )
    folder: StringProperty(
        name="Folder", description="Where the files go. Empty: the folder presentation in the workspace",
        subtype="DIR_PATH",
    )


CLASSES = (CURECON_PG_present,)
