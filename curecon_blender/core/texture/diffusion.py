# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours for what no photo shows, from what is around it."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import cg

_TOLERANCE = 1e-3
_ITERATIONS = 400
_PULL = 0.02  # of the guess for an unseen vertex, beside 1 for each of its edges


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


def _incidence(start: np.ndarray, end: np.ndarray, count: int) -> sp.csr_array:
    """One row an edge: +1 at its start, -1 at its end."""
    rows = np.repeat(np.arange(len(start)), 2)
    return sp.csr_array(
        (np.tile([1.0, -1.0], len(start)), (rows, np.stack([start, end], axis=1).ravel())), shape=(len(start), count)
    )
