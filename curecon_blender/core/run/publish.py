# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The worker's command `publish`: a finished workspace as a folder of web pages."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import date
from pathlib import Path
from typing import Any

from ..base.errors import WorkspaceError
from ..base.files import disk_errors
from ..base.language import Text
from ..base.messages import Reporter
from ..base.records import Component
from ..photos import capture
from ..publish import folder as site_files
from ..publish.records import About, PublishError
from ..publish.write import STAGES, Source, write_site
from ..site import adjustment
from ..surface.mesh import mesh_file, textured_folder
from ..views import record as views_record
from .workspace import Workspace, folder_bytes, require_workspace, try_lock

_LOCK = ".publish.lock"


def publish(workspace: Path, folder: Path, about: About, part: int, reporter: Reporter) -> dict[str, Any]:
    """Write part `part` (from 1) of a workspace as a site of the published folder. What cannot be shown of it is told
    as a warning. Raises WorkspaceError, PublishError, SurfaceError, Cancelled."""
    require_workspace(workspace)
    if not about.title.strip():
        raise PublishError("The site has no name.", remedy="Give it the name that it is to be found by (--title).")
    reporter.begin(STAGES)
    with Workspace(workspace) as held, _destination(folder.absolute(), held.root) as destination:
        source = _source(held.root, part, reporter)
        with site_files.site_folder(destination, about.id) as place:
            record = write_site(source, about, place, reporter)
            reporter.check_cancelled()
        site_files.write_pages(destination)
        sites = site_files.write_catalogue(destination, reporter)
        site = destination / site_files.SITES / about.id
        return {
            "published": str(destination), "site": str(site / "index.html"), "id": about.id, "sites": sites,
            "bytes": folder_bytes(site), "location": about.location, "warnings": reporter.warnings,
            "faces": record["surface"]["faces"] if record["surface"] else 0,
            "points": record["cloud"]["points"] if record["cloud"] else 0,
            "first_view": record["surface" if record["surface"] else "cloud"]["first"],
        }


@contextmanager
def _destination(folder: Path, workspace: Path) -> Iterator[Path]:
    """The folder, for one publish at a time."""
    if folder.resolve().is_relative_to(workspace.resolve()) or workspace.resolve().is_relative_to(folder.resolve()):
        raise PublishError(Text("{} and the workspace lie in each other: its files are not for everybody.", folder),
                           remedy="Choose a folder elsewhere.", path=folder)
    site_files.check(folder)
    with disk_errors(folder / _LOCK), open(folder / _LOCK, "a+b") as lock:
        try:
            try_lock(lock)
        except OSError as error:
            raise PublishError(Text("Another publish is writing into {}.", folder),
                               remedy="Wait until it is done, then publish again.", path=folder) from error
        yield folder


def _source(root: Path, part: int, reporter: Reporter) -> Source:
    components = views_record.with_clouds(root, views_record.read(root))
    if not 1 <= part <= len(components):
        raise PublishError(Text("The site has no part {}; it has {}.", part, len(components)),
                           remedy=Text("Choose a part from 1 to {} (--part).", len(components)))
    if len(components) > 1:
        reporter.warning(Text("The site has {} parts that do not connect: part {} is published alone.", len(components),
                              part))
    component = components[part - 1]
    adjusted = adjustment.read(root / component.sparse)
    meshes = (root / textured_folder(component.index) / "mesh.ply", root / mesh_file(component.index))
    return Source(
        workspace=root, component=component, frame=adjustment.adjusted_frame(component.frame, adjusted),
        matrix=adjusted.matrix, mesh=next((file for file in meshes if file.is_file()), None),
        taken=_taken(root, component, reporter),
    )


def _taken(root: Path, component: Component, reporter: Reporter) -> date | None:
    """The day of the part's photos, by the cameras' clock."""
    names = {view.name for view in component.views}
    try:
        times = {name: time for name, time in capture.read_times(root).items() if name in names}
    except WorkspaceError as error:
        reporter.warning(Text("The page does not say when the photos were taken: {}", error.message))
        return None
    return capture.middle_time(times).date() if times else None
