# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""From where the 3D viewports look, and in what light they show a surface."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Euler, Vector

from . import cameras
from .points import Bounds

AZIMUTH = 145.0  # degrees clockwise from +Y: from where a site is looked at that was taken from all sides


def turn_to(context: bpy.types.Context, bounds: Bounds) -> None:
    """Turn every 3D viewport of the window to what lies in `bounds`, from obliquely above and the side that the photos
    were taken from, with fitting clip planes and without the grid where some of it lies beneath. Viewports in camera
    view leave it."""
    low, high = bounds
    centre, size = (low + high) / 2, float(np.linalg.norm(high - low))
    side = cameras.side(context.scene, centre)
    turn = 180 - (AZIMUTH if side is None else side)
    for area in context.window.screen.areas if context.window is not None else ():
        if area.type != "VIEW_3D":
            continue
        space = area.spaces.active
        view = space.region_3d
        view.view_perspective = "PERSP"
        view.view_location = Vector(centre.tolist())
        view.view_rotation = Euler((np.radians(58), 0, np.radians(turn))).to_quaternion()
        view.view_distance = size * 0.95
        space.clip_start, space.clip_end = size / 2000, size * 50
        if low[2] < 0:  # Blender 5's grid would cut its lines into a cloud beneath it, which is drawn later
            space.overlay.show_floor = False


def show_texture(context: bpy.types.Context, *, textured: bool) -> None:
    """Let Solid shading show the surface's texture or its vertex colours, where it shows plain materials so far."""
    for shading in _shadings(context):
        if shading.color_type in {"MATERIAL", "TEXTURE", "VERTEX"}:
            shading.color_type = "TEXTURE" if textured else "VERTEX"


def shows_lamps(context: bpy.types.Context) -> bool:
    """Whether a viewport of the window shows the scene's lamps and sky; without a window nobody is looking."""
    found = _shadings(context)
    return not found or any(
        shading.type == "RENDERED" or (shading.type == "MATERIAL" and shading.use_scene_lights) for shading in found)


def light(context: bpy.types.Context, by_scene: bool) -> None:
    """Let Solid shading light what it shows, or show colours as they are; a matcap that the user chose stays."""
    for shading in _shadings(context):
        if shading.light in {"STUDIO", "FLAT"}:
            shading.light = "STUDIO" if by_scene else "FLAT"


def _shadings(context: bpy.types.Context) -> list[bpy.types.View3DShading]:
    """Of the 3D viewports of the window."""
    areas = context.window.screen.areas if context.window is not None else ()
    return [area.spaces.active.shading for area in areas if area.type == "VIEW_3D"]
