# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of control points and marks: ODM's gcp_list.txt and geo.txt, CSV of Pix4D and Metashape, and plain tables.

numpy alone, since Blender reads them too.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..base.errors import ControlError
from ..base.files import atomic_write
from ..base.geodesy import gps_enu
from ..base.language import Text
from ..base.records import GeoPosition, Photo
from .control import (
    CHECK,
    CONTROL,
    MARK_SIGMA,
    OFF,
    USUAL_SIGMAS,
    ControlPoint,
    ControlSet,
    Mark,
    PhotoPosition,
    check_places,
    is_point_name,
    resolved,
    thin_points,
)
from .control_tables import Table, number_in, read_table
from .coordinates import FARTHEST_LOCAL, LOCAL, WGS84, guess_system, system_named, to_places

SAME = 1e-3, 1e-8  # metres or degrees, within which two lines of one point agree


@dataclass
class _Found:
    """What files hold: points by name with their coordinates as read, marks, positions, and where each was read."""

    points: dict[str, ControlPoint] = field(default_factory=dict)
    marks: list[Mark] = field(default_factory=list)
    positions: list[PhotoPosition] = field(default_factory=list)
    lines: dict[str | tuple[str, str], str] = field(default_factory=dict)


def import_files(
    paths: Sequence[Path], kept: ControlSet, photos: Iterable[Photo], system: str = ""
) -> tuple[ControlSet, list[str]]:
    """What the files hold together with what was `kept`, and sentences for the user.

    `photos` are the job's, none where they are not known yet. `system` is what the coordinates are in where a file does
    not say so; "" lets it be found out. Raises ControlError, naming file and line.
    """
    photos = tuple(photos)
    named = ""
    if system and not (named := system_named(system) or ""):
        raise ControlError(Text("{} is no known system of coordinates.", system),
                           remedy="Write it as WGS84, UTM 16N, EPSG:2180 or local.")
    located = [photo for photo in photos if photo.gps is not None]
    middle = gps_enu(located)[1] if located else None
    found = _Found()
    for path in paths:
        _take(read_table(path), named, middle, found)
    for mark in found.marks:
        if mark.point not in found.points and kept.point(mark.point) is None:
            raise ControlError(
                Text("{}: {} is marked, but its coordinates are in no file.", Text(found.lines[mark.point, mark.photo]),
                     mark.point),
                remedy="Import the file with the points' coordinates as well, or first.",
            )
    new = ControlSet(points=tuple(found.points.values()), positions=tuple(found.positions)).with_marks(found.marks)
    warnings: list[str] = []
    if photos:
        new, warnings = resolved(new, photos, found.lines)
        warnings += check_places(new, photos, found.lines)
    control = kept.with_imported(new)
    return control, warnings + (thin_points(control) if control.marks else [])


def _take(table: Table, system: str, middle: GeoPosition | None, found: _Found) -> None:
    """Add what a table holds."""
    columns = table.columns
    if {"latitude", "longitude"} <= columns or {"east", "north"} <= columns:
        _take_places(table, system, middle, found)
    for line, cells in table.rows:
        if "px" in columns and _text(cells, "photo"):
            name = _text(cells, "name") or found.lines.get(("", str(line)), "")
            _take_mark(table, line, cells, name, found)


def _take_places(table: Table, system: str, middle: GeoPosition | None, found: _Found) -> None:
    geographic = "latitude" in table.columns
    first, second = ("latitude", "longitude") if geographic else ("east", "north")
    plan = np.array([[_needed(table, line, cells, name) for name in (first, second)] for line, cells in table.rows])
    heights = [_number(table, line, cells, "height") for line, cells in table.rows]
    try:
        system = table.system or system or guess_system(plan, by_axes=table.by_axes, middle=middle)
    except ControlError as error:
        raise ControlError(Text("{}: {}", Text(table.where(table.rows[0][0])), error.message), remedy=error.remedy,
                           path=table.path) from error
    if system == WGS84 and table.by_axes:
        plan = plan[:, ::-1]
    if (most := np.abs(plan).max()) > (FARTHEST_LOCAL if system == LOCAL else 1e8):
        line = table.rows[int(np.abs(plan).max(axis=1).argmax())][0]
        raise ControlError(
            Text("{}: the coordinate {:.10g} is too large for {}.", Text(table.where(line)), most,
                 system), path=table.path,
            remedy=Text("Local coordinates must lie within {:g} km of their origin: take the same round number off "
                        "all of them, or name the system that they are in.", FARTHEST_LOCAL / 1000),
        )
    places = to_places(system, np.column_stack([plan, [np.nan if h is None else h for h in heights]]))
    _check_on_earth(table, system, places)
    for row, (line, cells) in enumerate(table.rows):
        height = places[row, 2]
        place = (float(places[row, 0]), float(places[row, 1]), None if np.isnan(height) else float(height))
        given = (float(plan[row, 0]), float(plan[row, 1]), heights[row])
        sigmas = _sigmas(table, line, cells)
        if "photo" in table.columns and "px" not in table.columns:
            _take_position(table, line, cells, place, sigmas, found)
            continue
        point = ControlPoint(
            name=_point_name(table, line, cells, given, found), system=system, given=given, place=place,
            sigma_plan=sigmas[0] or USUAL_SIGMAS[0], sigma_height=sigmas[1] or USUAL_SIGMAS[1], role=_role(cells),
        )
        _take_point(table, line, point, found)


def _take_point(table: Table, line: int, point: ControlPoint, found: _Found) -> None:
    before = found.points.get(point.name)
    if before is not None:
        step = SAME[1] if point.system == WGS84 else SAME[0]
        off = np.abs(np.subtract(before.given[:2], point.given[:2])).max()
        if off > step or abs((before.given[2] or 0) - (point.given[2] or 0)) > SAME[0]:
            raise ControlError(
                Text("{}: {} has other coordinates than in {}.", Text(table.where(line)), point.name,
                     Text(found.lines[point.name])),
                remedy="Two points need two names: correct one of the two lines.", path=table.path,
            )
        return
    found.points[point.name] = point
    found.lines[point.name] = table.where(line)


def _take_position(
    table: Table, line: int, cells: dict[str, str], place: tuple[float, float, float | None],
    sigmas: tuple[float | None, float | None], found: _Found,
) -> None:
    photo = _text(cells, "photo")
    if photo in found.lines:
        raise ControlError(Text("{}: {} has a position in {} already.", Text(table.where(line)), photo,
                                Text(found.lines[photo])),
                           remedy="Remove one of the two lines.", path=table.path)
    found.positions.append(PhotoPosition(photo=photo, place=place, sigma_plan=sigmas[0], sigma_height=sigmas[1]))
    found.lines[photo] = table.where(line)


def _take_mark(table: Table, line: int, cells: dict[str, str], name: str, found: _Found) -> None:
    photo = _text(cells, "photo")
    if not is_point_name(name):
        raise ControlError(Text("{}: the mark has no point's name.", Text(table.where(line))), path=table.path,
                           remedy="Write the point's name into that line.")
    if (name, photo) in found.lines:
        raise ControlError(
            Text("{}: {} is marked in {} a second time, after {}.", Text(table.where(line)), name, photo,
                 Text(found.lines[name, photo])),
            remedy="Remove one of the two lines.", path=table.path,
        )
    x, y = (_needed(table, line, cells, axis) for axis in ("px", "py"))
    if max(abs(x), abs(y)) > 1e6:
        raise ControlError(Text("{}: {} is marked at {:g}, {:g}, which is in no photo.", Text(table.where(line)), name,
                                x, y),
                           remedy="Marks count in pixels, from the photo's upper left corner.", path=table.path)
    sigma = _number(table, line, cells, "sigma_pixels") or float(_extra(cells, "px") or MARK_SIGMA)
    found.marks.append(Mark(point=name, photo=photo, x=x, y=y, sigma=min(max(sigma, 0.01), 1000.0)))
    found.lines[name, photo] = table.where(line)


def _point_name(
    table: Table, line: int, cells: dict[str, str], given: tuple[float, float, float | None], found: _Found
) -> str:
    """A row's point; ODM's rows without a name are of one point where their coordinates agree."""
    name = _text(cells, "name")
    if not name and "px" in table.columns:
        same = next((point.name for point in found.points.values() if point.given == given), None)
        name = same or f"gcp{len(found.points) + 1}"
        found.lines["", str(line)] = name
    if not is_point_name(name):
        raise ControlError(Text("{}: the point has no name, or one that is too long.",
                                Text(table.where(line))), path=table.path,
                           remedy="Write a short name into that line.")
    return name


def _sigmas(table: Table, line: int, cells: dict[str, str]) -> tuple[float | None, float | None]:
    """Sigmas in plan and height, metres; None where nothing is stated."""
    both = _number(table, line, cells, "sigma")
    plan = [_number(table, line, cells, name) for name in ("sigma_plan", "sigma_east", "sigma_north")]
    height = _number(table, line, cells, "sigma_height")
    if told := _extra(cells, "sigma"):
        plan[0], height = (float(value) for value in told.split("/"))
    stated = [value for value in (both, *plan, height) if value is not None]
    if any(value <= 0 for value in stated):
        raise ControlError(
            Text("{}: an accuracy of {:g} m. Nothing is measured without an error.", Text(table.where(line)),
                 min(stated)),
            remedy=Text("Write how far the point may be off, such as {} m, or leave it empty.", USUAL_SIGMAS[0]),
            path=table.path,
        )
    if any(value > 1e4 for value in stated):
        raise ControlError(Text("{}: an accuracy of {:g} m says nothing.", Text(table.where(line)),
                                max(stated)), path=table.path,
                           remedy="Accuracies are in metres: correct that one.")
    known = [value for value in plan if value is not None]
    plan_sigma = max(known) if known else both
    return plan_sigma, height if height is not None else both if both is not None else (
        plan_sigma * USUAL_SIGMAS[1] / USUAL_SIGMAS[0] if plan_sigma is not None else None)


def _role(cells: dict[str, str]) -> str:
    told = (_text(cells, "role") or _extra(cells, "role")).casefold()
    return CHECK if "check" in told else OFF if told in ("off", "none", "disabled") else CONTROL


def _extra(cells: dict[str, str], name: str) -> str:
    """What one of ODM's extra cells says, of those that `write_odm` writes: role=check, sigma=0.02/0.03, px=0.5."""
    number = r"\d+(?:\.\d+)?(?:e[+-]?\d+)?"
    known = {"role": "check|off|control", "sigma": f"{number}/{number}", "px": number}[name]
    for key, cell in cells.items():
        if key.startswith("extra") and re.fullmatch(f"{name}=({known})", cell):
            return cell.partition("=")[2]
    return ""


def _text(cells: dict[str, str], name: str) -> str:
    return cells.get(name, "").strip().strip('"')


def _needed(table: Table, line: int, cells: dict[str, str], name: str) -> float:
    value = _number(table, line, cells, name)
    if value is None:
        raise ControlError(Text("{}: the column for {} is empty or missing.", Text(table.where(line)),
                                Text(_WORDS[name])), path=table.path,
                           remedy="Complete that line, or remove it.")
    return value


_WORDS = {"east": "east (x)", "north": "north (y)", "latitude": "the latitude", "longitude": "the longitude",
          "px": "x in the photo", "py": "y in the photo"}


def _number(table: Table, line: int, cells: dict[str, str], name: str) -> float | None:
    try:
        return number_in(cells.get(name, ""))
    except ValueError as error:
        raise ControlError(
            Text("{}: {}.", Text(table.where(line)), Text(str(error))), path=table.path,
            remedy="Correct that line. Columns are parted by commas, semicolons, tabs or spaces; with decimal commas, "
            "by semicolons or tabs.",
        ) from error


def _check_on_earth(table: Table, system: str, places: np.ndarray) -> None:
    if system == LOCAL:
        return
    wrong = ~((np.abs(places[:, 0]) <= 90) & (np.abs(places[:, 1]) <= 180))
    if not wrong.any():
        return
    row = int(np.argmax(wrong))
    latitude, longitude = places[row, :2]
    exchanged = abs(longitude) <= 90 and abs(latitude) <= 180
    raise ControlError(
        Text("{}: latitude {:.6g}, longitude {:.6g} is no place on Earth.", Text(table.where(table.rows[row][0])),
             latitude, longitude),
        remedy="Latitude and longitude look exchanged: exchange the two columns." if exchanged else
        "The coordinates are not in degrees: name the system that they are in, such as UTM 50N.", path=table.path,
    )


# ---- writing


def write_odm(path: Path, control: ControlSet) -> list[str]:
    """Write the marked points as ODM's gcp_list.txt, with role and sigmas in its extra cells. Returns a sentence on
    points that it cannot hold. Raises WorkspaceError."""
    systems = {point.system for point in control.points}
    system = systems.pop() if len(systems) == 1 else WGS84
    lines = [{WGS84: "EPSG:4326", LOCAL: "local"}.get(system, f"WGS84 {system}" if system[:3] == "UTM" else system)]
    for point in control.points:
        x, y, z = point.given if point.system == system else point.place
        x, y, form = (y, x, ".10f") if system == WGS84 else (x, y, ".4f")
        for mark in control.marks_of(point.name):
            height = "NaN" if z is None else f"{z:.4f}"
            lines.append("\t".join([
                f"{x:{form}}", f"{y:{form}}", height, f"{mark.x:.3f}", f"{mark.y:.3f}", mark.photo,
                re.sub(r"\s", "_", point.name), f"role={point.role}",
                f"sigma={point.sigma_plan:g}/{point.sigma_height:g}", f"px={mark.sigma:g}",
            ]))
    with atomic_write(path) as file:
        file.write(("\n".join(lines) + "\n").encode())
    unmarked = [point.name for point in control.points if not control.marks_of(point.name)]
    if unmarked:
        return [f"{len(unmarked)} points without marks are not in {path.name}, since ODM's format cannot hold them: "
                f"{', '.join(unmarked[:5])}."]
    return []
