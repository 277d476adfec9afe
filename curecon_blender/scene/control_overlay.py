# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Control points over the 3D viewports: their places, and in a photo's view their marks, where the next one is
expected, and the loupe while one marks."""

from __future__ import annotations

from itertools import pairwise
from math import cos, pi, sin

import bpy
import gpu
import numpy as np
from mathutils import Vector

from ..core.adjust.control import CHECK, CONTROL
from . import cameras, control, loupe
from .drawing import Drawing
from .overlay import crosses, label, lines, on_screen

COLOURS = {CONTROL: (0.2, 1.0, 0.35, 1.0), CHECK: (1.0, 0.6, 0.1, 1.0)}
OFF_COLOUR, EXPECTED = (0.7, 0.7, 0.7, 1.0), (0.2, 0.9, 1.0, 1.0)
RING_PIXELS = 14.0

mouse: tuple[float, float] | None = None  # of the region in which somebody marks; None where nobody does
marking: int = 0  # that region's area, as a pointer


def colour_of(role: str) -> tuple[float, float, float, float]:
    return COLOURS.get(role, OFF_COLOUR)


def _draw() -> None:
    context = bpy.context
    scene, space = context.scene, context.space_data
    properties = scene.curecon.control
    if not properties.points or not properties.show or not space.overlay.show_overlays:
        return
    gpu.state.blend_set("ALPHA")
    camera = control.photo_camera(space.camera)
    if context.region_data.view_perspective == "CAMERA" and camera is not None and cameras.is_overlaid(space.camera):
        _draw_in_photo(context, camera)
    elif context.region_data.view_perspective != "CAMERA":
        _draw_in_site(context)
    gpu.state.blend_set("NONE")


def _draw_in_site(context: bpy.types.Context) -> None:
    for point in control.of(context.scene).points:
        place = control.place_of(context.scene, point.name)
        if place is None:
            place = control.given_place(context.scene, point.name)
        if place is not None and (end := on_screen(context, place)) is not None:
            crosses(context, [end], colour_of(point.role))
            label(context, end, point.name, colour_of(point.role))


def _draw_in_photo(context: bpy.types.Context, camera: control.PhotoCamera) -> None:
    scene, region, view = context.scene, context.region, context.region_data
    found, chosen = control.of(scene), control.active(scene)
    near: list[tuple[np.ndarray, tuple[float, float, float, float]]] = []
    for point in found.points:
        mark = next((mark for mark in found.marks_of(point.name) if mark.photo == camera.name), None)
        if mark is None:
            continue
        pixel = np.array([mark.x, mark.y])
        near.append((pixel, colour_of(point.role)))
        if (end := control.on_screen(region, view, camera, pixel)) is not None:
            crosses(context, [end], colour_of(point.role))
            label(context, end, point.name, colour_of(point.role))
    place = control.expected(scene, chosen) if chosen else None
    if place is not None and (there := control.pixel_of(camera, place)) is not None:
        near.append((there, EXPECTED))
        if (end := control.on_screen(region, view, camera, there)) is not None:
            _ring(context, end, EXPECTED)
            if not any(mark.photo == camera.name for mark in found.marks_of(chosen)):
                label(context, end, chosen, EXPECTED)
    if mouse is None or context.area.as_pointer() != marking:
        return
    under = control.pixel_under(region, view, camera, mouse)
    if under is not None and loupe.shows(camera.file):
        loupe.draw(context, mouse, under, camera.size, camera.turn, near)


def _ring(context: bpy.types.Context, middle: Vector, colour: tuple[float, ...]) -> None:
    radius = RING_PIXELS * context.preferences.system.ui_scale
    around = [middle + radius * Vector((cos(2 * pi * step / 24), sin(2 * pi * step / 24))) for step in range(25)]
    lines(context, [end for pair in pairwise(around) for end in pair], colour)


drawing = Drawing(_draw, "POST_PIXEL")
