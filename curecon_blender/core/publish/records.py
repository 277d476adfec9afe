# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What is said of a site on its pages, and what somebody noted on it."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from ..base.errors import CuReconError, WorkspaceError
from ..base.language import Text
from ..base.reading import FARTHEST, Within, build, read_json

_MOST_NOTES = 500
_LONGEST_NAME = 40  # letters of a site's folder


class PublishError(CuReconError):
    """Nothing can be published of a site, or not there."""

    exit_code = 15
    kind = "publish"


_Coordinate = Annotated[float, Within(-FARTHEST, FARTHEST)]
Place = tuple[_Coordinate, _Coordinate, _Coordinate]


@dataclass(frozen=True, kw_only=True)
class Note:
    """Something noted at a `place` of the site frame; `eye` is where one sees it best from, None for anywhere."""

    title: str
    text: str = ""
    place: Place
    eye: Place | None = None


@dataclass(frozen=True, kw_only=True)
class About:
    """What the publisher says: of the site, whose it is, on which terms. `place` is what may be said in words of where
    it lies, such as the country. `location` is one of LOCATIONS."""

    title: str
    location: str
    text: str = ""
    place: str = ""
    credit: str = ""
    licence: str = ""
    notes: tuple[Note, ...] = ()

    @property
    def copyright(self) -> str:
        """Credit and licence in one line."""
        return ", ".join(" ".join(text.split()) for text in (self.credit, self.licence) if text.strip())

    @property
    def id(self) -> str:
        """The site's name as a folder and an address may have it: of a title that they may not have, its digest."""
        plain = re.sub(r"[^a-z0-9]+", "-", self.title.lower()).strip("-")[:_LONGEST_NAME].strip("-")
        if plain == re.sub(r"[ _]", "-", self.title.lower()):
            return plain
        return f"{plain or 'site'}-{hashlib.sha256(self.title.encode('utf-8', 'replace')).hexdigest()[:8]}"


def read_notes(path: Path) -> tuple[Note, ...]:
    """Notes from a JSON list of their fields. Raises WorkspaceError."""
    try:
        found: Any = build(tuple[Note, ...], read_json(path))
        if len(found) > _MOST_NOTES:
            raise ValueError(f"{len(found)} notes; {_MOST_NOTES} are the most")
        notes: tuple[Note, ...] = found
        return notes
    except (OSError, ValueError) as error:
        raise WorkspaceError(Text("{} holds no notes ({}).", path, Text(str(error))), path=path,
                             remedy="Give a list of records with title, text and place.") from error
