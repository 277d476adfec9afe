# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What photos saw of a place: through it, so that it is empty, or it, though too few agreed for the cloud.

A depth map says more than the fused cloud does. A sure photo looks through all that lies before its depth: no surface
can be there. And where one photo alone is sure and none looks through, its depth is *weak* evidence of a surface. On
the sample site 71 % of such pixels lie within 20 cm of the truth at a confidence of 0.5, 85 % at 0.7.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numba import njit

from ..base import images
from ..base.errors import PhotoError, WorkspaceError
from ..base.language import Text
from ..base.messages import Reporter
from ..base.records import Component, View
from ..cloud.normals import normals
from ..cloud.ply import Cloud
from ..cloud.sky import sky_mask
from ..depth.maps import depth_path, read_depth
from ..views.masks import left_out
from .cells import STEPS, cell_numbers

SURE = 0.5  # confidence from which on a photo says what is empty
_LEVEL = np.cos(np.radians(1.0))  # where a turn tilts Z by more than a degree, it is up no longer
_ALONE = 0.7  # confidence from which on one photo alone says what is there
FINE = 0.006  # of the depth: by how much farther a photo must see to look through a gap
_THROUGH = 0.02  # of the depth: a sure photo that sees that much farther looks through a place
_EXPLAINED = 0.03  # of the depth: a pixel whose depth lies that near to the cloud's adds nothing
_NEAR = 20.0  # spacings: side of the cubes about the cloud's points that a weak point may lie in
_AROUND = 5  # pixels: side of the square that one point of the cloud explains
_compiled: Any = njit(nogil=True, error_model="numpy")


@dataclass(frozen=True)
class Glance:
    """One photo's depth map: `depth` (H,W) float32 z-depth, 0 where unknown, infinite in the sky; `sure` (H,W) bool;
    `confidence` (H,W) float32; `picture` (H,W,3) uint8."""

    view: View
    depth: np.ndarray
    sure: np.ndarray
    confidence: np.ndarray
    picture: np.ndarray


class Sight:
    """The depth maps of a component's photos, read one after another, and `views`, all of its cameras. `turn` (3,3)
    takes the site's axes to those of the places asked about. `z_up`: whether Z of those is known to be up. `each` is
    called for every depth map that is read."""

    def __init__(
        self, component: Component, workspace: Path, reporter: Reporter, turn: np.ndarray | None = None
    ) -> None:
        self.views = [_turned(view, turn) for view in component.views]
        self._told = [view for view in component.views if depth_path(workspace, view.name).exists()]
        self._workspace, self._reporter, self._turn = workspace, reporter, turn
        self._site_z_up = component.frame.up != "given"
        self.z_up = self._site_z_up and (turn is None or bool(turn[2, 2] > _LEVEL))
        self._skies: dict[str, np.ndarray] = {}
        self.each: Callable[[], None] = lambda: None

    def __bool__(self) -> bool:
        return bool(self._told)

    def glances(self) -> Iterator[Glance]:
        """Every photo's depth map; one that cannot be read says nothing, with a warning."""
        for view in self._told:
            self._reporter.check_cancelled()
            self.each()
            try:
                depth, confidence = read_depth(self._workspace, view)
                picture = images.read_rgb(self._workspace / view.image)
            except (WorkspaceError, PhotoError) as error:
                self._reporter.warning(Text("{} It tells nothing of what is empty.", error.message), view.name)
                continue
            depth = np.where(np.isfinite(depth) & (depth > 0), depth, 0).astype(np.float32)
            confidence = np.nan_to_num(confidence.astype(np.float32))
            sure = (confidence >= SURE) & (depth > 0)
            if self._site_z_up:
                sky = self._sky(view, picture, confidence)
                depth[sky] = np.inf
                sure[sky] = True
            yield Glance(_turned(view, self._turn), depth, sure, confidence, picture)

    def _sky(self, view: View, picture: np.ndarray, confidence: np.ndarray) -> np.ndarray:
        if view.name not in self._skies:
            sky = sky_mask(picture, confidence, view.K, view.cam_from_world)
            if (hidden := left_out(self._workspace, view)) is not None:
                sky &= ~hidden
            self._skies[view.name] = np.packbits(sky)
        bits = np.unpackbits(self._skies[view.name], count=confidence.size)
        return bits.view(bool).reshape(confidence.shape)


def _turned(view: View, turn: np.ndarray | None) -> View:
    """A view with its pose in the axes of the places asked about."""
    if turn is None:
        return view
    pose = view.cam_from_world.copy()
    pose[:, :3] = pose[:, :3] @ turn.T
    return replace(view, cam_from_world=pose)


def looked_through(places: np.ndarray, sight: Sight, farther: float = _THROUGH) -> np.ndarray:
    """How many photos surely look through each of places (n,3), (n,) uint8: see farther by this share of the depth."""
    count = np.zeros(len(places), np.uint8)
    for glance in sight.glances():
        # The nearest depth about a pixel: beside an outline nobody knows which of the two surfaces a place is before.
        depth = np.where(glance.sure, glance.depth, 0)
        _count_through(np.ascontiguousarray(places, np.float32), *_camera(glance.view),
                       np.asarray(cv2.erode(depth, np.ones((3, 3), np.uint8))), np.float32(1 + farther), count)
    return count


def weak_points(cloud: Cloud, sight: Sight, spacing: float) -> Cloud:
    """Points, about one a `spacing`, that a photo is sure of where the cloud has none and no photo looks through; their
    `views` are 1."""
    points = np.ascontiguousarray(cloud.points, np.float32)
    found = []
    for glance in sight.glances():
        explained = np.zeros(glance.depth.shape, np.uint8)
        _explain(points, *_camera(glance.view), glance.depth, np.float32(_EXPLAINED), explained)
        explained = np.asarray(cv2.dilate(explained, np.ones((_AROUND, _AROUND), np.uint8)))
        index = np.flatnonzero((glance.confidence >= _ALONE) & (glance.depth > 0) & np.isfinite(glance.depth)
                               & (explained == 0))
        if len(index):
            found.append(_lifted(glance, index, spacing))
    if not found:
        return cloud.take(np.zeros(0, np.int64))
    weak = Cloud(*(np.concatenate(columns) for columns in zip(*found, strict=True)))
    weak = weak.take(_one_a_cell(weak.points, weak.confidence, spacing))
    weak = weak.take(_beside(weak.points, cloud.points, _NEAR * spacing))
    return weak.take(looked_through(weak.points, sight) == 0)


def _lifted(glance: Glance, index: np.ndarray, spacing: float) -> tuple[np.ndarray, ...]:
    """The arrays of a Cloud of the pixels `index`, one a cell."""
    view = glance.view
    depth = np.where(np.isfinite(glance.depth) & (glance.depth > 0), glance.depth, np.nan)
    row, column = np.divmod(index, view.width)
    z = glance.depth.ravel()[index].astype(np.float64)
    camera = np.stack([column + 0.5, row + 0.5, np.ones(len(index))], axis=1) @ np.linalg.inv(view.K).T * z[:, None]
    rotation, translation = view.cam_from_world[:, :3], view.cam_from_world[:, 3]
    points = ((camera - translation) @ rotation).astype(np.float32)
    confidence = glance.confidence.ravel()[index]
    keep = _one_a_cell(points, confidence, spacing)
    normal = (normals(depth, 0, view.K, index[keep]).T @ rotation).astype(np.float32)
    return (points[keep], glance.picture.reshape(-1, 3)[index[keep]], normal, confidence[keep],
            np.ones(len(keep), np.uint8))


def _one_a_cell(points: np.ndarray, confidence: np.ndarray, side: float) -> np.ndarray:
    """Indices of the surest point in each cube of a grid."""
    surest = np.argsort(-confidence, kind="stable")
    first = np.unique(cell_numbers(points, points.min(axis=0), side)[surest], return_index=True)[1]
    kept: np.ndarray = np.sort(surest[first])
    return kept


def _beside(places: np.ndarray, points: np.ndarray, side: float) -> np.ndarray:
    """Which of places (n,3) have one of the points in the 3x3x3 cubes about theirs, (n,) bool."""
    low = np.minimum(places.min(axis=0), points.min(axis=0)) - 2 * side
    held = np.unique(cell_numbers(points, low, side))
    key = cell_numbers(places, low, side)
    found = np.zeros(len(places), bool)
    for offset in np.stack(np.meshgrid(*[[-1, 0, 1]] * 3), axis=-1).reshape(-1, 3) @ STEPS:
        at = np.minimum(np.searchsorted(held, key + offset), len(held) - 1)
        found |= held[at] == key + offset
    return found


def _camera(view: View) -> tuple[np.ndarray, np.ndarray]:
    """Projection (3,4) float64, and (width, height)."""
    return view.K @ view.cam_from_world, np.array([view.width, view.height])


@_compiled
def _pixel(point, projection, size):  # type: ignore[no-untyped-def]
    """The row and column (-1 outside of the picture) that a point is seen at, and its depth."""
    x, y, z = point[0], point[1], point[2]
    w = projection[2, 0] * x + projection[2, 1] * y + projection[2, 2] * z + projection[2, 3]
    if w > 0:
        u = (projection[0, 0] * x + projection[0, 1] * y + projection[0, 2] * z + projection[0, 3]) / w
        v = (projection[1, 0] * x + projection[1, 1] * y + projection[1, 2] * z + projection[1, 3]) / w
        if 0 <= u < size[0] and 0 <= v < size[1]:
            return int(v), int(u), w
    return -1, -1, w


@_compiled
def _count_through(points, projection, size, depth, factor, count):  # type: ignore[no-untyped-def]
    for i in range(len(points)):
        row, column, w = _pixel(points[i], projection, size)
        if row >= 0 and depth[row, column] > w * factor:
            count[i] = min(count[i] + 1, 255)


@_compiled
def _explain(points, projection, size, depth, share, explained):  # type: ignore[no-untyped-def]
    for i in range(len(points)):
        row, column, w = _pixel(points[i], projection, size)
        if row >= 0 and abs(depth[row, column] - w) < share * w:
            explained[row, column] = 1
