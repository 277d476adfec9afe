# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The site's sparse points as they lie in a photo, kept beside its undistorted picture for the refinement.

`undistorted/NAME.points.npz` holds `points` (P,4) float32: column and row in the picture, pixel centres at .5, z-depth
in world units, and 1 where the photo itself is among those that the point comes from. The others may be hidden there.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..base.errors import WorkspaceError
from ..base.files import atomic_write
from ..base.language import Text
from ..base.reading import Expected, read_arrays
from ..base.records import View


def points_path(workspace: Path, name: str) -> Path:
    return workspace / "undistorted" / f"{name}.points.npz"


def points_in(
    points: np.ndarray, matched: np.ndarray, K: np.ndarray, cam_from_world: np.ndarray, size: tuple[int, int]
) -> np.ndarray:
    """What of points (P,3) in the world lies in a picture of `size` (W, H): (P',4) float32 as above; `matched` (P,)
    bool."""
    camera = points @ cam_from_world[:, :3].T + cam_from_world[:, 3]
    ahead = camera[:, 2] > 0
    camera, matched = camera[ahead], matched[ahead]
    pixels = (camera @ K.T)[:, :2] / camera[:, 2:]
    inside = (pixels >= 0).all(1) & (pixels < size).all(1)
    return np.column_stack([pixels, camera[:, 2], matched])[inside].astype(np.float32)


def write(workspace: Path, name: str, points: np.ndarray) -> None:
    """Write a photo's points (P,4), whole or not at all."""
    with atomic_write(points_path(workspace, name)) as file:
        np.savez_compressed(file, points=points)


def read(workspace: Path, view: View) -> np.ndarray:
    """A view's points (P,4); none for a view that was told of none.

    Raises WorkspaceError when the file is missing, damaged or of other points.
    """
    if view.points == 0:
        return np.zeros((0, 4), np.float32)
    path = points_path(workspace, view.name)
    try:
        found = read_arrays(path, {"points": Expected((view.points, 4), "f")})["points"]
        if not np.isfinite(found).all() or not (found[:, 2] > 0).all():
            raise ValueError("its points are none")
        return found
    except (OSError, ValueError) as error:
        raise WorkspaceError(
            Text("{} is missing or damaged ({}).", path, Text(str(error))), path=path,
            remedy="Delete that file, if it is there, and run Reconstruct again.",
        ) from error
