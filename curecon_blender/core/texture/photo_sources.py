# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The best picture that there is of each view: its original undistorted at full size, or the workspace's own."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pycolmap

from ..base import images
from ..base.errors import PhotoError, SparseError
from ..base.language import Text
from ..base.messages import Reporter
from ..base.records import Component, View
from ..sparse.models import read_model
from ..views.undistortion import undistort, undistorted_camera


@dataclass(frozen=True)
class Source:
    """A view's pictures. `view` and the file `picture` are of the size that depth was made at, `full` is the view at
    the largest size there is (or was asked for). `workspace` holds its depth map. `camera` is the
    lens of `original`; None: use `picture` alone."""

    view: View
    picture: Path
    full: View
    original: Path
    workspace: Path
    camera: pycolmap.Camera | None

    def read(self, scale: float, reporter: Reporter) -> tuple[np.ndarray, np.ndarray]:
        """The picture (H,W,3) uint8 at `scale` times the full size, and its K (3,3). Where the photo has gone or
        changed since the work began, it is the workspace's picture, with a warning. Raises PhotoError."""
        size = max(1, round(scale * max(self.full.width, self.full.height)))
        if self.camera is not None:
            try:
                return undistort(images.read_rgb(self.original), self.camera, size)
            except (PhotoError, ValueError) as error:
                reporter.warning(Text("{} cannot be read any more ({}): its texture comes from the smaller picture "
                                      "in the workspace.", self.original.name, Text(str(error))), self.view.name)
        rgb = images.read_rgb(self.picture, size)
        return rgb, _scaled(self.view.K, rgb.shape[1] / self.view.width, rgb.shape[0] / self.view.height)


def find_sources(
    component: Component, workspace: Path, max_size: int | None, exclude: tuple[str, ...], reporter: Reporter
) -> list[Source]:
    """The pictures of the component's views but those in `exclude`, at most `max_size` pixels long. A view without
    its undistorted picture is left out, one without its photo takes the undistorted picture, each with a warning."""
    cameras = _cameras(workspace / component.sparse, reporter)
    sources = []
    for view in component.views:
        if view.name in exclude:
            continue
        picture, original = workspace / view.image, Path(view.original)
        if not picture.is_file():
            reporter.warning(Text("{} is missing from the workspace: it gives no texture.", picture.name), view.name)
            continue
        camera = cameras.get(view.name) if view.original else None
        if camera is not None and not original.is_file():
            reporter.warning(
                Text("{} is gone: its texture comes from the smaller picture in the workspace.",
                     original.name), view.name
            )
            camera = None
        if camera is not None:
            pinhole = undistorted_camera(camera)
            width, height = images.scaled_size(pinhole.width, pinhole.height, max_size)
            K = _scaled(pinhole.calibration_matrix(), width / pinhole.width, height / pinhole.height)
        else:
            width, height = images.scaled_size(view.width, view.height, max_size)
            K = _scaled(view.K, width / view.width, height / view.height)
        full = replace(view, width=width, height=height, K=K)
        sources.append(Source(view, picture, full, original, workspace, camera))
    return sources


def _cameras(sparse: Path, reporter: Reporter) -> dict[str, pycolmap.Camera]:
    """The cameras of a COLMAP model by the names of their photos; none, with a warning, when it cannot be read."""
    try:
        model = read_model(sparse)
    except SparseError:
        reporter.warning("The sparse model is missing: texture comes from the smaller pictures in the workspace.")
        return {}
    return {image.name: model.cameras[image.camera_id] for image in model.images.values()}


def _scaled(K: np.ndarray, x: float, y: float) -> np.ndarray:
    result: np.ndarray = np.diag([x, y, 1.0]) @ K
    return result
