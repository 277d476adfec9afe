# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Sheets: smooth surface fitted to the measured points about a place, flat up the slope and curved across it.

About every square metre or so a sheet is fitted. Its lattice of nodes tells where its own points lie, what other
surfaces stop it, and where gaps are. Trees and rubble fit no sheet.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from .cells import cell_numbers

CELL = 2.5  # spacings: side of the cells that points are gathered in, and of the lattice of a sheet
_REACH = 14  # cells: half the side of the square that a sheet is fitted in
_HIGHER = 14  # cells: how much farther up and down a wall goes on, straight
WIDTH, HEIGHT = 2 * _REACH + 1, 2 * (_REACH + _HIGHER) + 1  # nodes of a sheet's lattice, along it and up the slope
_SEED = 6  # cells: side of the cubes, each of which may begin a sheet a direction
_ALIKE = 0.8  # cosine of the angle between the normals of a sheet and of a point of it
_THICK = 3.0  # cells: how far from the sheet's tangent plane points are looked for
_ON = 0.8  # cells: how far from the sheet its own points lie at most
_LEAST = 160  # cells of points that carry a sheet
_GOOD = 0.7  # of the points about it that must lie on a sheet
_FULL = 0.97  # of the sheet's nodes: it has no gap
_STEEP = 0.5  # of a normal's z: what is steeper is a wall and goes on until something stops it
RECESS = 4  # cells behind a gap, and before a wide one: a surface measured there says that it is none
_MOST_NEAR = 200_000  # points that a sheet is fitted to
_BATCH = 4096  # sheets that are fitted at a time
GAP, OWN, BLOCKED, EMPTY = 0, 1, 2, 3  # states of a node
_compiled: Any = njit(nogil=True, error_model="numpy")


@dataclass(frozen=True)
class Grid:
    """Measured points gathered in cells: `points`, `normals` (n,3) means of each cell and direction, sorted by the
    bucket of _REACH cells' side that they lie in; `buckets` (b,) their keys with `starts` (b+1,); `cells` (c,) the
    sorted keys of all cells that hold a point; `low` (3,) and `side`."""

    points: np.ndarray
    normals: np.ndarray
    buckets: np.ndarray
    starts: np.ndarray
    cells: np.ndarray
    low: np.ndarray
    side: float


def _direction(normals: np.ndarray) -> np.ndarray:
    """Which of the six directions of the axes normals (n,3) are nearest to, (n,) int64."""
    axis = np.abs(normals).argmax(axis=1)
    return 2 * axis + (np.take_along_axis(normals, axis[:, None], axis=1)[:, 0] < 0)


def gather(points: np.ndarray, normals: np.ndarray, side: float) -> Grid:
    """Points and normals (n,3) in cells of this side."""
    low = points.min(axis=0).astype(np.float64) - 8 * side * _REACH
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
    bucket = cell_numbers(mean, np.zeros(3), side * _REACH)
    order = np.argsort(bucket, kind="stable")
    buckets, starts = np.unique(bucket[order], return_index=True)
    return Grid(mean[order], normal[order], buckets, np.r_[starts, len(mean)], np.unique(cells), low, side)


@dataclass(frozen=True)
class Sheets:
    """Sheets about `centres` (s,3), each h = c0 + c1 a + c2 b + c3 a^2 in cells along `axes` (s,3,3): level, up the
    slope, outwards; `bends` (s,4) are the c; `steep` (s,) bool are walls."""

    centres: np.ndarray
    axes: np.ndarray
    bends: np.ndarray
    steep: np.ndarray

    def nodes(self, numbers: np.ndarray, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
        """Places and normals (n,3) float32 of nodes, numbered sheet by sheet."""
        sheet, node = np.divmod(numbers, WIDTH * HEIGHT)
        a, b = node // HEIGHT - _REACH, node % HEIGHT - _REACH - _HIGHER
        c, axes = self.bends[sheet], self.axes[sheet]
        height = c[:, 0] + c[:, 1] * a + c[:, 2] * b + c[:, 3] * a * a
        places = self.centres[sheet] + grid.low
        places += grid.side * np.einsum("kn,nkc->nc", np.stack([a, b, height]), axes)
        normals = np.einsum("kn,nkc->nc", np.stack([-c[:, 1] - 2 * c[:, 3] * a, -c[:, 2], np.ones(len(a))]), axes)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return places.astype(np.float32), normals.astype(np.float32)


def fit_sheets(grid: Grid, stiff: float, ahead: int) -> tuple[Sheets, np.ndarray]:
    """All sheets with gaps, and the states of all their nodes. Walls are held plumb as firmly as `stiff`. A surface
    that many cells `ahead` of a gap stops it, as one behind it does."""
    cells = cell_numbers(grid.points, np.zeros(3), _SEED * grid.side)
    _, seed = np.unique(cells * 8 + _direction(grid.normals), return_index=True)
    near = np.empty(_MOST_NEAR, np.int64)
    parts = []
    for begin in range(0, len(seed), _BATCH):
        numbers = seed[begin : begin + _BATCH].copy()
        count = len(numbers)
        into = np.empty((count, 4)), np.empty((count, 3, 3)), np.empty((count, WIDTH * HEIGHT), np.int8)
        found = _fit(numbers, grid.points, grid.normals, grid.buckets, grid.starts, grid.cells, grid.side, stiff, ahead,
                     near, *into)
        parts.append([whole[:found].copy() for whole in (numbers, *into)])
    numbers, bends, axes, state = (np.concatenate(part) for part in zip(*parts, strict=True))
    steep = np.abs(grid.normals[numbers, 2]) < _STEEP
    return Sheets(grid.points[numbers], axes, bends, steep), state.ravel()


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
def _state_of(centre, axes, c, a, b, h, cells, side, ahead, state):  # type: ignore[no-untyped-def]
    """Which nodes of a sheet its own points (a,b,h) lie on, what other surfaces stop, and where gaps are; returns
    whether there are any."""
    higher = _HIGHER if abs(axes[2, 2]) < _STEEP else 0
    state[:] = EMPTY
    for i in range(WIDTH):
        for j in range(_HIGHER - higher, HEIGHT - _HIGHER + higher):
            state[i * HEIGHT + j] = GAP
    for k in range(len(a)):
        if abs(h[k] - c[0] - c[1] * a[k] - c[2] * b[k] - c[3] * a[k] * a[k]) < _ON:
            state[int(np.round(a[k]) + _REACH) * HEIGHT + int(np.round(b[k]) + _REACH + _HIGHER)] = OWN
    for i in range(WIDTH):
        for j in range(HEIGHT):
            at = i * HEIGHT + j
            if state[at] != GAP:
                continue
            x, y = i - _REACH, j - _REACH - _HIGHER
            height = c[0] + c[1] * x + c[2] * y + c[3] * x * x
            slope = c[1] + 2 * c[3] * x
            length = np.sqrt(1 + slope * slope + c[2] * c[2])
            for back in range(-ahead, RECESS + 1):
                # Along the sheet's normal there, in cells.
                u, v, w = x + back * slope / length, y + back * c[2] / length, height - back / length
                if _holds(cells, centre[0] + side * (u * axes[0, 0] + v * axes[1, 0] + w * axes[2, 0]),
                          centre[1] + side * (u * axes[0, 1] + v * axes[1, 1] + w * axes[2, 1]),
                          centre[2] + side * (u * axes[0, 2] + v * axes[1, 2] + w * axes[2, 2]), side):
                    state[at] = BLOCKED
                    break
    # A node beside the sheet's own points is its own noise, not another surface.
    edge = state.copy()
    for i in range(1, WIDTH - 1):
        for j in range(1, HEIGHT - 1):
            at = i * HEIGHT + j
            if edge[at] == BLOCKED:
                own = 0
                for di in range(-1, 2):
                    for dj in range(-1, 2):
                        own += edge[at + di * HEIGHT + dj] == OWN
                if own >= 5:
                    state[at] = OWN
    return (state == GAP).any()


@_compiled
def _fit(seeds, points, normals, buckets, starts, cells, side, stiff, ahead, near, bends, axes_of, states):  # type: ignore
    """Writes the seeds about which there is a sheet with gaps over the first of `seeds`, and its bends, axes, and the
    states of its nodes; returns how many there are."""
    found = 0
    a, b, h = np.empty(len(near)), np.empty(len(near)), np.empty(len(near))
    for seed in seeds:
        centre, n, axes = points[seed], normals[seed], axes_of[found]
        _axes(n, axes)
        count = 0
        for k in range(_about(centre, buckets, starts, side * _REACH, near)):
            i = near[k]
            if normals[i, 0] * n[0] + normals[i, 1] * n[1] + normals[i, 2] * n[2] < _ALIKE:
                continue
            d0, d1, d2 = points[i, 0] - centre[0], points[i, 1] - centre[1], points[i, 2] - centre[2]
            x = (d0 * axes[0, 0] + d1 * axes[0, 1] + d2 * axes[0, 2]) / side
            y = (d0 * axes[1, 0] + d1 * axes[1, 1] + d2 * axes[1, 2]) / side
            z = (d0 * axes[2, 0] + d1 * axes[2, 1] + d2 * axes[2, 2]) / side
            if abs(x) <= _REACH and abs(y) <= _REACH and abs(z) <= _THICK + 0.02 * (x * x + y * y):
                a[count], b[count], h[count] = x, y, z
                count += 1
        if count < _LEAST or _occupied(a[:count], b[:count], _REACH) > _FULL * WIDTH * WIDTH:
            continue
        # Along axes[1] as axes[2] lies, the vertical rises by n[2] for axes[1, 2].
        steep = abs(n[2]) < _STEEP
        c = _curved(a[:count], b[:count], h[:count], _REACH, n[2] / axes[1, 2] if steep else 0.0, stiff * steep)
        own = 0
        for k in range(count):
            own += abs(h[k] - c[0] - c[1] * a[k] - c[2] * b[k] - c[3] * a[k] * a[k]) < _ON
        if own < _LEAST or own < _GOOD * count:
            continue
        if _state_of(centre, axes, c, a[:count], b[:count], h[:count], cells, side, ahead, states[found]):
            seeds[found] = seed
            for k in range(4):
                bends[found, k] = c[k]
            found += 1
    return found
