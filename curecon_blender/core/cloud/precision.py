# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How precisely each point of a cloud is known: from the sparse points about it, and from how well it was matched.

What cameras and lenses contribute is that of the nearest sparse points. What the matching contributes has their shape,
too, since the same photos see both: it is as much larger as a dense match is less exact than a feature, and smaller
where more photos confirm the point.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from ..adjust.precision_record import read_precision
from ..base.records import View

NEAREST = 8  # sparse points that speak for a point; their median, since some are matched wrongly
MATCHED = 0.5  # pixels of the depth map, standard deviation of one match of full confidence
_MOST_AT_ONCE = 1 << 18


class SparsePrecision:
    """The precision of a component's sparse points."""

    def __init__(self, folder: Path, views: tuple[View, ...]) -> None:
        """Of the record in a component's `folder`; nothing is known where there is none. Raises WorkspaceError for a
        damaged one."""
        record = read_precision(folder)
        self._tree = None
        if record is None or not len(record.places):
            return
        self._tree = cKDTree(record.places)
        # A pixel of the depth maps in pixels of the photos.
        pixel = float(np.median([view.photo_size[0] / view.width if view.photo_size else 1.0 for view in views]))
        own = np.diagonal(record.own, axis1=1, axis2=2)
        self._of_cameras = np.maximum(np.diagonal(record.shapes, axis1=1, axis2=2) - own, 0)
        self._of_one_match = own * (record.rays[:, None] * (MATCHED * pixel / record.sigma) ** 2)

    def sigmas(self, points: np.ndarray, confidence: np.ndarray, views: np.ndarray) -> np.ndarray:
        """Standard deviations (N,3) float32 along x, y, z of `points` (N,3), which `views` (N,) photos confirm with a
        mean `confidence` (N,); 0 where nothing is known."""
        found = np.zeros((len(points), 3), np.float32)
        if self._tree is None:
            return found
        for start in range(0, len(points), _MOST_AT_ONCE):
            part = slice(start, start + _MOST_AT_ONCE)
            _, near = self._tree.query(points[part], min(NEAREST, self._tree.n))
            near = near.reshape(len(points[part]), -1)
            matching = np.median(self._of_one_match[near], axis=1)
            matching /= (views[part] * np.maximum(confidence[part], 0.05))[:, None]
            found[part] = np.sqrt(np.median(self._of_cameras[near], axis=1) + matching)
        return found
