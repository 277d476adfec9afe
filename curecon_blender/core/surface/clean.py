# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Cutting the surface back to what is measured, and making it a sound mesh: no dust, no folds, faces outwards."""

from __future__ import annotations

import numpy as np

from ..base.graphs import connected_components
from .support import Support
from .triangles import face_neighbours, face_normals, mesh_edges, triangle_areas

_FLAT = 0.85  # length of a piece's mean unit normal, from which on it goes on as the surface around it does
_SMALLEST_PART = 500  # points' worth of surface: a part with less is floating dust
_SMALLEST_SHARE = 0.001  # of the largest part: what is smaller, and hangs together with nothing, is a raft
_SHORTEST_EDGE = 1e-3  # median spacings: vertices nearer than this are one
_SAMPLE = 20_000  # faces that tell which way they all look


def worth_keeping(
    vertices: np.ndarray, faces: np.ndarray, supported: np.ndarray, distance: np.ndarray, largest_hole: float
) -> np.ndarray:
    """Vertices (n,) bool that are supported, or that belong to what closes a small, flat hole between such.

    `supported` (n,) bool and `distance` (n,) are the vertices'. With `largest_hole` 0 no hole is closed.
    """
    keep: np.ndarray = supported[faces].all(axis=1)
    result = supported.copy()
    if not largest_hole or keep.all():
        return result
    loose = np.flatnonzero(~keep)
    neighbours = face_neighbours(faces)[loose]
    at_border = (neighbours < 0).any(axis=1)
    face, edge = np.nonzero((neighbours >= 0) & ~keep[neighbours])
    piece = connected_components(
        np.stack([face, np.searchsorted(loose, neighbours[face, edge])], axis=1), len(loose))
    depth = np.zeros(piece.max() + 1, np.float32)
    np.maximum.at(depth, piece, distance[faces[loose]].max(axis=1))
    ends_in_the_air = np.bincount(piece, weights=at_border) > 0  # nothing around it to close
    normals = face_normals(vertices, faces[loose])
    mean = np.stack([np.bincount(piece, weights=normals[:, axis]) for axis in range(3)], axis=1)
    flat = np.linalg.norm(mean, axis=1) >= _FLAT * np.bincount(piece, weights=np.linalg.norm(normals, axis=1))
    closing = ((depth <= largest_hole) & flat & ~ends_in_the_air)[piece]
    result[faces[loose[closing]]] = True
    return result


def drop_small_parts(
    vertices: np.ndarray, faces: np.ndarray, supported: np.ndarray, local_spacing: np.ndarray
) -> np.ndarray:
    """Faces (k,3) without the parts that only a few points carry. The last two (n,) are the vertices'."""
    if not len(faces):
        return faces
    part = connected_components(faces[:, [0, 1, 1, 2]].reshape(-1, 2), len(vertices))[faces[:, 0]]
    measured = supported[faces].all(axis=1)
    squares = triangle_areas(vertices[faces]) / local_spacing[faces].mean(axis=1) ** 2
    points = np.bincount(part, weights=measured * squares)
    least = max(_SMALLEST_PART, _SMALLEST_SHARE * points.max())
    large: np.ndarray = faces[points[part] >= least]
    return large


def clean(vertices: np.ndarray, faces: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces without double vertices, degenerate faces, edges of three faces, and unused vertices."""
    edges = mesh_edges(faces)[0]
    short = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1) < _SHORTEST_EDGE * spacing
    if short.any():
        merged = connected_components(edges[short], len(vertices))
        vertices, faces = vertices[np.unique(merged, return_index=True)[1]], merged[faces]
    faces = faces[triangle_areas(vertices[faces]) > (_SHORTEST_EDGE * spacing) ** 2]
    faces = faces[np.unique(np.sort(faces, axis=1), axis=0, return_index=True)[1]]
    while len(faces):
        edge = mesh_edges(faces)[1]
        crowded = (np.bincount(edge.ravel())[edge] > 2).any(axis=1)
        if not crowded.any():
            break
        # The smaller half of what meets there goes: the fins of a fold, seldom the surface.
        area = triangle_areas(vertices[faces])
        faces = faces[~crowded | (area > np.median(area[crowded]))]
    used, index = np.unique(faces, return_inverse=True)
    return np.ascontiguousarray(vertices[used], np.float32), index.reshape(-1, 3).astype(np.int32)


def orient(vertices: np.ndarray, faces: np.ndarray, support: Support) -> np.ndarray:
    """The faces (m,3), turned over together where most of them look away from the cloud's normals."""
    sample = faces[np.random.default_rng(0).choice(len(faces), min(len(faces), _SAMPLE), replace=False)]
    _, nearest = support.nearest(vertices[sample].mean(axis=1))
    agreement = np.einsum("nc,nc->n", face_normals(vertices, sample), support.cloud.normals[nearest])
    return faces if agreement.sum() >= 0 else faces[:, ::-1].copy()
