# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How much each photo counts for the colours of the surface, gradually from place to place.

Where several photos show a place well and alike, their mean is truer than any of them: noise goes, and what the mesh
has slightly wrong shows less. Towards the edge of what a photo shows its weight falls to nothing over some rings of
vertices, so that one sees no seam where it ends.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

_RINGS = 3  # of vertices over which a photo fades out
_LEAST = 1e-3  # of a photo's weight for a face is left where it fades out: it may be the only one


@dataclass(frozen=True)
class Shares:
    """`view` (M,K) int16, candidates of each face, and `weight` (M,K) float32, how much each counts for it, 0 for not
    at all; `faces` (M,3) of `vertices` vertices."""

    view: np.ndarray
    weight: np.ndarray
    faces: np.ndarray
    vertices: int

    @property
    def seen(self) -> np.ndarray:
        """Whether any photo counts for each face (M,)."""
        seen: np.ndarray = (self.weight > 0).any(axis=1)
        return seen

    def of(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        """The faces (n,) int64 that photo `number` counts for, and its weight at their corners (n,3) float32."""
        face, slot = np.nonzero((self.view == number) & (self.weight > 0))
        weight = self.weight[face, slot]
        own = np.zeros(len(self.faces), np.float32)
        own[face] = weight
        return face, np.maximum(_faded(self.faces, own, self.vertices)[self.faces[face]], _LEAST * weight[:, None])


@njit(nogil=True)
def _faded(faces, weight, vertices):  # type: ignore[no-untyped-def]
    """Weights (N,) at the vertices of those (M,) of the faces, falling to 0 towards faces whose weight is 0."""
    count = np.zeros(vertices, np.float32)
    shown, mean = np.zeros(vertices, np.float32), np.zeros(vertices, np.float32)
    for face in range(len(faces)):
        for corner in range(3):
            vertex = faces[face, corner]
            count[vertex] += 1
            mean[vertex] += weight[face]
            shown[vertex] += weight[face] > 0
    for vertex in range(vertices):
        mean[vertex] /= max(shown[vertex], np.float32(1))
        shown[vertex] /= max(count[vertex], np.float32(1))
    for _ in range(_RINGS - 1):
        wider = np.zeros(vertices, np.float32)
        for face in range(len(faces)):
            share = (shown[faces[face, 0]] + shown[faces[face, 1]] + shown[faces[face, 2]]) / np.float32(3)
            for corner in range(3):
                wider[faces[face, corner]] += share
        for vertex in range(vertices):
            shown[vertex] = wider[vertex] / max(count[vertex], np.float32(1))
    for vertex in range(vertices):
        mean[vertex] *= min(max(np.float32(2) * shown[vertex] - np.float32(1), np.float32(0)), np.float32(1))
    return mean
