# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Faces that pass through each other: which they are, and vertices moved back until none do."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from .borders import smoothed

_CELL = 3.0  # median edges: side of the cells that faces are looked for in, at least
_MOST_CELLS = 8  # a face, in the mean: a few faces of a field's size would else fill the memory
_ROUNDS = 8  # of moving vertices back
_compiled: Any = njit(nogil=True, error_model="numpy")


def uncrossed(before: np.ndarray, moved: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The moved vertices (n,3) float32; those of faces (m,3) that cross lie where they were before, or, where faces
    crossed there as well, between their neighbours."""
    moved = moved.copy()
    asked = np.ones(len(faces), bool)
    for _ in range(_ROUNDS):
        found = np.unique(faces[crossing(moved[faces], faces, asked)])
        if not len(found):
            break
        here = np.zeros(len(moved), bool)
        here[found] = True
        near = faces[here[faces].any(axis=1)]
        back = found[(moved[found] != before[found]).any(axis=1)]
        still = np.setdiff1d(found, back, assume_unique=True)
        moved[back] = before[back]
        for axis in range(3):
            moved[still, axis] = smoothed(moved[:, axis], near, 1)[still]
        asked = here[faces].any(axis=1)
    return moved


def crossing(corners: np.ndarray, faces: np.ndarray, asked: np.ndarray | None = None) -> np.ndarray:
    """Which of the faces (M,) pass through another and share no corner with it, by their corners (M,3,3) and vertex
    numbers (M,3). Pairs of which neither is `asked` (M,) are left out."""
    corners = corners.astype(np.float64)
    if not len(faces):
        return np.zeros(0, bool)
    if asked is None:
        asked = np.ones(len(faces), bool)
    side = _CELL * float(np.median(np.linalg.norm(corners[:, 0] - corners[:, 1], axis=1)))
    lowest, highest = corners.min(axis=1) - corners.min(axis=(0, 1)), corners.max(axis=1) - corners.min(axis=(0, 1))
    while True:
        low, high = np.floor(lowest / side).astype(np.int64), np.floor(highest / side).astype(np.int64)
        count = (high - low + 1).prod(axis=1)
        if count.sum() <= _MOST_CELLS * len(faces):
            break
        side *= 2
    owner = np.repeat(np.arange(len(faces)), count)
    number = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    span = (high - low + 1)[owner]
    cell = low[owner] + np.stack([number // (span[:, 1] * span[:, 2]), number // span[:, 2] % span[:, 1],
                                  number % span[:, 2]], axis=1)
    key = (cell[:, 0] << 42) + (cell[:, 1] << 21) + cell[:, 2]
    if not asked.all():
        there = np.isin(key, key[asked[owner]])
        owner, key = owner[there], key[there]
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.r_[True, np.diff(key[order]) > 0, True])
    found = np.zeros(len(faces), np.bool_)
    _find(corners, faces, asked, owner[order], starts, found)
    return found


@_compiled
def _find(corners, faces, asked, owner, starts, found):  # type: ignore[no-untyped-def]
    for c in range(len(starts) - 1):
        for i in range(starts[c], starts[c + 1]):
            for j in range(i + 1, starts[c + 1]):
                a, b = owner[i], owner[j]
                if (found[a] and found[b]) or not (asked[a] or asked[b]) or _apart(corners[a], corners[b]):
                    continue
                shared = False
                for k in range(3):
                    for m in range(3):
                        shared |= faces[a, k] == faces[b, m]
                if shared:
                    continue
                for k in range(3):
                    if _passes(corners[a, k], corners[a, (k + 1) % 3], corners[b]) or _passes(
                            corners[b, k], corners[b, (k + 1) % 3], corners[a]):
                        found[a] = found[b] = True
                        break


@_compiled
def _apart(first, second):  # type: ignore[no-untyped-def]
    """Whether the upright boxes about two triangles (3,3) do not touch."""
    for axis in range(3):
        a0, a1, a2 = first[0, axis], first[1, axis], first[2, axis]
        b0, b1, b2 = second[0, axis], second[1, axis], second[2, axis]
        if max(a0, a1, a2) < min(b0, b1, b2) or max(b0, b1, b2) < min(a0, a1, a2):
            return True
    return False


@_compiled
def _volume(a, b, c, d):  # type: ignore[no-untyped-def]
    """Six times the signed volume of a tetrahedron."""
    x0, x1, x2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    y0, y1, y2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    z0, z1, z2 = d[0] - a[0], d[1] - a[1], d[2] - a[2]
    return x0 * (y1 * z2 - y2 * z1) - x1 * (y0 * z2 - y2 * z0) + x2 * (y0 * z1 - y1 * z0)


@_compiled
def _passes(p, q, face):  # type: ignore[no-untyped-def]
    """Whether the line from p to q passes through a triangle (3,3)."""
    if _volume(face[0], face[1], face[2], p) * _volume(face[0], face[1], face[2], q) >= 0:
        return False
    u, v, w = _volume(p, q, face[0], face[1]), _volume(p, q, face[1], face[2]), _volume(p, q, face[2], face[0])
    return (u > 0 and v > 0 and w > 0) or (u < 0 and v < 0 and w < 0)
