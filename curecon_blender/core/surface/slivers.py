# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Slivers turned into better triangles: two faces that share an edge on nearly flat surface may share the other one."""

from __future__ import annotations

import numpy as np

from .triangles import face_neighbours, face_normals, mesh_edges, unit

_THIN = 15.0  # degrees: faces with a smaller angle are looked at
_FLAT = 0.97  # cosine between two faces that count as one plane, and of how far a new face may turn
_ROUNDS = 10
_WORTH_IT = 1e-3  # of the faces: a round that flips fewer is the last


def flipped(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The faces (M,3), with the longest edge of thin ones flipped where that makes the smaller angle larger."""
    faces = faces.copy()
    for _ in range(_ROUNDS):
        first, second, quad = _candidates(vertices, faces)
        a, b, c, d = quad.T
        faces[first], faces[second] = np.stack([a, d, c], axis=1), np.stack([d, b, c], axis=1)
        if len(first) <= _WORTH_IT * len(faces):
            break
    return faces


def _candidates(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Faces (k,), those beside them (k,), and the vertices a, b, c, d (k,4) of abc and bad, which are to become adc and
    dbc; no face is named twice."""
    beside = face_neighbours(faces)
    sides = np.linalg.norm(vertices[faces] - vertices[np.roll(faces, -1, axis=1)], axis=2)
    edge = sides.argmax(axis=1)
    first = np.flatnonzero((_least_angle(vertices, faces) < _THIN) & (beside[np.arange(len(faces)), edge] >= 0))
    edge = edge[first]
    second = beside[first, edge]
    a, b, c = (faces[first, (edge + turn) % 3] for turn in range(3))
    other = faces[second]
    d = other[(other != a[:, None]) & (other != b[:, None])] if len(first) else a
    if len(d) != len(first):  # two faces of the same three vertices
        return first[:0], second[:0], np.zeros((0, 4), faces.dtype)
    before = np.minimum(_least_angle(vertices, faces[first]), _least_angle(vertices, other))
    made = np.stack([a, d, c], axis=1), np.stack([d, b, c], axis=1)
    after = np.minimum(*(_least_angle(vertices, new) for new in made))
    plane = unit(face_normals(vertices, faces[first]) + face_normals(vertices, other))
    good = (after > before) & ((plane * unit(face_normals(vertices, other))).sum(axis=1) > _FLAT)
    for new in made:
        good &= (plane * unit(face_normals(vertices, new))).sum(axis=1) > _FLAT
    count = len(vertices)
    edges = mesh_edges(faces)[0].astype(np.int64)
    key = np.minimum(c, d).astype(np.int64) * count + np.maximum(c, d)
    good &= ~np.isin(key, edges[:, 0] * count + edges[:, 1])
    chosen = np.flatnonzero(good)
    chosen = chosen[np.argsort(before[chosen] - after[chosen], kind="stable")]
    chosen = chosen[np.sort(np.unique(key[chosen], return_index=True)[1])]
    # The flip that gains most of those that a face is in.
    rank = np.full(len(faces), len(chosen))
    for of in (first, second):
        np.minimum.at(rank, of[chosen], np.arange(len(chosen)))
    alone = np.arange(len(chosen))
    chosen = chosen[(rank[first[chosen]] == alone) & (rank[second[chosen]] == alone)]
    return first[chosen], second[chosen], np.stack([a, b, c, d], axis=1)[chosen]


def _least_angle(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The smallest angle (M,) of each face, in degrees."""
    corners = vertices[faces].astype(np.float64)
    sides = np.sort(np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2), axis=1)
    twice = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    angle: np.ndarray = np.degrees(np.arcsin(np.clip(twice / np.maximum(sides[:, 1] * sides[:, 2], 1e-30), 0, 1)))
    return angle
