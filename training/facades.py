# SPDX-License-Identifier: GPL-3.0-or-later
"""Facades that one sees through: walls with openings, and arcades and galleries before them.  Z up, metres."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from training.assets import Material, Mesh
from training.procedural import (
    Noise,
    Placement,
    Recess,
    around,
    gallery_levels,
    gallery_openings,
    panel,
    straight,
    wall_recesses,
)


def facade(
    rng: np.random.Generator, walls: Material, stone: Material, noise: Noise
) -> tuple[list[Mesh], float, float, list[Recess]]:
    """A wall that one sees through, centred on the origin and turned to -y, half its width, its height and its
    openings: mostly an arcade before it, and behind it rooms with a roof, or, in a ruin, the sky."""
    width, height, thick = rng.uniform(12, 34), rng.uniform(5, 15), rng.uniform(0.4, 1.2)
    below, amplitude = 1.0, rng.choice([0.01, 0.03, 0.06])

    def rough(points: np.ndarray) -> np.ndarray:
        return amplitude * noise(points, 1.3, 2)

    relief = [r for r in wall_recesses(rng, width, height) if r.offset > 0]
    storeys, bays = max(1, int(height / rng.uniform(3, 5))), max(3, int(width / rng.uniform(2, 5)))
    storey, bay = height / storeys, width / bays
    wide, tall = bay * rng.uniform(0.3, 0.7), storey * rng.uniform(0.4, 0.8)
    holes = [Recess((i + 0.5) * bay - wide / 2, (i + 0.5) * bay + wide / 2, level * storey + 0.2 * storey * (level > 0),
                    level * storey + tall, -thick, open=True)
             for level in range(storeys) for i in range(bays) if rng.random() < 0.85]
    recesses = [Recess(r.u0, r.u1, r.v0 + below * (r.v0 > 0), r.v1 + below, r.offset, r.open) for r in relief + holes]
    back = tuple(Recess(width - r.u1, width - r.u0, r.v0, r.v1, 0.0, open=True) for r in recesses if r.open)
    x, up = np.array([1.0, 0, 0]), np.array([0.0, 0, 1])
    left, right, outward = -width / 2, width / 2, np.array([0, -1.0, 0])

    def sheet(start: tuple[float, float, float], along: np.ndarray, size: tuple[float, float], facing: np.ndarray,
              cut: tuple[Recess, ...] = (), upward: np.ndarray = up) -> Mesh:
        return panel(*size, straight(np.array(start), along, upward, facing), list(cut), rough, 0.5, walls)

    tall_size = (width, height + below)
    meshes = [sheet((left, 0, -below), x, tall_size, outward, tuple(recesses)),
              sheet((right, thick, -below), -x, tall_size, -outward, back)]
    deep = rng.uniform(3, 9) if rng.random() < 0.6 else thick
    meshes += [sheet((left, deep, -below), outward, (deep, height + below), -x),
               sheet((right, 0, -below), -outward, (deep, height + below), x),
               sheet((left, 0, height), x, (width, deep), up, upward=-outward)]
    if deep > thick:
        meshes.append(sheet((right, deep, -below), -x, tall_size, -outward, back if rng.random() < 0.3 else ()))
    if rng.random() < 0.7:
        meshes += _arcade(rng, width, min(height, rng.uniform(3, 6)), stone, rough)
    return meshes, width / 2, height, holes


def galleries(rng: np.random.Generator, half: float, height: float, wood: Material) -> list[Mesh]:
    """Galleries of wood before a facade, from `half` its width: a front that one looks through, and dark floors."""
    deep, levels = rng.uniform(0.9, 2.6), gallery_levels(rng, height)
    dark = replace(wood, sheltered=float(rng.uniform(0.08, 0.5)))
    x, y, up = np.eye(3)

    def sheet(z: float, across: np.ndarray, facing: np.ndarray, size: float, cut: list[Recess], of: Material) -> Mesh:
        place = straight(np.array([-half, -deep, z]), x, across, facing)
        return panel(2 * half, size, place, cut, lambda points: np.zeros(len(points)), 0.6, of)

    meshes = [sheet(0.0, up, -y, height, gallery_openings(rng, 2 * half, levels, height), wood),
              sheet(height, y, up, deep, [], wood), sheet(height - 0.1, y, -up, deep, [], dark)]
    for level in levels[1:]:
        meshes += [sheet(level, y, up, deep, [], dark), sheet(level - 0.12, y, -up, deep, [], dark)]
    return meshes


def panes(rng: np.random.Generator, half: float, holes: list[Recess], glass: Material) -> list[Mesh]:
    """Glass in most of the openings of a facade, from `half` its width."""
    x, y, up = np.eye(3)
    meshes = []
    for hole in holes:
        if rng.random() < 0.7:
            corner = np.array([hole.u0 - half, -0.6 * hole.offset, hole.v0])  # a little more than half way in
            meshes.append(panel(hole.u1 - hole.u0, hole.v1 - hole.v0, straight(corner, x, up, -y), [],
                                lambda points: np.zeros(len(points)), 2.0, glass))
    return meshes


def _arcade(
    rng: np.random.Generator, width: float, height: float, stone: Material, rough: Callable[[np.ndarray], np.ndarray]
) -> list[Mesh]:
    """Columns that stand free before a facade, with a beam on them and, mostly, a roof from it to the wall."""
    away, radius, beam = rng.uniform(1.5, 4), rng.uniform(0.12, 0.45), rng.uniform(0.3, 1.0)
    round_, below, top, front = 2 * np.pi * radius, 1.0, height + beam, -away - radius
    meshes = []
    for at in np.linspace(radius - width / 2, width / 2 - radius, max(3, int(width / rng.uniform(1.6, 4.5)))):
        turn = around(lambda v: radius + 0 * v, round_, rng.choice([2.0, 8.0]), 1.0)

        def place(u: np.ndarray, v: np.ndarray, d: np.ndarray, at: float = at, turn: Placement = turn) -> np.ndarray:
            return turn(u, v, d) + np.array([at, -away, -below])

        meshes.append(panel(round_, height + below, place, [], rough, 0.2, stone))
    x, y, up = np.eye(3)
    for start, across, facing, size in (
        ((-width / 2, front, height), up, -y, beam), ((-width / 2, front + 2 * radius, height), up, y, beam),
        ((-width / 2, front, height), y, -up, 2 * radius), ((-width / 2, front, top), y, up, 2 * radius),
        *([((-width / 2, front, top + 0.02), y, up, -front)] if rng.random() < 0.7 else []),
    ):
        meshes.append(panel(width, size, straight(np.array(start), x, across, facing), [], rough, 0.4, stone))
    return meshes
