# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Contours, plan cuts and vertical cuts of a mesh as drawings."""

from __future__ import annotations

import numpy as np

from ..base.language import Text
from ..base.messages import Reporter
from ..surface.mesh import Mesh
from .cuts import clipped, cut
from .drawings import Stroke
from .ortho import round_up
from .placement import DeliverError

_LEVELS = 40  # contours of a site, about, where nobody says how far apart
_MOST_LEVELS = 5000
_INDEX = 5  # every fifth contour is drawn heavier


def mesh_of_lines(mesh: Mesh | None) -> Mesh:
    """Raises DeliverError where there is none."""
    if mesh is None:
        raise DeliverError("Contours and sections are cut from the mesh, and there is none.",
                           remedy="Build Mesh first, then export them.")
    return mesh


def contours(mesh: Mesh, places: np.ndarray, interval: float | None, reporter: Reporter) -> tuple[list[Stroke], float]:
    """The lines at each whole multiple of `interval` of a mesh whose vertices are at `places` (N,3), and the interval.
    Raises DeliverError for too many, Cancelled."""
    heights = places[:, 2]
    low, high = (float(bound) for bound in (heights.min(), heights.max()))
    step = interval or round_up(max(high - low, 1e-6) / _LEVELS)
    first, last = int(np.ceil(low / step)), int(np.floor(high / step))
    count = last - first + 1
    if count > _MOST_LEVELS:
        raise DeliverError(Text("Contours every {:g} would be {}; {} are the most.", step, count, _MOST_LEVELS),
                           remedy=Text("Choose {:g} or more.", round_up((high - low) / _MOST_LEVELS)))
    strokes = []
    for number in range(first, last + 1):
        layer = "CONTOUR" if number % _INDEX else "CONTOUR_INDEX"
        for line in cut(places, mesh.faces, mesh.filled, heights, number * step):
            strokes.append(Stroke(layer="CONTOUR_FILLED" if line.filled else layer, points=line.points[:, :2],
                                  closed=line.closed, elevation=number * step))
        reporter.progress(number - first + 1, count)
    return strokes, step


def plan_cut(mesh: Mesh, places: np.ndarray, height: float) -> list[Stroke]:
    """What a level plane at `height` cuts of a mesh whose vertices are at `places` (N,3)."""
    return [Stroke(layer=_layer(line.filled), points=line.points[:, :2], closed=line.closed, elevation=height)
            for line in cut(places, mesh.faces, mesh.filled, places[:, 2], height)]


def vertical_cut(mesh: Mesh, places: np.ndarray, start: np.ndarray, end: np.ndarray) -> list[Stroke]:
    """What an upright plane from `start` to `end` (2,) cuts: x along it from the start, y the height. Raises
    DeliverError for ends at one place."""
    length = float(np.linalg.norm(end - start))
    if length < 1e-9:
        raise DeliverError("The two ends of a section lie at one place.", remedy="Choose two that lie apart.")
    along = np.array([*(end - start) / length, 0.0])
    across = np.array([-along[1], along[0], 0.0])
    shifted = places - [*start, 0.0]
    strokes = []
    for whole in cut(shifted, mesh.faces, mesh.filled, shifted @ across, 0.0):
        for line in clipped(whole, along, 0.0, length):
            flat = np.column_stack([line.points @ along, line.points[:, 2]])
            strokes.append(Stroke(layer=_layer(line.filled), points=flat, closed=line.closed))
    return strokes


def middle_cuts(places: np.ndarray, turn: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Two cuts through the middle of places (N,3), along and across axes turned by `turn` (radians)."""
    x, y = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
    low, high = (np.array([bound(places[:, :2] @ axis) for axis in (x, y)]) for bound in (np.min, np.max))
    middle = (low + high) / 2
    return [(low[0] * x + middle[1] * y, high[0] * x + middle[1] * y),
            (middle[0] * x + low[1] * y, middle[0] * x + high[1] * y)]


def _layer(filled: bool) -> str:
    return "CUT_FILLED" if filled else "CUT"
