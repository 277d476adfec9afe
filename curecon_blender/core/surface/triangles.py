# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Geometry and topology of triangles, in numpy alone. Faces are (M,3) vertex numbers; a face's edge k goes from its
corner k to the next."""

from __future__ import annotations

import numpy as np


def triangle_areas(corners: np.ndarray) -> np.ndarray:
    """Areas (M,) of triangles in space (M,3,3) or on a plane (M,3,2)."""
    ab, ac = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    if corners.shape[2] == 2:
        twice = np.abs(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])
    else:
        twice = np.linalg.norm(np.cross(ab, ac), axis=1)
    areas: np.ndarray = twice / 2
    return areas


def face_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Normals (M,3) of the faces, each twice its face's area long."""
    first, second, third = (vertices[faces[:, corner]] for corner in range(3))
    return np.cross(second - first, third - first)


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors (...,3) of length 1; those without a length stay so."""
    units: np.ndarray = vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-30)
    return units


def corner_sums(values: np.ndarray, faces: np.ndarray, count: int) -> np.ndarray:
    """The sum (count,) at each vertex of the values (M,3) at the corners of its faces."""
    return np.bincount(faces.ravel(), values.ravel(), count)


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals (N,3) at the vertices, the means of their faces' by area."""
    normals = face_normals(vertices, faces)
    return unit(np.stack([corner_sums(np.repeat(normals[:, axis : axis + 1], 3, axis=1), faces, len(vertices))
                           for axis in range(3)], axis=1))


def mesh_edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The unique edges (E,2) int32, lower vertex first and sorted, and the number (M,3) int32 of each face's three."""
    following = np.roll(faces, -1, axis=1)
    vertices = int(faces.max(initial=0)) + 1
    keys = (np.minimum(faces, following).astype(np.int64) * vertices + np.maximum(faces, following)).ravel()
    order = np.argsort(keys)  # several times as fast as np.unique with its inverse
    ordered = keys[order]
    first = np.ones(len(keys), bool)
    np.not_equal(ordered[1:], ordered[:-1], out=first[1:])
    edge = np.empty(len(keys), np.int32)
    edge[order] = np.cumsum(first, dtype=np.int32) - 1
    edges = np.stack(np.divmod(ordered[first], vertices), axis=1).astype(np.int32)
    return edges, edge.reshape(-1, 3)


def face_neighbours(faces: np.ndarray) -> np.ndarray:
    """The face across each edge (M,3) int32, -1 at a border.

    Where more than two faces share an edge, they are joined in pairs as they come.
    """
    edge = mesh_edges(faces)[1].ravel()
    order = np.argsort(edge, kind="stable")
    ordered = edge[order]
    begins = np.ones(len(edge), bool)  # whether a place in the order is an edge's first
    np.not_equal(ordered[1:], ordered[:-1], out=begins[1:])
    place = np.arange(len(edge))
    place -= np.maximum.accumulate(np.where(begins, place, 0))
    second = np.flatnonzero(place % 2 == 1)
    one, other = order[second - 1], order[second]
    neighbours = np.full(len(edge), -1, np.int32)
    neighbours[one], neighbours[other] = other // 3, one // 3
    return neighbours.reshape(-1, 3)
