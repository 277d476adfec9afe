# SPDX-License-Identifier: GPL-3.0-or-later
"""Tulou: annular buildings of earth about a court, with galleries inside.  Z up, metres."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from training.assets import Material, Mesh
from training.procedural import Noise, Placement, Recess, around, gallery_levels, gallery_openings, panel, wall_recesses


def tulou(
    rng: np.random.Generator, earth: Material, roof: Material, wood: Material, noise: Noise,
    carpenter: np.random.Generator | None,
) -> tuple[list[Mesh], float, float]:
    """A Tulou centred on the origin, its outer radius and its height: earth wall, galleries, ring roof, inner rings.
    With a `carpenter` most have galleries that one looks into."""
    radius = rng.uniform(11, 30)
    height = rng.uniform(7, 14)
    power = rng.choice([2.0, 2.0, 2.0, 7.0])
    depth = rng.uniform(3.5, 6.5)
    meshes = _ring(rng, radius, height, depth, power, earth, roof, wood, noise, carpenter)
    inner = radius - depth - rng.uniform(2.5, 5)
    while inner > 5 and rng.random() < 0.6:
        inner_depth = min(rng.uniform(2.5, 4), inner * 0.5)
        meshes += _ring(rng, inner, rng.uniform(3, 5), inner_depth, power, earth, roof, wood, noise, carpenter)
        inner -= inner_depth + rng.uniform(2.5, 4)
    return meshes, radius * (1.0 if power == 2 else 1.3), height + 0.35 * depth


def _ring(
    rng: np.random.Generator,
    radius: float,
    height: float,
    depth: float,
    power: float,
    earth: Material,
    roof: Material,
    wood: Material,
    noise: Noise,
    carpenter: np.random.Generator | None,
) -> list[Mesh]:
    """One annular building: outer wall with batter and small windows, gallery inside, two roof slopes."""
    perimeter = 2 * np.pi * radius
    below = 1.0
    total = height + below
    batter = rng.uniform(0, 0.05)
    amplitude = rng.uniform(0.01, 0.06)

    def rough(points: np.ndarray) -> np.ndarray:
        return amplitude * noise(points, 1.7, 2)

    windows = []
    pitch = rng.uniform(2.5, 5)
    count = int(perimeter / pitch)
    size = rng.uniform(0.4, 0.9)
    for level in np.arange(height - rng.uniform(1.8, 2.6), max(height * 0.4, 2.5), -rng.uniform(2.4, 3.2)):
        for column in range(count):
            if rng.random() < 0.9:
                u = (column + 0.5) * perimeter / count
                v = level + below
                windows.append(Recess(u - size / 2, u + size / 2, v - size * 0.6, v + size * 0.6, -0.35))
    gate = rng.uniform(0.05, 0.95) * perimeter
    windows.append(Recess(gate - 1.6, gate + 1.6, 0, below + 3.4, 0.12))
    windows.append(Recess(gate - 1.1, gate + 1.1, 0, below + 2.9, -0.7))
    outer = panel(
        perimeter,
        total,
        _sunk(around(lambda v: radius + batter * (total - v), perimeter, power, 1.0), below),
        windows,
        rough,
        0.6,
        earth,
    )
    inner_radius = radius - depth
    inside = 2 * np.pi * inner_radius
    storey = rng.uniform(2.3, 3.1)
    gallery = [Recess(-1, inside + 1, -1, total + 1, -rng.uniform(0.5, 1.4))]  # set back behind posts and railings
    posts = max(6, int(inside / rng.uniform(1.8, 3.5)))
    for level in np.arange(0, height, storey):
        gallery.append(Recess(-1, inside + 1, level + below - 0.15, level + below + (0.9 if level else 0.1), 0.0))
    gallery += [Recess(u - 0.1, u + 0.1, 0, total, 0.05) for u in np.arange(posts) * inside / posts + 0.3]
    turned = [Recess(r.u0, r.u1, r.v0, r.v1, -r.offset) for r in gallery]  # outward of this wall is the courtyard
    courtyard = panel(
        inside,
        total,
        _sunk(around(lambda v: inner_radius + 0 * v, inside, power, 1.0), below),
        turned,
        rough,
        0.6,
        wood,
    )
    over_out, over_in = rng.uniform(0.6, 2.2), rng.uniform(0.4, 1.4)
    rise = (depth / 2) * rng.uniform(0.4, 0.75)
    ridge = radius - depth / 2
    roofs = []
    for edge, overhang in ((radius, over_out), (inner_radius, -over_in)):
        eave = edge + overhang
        slope = float(np.hypot(ridge - eave, rise))
        low = height - 0.1 - abs(overhang) * rise / (depth / 2) * 0.5
        round_ = 2 * np.pi * eave

        def outwards(v: np.ndarray, eave: float = eave, slope: float = slope) -> np.ndarray:
            return eave + (ridge - eave) * v / slope

        place = around(outwards, round_, power, (height + rise - low) / slope)
        roofs.append(panel(round_, slope, _sunk(place, -low), [], rough, 0.55, roof))
    if carpenter is not None and carpenter.random() < 0.7:
        return [outer, *_ring_galleries(carpenter, inner_radius, height, depth, power, wood, rough), *roofs]
    return [outer, courtyard, *roofs]


def _ring_galleries(
    rng: np.random.Generator, radius: float, height: float, depth: float, power: float, wood: Material,
    rough: Callable[[np.ndarray], np.ndarray],
) -> list[Mesh]:
    """Galleries about a court of this radius: a front that one looks through, floors, and a dark wall behind."""
    deep, levels, below = min(rng.uniform(0.8, 2.6), 0.7 * depth), gallery_levels(rng, height), 1.0
    inside, behind = 2 * np.pi * radius, 2 * np.pi * (radius + deep)
    dark = replace(wood, sheltered=float(rng.uniform(0.08, 0.5)))

    def upright(at: float, round_: float, cut: list[Recess], size: float, material: Material) -> Mesh:
        turned = [replace(r, v0=r.v0 + below, v1=r.v1 + below, offset=-r.offset) for r in cut]
        place = _sunk(around(lambda v: at + 0 * v, round_, power, 1.0), below)
        return panel(round_, height + below, place, turned, rough, size, material)

    rooms = [r for r in wall_recesses(rng, behind, height) if r.offset < 0]
    meshes = [upright(radius, inside, gallery_openings(rng, inside, levels, height), 0.6, wood),
              upright(radius + deep, behind, rooms, 0.6, dark)]
    for level in levels[1:]:
        for lift in (0.0, -0.12):
            place = _sunk(around(lambda v: radius + v, inside, power, 0.0), -(level + lift))
            meshes.append(panel(inside, deep, place, [], rough, 0.6, dark))
    return meshes


def _sunk(place: Placement, below: float) -> Placement:
    """The placement moved down by `below` metres."""
    return lambda u, v, d: place(u, v, d) - np.array([0, 0, below])
