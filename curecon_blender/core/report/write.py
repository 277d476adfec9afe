# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The report of a workspace: `report/report.json`, `.html` and `.pdf`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..base.errors import WorkspaceError
from ..base.files import disk_errors, write_json
from ..base.messages import Reporter
from ..base.records import Component, PhotoSet
from .figures import measure
from .pages import write_html, write_pdf
from .provenance import trace
from .sections import Section, provenance_section, sections_of

FOLDER = "report"


def write_report(
    workspace: Path, components: Sequence[Component], photo_set: PhotoSet, weights: str, settings: dict[str, str],
    by: str, reporter: Reporter,
) -> dict[str, Any]:
    """Write the three files into the workspace; the paths by format. Raises WorkspaceError where no part has a cloud,
    or a file is damaged, and Cancelled."""
    finished = [component for component in components if (workspace / component.cloud).exists()]
    if not finished:
        raise WorkspaceError(f"{workspace} has no point cloud yet.", remedy="Run Reconstruct to the end first.",
                             path=workspace)
    sections: list[Section] = []
    parts = []
    for component in finished:
        reporter.check_cancelled()
        site = measure(component, photo_set.photos, workspace)
        parts.append(site.part)
        told = sections_of(site)
        if len(finished) > 1:
            told = [Section(title=f"{section.title}, part {component.index + 1}", sentence=section.sentence,
                            rows=section.rows, pictures=section.pictures) for section in told]
        sections += told
    placed = {view.name for component in components for view in component.views}
    provenance = trace(photo_set.photos, placed, weights, settings, by, reporter)
    sections.append(provenance_section(provenance))
    name = workspace.name or "site"
    title, subtitle = f"Accuracy report: {name}", f"{provenance.program}, {provenance.made}"
    folder = workspace / FOLDER
    with disk_errors(folder):
        folder.mkdir(exist_ok=True)
    paths = {kind: folder / f"report.{kind}" for kind in ("json", "html", "pdf")}
    write_json(paths["json"], {
        "title": title, "parts": [asdict(part) for part in parts],
        "sentences": {section.title: section.sentence for section in sections}, "provenance": asdict(provenance),
    })
    write_html(paths["html"], title, subtitle, sections)
    write_pdf(paths["pdf"], title, subtitle, sections)
    return {kind: str(path) for kind, path in paths.items()}
