# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The flight that the photo check found, over the 3D viewports until there is a site: where each photo was taken, the
way between them, and the ground that each shows."""

from __future__ import annotations

import bpy
import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader

from . import placing
from .drawing import Drawing
from .points import Bounds

PLACE, WEAK = (0.3, 0.75, 1.0, 1.0), (1.0, 0.55, 0.1, 1.0)  # a photo; one that overlaps too little
WAY, GROUND = (1.0, 1.0, 1.0, 0.35), (0.3, 0.75, 1.0, 0.30)
PLACE_PIXELS, WAY_PIXELS, GROUND_PIXELS = 8.0, 1.5, 1.0


def stations(scene: bpy.types.Scene) -> tuple[np.ndarray, np.ndarray]:
    """Places (N,3) of the photos, and corners of their ground (M,4,3), in the scene's units."""
    entries, scale = scene.curecon.check.stations, placing.unit(scene)
    places = np.array([entry.place for entry in entries], np.float32).reshape(-1, 3)
    plan = np.array([entry.ground for entry in entries if entry.sees_ground], np.float32).reshape(-1, 4, 2)
    corners = np.concatenate([plan, np.zeros((*plan.shape[:2], 1), np.float32)], axis=2)
    return places * scale, corners * scale


def bounds(scene: bpy.types.Scene) -> Bounds | None:
    """What the flight covers; None without one."""
    places, corners = stations(scene)
    if not len(places):
        return None
    every = np.concatenate([places, corners.reshape(-1, 3)])
    return every.min(axis=0), every.max(axis=0)


def _draw() -> None:
    context = bpy.context
    scene = context.scene
    check = scene.curecon.check
    if not (check.show_stations and check.stations and context.space_data.overlay.show_overlays):
        return
    if scene.curecon.result.workspace or check.folder != scene.curecon.photos:  # a site, or other photos
        return
    places, corners = stations(scene)
    edges = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 3)
    gpu.state.blend_set("ALPHA")
    gpu.state.depth_test_set("LESS_EQUAL")
    _lines(context, edges, GROUND, GROUND_PIXELS)
    _lines(context, np.repeat(places, 2, axis=0)[1:-1], WAY, WAY_PIXELS)
    weak = set(check.weak.split(", "))
    far = np.array([entry.name in weak for entry in check.stations])
    shader = gpu.shader.from_builtin("POINT_UNIFORM_COLOR")
    gpu.state.point_size_set(PLACE_PIXELS * context.preferences.system.ui_scale)
    for chosen, colour in ((~far, PLACE), (far, WEAK)):
        if chosen.any():
            shader.uniform_float("color", colour)
            batch_for_shader(shader, "POINTS", {"pos": places[chosen]}).draw(shader)
    gpu.state.depth_test_set("NONE")
    gpu.state.blend_set("NONE")


def _lines(context: bpy.types.Context, ends: np.ndarray, colour: tuple[float, ...], width: float) -> None:
    """Each two of `ends` (2N,3) joined."""
    if not len(ends):
        return
    shader = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
    shader.uniform_float("viewportSize", (context.region.width, context.region.height))
    shader.uniform_float("lineWidth", width * context.preferences.system.ui_scale)
    shader.uniform_float("color", colour)
    batch_for_shader(shader, "LINES", {"pos": ends}).draw(shader)


drawing = Drawing(_draw, "POST_VIEW")
