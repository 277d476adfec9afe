# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The worker's command `export`: a finished workspace in surveyors' formats."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..base.errors import CuReconError, SetupError, WorkspaceError
from ..base.files import DELIVERABLES, disk_errors
from ..base.language import Text
from ..base.messages import Reporter
from ..base.options import LOCAL
from ..base.records import Component
from ..deliver.placement import DeliverError, Placement
from ..deliver.write import Choices, Site, write, write_words
from ..site import adjustment
from ..site.footprint import rectangle_direction, wall_direction
from ..surface.mesh import Mesh, mesh_file, textured_folder
from ..surface.triangles import face_normals
from ..views import record as views_record
from .workspace import Workspace, require_workspace

ABOUT = "deliverables.txt"
_TITLE = "CU-Recon Deliverables, frame: "
_SOME = 100_000  # vertices or points that tell a direction


def export(
    folder: Path, formats: Sequence[str], frame: str, to: Path | None, choices: Choices, reporter: Reporter
) -> dict[str, Any]:
    """Write a workspace's deliverables into `to`, or below the workspace; what cannot be made of it is told as left
    out. Raises WorkspaceError, Cancelled, and what hinders the first one where none can be made."""
    require_workspace(folder)
    formats = tuple(dict.fromkeys(formats))
    reporter.begin(dict.fromkeys(formats, 1.0))
    made: list[dict[str, Any]] = []
    failures: list[CuReconError] = []
    left_out: list[dict[str, Any]] = []
    words: list[str] = []
    with Workspace(folder) as workspace:
        root = workspace.root
        components = views_record.with_clouds(root, views_record.read(root))
        destination = _destination(root / DELIVERABLES / frame if to is None else to.absolute(), frame)
        for name in formats:
            reporter.stage(name)
            for component in components:
                number = component.index + 1
                try:
                    site = _site(root, component, frame, choices, destination)
                    files = write(site, name, reporter)
                except (DeliverError, SetupError) as error:
                    failures.append(error)
                    left_out.append({"format": name, "part": number, "why": error.message,
                                     "remedy": error.remedy})
                    told = f"{name} is left out: {error.message} {error.remedy}"
                    reporter.warning(Text("Part {}: {}", number, Text(told)) if len(components) > 1 else told)
                    continue
                words = words or site.words
                made += [{"format": name, "part": number, "file": str(path), "says": said,
                          "bytes": path.stat().st_size} for path, said in files]
        if not made:
            raise failures[0]
        write_words(destination / ABOUT, [f"{_TITLE}{frame}", *words,
                                          *(f"{Path(one['file']).name}: {one['says']}" for one in made)])
    return {"deliverables": made, "left_out": left_out, "folder": str(destination), "position": frame != LOCAL,
            "words": words, "warnings": reporter.warnings}


def _destination(folder: Path, frame: str) -> Path:
    """The folder, made where it is missing. Raises WorkspaceError for one that holds somebody else's files, or
    deliverables of another frame: what is handed on together must not tell more than was chosen."""
    with disk_errors(folder):
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except (FileExistsError, NotADirectoryError) as error:
            raise WorkspaceError(Text("{} cannot be a folder: a file is in the way.", folder),
                                 remedy="Choose another folder.", path=folder) from error
        if not any(not entry.name.startswith(".") for entry in folder.iterdir()):
            return folder
        try:
            with open(folder / ABOUT, encoding="utf-8", errors="replace") as file:
                first = file.readline(200).strip()
        except FileNotFoundError:
            first = ""
    if not first.startswith(_TITLE):
        raise WorkspaceError(Text("{} is not empty, and its files are not of an export before.", folder), path=folder,
                             remedy="Choose an empty folder, or a new one.")
    if first != f"{_TITLE}{frame}":
        raise WorkspaceError(Text("{} holds deliverables of another frame ({}).", folder,
                                  Text(first.removeprefix(_TITLE))),
                             remedy="Choose an empty folder, or a new one.", path=folder)
    return folder


def _site(root: Path, component: Component, frame: str, choices: Choices, folder: Path) -> Site:
    """Raises DeliverError where the frame cannot be had, WorkspaceError."""
    adjusted = adjustment.read(root / component.sparse)
    placement = Placement(kind=frame, matrix=adjusted.matrix,
                          frame=adjustment.adjusted_frame(component.frame, adjusted))
    meshes = (root / textured_folder(component.index) / "mesh.ply", root / mesh_file(component.index))
    return Site(
        cloud=root / component.cloud, mesh=next((file for file in meshes if file.is_file()), None),
        placement=placement, choices=choices, turn_of=_turn, folder=folder,
        suffix=f"_{component.index}" if component.index else "",
    )


def _turn(mesh: Mesh | None, places: np.ndarray) -> float:
    """The direction of a site's walls, or else of its plan; `places` (N,3) are the mesh's vertices or the cloud's
    points."""
    if mesh is not None:
        normals = face_normals(places, mesh.faces)
        areas = np.linalg.norm(normals, axis=1)
        measured = ~mesh.filled & (areas > 0)
        walls = wall_direction(normals[measured] / areas[measured, None], areas[measured])
        if walls is not None:
            return walls[0]
    return rectangle_direction(places[:: max(len(places) // _SOME, 1), :2])
