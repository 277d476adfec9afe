# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The report of a workspace: `report/report.json`, `.html` and `.pdf`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from ..base.files import disk_errors, write_json
from ..base.language import Language, Text
from ..base.messages import Reporter
from ..base.records import Component, PhotoSet
from ..views import record as views_record
from .document import Section
from .fonts import LATIN, Letters, letters_of
from .maps import Lettering
from .measure import Site, Standing, measure
from .pages import write_html, write_pdf
from .provenance import About, Provenance, provenance_section, trace
from .sections import sections_of

FOLDER = "report"


@dataclass(frozen=True, kw_only=True)
class Rest:
    """What the whole workspace knows beside its parts: the weights' digest, the options of the last run, and how many
    minutes it worked."""

    weights: str
    settings: dict[str, str]
    minutes: float | None


def write_report(
    workspace: Path, parts: Sequence[tuple[Component, Standing]], photo_set: PhotoSet, rest: Rest, about: About,
    language: Language, font: Path | None, reporter: Reporter,
) -> dict[str, Any]:
    """Write the three files into the workspace; the paths by format. PDF and web page are in the `language`, with
    letters of `font`; the record is in English. Raises WorkspaceError where no part has a cloud, or a file is damaged,
    SparseError and PhotoError, and Cancelled."""
    standings = {component.index: standing for component, standing in parts}
    finished = views_record.with_clouds(workspace, [component for component, _ in parts])
    placed = {view.name for component, _ in parts for view in component.views}
    provenance = trace(photo_set, placed, workspace, about, rest.weights, rest.settings, rest.minutes, reporter)
    sites = [measure(component, photo_set.photos, workspace, standings[component.index], reporter)
             for component in finished]
    lettering = Lettering(_letters(sites, provenance, language, font, reporter), language.said)
    sections = [section for site in sites for section in _told(site, lettering, several=len(sites) > 1)]
    sections.append(provenance_section(provenance))
    title = Text("Accuracy report: {}", provenance.site)
    made = [provenance.by, provenance.when or provenance.reported[:10], provenance.program]
    subtitle = " · ".join(part for part in made if part)
    folder = workspace / FOLDER
    with disk_errors(folder):
        folder.mkdir(exist_ok=True)
    paths = {kind: folder / f"report.{kind}" for kind in ("json", "html", "pdf")}
    write_json(paths["json"], {
        "title": title, "parts": [asdict(site.part) for site in sites],
        "sentences": {section.title: " ".join(section.sentences) for section in sections},
        "provenance": asdict(provenance),
    })
    write_html(paths["html"], title, subtitle, sections, language, lettering.letters)
    write_pdf(paths["pdf"], title, subtitle, sections, language, lettering.letters)
    return {kind: str(path) for kind, path in paths.items()}


def _told(site: Site, lettering: Lettering, *, several: bool) -> list[Section]:
    told = sections_of(site, lettering)
    if not several:
        return told
    return [replace(section, title=Text("{}, part {}", section.title, str(site.part.index + 1))) for section in told]


def _letters(
    sites: Sequence[Site], provenance: Provenance, language: Language, font: Path | None, reporter: Reporter
) -> Letters:
    """The letters of the language and of all names. The user is told what the font lacks."""
    names = {text for record in (asdict(provenance), *(asdict(site.part) for site in sites)) for text in _texts(record)}
    needed = set().union(*names, *language.words.values())
    letters = letters_of(needed | set(LATIN), font)
    if lacking := "".join(sorted(needed & set(letters.lacks))):
        reporter.warning(Text("The font of PDF and maps has no letters for {}: they are boxes there. Name another "
                              "font.", lacking[:20]))
    return letters


def _texts(record: Any) -> Iterator[str]:
    """All texts in a record."""
    if isinstance(record, str):
        yield record
    elif isinstance(record, dict):
        for key, value in record.items():
            yield from _texts(key)
            yield from _texts(value)
    elif isinstance(record, list | tuple):
        for value in record:
            yield from _texts(value)
