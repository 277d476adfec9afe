# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `mask`: what lies in a solid of the site becomes masks of all photos that show it, for the next run.

A pixel is left out where it looks into the solid and the photo's depth map is not sure that something stands before it,
or that one looks past what is in it. The masks are in the photo's own pixels, in COLMAP's convention, in the
workspace's folder `masks`.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap

from ..base import images
from ..base.errors import WorkspaceError
from ..base.files import atomic_write, disk_errors
from ..base.language import Text
from ..base.messages import Reporter
from ..base.options import MASKS_FOLDER
from ..base.records import View
from ..compare.read import read_result
from ..depth.maps import read_depth
from ..sparse.models import read_model
from ..texture.rasterise import inverse_depth_buffer
from ..texture.visibility import in_camera, project
from ..views import record
from .workspace import Workspace, require_workspace

SURE = 0.3  # confidence of a depth that tells what is before the solid or behind it
APART = 0.02  # of the depth by which that must be
SPECKLE, MARGIN = 5, 7  # pixels of a depth map: sides of the square of what is smoothed away, and then added around
WORKED_AT = 1600  # pixels, longest side of a mask: photos are larger, and what is drawn is not that exact


def run_mask(given: argparse.Namespace, reporter: Reporter) -> dict[str, Any]:
    """Write masks of what lies in the closed mesh `given.solid` (frame of the largest part), or take all drawn masks
    away where it is None. Masks drawn before stay: they add up. Raises WorkspaceError, CompareError, Cancelled."""
    require_workspace(given.workspace)
    reporter.begin({"mask": 1.0})
    with Workspace(given.workspace) as workspace:
        reporter.stage("mask")
        drawn = workspace.root / MASKS_FOLDER
        if given.solid is None:
            files = sorted(drawn.glob("*.png"))
            with disk_errors(drawn):
                for file in files:
                    file.unlink()
            return {"mask": {"photos": 0, "cleared": len(files), "of": 0}, "warnings": reporter.warnings}
        solid = read_result(given.solid)
        if solid.faces is None or not len(solid.faces):
            raise WorkspaceError(Text("{} has no faces: it encloses nothing.", given.solid), path=given.solid,
                                 remedy="Give a closed mesh, such as a box around what is to be left out.")
        component, *others = record.read(workspace.root)
        if others:
            reporter.warning("Only photos of the largest part are masked: the others have coordinates of their own.")
        model = read_model(workspace.root / component.sparse)
        cameras = {image.name: model.cameras[image.camera_id] for image in model.images.values()}
        showing = 0
        for number, view in enumerate(component.views):
            reporter.progress(number, len(component.views))
            hidden = inside(solid.about(np.zeros(3)), solid.faces, view, workspace.root)
            if hidden.any():
                showing += _write(drawn / f"{view.name}.png", hidden, view, cameras[view.name])
    if not showing:
        reporter.warning("No photo shows what is to be left out: is the object where it should be?")
    return {"mask": {"photos": showing, "cleared": 0, "of": len(component.views)}, "warnings": reporter.warnings}


def inside(vertices: np.ndarray, faces: np.ndarray, view: View, workspace: Path) -> np.ndarray:
    """Which pixels (H,W) bool of a view show what lies in a closed mesh. Raises WorkspaceError."""
    camera = in_camera(vertices, view)
    corners = project(camera, view.K)[faces]
    with np.errstate(divide="ignore"):
        inverse = (1 / camera[:, 2])[faces]
    front = inverse_depth_buffer(corners, inverse, view.width, view.height)
    if not front.any():
        return front > 0
    most = 2 * front.max()  # the nearest of what is turned round is the farthest
    back = most - inverse_depth_buffer(corners, most - inverse, view.width, view.height)
    depth, confidence = read_depth(workspace, view)
    with np.errstate(divide="ignore"):
        seen = 1 / depth
    sure = (confidence >= SURE) & (depth > 0)
    hidden = (front > 0) & ~(sure & (seen > front * (1 + APART))) & ~(sure & (seen < back * (1 - APART)))
    smooth = cv2.medianBlur(hidden.astype(np.uint8), SPECKLE)
    return np.asarray(cv2.dilate(smooth, np.ones((MARGIN, MARGIN), np.uint8))) > 0


def _write(path: Path, hidden: np.ndarray, view: View, camera: pycolmap.Camera) -> bool:
    """Add to a photo's mask; whether there was anything to add."""
    width, height = images.scaled_size(camera.width, camera.height, WORKED_AT)
    left = np.full((height, width), 255, np.uint8)
    left[_in_the_photo(hidden, view, camera, (width, height))] = 0
    if left.all():
        return False
    if path.is_file():
        before = images.read_rgb(path).max(axis=2)
        left = np.minimum(left, cv2.resize(before, (width, height), interpolation=cv2.INTER_NEAREST))
    with disk_errors(path):
        path.parent.mkdir(exist_ok=True)
    with atomic_write(path) as file:
        file.write(images.encode_png(left))
    return True


def _in_the_photo(
    hidden: np.ndarray, view: View, camera: pycolmap.Camera, size: tuple[int, int]
) -> np.ndarray:
    """What is hidden in the undistorted view, in the photo with its lens, (H,W) bool of `size`."""
    x, y = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
    pixels = np.stack([x * camera.width / size[0], y * camera.height / size[1]], axis=-1).reshape(-1, 2)
    rays = np.column_stack([camera.cam_from_img(pixels), np.ones(len(pixels))])
    column, row = np.nan_to_num((rays @ view.K.T)[:, :2], nan=-1).T.astype(np.int64)
    there = (column >= 0) & (row >= 0) & (column < view.width) & (row < view.height)
    found = np.zeros(len(pixels), bool)
    found[there] = hidden[row[there], column[there]]
    return found.reshape(size[1], size[0])
