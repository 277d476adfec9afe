# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Where nothing was measured, a wall goes on as a wall: points that continue the surfaces about a hole.

Photos from the air leave out the top of a wall under its eave, its shaded foot, the middle of a façade behind a tree.
What was measured about such a place is mostly smooth and bent in one direction: plane, cylinder or cone. So about every
square metre or so a sheet is fitted to the measured points, flat along the slope and curved across it. A gap in it is
closed along lines that begin and end on what was measured: on the sheet itself, or, up and down a wall, on the roof or
the ground that it meets, or, on level ground, on the wall that it meets. Where a recess lies behind the gap or a photo
looks through it, it is none. Trees and rubble fit no sheet and are left alone. On a sixth of the sample site, the
gate's, 87 % of what closes walls and 93 % of what closes roofs and ground lies within 20 cm of the truth; where gaps
need not end on something, 20 and 45 %.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from ..cloud.ply import Cloud
from .cells import cell_numbers
from .sheets import BLOCKED, CELL, EMPTY, GAP, HEIGHT, OWN, RECESS, WIDTH, fit_sheets, gather
from .sight import FINE, Sight, looked_through

_DENSE = 2  # points for each node of the lattice, along each side
_WIDER = 2  # times as wide cells, for gaps of walls that are too wide for sheets of the first size
_APART = 2.0  # of their spacings: so far from all that is known, wider cells close
_UPRIGHT = 0.2  # of a normal's z at most: a wall, and no steep roof
_LEVEL = 0.95  # of a normal's z: ground and floors, which go on until they meet a wall
# How firmly a wall is held plumb: as by the points of a strip some ten cells high. Where a wall is seen at a slant,
# or by few photos, what was measured of it leans; on its way up to the eave that would add up.
_PLUMB = 5e3
_SLIT = 5  # nodes between two closed parts of a wall that are closed with them
_compiled: Any = njit(nogil=True, error_model="numpy")


def continued(cloud: Cloud, spacing: float, sight: Sight) -> Cloud:
    """Points (with 0 views) that continue the surfaces of `cloud` over their gaps, about one a spacing."""
    return _closing(cloud, spacing, sight)


def over_wide_gaps(cloud: Cloud, spacing: float, sight: Sight) -> Cloud:
    """As `continued`, over the gaps of upright walls that are too wide for it. Z is up."""
    wide = _closing(cloud, spacing, sight, _WIDER)
    known, reach = cKDTree(cloud.points), _APART * _WIDER * spacing
    away = np.isinf(known.query(wide.points, distance_upper_bound=reach, workers=-1)[0]) if len(wide) else []
    return wide.take(np.flatnonzero(away))


def _closing(cloud: Cloud, spacing: float, sight: Sight, wider: int = 1) -> Cloud:
    """Points that continue the surfaces of `cloud`, by sheets whose cells are so many times as wide as usual. Wider
    ones continue upright walls alone, and not behind what stands before them, such as a dormer."""
    side, wide = wider * CELL * spacing, wider > 1
    grid = gather(cloud.points, cloud.normals, side)
    sheets, state = fit_sheets(grid, _PLUMB if sight.z_up else 0.0, RECESS if wide else 1)
    if wide:
        state.reshape(-1, WIDTH * HEIGHT)[np.abs(sheets.axes[:, 2, 2]) > _UPRIGHT] = EMPTY
    level = (sheets.axes[:, 2, 2] > _LEVEL) & sight.z_up
    gaps = np.flatnonzero(_closed(state, sheets.steep, level))
    places, directions = sheets.nodes(gaps, grid)
    state[gaps[looked_through(places, sight, FINE) > 0]] = EMPTY
    length = _closed(state, sheets.steep, level)[gaps]
    found = np.flatnonzero(length > 0)
    kept = found[_shortest_first(places[found], length[found], side)]
    points, normals = _spread(places[kept], directions[kept], side, wider * _DENSE)
    return unseen(points, normals, cloud)


def unseen(points: np.ndarray, normals: np.ndarray, cloud: Cloud) -> Cloud:
    """Points and normals (n,3) that no photo saw (0 views), as sure as those of `cloud` are."""
    count = len(points)
    return Cloud(points=points.astype(np.float32), colours=np.full((count, 3), 128, np.uint8),
                 normals=normals.astype(np.float32), views=np.zeros(count, np.uint8),
                 confidence=np.full(count, np.median(cloud.confidence), np.float32))


def _spread(
    places: np.ndarray, normals: np.ndarray, side: float, dense: int
) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals (n * dense^2,3) float32 spread evenly over squares of this side about places (n,3)."""
    flat = np.abs(normals[:, 2]) > 0.99
    u = np.where(flat[:, None], [1.0, 0, 0], np.stack([-normals[:, 1], normals[:, 0], 0 * normals[:, 0]], axis=1))
    u -= (u * normals).sum(axis=1, keepdims=True) * normals
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(normals, u)
    steps = (np.arange(dense) - (dense - 1) / 2) / dense * side
    points = [places + first * u + second * v for first in steps for second in steps]
    return np.concatenate(points).astype(np.float32), np.tile(normals, (dense**2, 1)).astype(np.float32)


def _shortest_first(places: np.ndarray, gap: np.ndarray, side: float) -> np.ndarray:
    """One place a cell, that in the shortest gap."""
    low = places.min(axis=0) if len(places) else np.zeros(3)
    order = np.argsort(gap, kind="stable")
    chosen: np.ndarray = order[np.unique(cell_numbers(places, low, side)[order], return_index=True)[1]]
    return chosen


def _closed(state: np.ndarray, steep: np.ndarray, level: np.ndarray) -> np.ndarray:
    """As _bridged, with the slits in walls."""
    length: np.ndarray = _bridged(state, steep, level)
    _close_slits(length, state, steep)
    return length


# Long: the two directions of a line share all of it.
@_compiled
def _bridged(state, steep, level):  # type: ignore[no-untyped-def]
    """How long the gap is that each node (n,) lies in, (n,) int16, in nodes along a line of its sheet that begins and
    ends on what was measured; 0 where there is none. Up a wall a line may end on another surface, and on level ground
    any line may; there, and on walls, one line is enough. Elsewhere both its lines must end on the sheet itself: where
    only one does, it is below 0."""
    size = WIDTH * HEIGHT
    length = np.zeros(len(state), np.int16)
    for sheet in range(len(steep)):
        low = sheet * size
        for up in (False, True):
            lines, nodes = (WIDTH, HEIGHT) if up else (HEIGHT, WIDTH)
            for line in range(lines):
                start, step = (line * HEIGHT, 1) if up else (line, HEIGHT)
                begin = -1  # the last node that is no gap
                for k in range(nodes):
                    here = state[low + start + k * step]
                    if here == GAP:
                        continue
                    if begin >= 0 and k - begin > 1:
                        first = state[low + start + begin * step]
                        both = first == OWN and here == OWN
                        meets = (first == OWN and here == BLOCKED) or (first == BLOCKED and here == OWN)
                        if both or (meets and (level[sheet] or (up and steep[sheet]))):
                            run = k - begin - 1
                            for m in range(begin + 1, k):
                                at = low + start + m * step
                                before = length[at]
                                if steep[sheet] or meets:
                                    length[at] = min(run, before) if before > 0 else run
                                else:
                                    length[at] = min(run, abs(before)) if before else -run
                    begin = k
    return length


@_compiled
def _close_slits(length, state, steep):  # type: ignore[no-untyped-def]
    """Close what is left open between two closed parts of a wall, a few nodes apart: changes `length`, as of _bridged,
    of nodes (n,)."""
    size = WIDTH * HEIGHT
    for sheet in range(len(steep)):
        if not steep[sheet]:
            continue
        for line in range(HEIGHT):
            begin = -1  # the last node that is closed
            for k in range(WIDTH):
                at = sheet * size + line + k * HEIGHT
                if length[at] > 0:
                    if begin >= 0 and 1 < k - begin <= _SLIT + 1:
                        wider = max(length[at], length[at - (k - begin) * HEIGHT])
                        for m in range(at - (k - begin - 1) * HEIGHT, at, HEIGHT):
                            length[m] = wider
                    begin = k
                elif state[at] != GAP:
                    begin = -1
