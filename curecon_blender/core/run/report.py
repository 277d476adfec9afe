# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The accuracy report of a workspace, as a command."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..base.errors import WorkspaceError
from ..base.messages import Reporter
from ..network import weights
from ..photos.record import read_photos
from ..report.write import write_report
from ..views import record as views_record
from .settings import read_settings
from .workspace import Workspace


def report(folder: Path, by: str, reporter: Reporter) -> dict[str, Any]:
    """Write the report of a workspace whose cloud is finished; its files by format, as `report`. Raises
    WorkspaceError, Cancelled."""
    if not (folder / "workspace.json").is_file():
        raise WorkspaceError(
            f"{folder} is not a workspace of CU-Recon.", path=folder,
            remedy="Choose the folder that Reconstruct made, or run Reconstruct first.",
        )
    reporter.begin({"report": 1.0})
    with Workspace(folder) as workspace:
        reporter.stage("report")
        root, settings = workspace.root, read_settings(workspace.root)
        used = settings.get("weights")
        digest = weights.describe(Path(used) if used else None)["sha256"]
        components, photo_set = views_record.read(root), read_photos(root)
        return {"report": write_report(root, components, photo_set, digest, settings, by, reporter)}
