# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Control points and their marks: what they are, `control.json` of a workspace, and whether they fit the photos.

numpy alone, since Blender reads and writes them too.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from ..base.errors import ControlError, WorkspaceError
from ..base.files import disk_errors, write_json
from ..base.geodesy import geodetic_to_enu, gps_enu
from ..base.language import Text
from ..base.reading import FARTHEST, OneOf, Within, build, parse_json, read_json
from ..base.records import GeoPosition, Photo
from ..photos.record import photo_finder
from .coordinates import LOCAL, mistaken_for

CONTROL_FILE = "control.json"
FORMAT = 1
CONTROL, CHECK, OFF = "control", "check", "off"  # what a point is used for
USUAL_SIGMAS = 0.02, 0.03  # metres in plan and height of a point whose accuracy nobody states: a survey by RTK
MARK_SIGMA = 0.5  # pixels, of a mark by hand
FAR = 5_000.0  # metres from every photo's GPS, from where on a point belongs to another place
FAR_UP = 1_000.0
UNKNOWN_HEIGHT = 1e6  # metres: the sigma of a height that is not known

_Metres = Annotated[float, Within(-FARTHEST, FARTHEST)]
_Sigma = Annotated[float, Within(1e-6, 1e4)]
_Place = tuple[_Metres, _Metres, _Metres | None]


class _PointName:
    def check(self, value: str) -> None:
        if not is_point_name(value):
            raise ValueError(f"{value[:40]!r} is no name of a point")


def is_point_name(name: str) -> bool:
    """Whether a point may be called so: a short text of one line, without spaces at its ends."""
    return 0 < len(name) <= 100 and name.isprintable() and name.strip() == name


_Name = Annotated[str, _PointName()]


@dataclass(frozen=True, kw_only=True)
class ControlPoint:
    """A point whose coordinates somebody measured.

    `given` is as it was read, in `system`: east, north and height in metres; on WGS84 latitude, longitude and altitude.
    `place` is what it means: metres of the site's own axes where `system` is LOCAL, else latitude and longitude
    (degrees on WGS84) and altitude (metres). A height that is None is unknown. Sigmas are in metres, of one coordinate.
    """

    name: _Name
    system: _Name
    given: _Place
    place: _Place
    sigma_plan: _Sigma = USUAL_SIGMAS[0]
    sigma_height: _Sigma = USUAL_SIGMAS[1]
    role: Annotated[str, OneOf(CONTROL, CHECK, OFF)] = CONTROL

    @property
    def sigmas(self) -> np.ndarray:
        """(3,) metres, in x, y and z."""
        height = UNKNOWN_HEIGHT if self.place[2] is None else self.sigma_height
        return np.array([self.sigma_plan, self.sigma_plan, height])


@dataclass(frozen=True, kw_only=True)
class Mark:
    """Where a point is seen in a photo: pixels of the photo as it is displayed, from its upper left corner, so that
    pixel centres are at .5. `photo` is its name in the job, once it is known. `sigma` is in pixels."""

    point: _Name
    photo: str
    x: Annotated[float, Within(-1e6, 1e6)]
    y: Annotated[float, Within(-1e6, 1e6)]
    sigma: Annotated[float, Within(0.01, 1000)] = MARK_SIGMA


@dataclass(frozen=True, kw_only=True)
class PhotoPosition:
    """A photo's position in place of its GPS: latitude, longitude (degrees on WGS84), altitude; sigmas in metres."""

    photo: str
    place: _Place
    sigma_plan: _Sigma | None = None
    sigma_height: _Sigma | None = None


@dataclass(frozen=True, kw_only=True)
class ControlSet:
    """All points with their marks, and the photos' positions that somebody gave."""

    points: tuple[ControlPoint, ...] = ()
    marks: tuple[Mark, ...] = ()
    positions: tuple[PhotoPosition, ...] = ()

    @property
    def is_local(self) -> bool:
        """Whether the points are in the site's own axes, and not on Earth."""
        return any(point.system == LOCAL for point in self.points)

    def point(self, name: str) -> ControlPoint | None:
        return next((point for point in self.points if point.name == name), None)

    def of_role(self, *roles: str) -> tuple[ControlPoint, ...]:
        return tuple(point for point in self.points if point.role in roles)

    def marks_of(self, name: str) -> tuple[Mark, ...]:
        return tuple(mark for mark in self.marks if mark.point == name)

    def of_roles(self, *roles: str) -> ControlSet:
        """The points of some roles with their marks, and no positions."""
        points = self.of_role(*roles)
        names = {point.name for point in points}
        return ControlSet(points=points, marks=tuple(mark for mark in self.marks if mark.point in names))

    @property
    def adjusted_to(self) -> ControlSet:
        """What of it the cameras are adjusted to: check points are none of that."""
        return replace(self.of_roles(CONTROL), positions=self.positions)

    def with_points(self, points: Iterable[ControlPoint]) -> ControlSet:
        """With these points in place of those of their names, or at the end. Raises ControlError for points of the
        site's own axes among others."""
        new = {point.name: point for point in points}
        kept = tuple(new.pop(point.name, point) for point in self.points)
        changed = replace(self, points=(*kept, *new.values()))
        if len({point.system == LOCAL for point in changed.points}) > 1:
            one = next(point.name for point in changed.points if point.system == LOCAL)
            raise ControlError(
                Text("{} is in local metres and other points are on Earth: one site has one kind of coordinates.", one),
                remedy="Remove the points of the other kind, or convert them.",
            )
        return changed

    def without_point(self, name: str) -> ControlSet:
        """Without a point and its marks."""
        return replace(self, points=tuple(point for point in self.points if point.name != name),
                       marks=tuple(mark for mark in self.marks if mark.point != name))

    def with_marks(self, marks: Iterable[Mark]) -> ControlSet:
        """With these marks in place of those of the same points in the same photos."""
        new = {(mark.point, mark.photo): mark for mark in marks}
        kept = tuple(mark for mark in self.marks if (mark.point, mark.photo) not in new)
        return replace(self, marks=(*kept, *new.values()))

    def without_mark(self, point: str, photo: str) -> ControlSet:
        return replace(self, marks=tuple(m for m in self.marks if (m.point, m.photo) != (point, photo)))

    def with_imported(self, new: ControlSet) -> ControlSet:
        """With what a file gave. A point that was there keeps its role where the file says nothing else."""
        roles = {point.name: point.role for point in self.points}
        points = [replace(point, role=roles.get(point.name, CONTROL)) if point.role == CONTROL else point
                  for point in new.points]
        placed = {position.photo for position in new.positions}
        positions = (*(kept for kept in self.positions if kept.photo not in placed), *new.positions)
        return replace(self.with_points(points).with_marks(new.marks), positions=positions)


# ---- the file


def read_control(workspace: Path) -> ControlSet:
    """What the workspace keeps; nothing where there is no file. Raises WorkspaceError for a damaged one."""
    path = workspace / CONTROL_FILE
    try:
        return _built(read_json(path))
    except FileNotFoundError:
        return ControlSet()
    except (OSError, ValueError) as error:
        raise WorkspaceError(
            Text("{} is damaged ({}).", path, Text(str(error))), path=path,
            remedy="Delete that file, then import the control points again.",
        ) from error


def write_control(workspace: Path, control: ControlSet) -> None:
    """Keep the points in the workspace (atomically); none need no file. Raises WorkspaceError."""
    path = workspace / CONTROL_FILE
    if control == ControlSet():
        with disk_errors(path):
            path.unlink(missing_ok=True)
    else:
        write_json(path, {"format": FORMAT, **asdict(control)})


def to_json(control: ControlSet) -> str:
    return json.dumps({"format": FORMAT, **asdict(control)})


def from_json(text: str) -> ControlSet:
    """The inverse of `to_json`. Raises ValueError."""
    return _built(parse_json(text))


def _built(fields: Any) -> ControlSet:
    if not isinstance(fields, dict):
        raise ValueError("no record")
    if build(int, fields.get("format"), "format") > FORMAT:
        raise ValueError("written by a newer version of CU-Recon")
    made: ControlSet = build(ControlSet, {name: value for name, value in fields.items() if name != "format"})
    names = {point.name for point in made.points}
    if len(names) != len(made.points):
        raise ValueError("two points have one name")
    if not {mark.point for mark in made.marks} <= names:
        raise ValueError("a mark is of a point that is not there")
    if len({(mark.point, mark.photo) for mark in made.marks}) != len(made.marks):
        raise ValueError("a point is marked twice in one photo")
    if len({point.system == LOCAL for point in made.points}) > 1:
        raise ValueError("local and other points are mixed")
    for place in [*(p.place for p in made.points if p.system != LOCAL), *(p.place for p in made.positions)]:
        if not (abs(place[0]) <= 90 and abs(place[1]) <= 180 and abs(place[2] or 0) <= 100_000):
            raise ValueError("a place that is not on Earth")
    return made


# ---- against the photos

# Where something was read, by point or by (point, photo), for messages: "gcp_list.txt, line 4".
Lines = Mapping[str | tuple[str, str], str]


def resolved(control: ControlSet, photos: Iterable[Photo], lines: Lines) -> tuple[ControlSet, list[str]]:
    """The marks and positions with their photos' names in the job, and a sentence on each that is left out since its
    photo is not there. Raises ControlError for a mark outside of its photo."""
    find, warnings, kept, positions = photo_finder(photos), [], [], []
    missing: dict[str, list[str]] = {}
    for mark in control.marks:
        photo, where = find(mark.photo), lines.get((mark.point, mark.photo), f"The mark of {mark.point}")
        if photo is None:
            missing.setdefault(mark.photo, []).append(where)
        elif not (0 <= mark.x <= photo.width and 0 <= mark.y <= photo.height):
            raise ControlError(
                Text("{}: {} is marked at {:g}, {:g} in {}, which has {} x {} pixels.", Text(where), mark.point, mark.x,
                     mark.y, mark.photo, photo.width, photo.height),
                remedy="Marks count in pixels of the photo as it is displayed, from its upper left corner: correct or "
                "remove that one. If all are so, the photos were scaled or turned after they were marked.",
            )
        else:
            kept.append(replace(mark, photo=photo.name))
    for position in control.positions:
        photo = find(position.photo)
        if photo is None:
            missing.setdefault(position.photo, []).append(lines.get(position.photo, "A position"))
        else:
            positions.append(replace(position, photo=photo.name))
    for name, places in list(missing.items())[:5]:
        more = f" and {len(places) - 1} more" if len(places) > 1 else ""
        warnings.append(f"{places[0]}{more}: there is no photo {name} in this job; it is left out.")
    if len(missing) > 5:
        warnings.append(f"{len(missing) - 5} further photos that the control file names are not in this job.")
    if control.marks and not kept:
        raise ControlError(
            Text("None of the marked photos is in this job: {} ...", ', '.join(list(missing)[:3])),
            remedy="Choose the folder with the photos that were marked; their file names must agree.",
        )
    return replace(ControlSet(points=control.points, positions=tuple(positions)).with_marks(kept)), warnings


def check_places(control: ControlSet, photos: Iterable[Photo], lines: Lines) -> list[str]:
    """Whether points and positions on Earth lie where the photos' GPS does. Raises ControlError for one that is
    kilometres off; returns a sentence on heights that cannot be."""
    located = [photo for photo in photos if photo.gps is not None]
    if not located or control.is_local:
        return []
    positions, middle = gps_enu(located)
    flown = positions[:, :2]
    heights = []
    items: list[ControlPoint | PhotoPosition] = [*control.points, *control.positions]
    for item in items:
        name = item.name if isinstance(item, ControlPoint) else item.photo
        latitude, longitude, altitude = item.place
        at = geodetic_to_enu(np.array([[latitude, longitude, middle.altitude or 0.0]]), middle)[0, :2]
        off = float(np.linalg.norm(flown - at, axis=1).min())
        if off > FAR:
            where = lines.get(name, "The control points")
            guess = mistaken_for(item.given, item.system, middle) if isinstance(item, ControlPoint) else ""
            raise ControlError(
                Text("{}: {} lies {:,.0f} km from the photos' GPS. It is at latitude {:.5f}, longitude {:.5f}; "
                     "expected was about {:.5f}, {:.5f}.", Text(where), name, off / 1000, latitude, longitude,
                     middle.latitude, middle.longitude),
                remedy=guess or "Check that line, and the system of coordinates that the file is in.",
            )
        if altitude is not None and middle.altitude is not None and abs(altitude - middle.altitude) > FAR_UP:
            heights.append(name)
    if heights:
        return [f"The height of {heights[0]}{_and_more(heights)} is more than {FAR_UP:.0f} m from the photos'. Heights "
                "are in metres: check them."]
    return []


def thin_points(control: ControlSet) -> list[str]:
    """A sentence on each kind of point that can take no part."""
    said = []
    used = control.of_role(CONTROL, CHECK)
    counts = {point.name: len(control.marks_of(point.name)) for point in used}
    if once := [name for name, count in counts.items() if count == 1]:
        said.append(f"{once[0]}{_and_more(once)} is marked in one photo only and takes no part: mark it in a second.")
    if no_height := [point.name for point in used if point.place[2] is None]:
        said.append(f"{no_height[0]}{_and_more(no_height)} has no height: it holds the plan only.")
    return said


def _and_more(names: list[str]) -> str:
    return f" (and {len(names) - 1} more)" if len(names) > 1 else ""


def frame_positions(points: Iterable[ControlPoint], origin: GeoPosition | None) -> np.ndarray:
    """(N,3) metres in a frame whose origin is there; of LOCAL points as they are. Unknown heights are the origin's."""
    places = [point.place for point in points]
    if origin is None:
        return np.array([[x, y, z or 0.0] for x, y, z in places]).reshape(-1, 3)
    known = [[latitude, longitude, (origin.altitude or 0.0) if height is None else height]
             for latitude, longitude, height in places]
    return geodetic_to_enu(np.array(known).reshape(-1, 3), origin)
