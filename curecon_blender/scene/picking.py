# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What lies under the mouse: the nearest shown point of a cloud, or the surface.

The viewport draws clouds itself, so Blender cannot pick them. Their points are projected with numpy, in pieces that
stay in the processor's cache, so that a look at millions of them takes some hundredths of a second.
"""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np
from bpy_extras import view3d_utils
from mathutils import Vector

from . import display, points
from .surface import surfaces_of
from .workspace import clouds_of

SNAP_PIXELS = 10.0  # at interface scale 1
FRONT = 4.0  # snap radii, in the scene, behind the foremost point: what is farther back is hidden by it


@dataclass(frozen=True)
class _Shown:
    """A cloud's shown points: their `places` (n,3) in its own frame; `key` tells when they are others."""

    key: tuple[object, ...]
    places: np.ndarray


_shown: dict[int, _Shown] = {}  # by the cloud's session_uid


def prepare(context: bpy.types.Context) -> None:
    """Fetch the clouds' points, so that the first look is as quick as the others."""
    for item in clouds_of(context.scene):
        if item.visible_get():
            _places(context, item)


def under(
    context: bpy.types.Context, region: bpy.types.Region, view: bpy.types.RegionView3D, mouse: tuple[float, float]
) -> np.ndarray | None:
    """The place (3,) in the world under `mouse` (pixels of `region`), of whatever is nearest to the eye; or None."""
    origin = view3d_utils.region_2d_to_origin_3d(region, view, mouse)
    direction = view3d_utils.region_2d_to_vector_3d(region, view, mouse)
    hits = [_surface_hit(context, item, origin, direction) for item in surfaces_of(context.scene)
            if item.visible_get()]
    hits += [_cloud_hit(context, item, region, view, mouse) for item in clouds_of(context.scene) if item.visible_get()]
    found = [hit for hit in hits if hit is not None]
    return min(found, key=lambda place: (Vector(place) - origin).dot(direction)) if found else None


def forget() -> None:
    """Give the points' memory back."""
    _shown.clear()


def _surface_hit(
    context: bpy.types.Context, item: bpy.types.Object, origin: Vector, direction: Vector
) -> np.ndarray | None:
    # Not the scene's ray cast, which the region box would stop.
    back = item.matrix_world.inverted()
    start = back @ origin
    hit, place, *_ = item.ray_cast(
        start, (back.to_3x3() @ direction).normalized(), depsgraph=context.evaluated_depsgraph_get()
    )
    return np.array(item.matrix_world @ place) if hit else None


def _cloud_hit(
    context: bpy.types.Context, item: bpy.types.Object, region: bpy.types.Region, view: bpy.types.RegionView3D,
    mouse: tuple[float, float],
) -> np.ndarray | None:
    places = _places(context, item)
    radius = SNAP_PIXELS * context.preferences.system.ui_scale
    aside, above = 2 * mouse[0] / region.width - 1, 2 * mouse[1] / region.height - 1
    reach_x, reach_y = 2 * radius / region.width, 2 * radius / region.height
    clip = np.array(view.perspective_matrix @ item.matrix_world, np.float32)
    # Offsets from the mouse times w, and w: nothing is divided for points that lie elsewhere, and none behind the eye
    # (w < 0) passes.
    matrix = np.stack([clip[0] - np.float32(aside) * clip[3], clip[1] - np.float32(above) * clip[3], clip[3]])
    found = []
    for start in range(0, len(places), display.PIECE):
        x, y, w = matrix[:, :3] @ places[start : start + display.PIECE].T + matrix[:, 3:]
        near = np.flatnonzero((np.abs(x) < reach_x * w) & (np.abs(y) < reach_y * w))
        found.append(np.stack([near + start, x[near] / w[near], y[near] / w[near], w[near]]).astype(np.float64))
    which, x, y, w = np.concatenate(found, axis=1) if found else np.zeros((4, 0))
    if not len(which):
        return None
    near = places[which.astype(int)]
    eye = np.array(view.view_matrix @ item.matrix_world)
    depth = -(near @ eye[2, :3] + eye[2, 3])
    foremost = depth.argmin()
    pixel = w[foremost] * 2 / (view.window_matrix[1][1] * region.height)  # its size there, in world units
    off = (x * region.width) ** 2 + (y * region.height) ** 2
    off[depth > depth[foremost] + FRONT * radius * pixel] = np.inf
    return np.array(item.matrix_world @ Vector(near[off.argmin()].tolist()))


def _places(context: bpy.types.Context, item: bpy.types.Object) -> np.ndarray:
    key, known = display.key(context.scene, item), _shown.get(item.data.session_uid)
    if known is not None and known.key == key:
        return known.places
    places = points.positions(item.data)
    if not (kept := display.shown(context.scene, item, places)).all():
        places = places[kept]
    _shown[item.data.session_uid] = _Shown(key, places)
    return places
