# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Making patches from different photos meet without a step: colour levelling and cross-fading at seams.

Colours are levelled as in Waechter et al. 2014 ("Let There Be Color!", after Lempitsky and Ivanov 2007): at a vertex
on a seam the photos get corrections that make their colours meet, and corrections change slowly within a patch. Here
they also fade out away from seams, since what all of a photo has too much or too little of is in its gain already.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import cg

from ..surface.triangles import mesh_edges

_SMOOTH = 1.0  # weight of a small change along an edge, beside 1 for meeting at a seam
_FADE = 2e-3  # of a small correction: it halves over some 15 edges
_TOLERANCE = 1e-3
_ITERATIONS = 400
_PULL = 0.02  # of the guess for an unseen vertex, beside 1 for each of its edges
_RINGS = 4  # of vertices on each side of a seam across which two photos fade into each other


@dataclass(frozen=True)
class Nodes:
    """The pairs of a vertex and a photo that textures a face at it. `vertex`, `view` (P,) int32, sorted by vertex;
    `corner` (M,3) int32, the pair at each face's corner, -1 on faces of no photo."""

    vertex: np.ndarray
    view: np.ndarray
    corner: np.ndarray

    @classmethod
    def of(cls, faces: np.ndarray, label: np.ndarray, views: int) -> Nodes:
        seen = np.flatnonzero(label >= 0)
        key = faces[seen].astype(np.int64) * views + label[seen, None]
        pairs, index = np.unique(key, return_inverse=True)
        corner = np.full(faces.shape, -1, np.int32)
        corner[seen] = index.reshape(-1, 3)
        vertex, view = np.divmod(pairs, views)
        return cls(vertex.astype(np.int32), view.astype(np.int32), corner)

    def find(self, vertex: np.ndarray, view: np.ndarray) -> np.ndarray:
        """The node of each vertex and photo (broadcast together), -1 where there is none."""
        views = int(max(self.view.max(initial=0), view.max(initial=0))) + 1
        known = self.vertex.astype(np.int64) * views + self.view
        wanted = vertex.astype(np.int64) * views + view
        at = np.minimum(np.searchsorted(known, wanted), max(len(known) - 1, 0))
        found: np.ndarray = np.where(known[at] == wanted, at, -1)
        return found

    def seams(self) -> tuple[np.ndarray, np.ndarray]:
        """Pairs (S,), (S,) of nodes at the same vertex: each with the next."""
        same = np.flatnonzero(self.vertex[1:] == self.vertex[:-1])
        return same, same + 1

    def edges(self) -> tuple[np.ndarray, np.ndarray]:
        """Pairs (E,), (E,) of nodes at the two ends of an edge of a face."""
        start, end = mesh_edges(self.corner[self.corner[:, 0] >= 0])[0].T
        return start, end


def level(nodes: Nodes, colour: np.ndarray) -> np.ndarray:
    """Corrections (P,3) float32 to add to the colours (P,3) of the nodes so that they meet at seams. sRGB, 0 to 255."""
    count = len(nodes.vertex)
    one, two = nodes.seams()
    correction = np.zeros((count, 3), np.float32)
    if not len(one):
        return correction
    start, end = nodes.edges()
    seams = _incidence(one, two, count)
    along = _incidence(start, end, count)
    normal = seams.T @ seams + _SMOOTH * (along.T @ along) + sp.diags_array(np.full(count, _FADE))
    normal = sp.csr_array(normal)
    preconditioner = sp.diags_array(1 / normal.diagonal())
    gap = colour[two].astype(np.float64) - colour[one]
    for channel in range(3):
        right = seams.T @ gap[:, channel]
        solved, _ = cg(normal, right, rtol=_TOLERANCE, maxiter=_ITERATIONS, M=preconditioner)
        correction[:, channel] = solved
    return correction


def _incidence(start: np.ndarray, end: np.ndarray, count: int) -> sp.csr_array:
    """One row an edge: +1 at its start, -1 at its end."""
    rows = np.repeat(np.arange(len(start)), 2)
    return sp.csr_array(
        (np.tile([1.0, -1.0], len(start)), (rows, np.stack([start, end], axis=1).ravel())), shape=(len(start), count)
    )


def cross_fade(
    faces: np.ndarray, label: np.ndarray, usable: np.ndarray, small: np.ndarray, vertices: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A second photo (M,) int16 for the faces near a seam, -1 elsewhere; its weight at their corners (M,3) float32; and
    for every vertex (N,) int32 the seam's vertex that it was reached from, whose corrections the second photo takes.

    On the seam both weigh a half; the second one's weight falls to nothing over some rings of vertices. `usable`
    (M,K) int16 are the photos that see a face well; `small` (M,) tells which faces may be blended at all: on a large
    one the band would be wide and show everything twice.
    """
    second = np.full(len(faces), -1, np.int16)
    weight = np.zeros(faces.shape, np.float32)
    # Which two photos meet at the nearest seam, and how many rings away it is: spread ring by ring.
    low = np.full(vertices, np.iinfo(np.int16).max, np.int16)
    high = np.full(vertices, -1, np.int16)
    seen = label >= 0
    for corner in range(3):
        np.minimum.at(low, faces[seen, corner], label[seen])
        np.maximum.at(high, faces[seen, corner], label[seen])
    seam = (high >= 0) & (low != high)
    ring = np.where(seam, 0, _RINGS).astype(np.int8)
    first, other = np.where(seam, low, -1).astype(np.int16), np.where(seam, high, -1).astype(np.int16)
    origin = np.arange(vertices, dtype=np.int32)
    for step in range(1, _RINGS):
        near = ring[faces].min(axis=1) == step - 1
        touched = faces[near]
        source = touched[np.arange(len(touched)), ring[touched].argmin(axis=1)]
        for corner in range(3):
            target = touched[:, corner]
            fresh = ring[target] == _RINGS
            ring[target[fresh]] = step
            for spread in (first, other, origin):
                spread[target[fresh]] = spread[source[fresh]]
    nearest = faces[np.arange(len(faces)), ring[faces].argmin(axis=1)]
    a, b = first[nearest], other[nearest]
    partner = np.where(a == label, b, np.where(b == label, a, -1))
    partner[(ring[nearest] >= _RINGS) | ~seen | ~small] = -1
    good = (usable == partner[:, None]).any(axis=1) & (partner >= 0)
    second[good] = partner[good]
    weight[good] = 0.5 * (1 - ring[faces[good]] / _RINGS)
    return second, weight, origin


def diffuse(faces: np.ndarray, colours: np.ndarray, known: np.ndarray, guess: np.ndarray) -> np.ndarray:
    """Colours (N,3) float64 of all vertices: `colours` (N,3) where `known` (N,), elsewhere spread along the edges from
    there, drawn a little to `guess` (N,3)."""
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    result = np.where(known[:, None], colours, guess).astype(np.float64)
    unknown = np.flatnonzero(~known)
    ends = ends[~known[ends].all(axis=1)]
    if not len(unknown):
        return result
    edges = _incidence(ends[:, 0], ends[:, 1], len(colours))
    laplacian = sp.csr_array(edges.T @ edges)[unknown]
    inner = sp.csr_array(laplacian[:, unknown] + sp.diags_array(np.full(len(unknown), _PULL)))
    outside = laplacian[:, np.flatnonzero(known)]
    preconditioner = sp.diags_array(1 / inner.diagonal())
    for channel in range(3):
        right = _PULL * guess[unknown, channel].astype(np.float64) - outside @ result[known, channel]
        start = result[unknown, channel]
        result[unknown, channel], _ = cg(
            inner, right, x0=start, rtol=_TOLERANCE, maxiter=_ITERATIONS, M=preconditioner
        )
    return result
