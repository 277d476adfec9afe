# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Points of a Tulou (the sample site's truth, and a drawn ring), a façade and a ruin, each cloud sampled anew, as two
programs see one building."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from curecon_blender.core.compare.geometry import Similarity, turned

_TRUTH = Path(__file__).parents[1] / "samples" / "tulou" / "truth" / "cloud.npz"


def _plate(rng: np.random.Generator, count: int, corner: tuple, u: tuple, v: tuple) -> np.ndarray:
    a, b = rng.random((2, count, 1))
    points: np.ndarray = np.array(corner) + a * np.array(u) + b * np.array(v)
    return points


def _box(rng: np.random.Generator, density: float, low: tuple, high: tuple) -> np.ndarray:
    (x0, y0, z0), (x1, y1, z1) = low, high
    dx, dy, dz = x1 - x0, y1 - y0, z1 - z0
    sides = [((x0, y0, z0), (dx, 0, 0), (0, 0, dz)), ((x0, y1, z0), (dx, 0, 0), (0, 0, dz)),
             ((x0, y0, z0), (0, dy, 0), (0, 0, dz)), ((x1, y0, z0), (0, dy, 0), (0, 0, dz)),
             ((x0, y0, z1), (dx, 0, 0), (0, dy, 0))]
    return np.concatenate([_plate(rng, max(int(density * np.linalg.norm(np.cross(u, v))), 1), corner, u, v)
                           for corner, u, v in sides])


def ring(rng: np.random.Generator, density: float = 12.0, *, plain: bool = False) -> np.ndarray:
    """An annular house of 40 m with a pitched roof; unless `plain`, with a gate house, a hall and a well."""
    def wall(radius: float, height: float) -> np.ndarray:
        count = int(density * 2 * np.pi * radius * height)
        angle = rng.random(count) * 2 * np.pi
        return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height * rng.random(count)])

    count = int(density * 2 * np.pi * 16 * 9)
    r, angle = np.sqrt(rng.uniform(11.5**2, 20.5**2, count)), rng.random(count) * 2 * np.pi
    roof = np.column_stack([r * np.cos(angle), r * np.sin(angle), 13 - 0.6 * np.abs(r - 16)])
    ground = _plate(rng, int(density * 3600), (-30, -30, 0), (60, 0, 0), (0, 60, 0))
    ground = ground[(np.hypot(*ground[:, :2].T) > 20) | (np.hypot(*ground[:, :2].T) < 12)]
    parts = [wall(20, 10), wall(12, 10), roof, ground]
    if not plain:
        parts += [_box(rng, density, (-5, -3, 0), (4, 3, 5)), _box(rng, density, (3, -23, 0), (9, -19, 6)),
                  _box(rng, density, (5, 6, 0), (6, 7, 1)), _box(rng, density, (-28, 18, 0), (-20, 26, 4))]
    return np.concatenate(parts)


def facade(rng: np.random.Generator, density: float = 40.0) -> np.ndarray:
    """A front of 40 m with piers, a porch off its middle, niches and a gable."""
    wall = _plate(rng, int(density * 40 * 12), (0, 0, 0), (40, 0, 0), (0, 0, 12))
    niche = np.zeros(len(wall), bool)
    for x, z, w, h in ((3, 1, 2, 3), (9, 1, 3, 3), (31, 1, 2, 4), (5, 7, 1.5, 2), (14, 7, 2.5, 2), (34, 6, 4, 3)):
        niche |= (np.abs(wall[:, 0] - x - w / 2) < w / 2) & (np.abs(wall[:, 2] - z - h / 2) < h / 2)
    wall[niche, 1] += 0.8
    gable = _plate(rng, int(density * 60), (14, 0, 12), (12, 0, 0), (0, 0, 5))
    gable = gable[gable[:, 2] - 12 < 5 - np.abs(gable[:, 0] - 20) * 5 / 6]
    ground = _plate(rng, int(density * 40 * 8), (0, -8, 0), (40, 0, 0), (0, 8, 0))
    boxes = [_box(rng, density, (x, -0.7, 0), (x + 1, 0, 11)) for x in (0, 7, 13, 27, 39)]
    return np.concatenate([wall, gable, ground, *boxes, _box(rng, density, (18, -4, 0), (24, 0, 5)),
                           _box(rng, density, (29, -6, 0), (31, -4, 1.5))])


def ruin(rng: np.random.Generator, density: float = 40.0) -> np.ndarray:
    """Broken walls of different heights, rubble, and uneven ground."""
    ground = _plate(rng, int(density * 900), (0, 0, 0), (30, 0, 0), (0, 30, 0))
    ground[:, 2] = 0.5 * np.sin(ground[:, 0] / 3) + 0.4 * np.cos(ground[:, 1] / 4 + ground[:, 0] / 9)
    walls = [_box(rng, density, low, high) for low, high in (
        ((3, 3, 0), (18, 4, 5)), ((3, 3, 0), (4, 20, 3)), ((3, 19, 0), (12, 20, 6)), ((17, 3, 0), (18, 11, 2)),
        ((10, 8, 0), (11, 15, 3.5)), ((22, 22, 0), (26, 25, 2.5)))]
    stones = np.random.default_rng(5)  # the same ones in every cloud
    rubble = [_box(rng, density, tuple(c), tuple(c + s)) for c, s in
              zip(np.column_stack([stones.uniform(0, 28, (25, 2)), np.zeros(25)]), stones.uniform(0.4, 1.8, (25, 3)),
                  strict=True)]
    cloud = np.concatenate([ground, *walls, *rubble])
    tops = (cloud[:, 2] > 4) & (np.sin(cloud[:, 0] * 1.3) > 0.4)  # broken edges
    kept: np.ndarray = cloud[~tops]
    return kept


def tulou(rng: np.random.Generator, count: int = 80_000) -> np.ndarray:
    """True points of the sample site."""
    with np.load(_TRUTH) as truth:
        points = truth["points"].T
        return np.asarray(points[rng.choice(len(points), count, replace=False)] * float(truth["unit"]))


SCENES: dict[str, Callable[[np.random.Generator], np.ndarray]] = {
    "tulou": tulou, "ring": ring, "facade": facade, "ruin": ruin}


def pair(
    name: str, seed: int, overlap: float, *, noise: float = 0.02, scaled: bool = False
) -> tuple[np.ndarray, np.ndarray, Similarity]:
    """A cloud, another of the same scene that shares this part of the length along x, and the motion from the first to
    the second."""
    rng = np.random.default_rng(seed)
    first, second = SCENES[name](rng), SCENES[name](rng)
    first, second = (cloud + rng.normal(0, noise, cloud.shape) for cloud in (first, second))
    if overlap < 1:
        way = rng.random() * 2 * np.pi if name != "facade" else 0.0
        along = np.array([np.cos(way), np.sin(way), 0])
        low, high = (f(first @ along) for f in (np.min, np.max))
        share = 1 / (2 - overlap)  # of the length that each covers
        first = first[first @ along < low + share * (high - low)]
        second = second[second @ along > high - share * (high - low)]
    axis = rng.normal(size=3)
    rotation = turned(axis / np.linalg.norm(axis) * rng.uniform(0, np.pi))
    motion = Similarity(float(rng.uniform(0.4, 2.5)) if scaled else 1.0, rotation, rng.uniform(-50, 50, 3))
    return first, motion.apply(second), motion
