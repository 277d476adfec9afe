# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Drawn over the 3D viewports: measured distances with their lengths, and what is being picked."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import blf
import bpy
import gpu
import numpy as np
from bpy_extras import view3d_utils
from gpu_extras.batch import batch_for_shader
from mathutils import Vector

from . import cameras, measurements
from .drawing import Drawing

LINE = (1.0, 0.85, 0.2, 1.0)  # measured
PICK = (0.2, 0.9, 1.0, 1.0)  # being picked
SHADE = (0.0, 0.0, 0.0, 0.65)
CROSS_PIXELS = 7.0
TEXT_POINTS = 12.0

picked: list[np.ndarray] = []  # places (3,) in the world that the running operator has so far
hover: np.ndarray | None = None  # and the one under the mouse


def _draw() -> None:
    context = bpy.context
    scene = context.scene
    gpu.state.blend_set("ALPHA")
    space = context.space_data
    through_photo = context.region_data.view_perspective == "CAMERA" and cameras.is_overlaid(space.camera)
    if scene.curecon.show_measurements and space.overlay.show_overlays and not through_photo:
        for measurement in scene.curecon.measurements:
            ends = [on_screen(context, place) for place in (measurement.first, measurement.second)]
            if ends[0] is not None and ends[1] is not None:
                lines(context, [ends[0], ends[1]], LINE)
                crosses(context, ends, LINE)
                label(context, (ends[0] + ends[1]) / 2, measurements.in_words(scene, measurement), LINE)
    places = [*picked, *([hover] if hover is not None else [])]
    ends = [end for place in places if (end := on_screen(context, place)) is not None]
    if ends:
        lines(context, [end for pair in pairwise(ends) for end in pair], PICK)
        crosses(context, ends, PICK)
        for number, end in enumerate(ends[: len(picked)]):
            label(context, end, str(number + 1), PICK)
    gpu.state.blend_set("NONE")


def on_screen(context: bpy.types.Context, place: Sequence[float] | np.ndarray) -> Vector | None:
    found: Vector | None = view3d_utils.location_3d_to_region_2d(context.region, context.region_data, Vector(place))
    return found


def lines(context: bpy.types.Context, ends: list[Vector], colour: tuple[float, ...]) -> None:
    """Each two of `ends` (pixels) joined by a line with a dark edge, which is seen on bright walls too."""
    if not ends:
        return
    shader = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
    batch = batch_for_shader(shader, "LINES", {"pos": [(end.x, end.y, 0.0) for end in ends]})
    scale = context.preferences.system.ui_scale
    shader.uniform_float("viewportSize", (context.region.width, context.region.height))
    for width, shade in ((4.0, SHADE), (2.0, colour)):
        shader.uniform_float("lineWidth", width * scale)
        shader.uniform_float("color", shade)
        batch.draw(shader)


def crosses(context: bpy.types.Context, ends: list[Vector], colour: tuple[float, ...]) -> None:
    arm = CROSS_PIXELS * context.preferences.system.ui_scale
    lines(context, [end + Vector(side) * arm for end in ends for side in ((-1, 0), (1, 0), (0, -1), (0, 1))], colour)


def label(context: bpy.types.Context, place: Vector, text: str, colour: tuple[float, ...]) -> None:
    scale = context.preferences.system.ui_scale
    blf.size(0, TEXT_POINTS * scale)
    width, height = blf.dimensions(0, text)
    x, y, pad = place.x + 10 * scale, place.y + 10 * scale, 4 * scale
    gpu.state.blend_set("ALPHA")  # which drawing text leaves switched off
    shader = gpu.shader.from_builtin("UNIFORM_COLOR")
    box = [(x - pad, y - pad), (x + width + pad, y - pad), (x + width + pad, y + height + pad),
           (x - pad, y + height + pad)]
    shader.uniform_float("color", SHADE)
    batch_for_shader(shader, "TRIS", {"pos": [(*box[i], 0.0) for i in (0, 1, 2, 0, 2, 3)]}).draw(shader)
    blf.position(0, x, y, 0)
    blf.color(0, *colour)
    blf.draw(0, text)


drawing = Drawing(_draw, "POST_PIXEL")
