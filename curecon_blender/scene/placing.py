# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Where an imported part stands in the scene: in the scene's own unit, and from what is already there as far as their
positions on Earth are apart."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix

from ..core.base import geodesy
from ..core.base.records import UNKNOWN, GeoPosition
from . import frame
from .frame import Part

FARTHEST = 5000.0  # metres from the first part: beyond, float32 would blur what is measured


def unit(scene: bpy.types.Scene) -> float:
    """How long a metre is in the scene, in Blender's units."""
    settings = scene.unit_settings
    return 1.0 if settings.system == "NONE" else 1.0 / settings.scale_length


def place(scene: bpy.types.Scene, parts: list[Part]) -> list[Part]:
    """Stand parts just brought in, the largest first, where they belong. Those whose place on Earth is known keep
    their distance from the first such part in the scene; returns the parts that are too far from it and so are not."""
    stray = []
    for part in parts:
        first = next((other for other in frame.parts_of(scene) if other not in parts[parts.index(part):]
                      and is_placed(other)), None)
        matrix = Matrix.Scale(unit(scene), 4)
        if first is not None and is_placed(part):
            apart = _from(first, part)
            if np.linalg.norm(apart[:3, 3]) <= FARTHEST:
                matrix = first.moved @ Matrix(apart.tolist())
            else:
                stray.append(part)
        frame.stand(part, matrix)
    return stray


def is_placed(part: Part) -> bool:
    """Whether it is known where on Earth each of its points is."""
    known = part.frame
    return known.origin is not None and known.north and known.scale == "metres"


def world_origin(part: Part) -> GeoPosition | None:
    """Where on Earth the world's origin lies, by a part as it stands in the scene; None where nobody knows."""
    origin = part.frame.origin
    if origin is None or not is_placed(part):
        return origin
    place = np.array(part.moved.inverted().translation)
    if np.abs(place).max() < 1e-6:
        return origin
    latitude, longitude, altitude = geodesy.enu_to_geodetic(place[None], origin)[0].tolist()
    return GeoPosition(
        latitude=latitude, longitude=longitude, altitude=None if origin.altitude is None else altitude,
        altitude_datum=origin.altitude_datum)


def world_shift(part: Part) -> tuple[float, float, float] | None:
    """What to add to a part as it stands in the scene to come back to a given model's coordinates; None where that was
    never far off or earth-centred (its origin then tells all), or the part is turned or scaled."""
    shift, moved = part.frame.shift, np.array(part.moved)
    if shift is None or part.frame.origin is not None or np.abs(moved[:3, :3] - np.eye(3)).max() > 1e-6:
        return None
    x, y, z = (np.array(shift) - moved[:3, 3]).tolist()
    return x, y, z


def _from(first: Part, part: Part) -> np.ndarray:
    """The frame of `part` in that of `first`, (4,4); level with it where their altitudes do not compare."""
    origin, other = first.frame.origin, part.frame.origin
    assert origin is not None and other is not None, "both are placed"
    corners = np.concatenate([np.zeros((1, 3)), np.eye(3)])  # metres; Earth bends less than a micrometre over one
    seen = geodesy.geodetic_to_enu(geodesy.enu_to_geodetic(corners, other), origin)
    matrix = np.eye(4)
    axes, _ = np.linalg.qr((seen[1:] - seen[0]).T)
    matrix[:3, :3] = axes * np.sign(np.diag(axes))
    matrix[:3, 3] = seen[0]
    known = None not in (origin.altitude, other.altitude) and origin.altitude_datum == other.altitude_datum != UNKNOWN
    if not known:
        matrix[2, 3] = 0.0
    return matrix
