# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Vertices moved onto what was measured, and edges sharpened.

Poisson's surface runs through a mean of the points and rounds edges off. So each vertex is moved along its normal by
the robust mean of the points about it. Then the faces' normals are filtered, each by those neighbours that look alike
(bilateral normal filter), and the vertices follow them (Sun, Rosin, Martin and Langbein 2007).
"""

from __future__ import annotations

import numpy as np

from .borders import smoothed
from .support import Support
from .triangles import corner_sums, face_neighbours, face_normals, triangle_areas, unit, vertex_normals

_POINTS = 16  # measured points about a vertex that move it
_MOVES = 2  # times that all vertices are moved onto the points
_FACING = 0.3  # least cosine between a vertex's normal and a point's: the other side of a wall is another surface
_FARTHEST = 1.5  # median spacings that a vertex moves at most at a time
_ROUNDS = 5  # of filtering the normals
_ALIKE = 0.35  # length of the difference of two unit normals at which they count little to each other
_FOLLOWING = 10  # steps in which the vertices follow the normals
_ROUNDEST = 0.25  # median spacings that a vertex moves at most to sharpen an edge
_TURNED = 0.5  # cosine: a face that turns farther is folded, and its vertices go back
_CHUNK = 50_000  # vertices at a time


def refined(vertices: np.ndarray, faces: np.ndarray, support: Support) -> np.ndarray:
    """The vertices (n,3) float32 moved onto the measured points, with sharper edges; those of filled faces follow
    their neighbours."""
    spacing = float(np.median(support.spacing))
    moved = vertices.astype(np.float64)
    for _ in range(_MOVES):
        normals = vertex_normals(moved, faces)
        off = np.concatenate([_offsets(moved[at : at + _CHUNK], normals[at : at + _CHUNK], support)
                              for at in range(0, len(moved), _CHUNK)])
        off = smoothed(np.clip(off, -_FARTHEST * spacing, _FARTHEST * spacing), faces, 1)
        moved += off[:, None] * normals
    return _unfolded(vertices, _sharpened(moved, faces, _ROUNDEST * spacing).astype(np.float32), faces)


def _unfolded(before: np.ndarray, moved: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The moved vertices, those of folded faces where they were before, until no face is folded."""
    moved, normals = moved.copy(), unit(face_normals(before.astype(np.float64), faces))
    while True:
        turned = (unit(face_normals(moved.astype(np.float64), faces)) * normals).sum(axis=1) < _TURNED
        back = np.unique(faces[turned])
        back = back[(moved[back] != before[back]).any(axis=1)]
        if not len(back):
            return moved
        moved[back] = before[back]


def _offsets(places: np.ndarray, normals: np.ndarray, support: Support) -> np.ndarray:
    """How far (n,) along the normals the points about places (n,3) lie: a mean that is robust against strays."""
    distance, index = support.about(places, _POINTS)
    near = np.isfinite(distance)
    index = np.where(near, index, 0)
    to = support.cloud.points[index] - places[:, None]
    along = np.einsum("nkc,nc->nk", to, normals)
    cosine = np.einsum("nkc,nc->nk", support.normals[index], normals)
    spacing = support.spacing[index]
    weight = np.where(near & (cosine > _FACING), support.cloud.confidence[index] * cosine**2, 0)
    weight *= np.exp(-0.5 * (np.where(near, distance, 0) / spacing) ** 2)
    total = weight.sum(axis=1)
    order = np.argsort(along, axis=1)
    below = np.cumsum(np.take_along_axis(weight, order, axis=1), axis=1) < total[:, None] / 2
    middle = np.minimum(below.sum(axis=1), _POINTS - 1)[:, None]
    mean = np.take_along_axis(along, np.take_along_axis(order, middle, axis=1), axis=1)[:, 0]
    for _ in range(3):
        stray = (along - mean[:, None]) / spacing[:, :1]
        alike = weight / (1 + stray**2) ** 2
        mean = (alike * along).sum(axis=1) / np.maximum(alike.sum(axis=1), 1e-12)
    result: np.ndarray = np.where((weight > 0).sum(axis=1) >= 3, mean, 0)
    return result


def _sharpened(vertices: np.ndarray, faces: np.ndarray, farthest: float) -> np.ndarray:
    """The vertices (n,3) where the faces' filtered normals want them, at most so far from where they were."""
    area = triangle_areas(vertices[faces]).astype(np.float32)
    normals = unit(face_normals(vertices, faces)).astype(np.float32)
    beside = face_neighbours(faces)
    weight_of = np.where(beside >= 0, area[beside], 0)
    for _ in range(_ROUNDS):
        mean = area[:, None] * normals
        for side in range(3):
            other = normals[beside[:, side]]
            apart = ((normals - other) ** 2).sum(axis=1)
            mean += (weight_of[:, side] * np.exp(-apart / (2 * _ALIKE**2)))[:, None] * other
        normals = unit(mean)
    whole = np.maximum(corner_sums(np.repeat(area[:, None], 3, axis=1), faces, len(vertices)), 1e-12)
    moved = vertices.copy()
    for _ in range(_FOLLOWING):
        corners = moved[faces]
        height = np.einsum("fkc,fc->fk", corners.mean(axis=1)[:, None] - corners, normals) * area[:, None]
        step = np.stack([corner_sums(height * normals[:, axis : axis + 1], faces, len(vertices)) for axis in range(3)],
                        axis=1)
        off = moved + step / whole[:, None] - vertices
        length = np.linalg.norm(off, axis=1, keepdims=True)
        moved = vertices + off * np.minimum(1, farthest / np.maximum(length, 1e-12))
    return moved
