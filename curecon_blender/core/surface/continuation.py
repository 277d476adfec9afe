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

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from ..cloud.ply import Cloud
from .cells import cell_numbers
from .sight import FINE, Sight, looked_through

CELL = 2.5  # spacings: side of the cells that points are gathered in, and of the lattice of a sheet
REACH = 14  # cells: half the side of the square that a sheet is fitted in
_HIGHER = 14  # cells: how much farther up and down a wall goes on, straight
_WIDTH, _HEIGHT = 2 * REACH + 1, 2 * (REACH + _HIGHER) + 1  # nodes of a sheet's lattice, along it and up the slope
_DENSE = 2  # points for each node of the lattice, along each side
_SEED = 6  # cells: side of the cubes, each of which may begin a sheet a direction
_ALIKE = 0.8  # cosine of the angle between the normals of a sheet and of a point of it
_THICK = 3.0  # cells: how far from the sheet's tangent plane points are looked for
_ON = 0.8  # cells: how far from the sheet its own points lie at most
_LEAST = 160  # cells of points that carry a sheet
_GOOD = 0.7  # of the points about it that must lie on a sheet
_FULL = 0.97  # of the sheet's nodes: it has no gap
_STEEP = 0.5  # of a normal's z: what is steeper is a wall and goes on until something stops it
_LEVEL = 0.95  # of a normal's z: ground and floors, which go on until they meet a wall
# How firmly a wall is held plumb: as by the points of a strip some ten cells high. Where a wall is seen at a slant,
# or by few photos, what was measured of it leans; on its way up to the eave that would add up.
_PLUMB = 5e3
_SLIT = 5  # nodes between two closed parts of a wall that are closed with them
_RECESS = 4  # cells behind a gap: a surface measured there says that it is none
_MOST_NEAR = 200_000  # points that a sheet is fitted to
_BATCH = 4096  # sheets that are fitted at a time
_GAP, _OWN, _BLOCKED, _EMPTY = 0, 1, 2, 3
_compiled: Any = njit(nogil=True, error_model="numpy")


@dataclass(frozen=True)
class _Grid:
    """Measured points gathered in cells: `points`, `normals` (n,3) means of each cell and direction, sorted by the
    bucket of REACH cells' side that they lie in; `buckets` (b,) their keys with `starts` (b+1,); `cells` (c,) the
    sorted keys of all cells that hold a point; `low` (3,) and `side`."""

    points: np.ndarray
    normals: np.ndarray
    buckets: np.ndarray
    starts: np.ndarray
    cells: np.ndarray
    low: np.ndarray
    side: float


def continued(cloud: Cloud, spacing: float, sight: Sight) -> Cloud:
    """Points (with 0 views) that continue the surfaces of `cloud` over their gaps, about one a spacing."""
    side = CELL * spacing
    grid = _gather(cloud.points, cloud.normals, side)
    sheets, state = _sheets(grid, _PLUMB if sight.z_up else 0.0)
    level = (sheets.axes[:, 2, 2] > _LEVEL) & sight.z_up
    gaps = np.flatnonzero(_closed(state, sheets.steep, level))
    places, directions = sheets.nodes(gaps, grid)
    state[gaps[looked_through(places, sight, FINE) > 0]] = _EMPTY
    length = _closed(state, sheets.steep, level)[gaps]
    found = np.flatnonzero(length > 0)
    kept = found[_shortest_first(places[found], length[found], side)]
    points, normals = _spread(places[kept], directions[kept], side)
    return unseen(points, normals, cloud)


def unseen(points: np.ndarray, normals: np.ndarray, cloud: Cloud) -> Cloud:
    """Points and normals (n,3) that no photo saw (0 views), as sure as those of `cloud` are."""
    count = len(points)
    return Cloud(points=points.astype(np.float32), colours=np.full((count, 3), 128, np.uint8),
                 normals=normals.astype(np.float32), views=np.zeros(count, np.uint8),
                 confidence=np.full(count, np.median(cloud.confidence), np.float32))


def _spread(places: np.ndarray, normals: np.ndarray, side: float) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals (n * _DENSE^2,3) float32 spread evenly over squares of this side about places (n,3)."""
    flat = np.abs(normals[:, 2]) > 0.99
    u = np.where(flat[:, None], [1.0, 0, 0], np.stack([-normals[:, 1], normals[:, 0], 0 * normals[:, 0]], axis=1))
    u -= (u * normals).sum(axis=1, keepdims=True) * normals
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(normals, u)
    steps = (np.arange(_DENSE) - (_DENSE - 1) / 2) / _DENSE * side
    points = [places + first * u + second * v for first in steps for second in steps]
    return np.concatenate(points).astype(np.float32), np.tile(normals, (_DENSE**2, 1)).astype(np.float32)


def _direction(normals: np.ndarray) -> np.ndarray:
    """Which of the six directions of the axes normals (n,3) are nearest to, (n,) int64."""
    axis = np.abs(normals).argmax(axis=1)
    return 2 * axis + (np.take_along_axis(normals, axis[:, None], axis=1)[:, 0] < 0)


def _gather(points: np.ndarray, normals: np.ndarray, side: float) -> _Grid:
    low = points.min(axis=0).astype(np.float64) - 8 * side * REACH
    cells = cell_numbers(points, low, side)
    key = cells * 8 + _direction(normals)
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.r_[True, np.diff(key[order]) > 0])
    count = np.diff(np.r_[first, len(key)])[:, None]
    mean = np.add.reduceat((points - low)[order], first, axis=0) / count
    normal = np.add.reduceat(normals[order].astype(np.float64), first, axis=0) / count
    length = np.linalg.norm(normal, axis=1)
    good = length > _ALIKE
    mean, normal = mean[good], normal[good] / length[good, None]
    bucket = cell_numbers(mean, np.zeros(3), side * REACH)
    order = np.argsort(bucket, kind="stable")
    buckets, starts = np.unique(bucket[order], return_index=True)
    return _Grid(mean[order], normal[order], buckets, np.r_[starts, len(mean)], np.unique(cells), low, side)


@dataclass(frozen=True)
class _Sheets:
    """Sheets about `centres` (s,3), each h = c0 + c1 a + c2 b + c3 a^2 in cells along `axes` (s,3,3): level, up the
    slope, outwards; `bends` (s,4) are the c; `steep` (s,) bool are walls."""

    centres: np.ndarray
    axes: np.ndarray
    bends: np.ndarray
    steep: np.ndarray

    def nodes(self, numbers: np.ndarray, grid: _Grid) -> tuple[np.ndarray, np.ndarray]:
        """Places and normals (n,3) float32 of nodes, numbered sheet by sheet."""
        sheet, node = np.divmod(numbers, _WIDTH * _HEIGHT)
        a, b = node // _HEIGHT - REACH, node % _HEIGHT - REACH - _HIGHER
        c, axes = self.bends[sheet], self.axes[sheet]
        height = c[:, 0] + c[:, 1] * a + c[:, 2] * b + c[:, 3] * a * a
        places = self.centres[sheet] + grid.low
        places += grid.side * np.einsum("kn,nkc->nc", np.stack([a, b, height]), axes)
        normals = np.einsum("kn,nkc->nc", np.stack([-c[:, 1] - 2 * c[:, 3] * a, -c[:, 2], np.ones(len(a))]), axes)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return places.astype(np.float32), normals.astype(np.float32)


def _sheets(grid: _Grid, stiff: float) -> tuple[_Sheets, np.ndarray]:
    """All sheets with gaps, and the states of all their nodes. Walls are held plumb as firmly as `stiff`."""
    cells = cell_numbers(grid.points, np.zeros(3), _SEED * grid.side)
    _, seed = np.unique(cells * 8 + _direction(grid.normals), return_index=True)
    near = np.empty(_MOST_NEAR, np.int64)
    parts = []
    for begin in range(0, len(seed), _BATCH):
        numbers = seed[begin : begin + _BATCH].copy()
        count = len(numbers)
        into = np.empty((count, 4)), np.empty((count, 3, 3)), np.empty((count, _WIDTH * _HEIGHT), np.int8)
        found = _fit(numbers, grid.points, grid.normals, grid.buckets, grid.starts, grid.cells, grid.side, stiff, near,
                     *into)
        parts.append([whole[:found].copy() for whole in (numbers, *into)])
    numbers, bends, axes, state = (np.concatenate(part) for part in zip(*parts, strict=True))
    steep = np.abs(grid.normals[numbers, 2]) < _STEEP
    return _Sheets(grid.points[numbers], axes, bends, steep), state.ravel()


def _shortest_first(places: np.ndarray, gap: np.ndarray, side: float) -> np.ndarray:
    """One place a cell, that in the shortest gap."""
    low = places.min(axis=0) if len(places) else np.zeros(3)
    order = np.argsort(gap, kind="stable")
    chosen: np.ndarray = order[np.unique(cell_numbers(places, low, side)[order], return_index=True)[1]]
    return chosen


@_compiled
def _holds(cells, x, y, z, side):  # type: ignore[no-untyped-def]
    """Whether the cell at a place holds a point."""
    key = (np.int64(np.floor(x / side)) << 42) + (np.int64(np.floor(y / side)) << 21) + np.int64(np.floor(z / side))
    at = np.searchsorted(cells, key)
    return at < len(cells) and cells[at] == key


@_compiled
def _about(centre, buckets, starts, wide, into):  # type: ignore[no-untyped-def]
    """The numbers of the points in the 27 buckets about a place, written to `into`; how many they are."""
    bx, by, bz = np.int64(centre[0] // wide), np.int64(centre[1] // wide), np.int64(centre[2] // wide)
    count = 0
    for dx in range(-1, 2):
        for dy in range(-1, 2):
            for dz in range(-1, 2):
                key = ((bx + dx) << 42) + ((by + dy) << 21) + bz + dz
                at = np.searchsorted(buckets, key)
                if at < len(buckets) and buckets[at] == key:
                    for i in range(starts[at], starts[at + 1]):
                        if count < len(into):
                            into[count] = i
                            count += 1
    return count


@_compiled
def _occupied(a, b, reach):  # type: ignore[no-untyped-def]
    """How many of the lattice's nodes have a point near them."""
    width = 2 * reach + 1
    held = np.zeros(width * width, np.bool_)
    for k in range(len(a)):
        held[int(np.round(a[k]) + reach) * width + int(np.round(b[k]) + reach)] = True
    return held.sum()


@_compiled
def _curved(a, b, h, reach, plumb, stiff):  # type: ignore[no-untyped-def]
    """The sheet h = c0 + c1 a + c2 b + c3 a^2 that most of the points lie on: least squares, reweighted. Its slope c2
    is held at `plumb` as firmly as `stiff`."""
    weight = np.ones(len(a))
    c = np.zeros(4)
    for _ in range(4):
        s1 = sa = sb = saa = sab = sbb = saaa = saab = saaaa = 0.0
        r1 = ra = rb = raa = 0.0
        for k in range(len(a)):
            w, x, y, z = weight[k], a[k], b[k], h[k]
            wx, wy, wxx = w * x, w * y, w * x * x
            s1 += w
            sa += wx
            sb += wy
            saa += wxx
            sab += wx * y
            sbb += wy * y
            saaa += wxx * x
            saab += wxx * y
            saaaa += wxx * x * x
            r1 += w * z
            ra += wx * z
            rb += wy * z
            raa += wxx * z
        # little curvature where little tells it
        _solve(np.array([[s1, sa, sb, saa, r1], [sa, saa, sab, saaa, ra],
                         [sb, sab, sbb + stiff, saab, rb + stiff * plumb],
                         [saa, saaa, saab, saaaa + 1e4 / reach**2, raa]]), c)
        for k in range(len(a)):
            off = (h[k] - c[0] - c[1] * a[k] - c[2] * b[k] - c[3] * a[k] * a[k]) / _ON
            weight[k] = 1 / (1 + off * off * off * off)
    return c


@_compiled
def _solve(m, c):  # type: ignore[no-untyped-def]
    """The c (4,) of normal equations m (4,5), whose last column is the right side. LAPACK takes longer to compile than
    all sheets of a site to fit."""
    for i in range(4):
        m[i, i] += 1e-6
        for j in range(i + 1, 4):
            m[j, i] /= m[i, i]
            for k in range(i + 1, 5):
                m[j, k] -= m[j, i] * m[i, k]
    for i in range(3, -1, -1):
        c[i] = m[i, 4]
        for k in range(i + 1, 4):
            c[i] -= m[i, k] * c[k]
        c[i] /= m[i, i]


@_compiled
def _axes(n, axes):  # type: ignore[no-untyped-def]
    """Level, up the slope, and outwards, into `axes`, for a sheet whose normal is n."""
    x, y, z = n[0], n[1], n[2]
    if z * z < 0.98:
        ux, uy, uz = -y, x, 0.0
    else:
        ux, uy, uz = 1.0 - x * x, -y * x, -z * x
    length = np.sqrt(ux * ux + uy * uy + uz * uz)
    ux, uy, uz = ux / length, uy / length, uz / length
    axes[0, 0], axes[0, 1], axes[0, 2] = ux, uy, uz
    axes[1, 0], axes[1, 1], axes[1, 2] = y * uz - z * uy, z * ux - x * uz, x * uy - y * ux
    axes[2, 0], axes[2, 1], axes[2, 2] = x, y, z


@_compiled
def _state_of(centre, axes, c, a, b, h, cells, side, state):  # type: ignore[no-untyped-def]
    """Which nodes of a sheet its own points (a,b,h) lie on, what other surfaces stop, and where gaps are; returns
    whether there are any."""
    higher = _HIGHER if abs(axes[2, 2]) < _STEEP else 0
    state[:] = _EMPTY
    for i in range(_WIDTH):
        for j in range(_HIGHER - higher, _HEIGHT - _HIGHER + higher):
            state[i * _HEIGHT + j] = _GAP
    for k in range(len(a)):
        if abs(h[k] - c[0] - c[1] * a[k] - c[2] * b[k] - c[3] * a[k] * a[k]) < _ON:
            state[int(np.round(a[k]) + REACH) * _HEIGHT + int(np.round(b[k]) + REACH + _HIGHER)] = _OWN
    for i in range(_WIDTH):
        for j in range(_HEIGHT):
            at = i * _HEIGHT + j
            if state[at] != _GAP:
                continue
            x, y = i - REACH, j - REACH - _HIGHER
            height = c[0] + c[1] * x + c[2] * y + c[3] * x * x
            slope = c[1] + 2 * c[3] * x
            length = np.sqrt(1 + slope * slope + c[2] * c[2])
            for back in range(-1, _RECESS + 1):
                # Along the sheet's normal there, in cells.
                u, v, w = x + back * slope / length, y + back * c[2] / length, height - back / length
                if _holds(cells, centre[0] + side * (u * axes[0, 0] + v * axes[1, 0] + w * axes[2, 0]),
                          centre[1] + side * (u * axes[0, 1] + v * axes[1, 1] + w * axes[2, 1]),
                          centre[2] + side * (u * axes[0, 2] + v * axes[1, 2] + w * axes[2, 2]), side):
                    state[at] = _BLOCKED
                    break
    # A node beside the sheet's own points is its own noise, not another surface.
    edge = state.copy()
    for i in range(1, _WIDTH - 1):
        for j in range(1, _HEIGHT - 1):
            at = i * _HEIGHT + j
            if edge[at] == _BLOCKED:
                own = 0
                for di in range(-1, 2):
                    for dj in range(-1, 2):
                        own += edge[at + di * _HEIGHT + dj] == _OWN
                if own >= 5:
                    state[at] = _OWN
    return (state == _GAP).any()


@_compiled
def _fit(seeds, points, normals, buckets, starts, cells, side, stiff, near, bends, axes_of, states):  # type: ignore
    """Writes the seeds about which there is a sheet with gaps over the first of `seeds`, and its bends, axes, and the
    states of its nodes; returns how many there are."""
    found = 0
    a, b, h = np.empty(len(near)), np.empty(len(near)), np.empty(len(near))
    for seed in seeds:
        centre, n, axes = points[seed], normals[seed], axes_of[found]
        _axes(n, axes)
        count = 0
        for k in range(_about(centre, buckets, starts, side * REACH, near)):
            i = near[k]
            if normals[i, 0] * n[0] + normals[i, 1] * n[1] + normals[i, 2] * n[2] < _ALIKE:
                continue
            d0, d1, d2 = points[i, 0] - centre[0], points[i, 1] - centre[1], points[i, 2] - centre[2]
            x = (d0 * axes[0, 0] + d1 * axes[0, 1] + d2 * axes[0, 2]) / side
            y = (d0 * axes[1, 0] + d1 * axes[1, 1] + d2 * axes[1, 2]) / side
            z = (d0 * axes[2, 0] + d1 * axes[2, 1] + d2 * axes[2, 2]) / side
            if abs(x) <= REACH and abs(y) <= REACH and abs(z) <= _THICK + 0.02 * (x * x + y * y):
                a[count], b[count], h[count] = x, y, z
                count += 1
        if count < _LEAST or _occupied(a[:count], b[:count], REACH) > _FULL * _WIDTH * _WIDTH:
            continue
        # Along axes[1] as axes[2] lies, the vertical rises by n[2] for axes[1, 2].
        steep = abs(n[2]) < _STEEP
        c = _curved(a[:count], b[:count], h[:count], REACH, n[2] / axes[1, 2] if steep else 0.0, stiff * steep)
        own = 0
        for k in range(count):
            own += abs(h[k] - c[0] - c[1] * a[k] - c[2] * b[k] - c[3] * a[k] * a[k]) < _ON
        if own < _LEAST or own < _GOOD * count:
            continue
        if _state_of(centre, axes, c, a[:count], b[:count], h[:count], cells, side, states[found]):
            seeds[found] = seed
            for k in range(4):
                bends[found, k] = c[k]
            found += 1
    return found


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
    size = _WIDTH * _HEIGHT
    length = np.zeros(len(state), np.int16)
    for sheet in range(len(steep)):
        low = sheet * size
        for up in (False, True):
            lines, nodes = (_WIDTH, _HEIGHT) if up else (_HEIGHT, _WIDTH)
            for line in range(lines):
                start, step = (line * _HEIGHT, 1) if up else (line, _HEIGHT)
                begin = -1  # the last node that is no gap
                for k in range(nodes):
                    here = state[low + start + k * step]
                    if here == _GAP:
                        continue
                    if begin >= 0 and k - begin > 1:
                        first = state[low + start + begin * step]
                        both = first == _OWN and here == _OWN
                        meets = (first == _OWN and here == _BLOCKED) or (first == _BLOCKED and here == _OWN)
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
    size = _WIDTH * _HEIGHT
    for sheet in range(len(steep)):
        if not steep[sheet]:
            continue
        for line in range(_HEIGHT):
            begin = -1  # the last node that is closed
            for k in range(_WIDTH):
                at = sheet * size + line + k * _HEIGHT
                if length[at] > 0:
                    if begin >= 0 and 1 < k - begin <= _SLIT + 1:
                        wider = max(length[at], length[at - (k - begin) * _HEIGHT])
                        for m in range(at - (k - begin - 1) * _HEIGHT, at, _HEIGHT):
                            length[m] = wider
                    begin = k
                elif state[at] != _GAP:
                    begin = -1
