# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The one reader and writer of `depth/NAME.npz` in a workspace.

A file holds `depth` (H,W) float32 z-depth in world units (0: none), `confidence` (H,W) float16 in [0, 1], the camera it
was made for, `K` (3,3) and `cam_from_world` (3,4), and `key`, which tells of the options and inputs it was made with.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from ..base.errors import WorkspaceError
from ..base.files import atomic_write
from ..base.language import Text
from ..base.reading import Expected, read_arrays
from ..base.records import View

_CAMERA = {"K": Expected((3, 3), "f"), "cam_from_world": Expected((3, 4), "f")}


def depth_path(workspace: Path, name: str) -> Path:
    return workspace / "depth" / f"{name}.npz"


def write_depth(workspace: Path, view: View, depth: np.ndarray, confidence: np.ndarray, key: str = "") -> None:
    """Write a view's depth and confidence (H,W), whole or not at all. Raises WorkspaceError."""
    # By way of memory: a zip that meets a full disk half-way complains a second time when it is closed.
    content = io.BytesIO()
    np.savez(content, depth=depth.astype(np.float32), confidence=confidence.astype(np.float16), K=view.K,
             cam_from_world=view.cam_from_world, key=np.array(key))
    with atomic_write(depth_path(workspace, view.name)) as file:
        file.write(content.getbuffer())


def read_depth(workspace: Path, view: View) -> tuple[np.ndarray, np.ndarray]:
    """A view's depth (H,W) and confidence (H,W), read-only.

    Raises WorkspaceError when the file is missing, damaged, of another size or made for another camera.
    """
    path = depth_path(workspace, view.name)
    remedy = "Delete that file and run Reconstruct again: only that photo's depth is computed anew."
    size = Expected((view.height, view.width), "f")
    try:
        found = read_arrays(path, {"depth": size, "confidence": size, **_CAMERA})
    except FileNotFoundError as error:
        raise WorkspaceError(
            Text("The depth map of {} is missing ({}).", view.name, path),
            remedy="Run Reconstruct again: it computes the depth maps that are missing.", path=path,
        ) from error
    except (OSError, ValueError) as error:
        raise WorkspaceError(Text("The depth map {} is damaged ({}).", path, Text(str(error))),
                             remedy=remedy, path=path) from error
    if not all(np.allclose(getattr(view, name), found[name], rtol=1e-4, atol=1e-4) for name in _CAMERA):
        raise WorkspaceError(Text("The depth map {} was made for another camera.", path), remedy=remedy, path=path)
    return found["depth"], found["confidence"]


def is_finished(workspace: Path, view: View, key: str) -> bool:
    """Whether a view's depth map is there, whole, and made with the same options and inputs and for this camera."""
    try:
        arrays = read_arrays(depth_path(workspace, view.name), {"key": Expected((), "U"), **_CAMERA})
    except (OSError, ValueError):
        return False
    return (str(arrays["key"]) == key and np.array_equal(arrays["K"], view.K)
            and np.array_equal(arrays["cam_from_world"], view.cam_from_world))
