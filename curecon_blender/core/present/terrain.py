# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A plain ground that lies just under a site's own: for pictures, where a record that ends in shreds would float."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..base.ground import LEVEL

CELLS = 96  # a side
REACH = 3.0  # from the middle to the edge, in radii of the site
LOWEST = 10  # percentile of the heights in a cell, above which there are plants
ABOVE = 0.15  # of the site's height: what is level so far above its surroundings is no ground
UNDER = 98  # per cent of the ground lie above the plane
SOLID = 0.35  # of the reach: beyond it the ground melts away
_ROUNDS = 60  # of smoothing what was spread


@dataclass(frozen=True)
class Terrain:
    """`points` (CELLS,CELLS,3) from west to east and south to north; `colours` (CELLS,CELLS,4), linear, with alpha."""

    points: np.ndarray
    colours: np.ndarray

    @property
    def faces(self) -> np.ndarray:
        """Quads (N,4) of the points' numbers, anticlockwise from above."""
        corner = np.arange(CELLS * CELLS).reshape(CELLS, CELLS)
        quads: np.ndarray = np.stack(
            [corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]], axis=-1).reshape(-1, 4)
        return quads


def spread(
    points: np.ndarray, normals: np.ndarray, colours: np.ndarray, centre: np.ndarray, radius: float, height: float,
    far: tuple[float, float, float],
) -> Terrain:
    """The ground of a site, Z up, of a `radius` about `centre` and a `height`, from `points` (N,3) of its surface with
    unit `normals` (N,3) and linear `colours` (N,3); its colour becomes `far` as it melts away. Where nothing lies level
    it is flat, at the lowest point."""
    reach = REACH * radius
    place = (points[:, :2] - centre[:2]) / reach * (CELLS / 2) + CELLS / 2
    inside = ((place >= 0) & (place < CELLS)).all(axis=1) & (normals[:, 2] > LEVEL)
    cell = (place[inside, 1].astype(np.int64) * CELLS + place[inside, 0].astype(np.int64))
    level, shown = points[inside, 2].astype(float), colours[inside].astype(float)
    heights, known = _lowest(cell, level)
    if known.any():
        for _ in range(2):  # what is level and high is a roof, and once it is gone the next one shows
            known &= heights - _spread(heights[..., None], known, 4)[..., 0] < ABOVE * height
        ground = _spread(heights[..., None], known)[..., 0]
        near = level < ground.ravel()[cell] + ABOVE * height
        total = np.stack([np.bincount(cell[near], shown[near, k], CELLS**2) for k in range(3)], axis=1)
        count = np.bincount(cell[near], minlength=CELLS**2).reshape(CELLS, CELLS)
        mean = total.reshape(CELLS, CELLS, 3) / np.maximum(count, 1)[..., None]
        colour = _spread(mean, count > 0)
        ground -= max(0.0, float(np.percentile(ground.ravel()[cell[near]] - level[near], UNDER)))
    else:
        ground = np.full((CELLS, CELLS), points[:, 2].min() if len(points) else centre[2])
        colour = np.broadcast_to(np.array(far), (CELLS, CELLS, 3))
    axis = (np.arange(CELLS) + 0.5) / CELLS * 2 - 1
    x, y = np.meshgrid(axis, axis)
    share = np.clip((1 - np.hypot(x, y)) / (1 - SOLID), 0, 1)
    alpha = share * share * (3 - 2 * share)
    colour = far + alpha[..., None] * (colour - far)
    return Terrain(np.stack([centre[0] + reach * x, centre[1] + reach * y, ground], axis=2),
                   np.concatenate([colour, alpha[..., None]], axis=2))


def _lowest(cell: np.ndarray, heights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The LOWEST percentile of the heights in each cell (CELLS,CELLS), and where there are any."""
    order = np.lexsort((heights, cell))
    count = np.bincount(cell, minlength=CELLS**2)
    known = count > 0
    start = np.cumsum(count) - count
    found = np.zeros(CELLS**2)
    found[known] = heights[order][(start + count * LOWEST // 100)[known]]
    return found.reshape(CELLS, CELLS), known.reshape(CELLS, CELLS)


def _spread(values: np.ndarray, known: np.ndarray, coarsest: int = 1) -> np.ndarray:
    """Values (N,N,C) where `known` (N,N), and smoothly what is around them elsewhere; with a `coarsest` level above 1,
    everywhere the mean of squares of so many cells, spread."""
    weight = known[..., None].astype(float)
    levels = [(values * weight, weight)]
    while len(levels[-1][0]) > 2:
        total, count = levels[-1]
        if len(total) % 2:
            total, count = (np.pad(a, ((0, 1), (0, 1), (0, 0))) for a in (total, count))
        total, count = (a[::2, ::2] + a[1::2, ::2] + a[::2, 1::2] + a[1::2, 1::2] for a in (total, count))
        levels.append((total, count))
    total, count = levels[-1]
    overall = total.sum(axis=(0, 1)) / max(float(count.sum()), 1.0)
    result = np.where(count > 0, total / np.maximum(count, 1), overall)
    for number in range(len(levels) - 2, -1, -1):
        total, count = levels[number]
        finer = result.repeat(2, axis=0).repeat(2, axis=1)[: len(total), : len(total)]
        own = (count > 0) & (2**number >= coarsest)
        result = np.where(own, total / np.maximum(count, 1), finer)
        for _ in range(_ROUNDS // 4 if number else _ROUNDS):
            result = np.where(own, result, _neighbours(result))
    return result


def _neighbours(values: np.ndarray) -> np.ndarray:
    padded = np.pad(values, ((1, 1), (1, 1), (0, 0)), mode="edge")
    result: np.ndarray = (padded[2:, 1:-1] + padded[:-2, 1:-1] + padded[1:-1, 2:] + padded[1:-1, :-2]) / 4
    return result
