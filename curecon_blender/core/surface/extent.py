# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a site ends: what photos saw only from afar is background, not record.

An orbit about a building sees fields and trees behind it, too, at a few times the pixel size, in shreds and rafts. What
counts is the finest ground sampling distance at which any photo has a place in its frame, against that of the cloud.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..base.records import View
from .cells import cell_numbers

FAR = 3.0  # times the cloud's median ground sampling distance: what no photo shows finer is background
NEAR = 1.5  # times the same: what some photo shows finer is the subject and what lies about it
_CELL = 20.0  # spacings: side of the cubes that are asked first
_DOUBT = 1.25  # a cube's points are asked one by one where its middle is that near to the limit


def within(points: np.ndarray, views: Sequence[View], spacing: float, times: float) -> np.ndarray:
    """Which of points (n,3) a photo shows finer than so many times the cloud's median ground sampling distance, (n,)
    bool: all where there are no views."""
    if not views:
        return np.ones(len(points), bool)
    number = cell_numbers(points, points.min(axis=0), _CELL * spacing)
    _, first, cell, count = np.unique(number, return_index=True, return_inverse=True, return_counts=True)
    finest = _sampling_distance(points[first], views)
    order = np.argsort(finest)
    median = finest[order][np.searchsorted(np.cumsum(count[order]), len(points) / 2)]
    limit = times * median
    inside = finest <= limit
    doubtful = (finest > limit / _DOUBT) & (finest < limit * _DOUBT)
    kept: np.ndarray = inside[cell]
    asked = np.flatnonzero(doubtful[cell])
    kept[asked] = _sampling_distance(points[asked], views) <= limit
    return kept


def _sampling_distance(places: np.ndarray, views: Sequence[View]) -> np.ndarray:
    """World units a pixel at places (n,3), (n,), in the finest of the views that have them in their frame; infinite
    where none has."""
    finest = np.full(len(places), np.inf)
    for view in views:
        camera = places @ view.cam_from_world[:, :3].T + view.cam_from_world[:, 3]
        depth = camera[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            pixel = (camera @ view.K.T)[:, :2] / depth[:, None]
            inside = (depth > 0) & ((pixel >= 0) & (pixel < [view.width, view.height])).all(axis=1)
        finest[inside] = np.minimum(finest[inside], depth[inside] / view.K[0, 0])
    return finest
