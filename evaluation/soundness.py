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

import numpy as np

from curecon_blender.core.surface.crossing import crossing
from curecon_blender.core.surface.mesh import read_mesh
from curecon_blender.core.surface.triangles import face_neighbours, face_normals, mesh_edges, triangle_areas

SLIVER, FOLD = 5.0, 150.0  # degrees


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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("mesh", type=Path, nargs="+")
    for path in parser.parse_args().mesh:
        mesh = read_mesh(path)
        print(path, *(f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value:,}"
                      for name, value in asdict(soundness(mesh.vertices, mesh.faces)).items()))


if __name__ == "__main__":
    main()
