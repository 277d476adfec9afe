# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours for what no photo shows, from what is around it: along the surface, but hardly around its corners."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import cg

from ..surface.triangles import corner_sums, triangle_areas, vertex_normals

_TOLERANCE = 1e-3
_ITERATIONS = 400
_PULL = 0.02  # of the guess for an unseen vertex of the usual area, beside 1 for each of its edges
_CREASE = 16  # an edge counts by this power of the cosine of its ends' normals
_LEAST = 1e-3  # what an edge counts, and a vertex's area in usual ones, at least


def diffuse(
    vertices: np.ndarray, faces: np.ndarray, colours: np.ndarray, known: np.ndarray, guess: np.ndarray
) -> np.ndarray:
    """Colours (N,3) float64 of all `vertices` (N,3): `colours` (N,3) where `known` (N,), elsewhere spread along the
    edges from there, drawn a little to `guess` (N,3)."""
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    result = np.where(known[:, None], colours, guess).astype(np.float64)
    unknown = np.flatnonzero(~known)
    ends = ends[~known[ends].all(axis=1)]
    if not len(unknown):
        return result
    normals = vertex_normals(vertices, faces)
    area = corner_sums(np.repeat(triangle_areas(vertices[faces])[:, None], 3, axis=1), faces, len(vertices))
    pull = _PULL * np.maximum(area[unknown] / np.median(area), _LEAST)
    cosine = np.maximum((normals[ends[:, 0]] * normals[ends[:, 1]]).sum(axis=1), 0)
    edges = _incidence(ends[:, 0], ends[:, 1], np.maximum(cosine**_CREASE, _LEAST), len(colours))
    laplacian = sp.csr_array(edges.T @ edges)[unknown]
    inner = sp.csr_array(laplacian[:, unknown] + sp.diags_array(pull))
    outside = laplacian[:, np.flatnonzero(known)]
    preconditioner = sp.diags_array(1 / inner.diagonal())
    for channel in range(3):
        right = pull * guess[unknown, channel].astype(np.float64) - outside @ result[known, channel]
        start = result[unknown, channel]
        result[unknown, channel], _ = cg(
            inner, right, x0=start, rtol=_TOLERANCE, maxiter=_ITERATIONS, M=preconditioner
        )
    return result


def _incidence(start: np.ndarray, end: np.ndarray, weight: np.ndarray, count: int) -> sp.csr_array:
    """One row an edge: at its start the root of its weight, at its end minus that."""
    rows, root = np.repeat(np.arange(len(start)), 2), np.sqrt(weight)
    values, columns = np.stack([root, -root], axis=1), np.stack([start, end], axis=1)
    return sp.csr_array((values.ravel(), (rows, columns.ravel())), shape=(len(start), count))
