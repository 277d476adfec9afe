# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a record comes from: the photos by their digests, the program, its weights and settings, who and when."""

from __future__ import annotations

import hashlib
import importlib.metadata
import platform
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from ..base.language import Text
from ..base.messages import Reporter
from ..base.records import PhotoSet
from ..base.shares import is_safe
from .document import Section, Table

_MANIFEST = Path(__file__).parents[3] / "blender_manifest.toml"
_LEFT_TO_THE_PROGRAM = ("", "auto", "False", "()", "None")  # what options say that were not set
_ANY_FOLDER = re.compile(  # as a card has them, or as everyone calls them
    r"dcim|\d{3}[a-z_]*\d*[a-z]*|images?|photos?|pictures?|jpe?gs?|raws?|originals?|fotos?|照片|图片|影像|航片",
    re.IGNORECASE,
)
_LIBRARIES = ("torch", "pycolmap", "numpy", "opencv-python-headless")


@dataclass(frozen=True, kw_only=True)
class PhotoFile:
    """A photo of the job: `sha256` of the whole file, "" where it is no longer in its place; `placed` in the site."""

    name: str
    sha256: str
    taken: str
    width: int
    height: int
    placed: bool


@dataclass(frozen=True, kw_only=True)
class About:
    """What the user says of the record: the site's name, who made it and when; each may be empty."""

    name: str = ""
    by: str = ""
    when: str = ""


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """`settings` are the options of the last run by name, without those that were left to the program; `minutes` is how
    long it worked, None where that is not known; `left_out` are the files that were no photos of the job, and why."""

    site: str
    by: str
    when: str
    reported: str
    program: str
    libraries: dict[str, str]
    system: str
    weights: str
    settings: dict[str, str]
    minutes: float | None
    photos: tuple[PhotoFile, ...]
    left_out: tuple[tuple[str, str], ...]


def trace(
    photo_set: PhotoSet, placed: set[str], workspace: Path, about: About, weights: str, settings: dict[str, str],
    minutes: float | None, reporter: Reporter,
) -> Provenance:
    """Read every photo's file for its digest. Raises Cancelled."""
    files = []
    for number, photo in enumerate(photo_set.photos):
        files.append(PhotoFile(
            name=photo.name, sha256=digest_of(photo.path, workspace), taken=photo.time or "", width=photo.width,
            height=photo.height, placed=photo.name in placed,
        ))
        reporter.progress(number + 1, len(photo_set.photos))
    return Provenance(
        site=about.name or site_name([photo.path for photo in photo_set.photos], workspace), by=about.by,
        when=about.when, reported=f"{datetime.now().astimezone():%Y-%m-%d %H:%M %z}",
        program=f"CU-Recon {version()}",
        libraries={name: importlib.metadata.version(name) for name in _LIBRARIES},
        system=platform.platform(terse=True), weights=weights, minutes=minutes, photos=tuple(files),
        settings={name: value for name, value in settings.items() if value not in _LEFT_TO_THE_PROGRAM},
        left_out=tuple((skipped.path.name, skipped.reason) for skipped in photo_set.skipped),
    )


def site_name(photos: Sequence[Path], workspace: Path) -> str:
    """What the photos' folder is called, or the next one above it whose name is not one that cameras and people give to
    any folder of photos; else the workspace."""
    parents = {photo.parent for photo in photos}
    folder = parents.pop() if len(parents) == 1 else workspace
    names = [part.name for part in (folder, *folder.parents) if part.name and not _ANY_FOLDER.fullmatch(part.name)]
    return next(iter(names), workspace.name).removesuffix("_curecon").replace("_", " ").strip() or "site"


def provenance_section(provenance: Provenance) -> Section:
    """Who, when and with what; the settings; the photos with their digests."""
    missing = sum(not photo.sha256 for photo in provenance.photos)
    sentences = [Text("Made by {} from {} photos, which their digests name below.", provenance.program,
                      str(len(provenance.photos)))]
    if missing:
        sentences.append(Text("{} of them could not be read any more, so their digests are unknown.", str(missing)))
    rows = [(Text("Site"), provenance.site), (Text("Made by"), provenance.by or Text("not given")),
            (Text("Date of the record"), provenance.when or Text("not given")),
            (Text("Report written"), provenance.reported), (Text("Program"), provenance.program),
            (Text("System"), provenance.system),
            (Text("Libraries"), ", ".join(f"{name} {number}" for name, number in provenance.libraries.items())),
            (Text("Weights, SHA-256"), provenance.weights)]
    if provenance.minutes is not None:
        rows.append((Text("Computing time"), Text("{} min", f"{provenance.minutes:.0f}")))
    rows.append((Text("Settings"), ", ".join(f"{name} {value}" for name, value in provenance.settings.items())
                 or Text("the program's own")))
    tables = [Table(
        title=Text("Photos"), words=True, head=(Text("Photo"), "SHA-256"),
        rows=tuple((photo.name if photo.placed else Text("{} (not placed)", photo.name),
                    photo.sha256 or Text("could not be read")) for photo in provenance.photos),
    )]
    if provenance.left_out:
        tables.append(Table(title=Text("Files that were left out"), words=True, head=(Text("File"), Text("Reason")),
                            rows=tuple((name, Text(reason)) for name, reason in provenance.left_out)))
    return Section(title=Text("Provenance"), sentences=tuple(sentences), rows=tuple(rows),
                   tables=tuple(tables))


def digest_of(path: Path, workspace: Path) -> str:
    """The SHA-256 of a file; "" where there is none, it cannot be read, or a stranger may have named it."""
    if not (is_safe(path, [workspace.absolute()]) and path.is_file()):
        return ""
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return ""


def version() -> str:
    """The program's version, as the extension's manifest has it."""
    found = re.search(r'^version = "([^"]+)"', _MANIFEST.read_text(encoding="utf-8"), re.MULTILINE)
    return found[1] if found else "unknown"
