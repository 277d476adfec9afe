# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The ground of a site, closed, and the line where the site ends.

Behind a house, under a bush, in the shade of a wall nobody saw the ground; and the last of it that was seen ends in
tongues and bays, as the photos' frames and what stood before them will have it. Ground goes on: so its holes, and bays
that are not too wide, are closed by a membrane over the rim (no point of it is higher or lower than what was measured
about it), where no photo looks through and no roof stands. Tongues are cut off, but what stands keeps the ground about
it. Both are measured by a disc that rolls along the line from outside and from within.

All is seen from above, in columns.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy import ndimage
from scipy.sparse.linalg import cg

from ..cloud.ply import Cloud
from .continuation import unseen
from .extent import TUFT, ground_below, smoothness
from .sight import Sight, looked_through
from .triangles import unit

_COLUMN = 6.0  # spacings: side of the columns
_MOST_COLUMNS = 1500  # along each side of a site
_TONGUE = 0.05, 0.5  # of the root of the site's area, and of its widest place at most: radius of the disc within
_BAY = 3.0  # times that: radius of the disc outside
_PITCH = 2.0  # spacings between the points that close the ground
_FLAT = 0.7  # of a normal's z: ground at least
_SMOOTH = 0.8  # length of the mean normal about the points of a building, their mean: below, it is a tree
_CLEAR = 4.0  # columns' sides: what is higher above the ground hangs over it
_GROUND = 0.5  # of the rim of a bay: with less ground it stays open
_ROUND = 2.0  # columns over which the outline is rounded
_EXACT = 1e-5  # relative error of the membrane's heights


@dataclass(frozen=True)
class Outline:
    """How far inside a site a place lies: `depth` (w,h) at the middle of columns from `low` (2,) on of this `side`, in
    world units, below 0 outside."""

    low: np.ndarray
    side: float
    depth: np.ndarray

    def depths(self, places: np.ndarray) -> np.ndarray:
        """The depth (n,) float32 of places (n,3)."""
        at = ((places[:, :2] - self.low) / self.side - 0.5).T
        found: np.ndarray = ndimage.map_coordinates(self.depth, at, order=1, mode="nearest")
        return found.astype(np.float32)


@dataclass(frozen=True)
class _Plan:
    """A site from above, in columns from `low` (2,) on of this `side`, all (w,h): which were `seen`, the ground's
    `height`, NaN where it is not known, where something is `hung_over` unknown ground, and what is `built`."""

    low: np.ndarray
    side: float
    seen: np.ndarray
    height: np.ndarray
    hung_over: np.ndarray
    built: np.ndarray

    @cached_property
    def whole(self) -> np.ndarray:
        """What was seen, without holes."""
        closed: np.ndarray = ndimage.binary_fill_holes(ndimage.binary_closing(self.seen))
        return closed

    @cached_property
    def reach(self) -> float:
        """Radius of the disc that rolls within, in columns."""
        widest = float(ndimage.distance_transform_edt(self.whole).max())
        return min(_TONGUE[0] * float(np.sqrt(self.seen.sum())), _TONGUE[1] * widest)


def closed_ground(cloud: Cloud, gaps: Cloud, spacing: float, sight: Sight) -> tuple[Cloud, Outline]:
    """Points (with 0 views) that close the ground of `cloud`, and where the site ends. `gaps` are the points that
    continue its surfaces. Z is up."""
    plan = _from_above(cloud, gaps, spacing)
    inside, outline = _site(plan)
    open_ = _amid_ground(inside & (~plan.seen | plan.hung_over) & ~plan.built, inside, plan)
    # What nobody saw of the ground goes on under the open side of half a house.
    open_ |= plan.built & np.isnan(plan.height) & ~_eroded(~_opened(open_, 0.5 * plan.reach), plan.reach)
    level = _membrane(plan.height, open_)
    points, normals = _spread(level, open_ & np.isfinite(level), plan, spacing)
    made = ~_empty(points, looked_through(points, sight) > 0, plan)
    return unseen(points[made], normals[made], cloud), outline


def _from_above(cloud: Cloud, gaps: Cloud, spacing: float) -> _Plan:
    side = max(_COLUMN * spacing, float(np.ptp(cloud.points[:, :2], axis=0).max()) / _MOST_COLUMNS)
    points, normals = (np.concatenate(arrays) for arrays in (
        (cloud.points, gaps.points), (cloud.normals, gaps.normals)))
    low = points[:, :2].min(axis=0).astype(np.float64)
    column = np.floor((points[:, :2] - low) / side).astype(np.int64).T
    rim = int(_BAY * _TONGUE[0] * np.sqrt((column.max(axis=1) + 1).prod())) + 2
    low, column = low - rim * side, column + rim
    shape = tuple(column.max(axis=1) + 1 + rim)
    measured = column[:, : len(cloud)]
    below = ground_below(cloud.points[:, 2], measured, side)
    ground = np.pad(below, [(0, max(size - had, 0)) for size, had in zip(shape, below.shape, strict=True)], mode="edge")
    above = points[:, 2] - ground[*column]
    floor = (np.abs(above) < side) & (np.abs(normals[:, 2]) > _FLAT)
    count, total = (_sums(column[:, floor], shape, values) for values in (None, points[floor, 2]))
    lowest = np.full(shape, np.inf)
    np.minimum.at(lowest, tuple(column), above)
    high = above[: len(cloud)] > 2 * side
    part = ndimage.label(_sums(measured[:, high], shape) > 0)[0]
    smooth = smoothness(cloud, TUFT * spacing)[high] - _SMOOTH
    built = (np.bincount(part[*measured[:, high]], smooth, part.max() + 1) > 0)[part] & (part > 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return _Plan(low, side, _sums(measured, shape) > 0, total / count,
                     np.isfinite(lowest) & (lowest > _CLEAR * side), built)


def _sums(column: np.ndarray, shape: tuple[int, ...], values: np.ndarray | None = None) -> np.ndarray:
    """The sums (w,h) of the values (n,) of points over the column (2,n) of each; without them, how many there are."""
    found: np.ndarray = np.bincount(np.ravel_multi_index(tuple(column), shape), values, int(np.prod(shape)))
    return found.reshape(shape)


def _site(plan: _Plan) -> tuple[np.ndarray, Outline]:
    """Which columns (w,h) belong to the site, and its outline, which leaves some room about what is built: rounding it
    would cut a thin wall."""
    carries = plan.seen & ~_eroded(~plan.built, plan.reach)
    inside = ~_opened(~(_opened(plan.whole, plan.reach) | carries), _BAY * plan.reach)
    held = inside | ~_eroded(~carries, 2 * _ROUND)
    depth = ndimage.distance_transform_edt(held) - ndimage.distance_transform_edt(~held)
    return inside, Outline(plan.low, plan.side,
                           ndimage.gaussian_filter(depth - 0.5 * np.sign(depth), _ROUND) * plan.side)


def _eroded(inside: np.ndarray, radius: float) -> np.ndarray:
    """Where a disc of this radius, in columns, lies inside."""
    far: np.ndarray = inside if inside.all() else ndimage.distance_transform_edt(inside) > radius
    return far


def _opened(inside: np.ndarray, radius: float) -> np.ndarray:
    """What of it a disc of this radius, in columns, covers as it rolls about inside."""
    return ~_eroded(~_eroded(inside, radius), radius)


def _empty(points: np.ndarray, through: np.ndarray, plan: _Plan) -> np.ndarray:
    """Which of points (n,3) on the ground are empty, (n,) bool: photos look `through` (n,) most of those about them. A
    photo taken near the ground grazes it, and looks through what lies a little too high."""
    column = np.floor((points - np.append(plan.low, 0))[:, :2] / plan.side).astype(np.int64).T
    looked, of = (ndimage.gaussian_filter(_sums(column, plan.seen.shape, which), 0.5 * plan.reach) for which in (
        through, np.ones(len(points))))
    found: np.ndarray = looked[*column] > 0.5 * of[*column]
    return found


def _amid_ground(open_: np.ndarray, inside: np.ndarray, plan: _Plan) -> np.ndarray:
    """What is `open_` (w,h) without the bays that lie mostly between buildings: what is beyond those is not known."""
    part, count = ndimage.label(open_)
    about = ndimage.maximum_filter(part, 3) * ~open_
    rim, ground, outside = (np.bincount(about[which], minlength=count + 1) for which in (
        plan.seen, np.isfinite(plan.height), ~inside))
    kept: np.ndarray = ((outside == 0) | (ground > _GROUND * rim))[part] & open_
    return kept


def _membrane(height: np.ndarray, open_: np.ndarray) -> np.ndarray:
    """Heights (w,h) of a membrane over the columns that are `open_`, which holds on to the heights known beside them
    and ends freely elsewhere; NaN in parts that touch none. Nothing is open in the outermost columns."""
    known = np.isfinite(height) & ~open_
    level = np.where(known, height, np.nan)
    part = ndimage.label(open_)[0]
    inside = open_ & np.isin(part, part[ndimage.binary_dilation(known)])
    count = int(inside.sum())
    if not count:
        return level
    number = np.full(height.shape, -1)
    number[inside] = np.arange(count)
    x, y = np.nonzero(inside)
    diagonal, right, links = np.zeros(count), np.zeros(count), []
    for i, j in ((x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)):
        free, held = inside[i, j], known[i, j]
        links.append(np.stack([np.flatnonzero(free), number[i, j][free]]))
        diagonal += free | held
        right[held] += height[i, j][held]
    link = np.concatenate(links, axis=1)
    matrix = sp.diags_array(diagonal) - sp.csr_array((np.ones(link.shape[1]), tuple(link)), shape=(count, count))
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    level[inside] = cg(matrix, right, height[*nearest][inside], rtol=_EXACT)[0]
    return level


def _spread(
    level: np.ndarray, open_: np.ndarray, plan: _Plan, spacing: float
) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals (n,3) float32 spread evenly over the columns that are `open_`, on a ground of this `level`."""
    x, y = np.nonzero(open_)
    if not len(x):
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32)
    level = level[*ndimage.distance_transform_edt(np.isnan(level), return_distances=False, return_indices=True)]
    slope = np.stack(np.gradient(ndimage.gaussian_filter(level, 1.0), plan.side))
    steps = int(np.ceil(plan.side / (_PITCH * spacing)))
    offset = np.stack(np.meshgrid(*[(np.arange(steps) + 0.5) / steps] * 2), axis=-1).reshape(-1, 2)
    at = (np.stack([x, y], axis=1)[:, None] + offset).reshape(-1, 2)
    z = ndimage.map_coordinates(level, at.T - 0.5, order=1, mode="nearest")
    normals = np.column_stack([-slope[0, x, y], -slope[1, x, y], np.ones(len(x))]).repeat(len(offset), axis=0)
    return np.column_stack([plan.low + plan.side * at, z]).astype(np.float32), unit(normals).astype(np.float32)
