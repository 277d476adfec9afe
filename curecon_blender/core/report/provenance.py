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

from ..base.messages import Reporter
from ..base.records import Photo

_MANIFEST = Path(__file__).parents[3] / "blender_manifest.toml"
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
class Provenance:
    """`settings` are the options of the last run, by name."""

    made: str
    by: str
    program: str
    libraries: dict[str, str]
    system: str
    weights: str
    settings: dict[str, str]
    photos: tuple[PhotoFile, ...]


def trace(
    photos: Sequence[Photo], placed: set[str], weights: str, settings: dict[str, str], by: str, reporter: Reporter
) -> Provenance:
    """Read every photo's file for its digest. Raises Cancelled."""
    files = []
    for number, photo in enumerate(photos):
        files.append(PhotoFile(
            name=photo.name, sha256=digest_of(photo.path), taken=photo.time or "", width=photo.width,
            height=photo.height, placed=photo.name in placed,
        ))
        reporter.progress(number + 1, len(photos))
    return Provenance(
        made=datetime.now().astimezone().isoformat(timespec="minutes"), by=by, program=f"CU-Recon {version()}",
        libraries={name: importlib.metadata.version(name) for name in _LIBRARIES},
        system=platform.platform(terse=True), weights=weights, settings=settings, photos=tuple(files),
    )


def digest_of(path: Path) -> str:
    """The SHA-256 of a file; "" where there is none, or it cannot be read."""
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return ""


def version() -> str:
    """The program's version, as the extension's manifest has it."""
    found = re.search(r'^version = "([^"]+)"', _MANIFEST.read_text(encoding="utf-8"), re.MULTILINE)
    return found[1] if found else "unknown"
