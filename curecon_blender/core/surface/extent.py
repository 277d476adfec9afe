# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a site ends: what photos saw only from afar is background, not record.

An orbit about a building sees fields and trees behind it, too, at a few times the pixel size, in shreds and rafts. What
counts is the finest ground sampling distance at which any photo has a place in its frame, against that of the cloud.

The building alone is what stands on the ground and is smooth. The ground is the highest surface below all points that
rises no steeper than a ramp; leaves turn every way within an arm's length, walls and roofs do not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from ..base.records import View
from ..cloud.ply import Cloud
from .cells import STEPS, cell_numbers
from .mesh import MeshError

FAR = 3.0  # times the cloud's median ground sampling distance: what no photo shows finer is background
NEAR = 1.5  # times the same: what some photo shows finer is the subject and what lies about it
_CELL = 20.0  # spacings: side of the cubes that are asked first
_COLUMN = 8.0  # spacings: side of the columns that tell what stands on the ground
_FEWEST = 4  # points in a column's lowest cube: fewer are noise below the ground
_RAMP = 0.3  # height over length: steeper ground stands, for all we know
_TALL = 0.25  # of the building's height: a column of it reaches that high
TUFT = 5.0  # spacings: side of the cubes, 27 of which tell whether a place is smooth
_SMOOTH = 0.85  # length of the mean normal over a part that stands: below, it is a tree
_LEAFY = 0.7  # the same about one point: below, it is a leaf, a wire or a shred
_SHARE = 0.1  # of the largest part's area: what stands beside it and is smaller is no part of the subject
_ROUND_COURT = 4  # columns: how far under the eaves about a court its floor is kept
_DOUBT = 1.25  # a cube's points are asked one by one where its middle is that near to the limit


def within(points: np.ndarray, views: Sequence[View], spacing: float, times: float) -> np.ndarray:
    """Which of points (n,3) a photo shows finer than so many times the cloud's median ground sampling distance, (n,)
    bool: all where there are no views."""
    if not views:
        return np.ones(len(points), bool)
    number = cell_numbers(points, points.min(axis=0), _CELL * spacing)
    _, first, cell, count = np.unique(number, return_index=True, return_inverse=True, return_counts=True)
    finest = _sampling_distance(points[first], views)
    order = np.argsort(finest)
    median = finest[order][np.searchsorted(np.cumsum(count[order]), len(points) / 2)]
    limit = times * median
    inside = finest <= limit
    doubtful = (finest > limit / _DOUBT) & (finest < limit * _DOUBT)
    kept: np.ndarray = inside[cell]
    asked = np.flatnonzero(doubtful[cell])
    kept[asked] = _sampling_distance(points[asked], views) <= limit
    return kept


@dataclass(frozen=True)
class Building:
    """What stands on the ground: columns from `low` (2,) on of this `side`, each with its `ground` height (w,h), and
    whether it is part of the building, (w,h) bool, `roofed` or a `court` within. `tall` is its height."""

    low: np.ndarray
    side: float
    ground: np.ndarray
    roofed: np.ndarray
    court: np.ndarray
    tall: float

    def holds(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Which of points (n,3) lie in it: (n,) bool. The ground is part of it in its courts alone."""
        x, y = np.clip(_columns(points, self.low, self.side), 0, np.array(self.ground.shape)[:, None] - 1)
        height = points[:, 2] - self.ground[x, y]
        floor = (height < self.side) & (np.abs(normals[:, 2]) > 1 - _RAMP)
        held: np.ndarray = np.where(floor, self.court[x, y], (self.roofed | self.court)[x, y])
        return held


def find_building(cloud: Cloud, views: Sequence[View], spacing: float) -> tuple[Building, np.ndarray]:
    """The building that `cloud` shows, and which of its points belong to it, (n,) bool: of what stands there the
    largest part, and what is a tenth of that, of which the photos show at least half as finely as the subject. Raises
    MeshError where nothing stands on the ground."""
    side = _COLUMN * spacing
    low = cloud.points[:, :2].min(axis=0) - side
    column = _columns(cloud.points, low, side)
    ground = ground_below(cloud.points[:, 2], column, side)
    height = cloud.points[:, 2] - ground[*column]
    smooth = smoothness(cloud, TUFT * spacing)
    walls = (height > side) & (smooth > _SMOOTH)
    tall = float(np.quantile(height[walls], 0.95)) if walls.any() else 0.0
    stands = np.zeros(ground.shape, bool)
    stands[*column[:, height > max(_TALL * tall, side)]] = True
    part, count = ndimage.label(stands, np.ones((3, 3)))
    above = part[*column][height > side]
    points, straight, near = (np.bincount(above, which, count + 1) for which in (
        None, smooth[height > side], within(cloud.points, views, spacing, NEAR)[height > side]))
    built = (straight >= _SMOOTH * points) & (2 * near >= points)
    size = np.bincount(part[ndimage.binary_fill_holes(stands & built[part])], minlength=count + 1) * built
    size[0] = 0
    if not size.any():
        raise MeshError("Nothing in the cloud stands on the ground as a building does.",
                        remedy="Choose the whole site as the mesh's extent.")
    roofed = (size >= _SHARE * size.max())[part]
    whole = ndimage.binary_fill_holes(roofed)
    court = ndimage.binary_dilation(whole & ~roofed, iterations=_ROUND_COURT) & ndimage.binary_erosion(whole)
    building = Building(low, side, ground, ndimage.binary_dilation(roofed), court, tall)
    return building, building.holds(cloud.points, cloud.normals) & (smooth > _LEAFY)


def _columns(points: np.ndarray, low: np.ndarray, side: float) -> np.ndarray:
    """The columns (2,n) that points (n,3) lie in."""
    numbers: np.ndarray = np.floor((points[:, :2] - low) / side).astype(np.int64).T
    return numbers


def ground_below(heights: np.ndarray, column: np.ndarray, side: float) -> np.ndarray:
    """The ground's height in each column (w,h), from the `heights` (n,) of points and the `column` (2,n) of each."""
    shape = tuple(column.max(axis=1) + 2)
    layer = np.floor((heights - heights.min()) / side).astype(np.int64)
    key = np.ravel_multi_index((*column, layer), (*shape, layer.max() + 1))
    cubes, count = np.unique(key, return_counts=True)
    dense = (count >= _FEWEST)[np.searchsorted(cubes, key)]
    lowest = np.full(shape, np.inf)
    np.minimum.at(lowest, tuple(column[:, dense]), heights[dense])
    lowest = ndimage.rank_filter(lowest, 1, size=3, mode="nearest")  # one that lies lower alone is none
    steps = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
    while True:
        about = np.pad(lowest, 1, constant_values=np.inf)
        ramp = [about[1 + i : 1 + i + shape[0], 1 + j : 1 + j + shape[1]] + _RAMP * side * np.hypot(i, j)
                for i, j in steps]
        ground = np.minimum(lowest, np.min(ramp, axis=0))
        if np.array_equal(ground, lowest):
            return ground
        lowest = ground


def smoothness(cloud: Cloud, side: float) -> np.ndarray:
    """The length (n,) of the mean normal of each point's cube and the 26 about it, each cube by itself."""
    number = cell_numbers(cloud.points, cloud.points.min(axis=0) - 2 * side, side)
    cubes, cube, count = np.unique(number, return_inverse=True, return_counts=True)
    length = np.linalg.norm(cloud.normals, axis=1)
    mean = np.stack([np.bincount(cube, cloud.normals[:, axis] / length) for axis in range(3)], axis=1)
    straight, all_of_them = np.zeros((2, len(cubes)))
    for offset in np.stack(np.meshgrid(*[[-1, 0, 1]] * 3), axis=-1).reshape(-1, 3) @ STEPS:
        at = np.minimum(np.searchsorted(cubes, cubes + offset), len(cubes) - 1)
        there = cubes[at] == cubes + offset
        straight += np.where(there, np.linalg.norm(mean[at], axis=1), 0)
        all_of_them += np.where(there, count[at], 0)
    return (straight / all_of_them)[cube]


def _sampling_distance(places: np.ndarray, views: Sequence[View]) -> np.ndarray:
    """World units a pixel at places (n,3), (n,), in the finest of the views that have them in their frame; infinite
    where none has."""
    finest = np.full(len(places), np.inf)
    for view in views:
        camera = places @ view.cam_from_world[:, :3].T + view.cam_from_world[:, 3]
        depth = camera[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            pixel = (camera @ view.K.T)[:, :2] / depth[:, None]
            inside = (depth > 0) & ((pixel >= 0) & (pixel < [view.width, view.height])).all(axis=1)
        finest[inside] = np.minimum(finest[inside], depth[inside] / view.K[0, 0])
    return finest
