# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth maps as fusion looks things up in them: without the sky, with their pictures, within a number of bytes."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from ..base import images
from ..base.errors import PhotoError, WorkspaceError
from ..base.files import disk_errors
from ..base.language import Text
from ..base.messages import Reporter
from ..base.records import View
from ..base.sampling import sample
from ..depth.maps import read_depth
from .sky import sky_mask

BYTES_PER_PIXEL = 9  # of a depth map in memory


@dataclass(frozen=True)
class DepthMap:
    """A photo ready for lookups. `inverse_depth` (H,W) float32, NaN = none; `confidence` (H,W) float16;
    `colours` (H,W,3) uint8 RGB. Inverse depth, because it is linear over the pixels of a plane and depth is not."""

    inverse_depth: np.ndarray
    confidence: np.ndarray
    colours: np.ndarray

    def confidence_at(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Confidence (n,) float32 of the pixels nearest to u, v (n,)."""
        bits = sample(self.confidence.view(np.uint16), u, v, cv2.INTER_NEAREST)  # OpenCV takes no float16
        return bits.view(np.float16).astype(np.float32)


class DepthMaps:
    """The depth maps of a workspace, read when asked for; those used last are kept, up to `limit` bytes, one at least.

    In a world with Z up the sky is left out of them: it is found once, and its mask waits in the folder `scratch`.
    """

    def __init__(self, workspace: Path, limit: int, scratch: Path, *, z_up: bool) -> None:
        self._workspace, self._limit, self._scratch, self._z_up = workspace, limit, scratch, z_up
        self._kept: OrderedDict[str, tuple[DepthMap, int]] = OrderedDict()
        self._skies: dict[str, Path | None] = {}  # None: no sky in it

    def __getitem__(self, view: View) -> DepthMap:
        """Raises WorkspaceError for a depth map or picture that is missing, damaged or of another camera."""
        if view.name in self._kept:
            self._kept.move_to_end(view.name)
            return self._kept[view.name][0]
        size = BYTES_PER_PIXEL * view.width * view.height
        while self._kept and sum(kept for _, kept in self._kept.values()) + size > self._limit:
            self._kept.popitem(last=False)
        depth_map = self._read(view)
        self._kept[view.name] = depth_map, size
        return depth_map

    def _read(self, view: View) -> DepthMap:
        path = self._workspace / view.image
        remedy = "Delete that file and run Reconstruct again."
        try:
            picture = images.read_rgb(path)
        except PhotoError as error:
            raise WorkspaceError(Text("The undistorted picture {} is missing or damaged.", path), remedy=remedy,
                                 path=path) from error
        if picture.shape[:2] != (view.height, view.width):
            raise WorkspaceError(Text("{} and its depth map differ in size.", path), remedy=remedy, path=path)
        depth, confidence = read_depth(self._workspace, view)
        inverse = np.full(depth.shape, np.nan, np.float32)
        np.divide(1, depth, out=inverse, where=depth > 0)
        del depth
        confidence = np.fmax(confidence, 0).astype(np.float16, copy=False)  # what is no number counts as unsure
        if self._z_up:
            self._leave_out_the_sky(view, inverse, confidence, picture)
        return DepthMap(inverse, confidence, picture)

    def _leave_out_the_sky(
        self, view: View, inverse_depth: np.ndarray, confidence: np.ndarray, picture: np.ndarray
    ) -> None:
        if view.name not in self._skies:
            sky = sky_mask(picture, confidence, view.K, view.cam_from_world)
            self._skies[view.name] = file = self._scratch / f"{len(self._skies)}.sky.npy" if sky.any() else None
            if file is not None:
                with disk_errors(file):
                    np.save(file, np.packbits(sky))
        elif (file := self._skies[view.name]) is not None:
            sky = np.unpackbits(np.load(file), count=inverse_depth.size).view(bool).reshape(inverse_depth.shape)
        if file is not None:
            inverse_depth[sky] = np.nan


def finest_first(views: tuple[View, ...], workspace: Path, reporter: Reporter) -> list[View]:
    """The views by rising ground sampling distance (median depth over focal length), then by name."""

    def ground_sampling_distance(view: View) -> float:
        reporter.check_cancelled()
        depth, _ = read_depth(workspace, view)
        depth = depth[depth > 0]
        return float(np.median(depth, overwrite_input=True) / view.K[0, 0]) if len(depth) else np.inf

    return sorted(views, key=lambda view: (ground_sampling_distance(view), view.name))
