# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Graphs of numbered nodes."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components as scipy_components
from scipy.sparse.csgraph import minimum_spanning_tree


def connected_components(pairs: np.ndarray, count: int) -> np.ndarray:
    """The component, from 0, of each of `count` nodes of which pairs (P,2) are joined; (count,) int32."""
    links = coo_array((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    labels: np.ndarray = scipy_components(links, directed=False)[1]
    return labels


def spanning_tree(distances: np.ndarray) -> np.ndarray:
    """Edges (N-1,2), lower node first, of a minimum spanning tree of a graph with these edge lengths (N,N), both ways
    alike."""
    first, second = np.triu_indices(len(distances), 1)
    lengths = distances[first, second] + 1  # the same tree; to scipy a length of 0 would be no edge
    tree = minimum_spanning_tree(coo_array((lengths, (first, second)), shape=distances.shape).tocsr())
    return np.stack(tree.nonzero(), axis=1)
