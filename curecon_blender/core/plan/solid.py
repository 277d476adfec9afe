# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What was measured, as cubes of a grid that a ray may hit: eaves, arches and the space below a roof are free, as they
are not in columns of heights. For the worker."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

_compiled: Any = njit(nogil=True, error_model="numpy")
_MOST_CUBES = 60_000_000
_OWN = 2.5  # cubes before its place in which a ray hits only the surface that it is about


class Solid:
    """Cubes of `side` metres that hold one of points (N,3) or more; larger ones where the site is too large."""

    def __init__(self, points: np.ndarray, side: float) -> None:
        self._low = points.min(axis=0) - side
        size = points.max(axis=0) + side - self._low
        self.side = max(side, float(np.cbrt(size.prod() / _MOST_CUBES)))
        self._full = np.zeros(np.ceil(size / self.side).astype(int) + 1, bool)
        index = ((points - self._low) / self.side).astype(int)
        self._full[index[:, 0], index[:, 1], index[:, 2]] = True

    def hidden(self, eyes: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Whether (N,) a full cube lies between each eye (N,3) and its place (N,3), but for the place's own."""
        found = np.zeros(len(eyes), bool)
        start, end = ((np.ascontiguousarray(p, float) - self._low) / self.side for p in (places, eyes))
        _hit(start, end, self._full, found)
        return found


@_compiled
def _hit(starts, ends, full, found):  # type: ignore[no-untyped-def]
    """Walks each ray from cube to cube (Amanatides and Woo, 1987)."""
    for n in range(len(starts)):
        way = ends[n] - starts[n]
        length = np.sqrt((way**2).sum())
        if length <= _OWN:
            continue
        way /= length
        cube, step, next_at, apart = np.zeros(3, np.int64), np.zeros(3, np.int64), np.zeros(3), np.zeros(3)
        for axis in range(3):
            at = starts[n, axis] + _OWN * way[axis]
            cube[axis] = int(np.floor(at))
            step[axis] = 1 if way[axis] > 0 else -1
            apart[axis] = 1 / abs(way[axis]) if way[axis] != 0 else np.inf
            border = cube[axis] + 1 - at if way[axis] > 0 else at - cube[axis]
            next_at[axis] = border * apart[axis] if way[axis] != 0 else np.inf
        travelled = 0.0
        while travelled < length - _OWN:
            inside = True
            for axis in range(3):
                if cube[axis] < 0 or cube[axis] >= full.shape[axis]:
                    inside = False
            if inside and full[cube[0], cube[1], cube[2]]:
                found[n] = True
                break
            nearest = 0
            for axis in range(1, 3):
                if next_at[axis] < next_at[nearest]:
                    nearest = axis
            travelled = next_at[nearest]
            cube[nearest] += step[nearest]
            next_at[nearest] += apart[nearest]
