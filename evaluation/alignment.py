# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Bringing a reconstruction into the frame of its truth, by the centres of the cameras that both know."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from curecon_blender.core.base.errors import SparseError, WorkspaceError
from curecon_blender.core.compare.geometry import Similarity, fitted
from curecon_blender.core.views import record as views_record


def align(source: np.ndarray, target: np.ndarray) -> Similarity:
    """The similarity that brings `source` (n,3) nearest to `target` (n,3), n >= 3, in the least squares sense
    (Umeyama 1991)."""
    if len(source) < 3:
        raise SparseError(
            f"Only {len(source)} cameras are known on both sides; an alignment needs three.",
            remedy="Check that both sides name their photos alike.",
        )
    return fitted(source, target, scaled=True)


def align_cameras(estimate: dict[str, np.ndarray], truth: dict[str, np.ndarray]) -> Similarity:
    """The similarity from the estimate's frame to the truth's, by the centres (3,) that both have under one name."""
    names = sorted(set(estimate) & set(truth))
    return align(np.array([estimate[n] for n in names]).reshape(-1, 3),
                 np.array([truth[n] for n in names]).reshape(-1, 3))


def read_centres(path: Path) -> dict[str, np.ndarray]:
    """Camera centres (3,) by the photos' names without extension.

    `path`: one of our workspaces (component 0), a COLMAP model (folder, text or binary), or a trajectory .log of
    Tanks and Temples, whose i-th pose is that of photo 00000i, counted from 1.
    """
    if path.suffix == ".log":
        return _read_trajectory(path)
    if (path / views_record.FILE_NAME).exists():
        return {Path(view.name).stem: view.centre for view in views_record.read(path)[0].views}
    if not (path / "images.txt").exists() and not (path / "images.bin").exists():
        raise WorkspaceError(
            f"{path} holds no cameras.",
            remedy="Give a workspace with views.json, a folder with a COLMAP model, or a trajectory .log.", path=path,
        )
    import pycolmap

    model = pycolmap.Reconstruction(path)
    return {Path(image.name).stem: image.projection_center() for image in model.images.values() if image.has_pose}


def _read_trajectory(path: Path) -> dict[str, np.ndarray]:
    """Five lines a pose: three integers, then the rows of world_from_cam (4,4)."""
    rows = [line.split() for line in path.read_text().splitlines() if line.strip()]
    if len(rows) % 5 or any(len(row) != 4 for i, row in enumerate(rows) if i % 5):
        raise WorkspaceError(f"{path} is not a trajectory of Tanks and Temples.", path=path,
                             remedy="It needs five lines a pose: three integers, then four rows of four numbers.")
    return {
        f"{i // 5 + 1:06d}": np.array([row[3] for row in rows[i + 1 : i + 4]], dtype=float)
        for i in range(0, len(rows), 5)
    }
