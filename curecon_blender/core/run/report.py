# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The accuracy report of a workspace, as a command."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..base import language
from ..base.messages import Reporter
from ..base.options import STAGES
from ..base.records import Component
from ..network import weights
from ..photos.record import read_photos
from ..report.measure import Standing
from ..report.provenance import About
from ..report.write import Rest, write_report
from ..site import adjustment
from ..views import record as views_record
from .settings import read_settings
from .workspace import Workspace, require_workspace


def report(folder: Path, about: About, language_name: str, font: Path | None, reporter: Reporter) -> dict[str, Any]:
    """Write the report of a workspace whose cloud is finished, in a language by Blender's name of it; its files by
    format, as `report`. Raises WorkspaceError, SparseError, PhotoError, Cancelled."""
    require_workspace(folder)
    reporter.begin({"report": 1.0})
    with Workspace(folder) as workspace:
        reporter.stage("report")
        root, settings = workspace.root, read_settings(workspace.root)
        used = settings.pop("weights", "")
        settings.pop("until", None)
        done = [record.seconds for stage in STAGES if (record := workspace.record(stage))]
        rest = Rest(weights=weights.describe(Path(used) if used else None)["sha256"], settings=settings,
                    minutes=sum(done) / 60 if done else None)
        parts = [(component, _standing(component, root)) for component in views_record.read(root)]
        return {"report": write_report(root, parts, read_photos(root), rest, about, language.of_name(language_name),
                                       font, reporter)}


def _standing(component: Component, root: Path) -> Standing:
    """How a part stands with what was measured on it since it was reconstructed."""
    measured = adjustment.read(root / component.sparse)
    scale = measured.of(adjustment.SCALE)
    return Standing(adjustment.adjusted_frame(component.frame, measured), measured.matrix,
                    scale.sigma if scale is not None else component.frame.scale_sigma)
