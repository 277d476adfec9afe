# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What is unsound in a mesh: slivers, folds, edges of more than two faces, faces that pass through each other.

    python -m evaluation.soundness MESH ...

A *sliver* has an angle below 5 degrees; a *fold* is an edge whose two faces turn back by more than 150 degrees; faces
*cross* where an edge of one passes through the other and they share no corner. Areas are those of the 10th, 50th and
90th of a hundred faces, over the median: how far apart they lie tells that faces follow the detail.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit

from curecon_blender.core.surface.mesh import read_mesh
from curecon_blender.core.surface.triangles import face_neighbours, face_normals, mesh_edges, triangle_areas

SLIVER, FOLD = 5.0, 150.0  # degrees
_CELL = 3.0  # median edges: side of the cells that faces are looked for in
_compiled: Any = njit(nogil=True, error_model="numpy")


@dataclass(frozen=True, kw_only=True)
class Soundness:
    faces: int
    slivers: float  # per cent of the faces
    folds: int
    crowded: int  # edges of more than two faces
    crossing: int  # faces
    smallest_tenth: float
    largest_tenth: float


def soundness(vertices: np.ndarray, faces: np.ndarray) -> Soundness:
    """Of a mesh (N,3), (M,3)."""
    corners = vertices[faces].astype(np.float64)
    sides = np.sort(np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2), axis=1)
    areas = triangle_areas(corners)
    least = np.degrees(np.arcsin(np.clip(2 * areas / (sides[:, 1] * sides[:, 2]), 0, 1)))
    normals = face_normals(vertices.astype(np.float64), faces)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    face, corner = np.nonzero((beside := face_neighbours(faces)) >= 0)
    turned = (normals[face] * normals[beside[face, corner]]).sum(axis=1) < np.cos(np.radians(FOLD))
    tenth, median, ninth = np.quantile(areas, [0.1, 0.5, 0.9])
    return Soundness(
        faces=len(faces), slivers=100 * float((least < SLIVER).mean()), folds=int(turned.sum()) // 2,
        crowded=int((np.bincount(mesh_edges(faces)[1].ravel()) > 2).sum()),
        crossing=int(crossing(corners, faces).sum()),
        smallest_tenth=float(tenth / median), largest_tenth=float(ninth / median),
    )


def crossing(corners: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Which of the faces (M,) pass through another, by their corners (M,3,3) and vertex numbers (M,3)."""
    side = _CELL * float(np.median(np.linalg.norm(corners[:, 0] - corners[:, 1], axis=1)))
    low = np.floor((corners.min(axis=1) - corners.min(axis=(0, 1))) / side).astype(np.int64)
    high = np.floor((corners.max(axis=1) - corners.min(axis=(0, 1))) / side).astype(np.int64)
    count = (high - low + 1).prod(axis=1)
    owner = np.repeat(np.arange(len(faces)), count)
    number = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    span = (high - low + 1)[owner]
    cell = low[owner] + np.stack([number // (span[:, 1] * span[:, 2]), number // span[:, 2] % span[:, 1],
                                  number % span[:, 2]], axis=1)
    key = (cell[:, 0] << 42) + (cell[:, 1] << 21) + cell[:, 2]
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.r_[True, np.diff(key[order]) > 0, True])
    found = np.zeros(len(faces), np.bool_)
    _find(corners, faces, owner[order], starts, found)
    return found


@_compiled
def _find(corners, faces, owner, starts, found):  # type: ignore[no-untyped-def]
    for c in range(len(starts) - 1):
        for i in range(starts[c], starts[c + 1]):
            for j in range(i + 1, starts[c + 1]):
                a, b = owner[i], owner[j]
                if found[a] and found[b]:
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("mesh", type=Path, nargs="+")
    for path in parser.parse_args().mesh:
        mesh = read_mesh(path)
        print(path, *(f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value:,}"
                      for name, value in asdict(soundness(mesh.vertices, mesh.faces)).items()))


if __name__ == "__main__":
    main()
