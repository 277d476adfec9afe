# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What masks leave of a view: a picture beside the undistorted one, of its size."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap

from ..base import images
from ..base.errors import PhotoError, WorkspaceError
from ..base.files import atomic_write
from ..base.language import Text
from ..base.records import Photo, View
from ..photos import masks
from .undistortion import undistort

_CLEAR = 250  # of 255: a pixel that holds anything that is left out is left out


def write_mask(workspace: Path, photo: Photo, camera: pycolmap.Camera, image_size: int) -> str | None:
    """Write the undistorted mask of a photo; returns its file, relative to the workspace, or None where there is no
    mask. Raises PhotoError, WorkspaceError."""
    left = masks.kept(photo)
    if left is None:
        return None
    undistorted, _ = undistort(np.repeat(left[..., None], 3, axis=2), camera, image_size)
    file = f"undistorted/{photo.name}.mask.png"
    with atomic_write(workspace / file) as out:
        out.write(images.encode_png(np.where(undistorted[..., 0] >= _CLEAR, 255, 0).astype(np.uint8)))
    return file


def left_out(workspace: Path, view: View) -> np.ndarray | None:
    """Which pixels (H,W) bool of a view masks leave out; None where it has no mask. Raises WorkspaceError."""
    if view.mask is None:
        return None
    path = workspace / view.mask
    try:
        hidden: np.ndarray = images.read_rgb(path)[..., 0] < masks.DARK
    except PhotoError as error:
        raise WorkspaceError(Text("The mask {} is missing or damaged.", path), path=path,
                             remedy="Delete the folder undistorted and run Reconstruct again.") from error
    if hidden.shape != (view.height, view.width):
        raise WorkspaceError(Text("{} and its mask differ in size.", view.name), path=path,
                             remedy="Delete the folder undistorted and run Reconstruct again.")
    return hidden
