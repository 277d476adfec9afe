# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene's list of measured distances: what each measures, and how sure that is (see core/site/measuring.py)."""

from __future__ import annotations

import bpy
import numpy as np
from bpy.app.translations import pgettext_iface as iface_
from mathutils import Vector

from ..core.site import measuring
from . import points
from .frame import Part, part_at, part_in, world_matrix


def spread(part: Part, first: np.ndarray, second: np.ndarray) -> float:
    """Standard deviation (world units) that both picks (3,), in the world, give to their distance; from the part's
    cloud, or where there is none from its surface's vertices."""
    items = part.clouds or [item for item in part.collection.all_objects if item.type == "MESH"]
    if not items:
        return 0.0
    item = items[0]
    places, back = points.positions(item.data), world_matrix(item).inverted()
    ends = [np.array(back @ Vector(end.tolist())) for end in (first, second)]
    sigmas = points.vectors(item.data, "sigma") if "sigma" in item.data.attributes else None
    around = [measuring.surroundings(places, end, sigmas) for end in ends]
    return measuring.spread(ends[0], ends[1], (around[0], around[1])) * world_matrix(item).median_scale


def add(scene: bpy.types.Scene, first: np.ndarray, second: np.ndarray) -> bpy.types.PropertyGroup:
    """Put the distance between two places (3,) of the world on the scene's list."""
    properties = scene.curecon
    part = part_at(scene, first)
    measurement = properties.measurements.add()
    measurement.first, measurement.second = first, second
    measurement.spread = spread(part, first, second)
    measurement.part = str(part.folder)
    properties.measurement_index = len(properties.measurements) - 1
    return measurement


def length(measurement: bpy.types.PropertyGroup) -> float:
    """In world units."""
    return float((Vector(measurement.second) - Vector(measurement.first)).length)


def in_words(scene: bpy.types.Scene, measurement: bpy.types.PropertyGroup) -> str:
    """"12.34 m ± 0.03 m", or in units where the scale is unknown, by what is known of its part's scale now."""
    part, found = part_in(scene, measurement.part), length(measurement)
    metres = part is not None and part.collection["scale"] == "metres"
    sigma = part.scale_sigma if part is not None and metres else None
    metre = part.metre if part is not None else 1.0
    plus_minus = measuring.uncertainty(found, measurement.spread, sigma)
    words = measuring.in_words(found / metre, plus_minus / metre, metres=metres)
    return words if metres else words.replace("units", iface_("units"))


def as_text(scene: bpy.types.Scene) -> str:
    """The list as text: one distance a line, then its two ends (scene axes and units), tab-separated."""
    lines = []
    for number, measurement in enumerate(scene.curecon.measurements, start=1):
        ends = "\t".join(" ".join(f"{value:.3f}" for value in end) for end in (measurement.first, measurement.second))
        lines.append(f"{number}\t{in_words(scene, measurement)}\t{ends}")
    return "\n".join(lines)
