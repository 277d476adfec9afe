# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Walls that no photo saw, under the eaves of a roof that photos did see.

A drone sees roofs whole, and nothing of a wall in a narrow lane. A roof mostly juts out alike all around: where walls
were measured under some of its edges, walls stand under its other edges, too, as far in. Each is plumb, from the ground
up to the roof. Where no wall was measured under a roof, as under a shed's on posts, none is made, nor where a photo
looks through.

All is seen from above, in columns. Depth is how far in from the edge of its roof a place lies, below 0 outside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from ..cloud.ply import Cloud
from .continuation import unseen
from .extent import TUFT, ground_below, smoothness
from .sight import FINE, Sight, looked_through

_COLUMN = 3.0  # spacings: side of the columns
_MOST_COLUMNS = 2000  # along each side of a site
_RIM = 16  # columns about the site
_SMOOTH = 0.75  # length of the mean normal about a point of a roof: below, it is a tree
_TALL = 0.15  # of the height of what stands on the site: what is lower is no roof
_UP, _STEEP = 0.4, 0.5  # of a normal's z: of a roof at least, of a wall at most
_LEAST = 100  # columns of a roof
_STEP = 2**0.5 * (1 - _UP**2) ** 0.5 / _UP  # columns that one column is above the next: no roof is so steep
_FACING = 0.6  # cosine between a wall's normal and the direction to the edge over it
_JUTTING = 0.6  # of an eave's height: so far in a wall is looked for
_BETWEEN = 0.1, 0.8  # of the same: what is measured lower or higher is the ground or the edge of the roof
_ABOUT = 5.0  # columns along an edge that decide together
_WALLED, _BARE = 0.3, 0.15  # of an eave's height: walls measured under it that stand, that are none
_BESIDE = 0.5  # of the edge columns within an eave's height, that something was measured beside and far below
_FEWEST = 20  # edge columns with a wall under them that tell how far a roof juts out
_ALIKE = 0.5  # of that length: how much half of them differ at most
_OPEN = 0.2  # of a wall that photos look through: it is none
_APART = 3.0  # columns from what was measured of a wall


@dataclass(frozen=True)
class _Roofs:
    """Roofs from above. Of columns from `low` (2,) on with this `side`: `top` (w,h) of roofs, NaN elsewhere; `depth`
    (w,h); `out` (2,w,h), the unit direction out of the roof; `edge_of` (w,h), the number of the nearest edge column. Of
    edge columns: `places` (e,2), heights of the `ground` before them and of the `eaves` (e,), and their `roof` (e,)."""

    low: np.ndarray
    side: float
    top: np.ndarray
    depth: np.ndarray
    out: np.ndarray
    edge_of: np.ndarray
    places: np.ndarray
    ground: np.ndarray
    eaves: np.ndarray
    roof: np.ndarray

    @property
    def height(self) -> np.ndarray:
        return np.maximum(self.eaves - self.ground, 0)

    def columns(self, points: np.ndarray) -> np.ndarray:
        """The columns (2,n) of points (n,3), the nearest of the grid."""
        number = np.floor((points[:, :2] - self.low) / self.side).astype(np.int64)
        return np.clip(number, 0, np.array(self.top.shape) - 1).T

    def along_edges(self, values: np.ndarray, reach: np.ndarray | float = 0.0) -> np.ndarray:
        """Values (e,) of edge columns, each the mean of those within `reach` (e,) of it, and of a few at least."""
        about = cKDTree(self.places).query_ball_point(self.places, np.maximum(reach, _ABOUT * self.side))
        return np.array([values[which].mean() for which in about])


def under_eaves(cloud: Cloud, gaps: Cloud, spacing: float, sight: Sight) -> Cloud:
    """Points (with 0 views), about one a spacing, of the walls that nobody saw under the eaves of `cloud`. `gaps` are
    the points that continue its walls."""
    roofs = _find_roofs(cloud, spacing)
    points, normals, edge = np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, np.int64)
    if len(roofs.places):
        steep = [part.take(np.abs(part.normals[:, 2]) < _STEEP) for part in (cloud, gaps)]
        walls = np.concatenate([part.points for part in steep]).astype(np.float64)
        facing = np.concatenate([part.normals for part in steep]).astype(np.float64)
        juts = np.where(_ends(roofs, cloud.points), _juts(roofs, walls, facing), np.nan)
        points, normals, edge = _stand(roofs, juts, spacing)
        apart = _APART * roofs.side
        alone = np.isinf(cKDTree(walls).query(points, distance_upper_bound=apart, workers=-1)[0]) if len(walls) else (
            np.ones(len(points), bool))
        points, normals, edge = points[alone], normals[alone], edge[alone]
    if len(points):
        through = looked_through(points.astype(np.float32), sight, FINE) > 0
        open_, of = (roofs.along_edges(np.bincount(edge, which, len(roofs.places))) for which in (through, None))
        kept = ~through & (open_ < _OPEN * of)[edge]
        points, normals = points[kept], normals[kept]
    return unseen(points, normals, cloud)


def _find_roofs(cloud: Cloud, spacing: float) -> _Roofs:
    """What is smooth, looks up and stands high."""
    side = max(_COLUMN * spacing, float(np.ptp(cloud.points[:, :2], axis=0).max()) / _MOST_COLUMNS)
    low = cloud.points[:, :2].min(axis=0).astype(np.float64) - _RIM * side
    column = np.floor((cloud.points[:, :2] - low) / side).astype(np.int64).T
    ground = np.pad(ground_below(cloud.points[:, 2], column, side), (0, _RIM), mode="edge")
    height = cloud.points[:, 2] - ground[*column]
    smooth = smoothness(cloud, TUFT * spacing) > _SMOOTH
    standing = height[smooth & (height > 2 * side)]
    tall = _TALL * float(np.quantile(standing, 0.95)) if len(standing) else np.inf
    roof = smooth & (cloud.normals[:, 2] > _UP) & (height > tall)
    top = np.full(ground.shape, -np.inf)
    np.maximum.at(top, tuple(column[:, roof]), cloud.points[roof, 2])
    top[np.isinf(top)] = np.nan
    closed = ndimage.binary_closing(np.isfinite(top))
    level = top[*ndimage.distance_transform_edt(np.isnan(top), return_distances=False, return_indices=True)]
    under_another = ndimage.maximum_filter(np.where(closed, level, -np.inf), 3) - level > _STEP * side
    covered = ndimage.binary_opening(closed & ~under_another, iterations=2)
    part = ndimage.label(covered, np.ones((3, 3)))[0]
    large = np.bincount(part.ravel()) >= _LEAST
    large[0] = False
    covered = ndimage.binary_fill_holes(large[part])
    hole = ndimage.label(covered & ~large[part])[0]
    covered &= (np.bincount(hole.ravel()) < _LEAST)[hole] | large[part]
    depth = ndimage.distance_transform_edt(covered) - ndimage.distance_transform_edt(~covered)
    depth = ndimage.gaussian_filter(depth - 0.5 * np.sign(depth), 1.5) * side
    out = -np.stack(np.gradient(depth, side))
    out /= np.maximum(np.linalg.norm(out, axis=0), 1e-9)
    edge = covered & ~ndimage.binary_erosion(covered)
    x, y = np.nonzero(edge)
    number = np.zeros(edge.shape, np.int64)
    number[edge] = np.arange(len(x))
    edge_of = number[*ndimage.distance_transform_edt(~edge, return_distances=False, return_indices=True)]
    lowest = -ndimage.maximum_filter(np.where(np.isfinite(top), -top, -np.inf), 3)
    return _Roofs(low, side, top, depth, out, edge_of, low + side * (np.stack([x, y], axis=1) + 0.5), ground[x, y],
                  np.where(np.isfinite(lowest), lowest, ground)[x, y], part[x, y])


def _ends(roofs: _Roofs, points: np.ndarray) -> np.ndarray:
    """Whether a roof truly ends at each edge column, (e,) bool: some of `points` (n,3) lie far below, just outside,
    along most of the edge about it. Else that may be as far as photos saw it, such as a ridge from the ground."""
    column = roofs.columns(points)
    edge, depth = roofs.edge_of[*column], roofs.depth[*column]
    height = roofs.height[edge]
    below = (depth < 0) & (depth > -_JUTTING * height) & (points[:, 2] < roofs.ground[edge] + 0.5 * height)
    return roofs.along_edges(np.bincount(edge[below], minlength=len(roofs.places)) > 0, roofs.height) > _BESIDE


def _juts(roofs: _Roofs, walls: np.ndarray, facing: np.ndarray) -> np.ndarray:
    """How far in from each edge column (e,) an unseen wall stands under it; NaN where one was measured or none is
    known to stand. `walls` (n,3) are places on walls, which look to `facing`."""
    column = roofs.columns(walls)
    edge, height = roofs.edge_of[*column], roofs.height
    at = ((walls[:, :2] - roofs.low) / roofs.side - 0.5).T
    depth = ndimage.map_coordinates(roofs.depth, at, order=1, mode="nearest")
    share = (walls[:, 2] - roofs.ground[edge]) / np.maximum(height[edge], roofs.side)
    outwards = (facing[:, :2].T * roofs.out[:, *column]).sum(axis=0) > _FACING
    under = outwards & (depth > -2 * roofs.side) & (depth < _JUTTING * height[edge]) & (
        share > _BETWEEN[0]) & (share < _BETWEEN[1])
    edge, depth, level = edge[under], depth[under], np.floor(walls[under, 2] / roofs.side).astype(np.int64)
    count = len(roofs.places)
    storeys = np.bincount(np.unique(np.stack([edge, level]), axis=1)[0], minlength=count) * roofs.side
    measured = roofs.along_edges(storeys / np.maximum(height, roofs.side))
    juts = np.full(count, np.nan)
    for roof in np.unique(roofs.roof):
        own = roofs.roof == roof
        told = depth[(own & (measured > _WALLED))[edge]]
        if np.isin(np.flatnonzero(own & (measured > _WALLED)), edge).sum() < _FEWEST:
            continue
        middle, width = _narrowest_half(told)
        if width < _ALIKE * middle:
            juts[own & (measured < _BARE)] = middle
    return juts


def _narrowest_half(values: np.ndarray) -> tuple[float, float]:
    """The middle and the width of the narrowest interval that holds half of the values (n,)."""
    values, half = np.sort(values), len(values) // 2
    widths = values[half:] - values[: len(values) - half]
    first = int(widths.argmin())
    return float(values[first] + values[first + half]) / 2, float(widths[first])


def _stand(roofs: _Roofs, juts: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points and normals (n,3) of walls so far in from the edges, and the edge column (n,) that each is under."""
    wanted = juts[roofs.edge_of]
    with np.errstate(invalid="ignore"):
        x, y = np.nonzero((roofs.depth > 0) & (np.abs(roofs.depth - wanted) < 0.75 * roofs.side))
    edge, out = roofs.edge_of[x, y], roofs.out[:, x, y].T
    foot = roofs.low + roofs.side * (np.stack([x, y], axis=1) + 0.5) + (roofs.depth - wanted)[x, y, None] * out
    under = roofs.top[x, y] - roofs.side
    high = np.where(np.isfinite(under), np.maximum(under, roofs.eaves[edge]), roofs.eaves[edge]) - roofs.ground[edge]
    rows = np.maximum(np.ceil(high / spacing), 0).astype(np.int64)
    steps = (np.arange(-1.5, 2) / 4) * roofs.side
    column = np.repeat(np.arange(len(rows)), rows)
    row = np.arange(len(column)) - np.repeat(np.cumsum(rows) - rows, rows)
    level = roofs.ground[edge[column]] + (row + 0.5) * spacing
    along = np.stack([-out[:, 1], out[:, 0]], axis=1)[column]
    points = np.concatenate([np.column_stack([foot[column] + step * along, level]) for step in steps])
    normals = np.column_stack([out[column], np.zeros(len(column))])
    return points, np.tile(normals, (len(steps), 1)), np.tile(edge[column], len(steps))
