# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A finished mesh with fewer faces, which still knows what was measured: what levels of detail are made of."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from ..base.language import Text
from ..base.messages import Reporter
from .mesh import Mesh, MeshError
from .poisson import simplify
from .triangles import triangle_areas

_SAMPLES = 4  # a coarse face, about, for each fine one that may lie on it


def simplified(mesh: Mesh, count: int, scratch: Path, reporter: Reporter) -> Mesh:
    """The mesh with at most `count` faces, by quadric edge collapse, or more where each of its parts is as small as it
    can be; the mesh itself where it has no more.

    Each vertex takes colour, distance and views of the nearest one of the finer mesh. A face is `filled` or `weak`
    where at least half of the finer surface that it stands for is. UVs, pages and `unseen` are dropped: texture the
    result anew. `scratch` is a folder for files, which are deleted again. Raises MeshError for a count below 1 or
    where nothing is left, and WorkspaceError for a full disk.
    """
    if count < 1:
        raise MeshError(Text("A mesh of {} faces cannot be made.", count), remedy="Ask for at least one face.")
    mesh = replace(mesh, unseen=None, uv=None, page=None, pages=(), normal_pages=())
    if len(mesh.faces) <= count:
        return mesh
    vertices, faces = _sound(*simplify(mesh.vertices, mesh.faces, count, scratch, reporter))
    if not len(faces):
        raise MeshError(Text("Nothing is left of the mesh when it is simplified to {} face(s).", count),
                        remedy="Ask for more faces.")
    nearest = cKDTree(mesh.vertices).query(vertices)[1]
    stands_for = _coarse_face(mesh, vertices, faces)
    filled = _vote(mesh.filled, mesh, stands_for, vertices, faces)
    weak = None if mesh.weak is None else _vote(mesh.weak, mesh, stands_for, vertices, faces) & ~filled
    return replace(mesh, vertices=vertices, faces=faces, colours=mesh.colours[nearest],
                   distance=mesh.distance[nearest], views=mesh.views[nearest], filled=filled, weak=weak)


def _sound(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Without faces of no area and unused vertices. Where three faces meet at an edge, as happens between so few, they
    stay: without them one would see holes."""
    used, index = np.unique(faces[triangle_areas(vertices[faces]) > 0], return_inverse=True)
    return np.ascontiguousarray(vertices[used], np.float32), index.reshape(-1, 3).astype(np.int32)


def _coarse_face(mesh: Mesh, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The coarse face (M,) that each face of the finer mesh lies nearest to, by points spread over the coarse ones."""
    area = triangle_areas(vertices[faces])
    wanted = _SAMPLES * len(faces) * area / max(area.sum(), 1e-30)
    face = np.repeat(np.arange(len(faces)), np.maximum(np.rint(wanted).astype(np.int64), 1))
    first, second = np.random.default_rng(0).random((2, len(face), 1)).astype(np.float32)
    root = np.sqrt(first)
    a, b, c = (vertices[faces[face, corner]] for corner in range(3))
    points = (1 - root) * a + root * (1 - second) * b + root * second * c
    middle = mesh.vertices[mesh.faces].mean(axis=1)
    result: np.ndarray = face[cKDTree(points).query(middle)[1]]
    return result


def _vote(mark: np.ndarray, mesh: Mesh, stands_for: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The mark (m,) bool of the coarse faces: that of at least half of the area of the fine ones `stands_for` it, or
    of the nearest fine face where none does."""
    areas = mesh.areas
    whole = np.bincount(stands_for, areas, len(faces))
    result: np.ndarray = 2 * np.bincount(stands_for[mark], areas[mark], len(faces)) >= whole
    lonely = np.flatnonzero(whole == 0)
    if len(lonely):
        nearest = cKDTree(mesh.vertices[mesh.faces].mean(axis=1)).query(vertices[faces[lonely]].mean(axis=1))[1]
        result[lonely] = mark[nearest]
    return result
