# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Any program's result from its file or folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from ..base.errors import WorkspaceError
from ..base.language import Text
from ..cloud.edits import read_edited_cloud
from ..views import record as views_record
from .mesh_files import read_glb, read_obj
from .ply_files import read_ply_file
from .point_files import read_e57, read_las, read_text
from .result import CompareError, Result, result_of

_READERS: dict[str, Callable[[Path], Result]] = {
    ".ply": read_ply_file, ".las": read_las, ".laz": read_las, ".e57": read_e57, ".obj": read_obj, ".glb": read_glb,
    **dict.fromkeys((".xyz", ".txt", ".csv", ".pts", ".asc"), read_text),
}
SUFFIXES = tuple(_READERS)
_IN_FOLDERS = ("fused.ply", "dense/fused.ply", "dense/0/fused.ply", "scene_dense.ply")  # of COLMAP and OpenMVS


def read_result(path: Path, name: str = "") -> Result:
    """A result by the path of its file, of one of our workspaces, or of a dense workspace of COLMAP or OpenMVS. Raises
    CompareError, WorkspaceError, SetupError for E57 without its library."""
    if path.is_dir():
        if (path / "workspace.json").is_file():
            return _of_workspace(path, name or path.name)
        file = next((path / inside for inside in _IN_FOLDERS if (path / inside).is_file()), None)
        if file is None:
            raise CompareError(Text("{} holds no result.", path), path=path,
                               remedy="Choose a workspace of CU-Recon, a folder with fused.ply, or a file.")
        return read_result(file, name or path.name)
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise CompareError(Text("{} is of a kind that cannot be compared.", path), path=path,
                           remedy=Text("Export it as one of {}.", ", ".join(one[1:].upper() for one in SUFFIXES)))
    try:
        made = reader(path)
    except FileNotFoundError as error:
        raise CompareError(Text("{} does not exist.", path), path=path, remedy="Choose the file again.") from error
    except (OSError, ValueError, MemoryError) as error:
        why = str(error) or "it does not fit into memory"
        raise CompareError(Text("{} cannot be read: {}.", path, Text(why.rstrip("."))), path=path,
                           remedy="Export it again, as PLY or LAZ if you can.") from error
    return replace(made, name=name or made.name)


def _of_workspace(folder: Path, name: str) -> Result:
    component = views_record.read(folder)[0]
    cloud = read_edited_cloud(folder / component.cloud)
    try:
        return result_of(name, cloud.points.astype(float), colours=cloud.colours, normals=cloud.normals)
    except ValueError as error:
        raise WorkspaceError(Text("{} has an empty cloud.", folder), path=folder,
                             remedy="Run Reconstruct again.") from error
