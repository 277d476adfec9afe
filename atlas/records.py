# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a published site says of itself, and what its contributor adds: JSON of strangers, bounded field by field."""

from __future__ import annotations

import math
import re
import unicodedata
from dataclasses import asdict, dataclass, field, replace
from datetime import date
from typing import Annotated, Any

from curecon_blender.core.base.language import Text
from curecon_blender.core.base.options import CELL, EXACT, HIDDEN, LOCATIONS
from curecon_blender.core.base.reading import OneOf, Within, build, parse_json
from curecon_blender.core.base.records import Frame, GeoPosition
from curecon_blender.core.publish import privacy
from curecon_blender.core.publish.records import About

from .problems import refused, why

FILM = "film.mp4"
NEAR = 20_000.0  # site units about the middle: no coordinates of a country's grid or of the Earth are so small
_KEPT_INVISIBLE = "\u200c\u200d\u200e\u200f\u061c"  # joiners and marks that some scripts are written with
# Two numbers that may be degrees, or one with a compass point: a moderator looks whether the text tells the place.
_DEGREES = re.compile(r"-?\d{1,3}[.,]\d{3,}\D{1,12}-?\d{1,3}[.,]\d{3,}|\d{1,3}\s*°\s*\d{1,2}|\d{6,7}\D{1,8}\d{7}")


class Words:
    """Text without control characters but ends of lines, and without those that turn the direction of what follows."""

    def __init__(self, most: int) -> None:
        self._most = most

    def check(self, value: str) -> None:
        if len(value) > self._most:
            raise ValueError(Text("{} letters; {} are the most", len(value), self._most))
        for letter in value:
            kind = unicodedata.category(letter)
            if kind == "Cc" and letter not in "\n\r\t":
                raise ValueError(Text("the control character {}", f"U+{ord(letter):04X}"))
            if kind in ("Cf", "Co", "Cs", "Zl", "Zp") and letter not in _KEPT_INVISIBLE:
                raise ValueError(Text("the invisible letter {}", f"U+{ord(letter):04X}"))


class _Day:
    def check(self, value: str) -> None:
        if date.fromisoformat(value).isoformat() != value:
            raise ValueError("no day")


Line = Annotated[str, Words(200)]
Passage = Annotated[str, Words(5000)]
_Coordinate = Annotated[float, Within(-NEAR, NEAR)]
_Place = tuple[_Coordinate, _Coordinate, _Coordinate]
_Share = Annotated[float, Within(0, 1)]
_Count = Annotated[int, Within(0, 10**10)]
_Year = Annotated[int, Within(-10_000, 2200)]
_Tileset = Annotated[str, OneOf("surface/tileset.json", "cloud/tileset.json")]


@dataclass(frozen=True, kw_only=True)
class Note:
    title: Line
    text: Passage = ""
    place: _Place
    eye: _Place | None = None


@dataclass(frozen=True, kw_only=True)
class Surface:
    count: _Count
    bytes: _Count
    first: _Count
    faces: _Count
    textured: bool
    filled: _Share
    unseen: _Share
    weak: _Share = 0.0
    tileset: _Tileset


@dataclass(frozen=True, kw_only=True)
class Cloud:
    count: _Count
    bytes: _Count
    first: _Count
    points: _Count
    of: _Count
    tileset: _Tileset


@dataclass(frozen=True, kw_only=True)
class Figures:
    pixel: Annotated[float, Within(0, 1e6)] | None = None
    reprojection: Annotated[float, Within(0, 1e6)] | None = None
    sigma_plan: Annotated[float, Within(0, 1e6)] | None = None
    sigma_height: Annotated[float, Within(0, 1e6)] | None = None
    seen_well: _Share | None = None
    photos: Annotated[float, Within(0, 1e6)] | None = None
    control: Annotated[float, Within(0, 1e6)] | None = None
    check: Annotated[float, Within(0, 1e6)] | None = None


@dataclass(frozen=True, kw_only=True)
class Site:
    """site.json, as `core/publish/write.py` writes it."""

    format: Annotated[int, Within(1, 1)]
    id: Annotated[str, Words(60)]
    title: Line
    text: Passage
    place: Line
    credit: Annotated[str, Words(500)]
    licence: Line
    taken: Annotated[str, _Day()] | None
    location: Annotated[str, OneOf(*LOCATIONS)]
    geometry: dict | None
    metres: bool
    north: bool
    doubt: bool
    box: tuple[_Place, _Place]
    surface: Surface | None
    cloud: Cloud | None
    figures: Figures
    notes: tuple[Note, ...]
    pictures: tuple[Annotated[str, Words(40)], ...]
    report: Annotated[str, Words(40)] | None
    film: Annotated[str, OneOf(FILM)] | None = None

    @property
    def said(self) -> About:
        """What the catalogue and the tiles are made of."""
        return About(title=self.title, location=self.location, text=self.text, place=self.place, credit=self.credit,
                     licence=self.licence)

    def as_json(self) -> dict[str, Any]:
        """For the site's page: names in one line each, figures that nobody gave left out, no report."""
        lines = {name: _one_line(getattr(self, name)) for name in ("title", "place", "credit", "licence")}
        figures = {name: value for name, value in asdict(self.figures).items() if value is not None}
        return {**asdict(self), **lines, "figures": figures, "report": None}


@dataclass(frozen=True, kw_only=True)
class Exact:
    """A place in degrees that the owner leaves for officials, to be sealed."""

    latitude: Annotated[float, Within(-90, 90)]
    longitude: Annotated[float, Within(-180, 180)]


@dataclass(frozen=True, kw_only=True)
class Added:
    """What a contributor adds to a site, to be found by. `period` is years, before our era below zero. `exact` is only
    there where officials may see it."""

    tags: tuple[Annotated[str, Words(40)], ...] = ()
    register: Annotated[str, Words(80)] = ""
    period_from: _Year | None = None
    period_to: _Year | None = None
    exact: Exact | None = field(default=None)


def site(content: bytes) -> tuple[Site, list[str]]:
    """site.json, and what a moderator is to look at. Raises Problem."""
    try:
        found: Site = build(Site, parse_json(content.decode()))
        _check(found)
    except (ValueError, RecursionError) as error:
        raise refused(Text("site.json: {}. Publish the site again, then upload it.", why(error))) from error
    return found, doubts(found)


def _check(found: Site) -> None:
    if not found.title.strip() or not re.fullmatch(r"[a-z0-9][a-z0-9-]{0,59}", found.id):
        raise ValueError("the site has no name")
    if len(found.notes) > 500 or len(found.pictures) > 40:
        raise ValueError("too many notes or pictures")
    if not found.surface and not found.cloud:
        raise ValueError("the site has neither surface nor cloud")
    for name in ("surface", "cloud"):
        part = getattr(found, name)
        if part and part.tileset != f"{name}/tileset.json":
            raise ValueError(Text("{} names another's tiles", name))
    if found.pictures != tuple(f"pictures/{number}.jpg" for number in range(1, len(found.pictures) + 1)):
        raise ValueError("the pictures' names are none that publishing gives")
    _check_place(found.location, found.geometry)


def _check_place(location: str, geometry: dict[str, Any] | None) -> None:
    """A place says no more than its level: below EXACT a cell of the grid, or nothing."""
    if location == HIDDEN and geometry is not None:
        raise ValueError("the place is hidden, and yet a geometry is there")
    if geometry is None:
        return
    if location == EXACT:
        made = build(_Point, geometry)
        for value, most in zip(made.coordinates, (180, 90), strict=True):
            if abs(value) > most:
                raise ValueError("the place is not on Earth")
        return
    ring = build(_Polygon, geometry).coordinates
    if len(ring) != 1 or len(ring[0]) != 5:
        raise ValueError("the place is no square")
    middle = [math.fsum(corner[axis] for corner in ring[0][:4]) / 4 for axis in (0, 1)]
    if abs(middle[0]) > 180 or abs(middle[1]) > 84:
        raise ValueError("the square is not on the grid")
    position = GeoPosition(latitude=middle[1], longitude=middle[0], altitude=None)
    known = privacy.shown(Frame(scale="metres", up="gps", north=True, origin=position), CELL).geometry
    if known is None or [list(corner) for corner in ring[0]] != known["coordinates"][0]:
        raise ValueError("the square is not one of the grid's")


@dataclass(frozen=True, kw_only=True)
class _Point:
    type: Annotated[str, OneOf("Point")]
    coordinates: tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class _Polygon:
    type: Annotated[str, OneOf("Polygon")]
    coordinates: tuple[tuple[tuple[float, float], ...], ...]


def added(value: Any) -> Added:
    """Raises Problem."""
    try:
        found: Added = build(Added, value)
        if len(found.tags) > 20 or any(not tag.strip() for tag in found.tags):
            raise ValueError("there are 20 tags at most, none empty")
        if (found.period_from is None) != (found.period_to is None) or \
                (found.period_from is not None and found.period_to is not None and found.period_from > found.period_to):
            raise ValueError("a period has a first and a last year, in this order")
    except (ValueError, RecursionError) as error:
        raise refused(Text("What was added to the site: {}.", why(error))) from error
    return replace(found, tags=tuple(map(_one_line, found.tags)), register=_one_line(found.register))


def _one_line(text: str) -> str:
    return " ".join(text.split())


def doubts(found: Site) -> list[str]:
    """What a moderator is to look at, as nothing here can decide it."""
    if found.location == EXACT:
        return []
    said = {Text(name): getattr(found, name) for name in ("title", "text", "place", "credit")}
    said |= {Text("note {}", number): f"{note.title} {note.text}" for number, note in enumerate(found.notes, 1)}
    return [Text("coordinates in {}?", name) for name, text in said.items() if _DEGREES.search(text)]
