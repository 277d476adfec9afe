# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a surface ends: cut along the line where a field passes through zero, not along the cells it was made in."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from .triangles import mesh_edges

_LEAST_SHARE = 0.02  # of an edge: a cut nearer to a corner would leave a sliver


def smoothed(values: np.ndarray, faces: np.ndarray, rounds: int) -> np.ndarray:
    """Values (n,) of a mesh's vertices, each averaged with its neighbours so many times, float32."""
    average = _averaging(faces, len(values))
    result = values.astype(np.float32)
    for _ in range(rounds):
        result = 0.5 * result + 0.5 * (average @ result)
    return result


def clip(vertices: np.ndarray, faces: np.ndarray, field: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The part of a mesh where `field` (n,), linear over each face, is above zero. New vertices come after the old."""
    inside = field > 0
    count = inside[faces].sum(axis=1)
    mixed = faces[(count == 1) | (count == 2)]
    if not len(mixed):
        return vertices, faces[count == 3]
    lone_is_inside = inside[mixed].sum(axis=1) == 1
    first = (inside[mixed] == lone_is_inside[:, None]).argmax(axis=1)
    a, b, c = np.take_along_axis(mixed, (first[:, None] + np.arange(3)) % 3, axis=1).T
    ends = np.sort(np.stack([np.stack([a, b]), np.stack([a, c])]), axis=1).transpose(0, 2, 1).reshape(-1, 2)
    edges, place = np.unique(ends, axis=0, return_inverse=True)
    ab, ac = (place.reshape(2, -1) + len(vertices)).astype(faces.dtype)
    low, high = field[edges].T.astype(np.float64)
    share = np.clip(low / (low - high), _LEAST_SHARE, 1 - _LEAST_SHARE)[:, None]
    cut = (1 - share) * vertices[edges[:, 0]] + share * vertices[edges[:, 1]]
    tip, rest = lone_is_inside, ~lone_is_inside
    made = [np.stack([a, ab, ac], axis=1)[tip], np.stack([ab, b, c], axis=1)[rest], np.stack([ab, c, ac], axis=1)[rest]]
    return np.concatenate([vertices, cut.astype(vertices.dtype)]), np.concatenate([faces[count == 3], *made])


def _averaging(faces: np.ndarray, count: int) -> sp.csr_array:
    """The matrix (count,count) that gives each vertex the mean of its neighbours; itself where it has none."""
    edges = mesh_edges(faces)[0]
    rows, columns = np.concatenate([edges, edges[:, ::-1]]).T
    degree = np.bincount(rows, minlength=count)
    alone = np.flatnonzero(degree == 0)
    rows, columns = np.concatenate([rows, alone]), np.concatenate([columns, alone])
    weight = 1 / np.maximum(degree, 1).astype(np.float32)
    return sp.csr_array((weight[rows], (rows, columns)), shape=(count, count))
