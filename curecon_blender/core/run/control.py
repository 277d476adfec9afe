# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The worker's command `control`: the control points of a workspace come, are found in the photos, and go."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..adjust.control import ControlSet, read_control, write_control
from ..adjust.control_files import import_files, write_odm
from ..adjust.targets import find_targets
from ..base.errors import ControlError
from ..base.language import Text
from ..base.messages import Reporter
from ..photos.record import FILE_NAME, read_photos
from .workspace import Workspace


def run_control(
    folder: Path, imported: Sequence[Path], system: str, find: bool, dictionary: str, export: Path | None,
    reporter: Reporter,
) -> dict[str, Any]:
    """Import files, mark coded targets, export, in this order as far as asked for; returns what there is then.

    Raises ControlError, WorkspaceError, PhotoError; what the workspace had stays then.
    """
    reporter.begin({"control": 1.0})
    reporter.stage("control")
    with Workspace(folder) as workspace:
        control = read_control(workspace.root)
        if imported:
            control = import_into(workspace, imported, system, reporter)
        if find:
            control = _mark_targets(workspace, control, dictionary, reporter)
        if export is not None:
            _tell(write_odm(export.absolute(), control), reporter)
    reporter.progress(1, 1, fresh=False)
    return {
        "control": [
            {"name": point.name, "role": point.role, "system": point.system, "coordinates": list(point.given),
             "marks": len(control.marks_of(point.name))} for point in control.points
        ],
        "positions": len(control.positions), "warnings": reporter.warnings,
    }


def import_into(
    workspace: Workspace, files: Sequence[Path], system: str, reporter: Reporter
) -> ControlSet:
    """Add what the files hold to the workspace's control points. Raises ControlError, WorkspaceError."""
    root = workspace.root
    photos = read_photos(root).photos if (root / FILE_NAME).is_file() else ()
    control, said = import_files(files, read_control(root), photos, system)
    _tell(said, reporter)
    write_control(root, control)
    return control


def _mark_targets(workspace: Workspace, control: ControlSet, dictionary: str, reporter: Reporter) -> ControlSet:
    if not control.points:
        raise ControlError("There are no control points yet that targets could be.",
                           remedy="Import the file with the targets' coordinates first, or with --import.")
    marks, unknown = find_targets(read_photos(workspace.root).photos, control, dictionary, reporter)
    if unknown:
        numbers = ", ".join(f"{number} ({count} photos)" for number, count in sorted(unknown.items())[:8])
        reporter.warning(Text("Targets whose numbers no point's name ends in were left out: {}.", numbers))
    if not marks:
        raise ControlError(
            Text("No coded target of the kind {} that is a point was found in the photos.", dictionary),
            remedy="Choose the targets' own dictionary, and name the points by their numbers, such as gcp7; or mark "
            "them by hand.",
        )
    by_hand = {(mark.point, mark.photo) for mark in control.marks}
    control = control.with_marks(mark for mark in marks if (mark.point, mark.photo) not in by_hand)
    write_control(workspace.root, control)
    return control


def _tell(sentences: Sequence[str], reporter: Reporter) -> None:
    for sentence in sentences:
        reporter.warning(sentence)
