# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Taking points out of clouds: they stay in the data, marked, so that undo and Restore bring them back at once; the
workspace keeps the marks for imports and for meshes."""

from __future__ import annotations

import hashlib
from pathlib import Path

import bpy
import numpy as np

from ..core.base.errors import WorkspaceError
from ..core.base.language import Text
from ..core.cloud.edits import write_removed
from . import display, region
from .display import REMOVED, REMOVED_KEY
from .points import CLOUD_KEY, file_order, positions
from .writable import require

FILE_KEY = "curecon_file"  # on cloud data: its file in the workspace
COUNT_KEY = "curecon_removed_points"  # on cloud data: how many points are taken out
SELECTION = ".selection"  # Blender's own, from edit mode
_written: dict[str, str] = {}  # what this session last wrote, by cloud file


def attach(item: bpy.types.Object, file: Path, taken: np.ndarray | None) -> None:
    """Tell a cloud just brought in where it came from, and which of its points (N,) bool are taken out."""
    item.data[FILE_KEY] = str(file)
    if taken is not None:
        _mark(item.data, taken)


def in_region(item: bpy.types.Object, box: bpy.types.Object) -> np.ndarray:
    """Which of the cloud's points (N,) lie inside the region box."""
    return display.inside(positions(item.data), region.from_world(box) @ item.matrix_world)


def selected(item: bpy.types.Object) -> np.ndarray:
    """Which of the cloud's points (N,) are selected in Blender's edit mode."""
    return _flags(item.data, SELECTION)


def removed(item: bpy.types.Object) -> np.ndarray:
    """Which of the cloud's points (N,) are taken out."""
    return _flags(item.data, REMOVED)


def set_removed(item: bpy.types.Object, which: np.ndarray) -> None:
    """Mark the cloud's points (N,) bool as taken out, and keep that in its workspace. Raises WorkspaceError, before
    anything is marked, when it cannot be written or the cloud is not as it was imported, and LinkedError."""
    require([item, item.data])
    if len(which) != item.data[CLOUD_KEY]:
        raise WorkspaceError(
            Text("{} has lost points to Blender's own tools, which the workspace cannot follow.", item.name),
            remedy="Import the workspace again, then take points out here.",
        )
    _keep(item.data, which)
    _mark(item.data, which)
    item.update_tag()


def keep_up(clouds: list[bpy.types.Object]) -> None:
    """After an undo or a redo: what this session wrote into workspaces becomes what the scene says again."""
    for item in clouds:
        now = item.data.get(REMOVED_KEY, "")
        if _written.get(item.data.get(FILE_KEY), now) != now:
            _keep(item.data, removed(item))


def _keep(data: bpy.types.PointCloud, which: np.ndarray) -> None:
    in_file = np.empty(len(which), bool)
    in_file[file_order(len(which))] = which
    write_removed(Path(data[FILE_KEY]), in_file)
    _written[data[FILE_KEY]] = _key(which)


def _mark(data: bpy.types.PointCloud, which: np.ndarray) -> None:
    attribute = data.attributes.get(REMOVED) or data.attributes.new(REMOVED, "BOOLEAN", "POINT")
    attribute.data.foreach_set("value", which)
    data[REMOVED_KEY], data[COUNT_KEY] = _key(which), int(which.sum())
    data.update_tag()


def _flags(data: bpy.types.PointCloud, name: str) -> np.ndarray:
    found = np.zeros(len(data.points), bool)
    if (attribute := data.attributes.get(name)) is not None:
        attribute.data.foreach_get("value", found)
    return found


def _key(which: np.ndarray) -> str:
    return hashlib.sha256(np.packbits(which).tobytes()).hexdigest()[:20] if which.any() else ""
