# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What lies under the mouse: the nearest shown point of a cloud, or the surface.

The viewport draws clouds itself, so Blender cannot pick them. Their points are projected with numpy, once a view; until
the view changes a look costs only comparisons.
"""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np
from bpy_extras import view3d_utils
from mathutils import Matrix, Vector

from . import points
from .surface import surfaces_of
from .workspace import clouds_of

SNAP_PIXELS = 10.0  # at interface scale 1
FRONT = 4.0  # snap radii, in the scene, behind the foremost point: what is farther back is hidden by it


@dataclass(frozen=True)
class _Projection:
    """A cloud's shown points in a view: `indices` into the cloud (n,), None for all of them, and `rows` (4,n): clip x, y
    and w, and the distance along the view in world units."""

    key: tuple[object, ...]
    indices: np.ndarray | None
    rows: np.ndarray


_projections: dict[int, _Projection] = {}  # by the cloud's session_uid


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
    """Give the projections' memory back."""
    _projections.clear()


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
    seen = _projected(item, region, view)
    x, y, w, depth = seen.rows
    radius = SNAP_PIXELS * context.preferences.system.ui_scale
    # In clip units, so that nothing is divided for points that lie elsewhere; none behind the eye (w < 0) passes.
    aside, above = 2 * mouse[0] / region.width - 1, 2 * mouse[1] / region.height - 1
    near = np.flatnonzero(np.abs(x - np.float32(aside) * w) < np.float32(2 * radius / region.width) * w)
    near = near[np.abs(y[near] - above * w[near]) < 2 * radius / region.height * w[near]]
    if not len(near):
        return None
    foremost = near[depth[near].argmin()]
    pixel = w[foremost] * 2 / (view.window_matrix[1][1] * region.height)  # its size there, in world units
    near = near[depth[near] <= depth[foremost] + FRONT * radius * pixel]
    off = ((x[near] / w[near] - aside) * region.width) ** 2 + ((y[near] / w[near] - above) * region.height) ** 2
    chosen = near[off.argmin()]
    chosen = chosen if seen.indices is None else seen.indices[chosen]
    return np.array(item.matrix_world @ item.data.points[int(chosen)].co)


def _projected(item: bpy.types.Object, region: bpy.types.Region, view: bpy.types.RegionView3D) -> _Projection:
    key = (_numbers(view.perspective_matrix), _numbers(item.matrix_world), region.width, region.height,
           points.shown_key(item))
    known = _projections.get(item.data.session_uid)
    if known is not None and known.key == key:
        return known
    places, indices = points.positions(item.data), points.shown(item)
    if indices is not None:
        places = places[indices]
    clip = np.array(view.perspective_matrix @ item.matrix_world, np.float32)
    eye = np.array(view.view_matrix @ item.matrix_world, np.float32)
    matrix = np.stack([clip[0], clip[1], clip[3], -eye[2]])
    rows = matrix[:, :3] @ places.T
    rows += matrix[:, 3:]
    _projections[item.data.session_uid] = found = _Projection(key, indices, rows)
    return found


def _numbers(matrix: Matrix) -> tuple[float, ...]:
    return tuple(value for row in matrix for value in row)
