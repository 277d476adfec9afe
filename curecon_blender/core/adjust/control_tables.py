# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Text files of coordinates as tables: letters, separators, decimal signs, headers, and which column is what."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from ..base.errors import ControlError
from ..base.language import Text
from ..base.reading import read_bytes
from .coordinates import LOCAL, WGS84, system_named

MOST_BYTES, MOST_ROWS, MOST_CELLS = 32 << 20, 200_000, 64
# What columns are called, in small letters without units, spaces and signs.
_COLUMNS = {
    "name": "name label id point pointid pointname pointlabel gcp gcpname gcplabel marker number no nr station",
    "latitude": "latitude lat ylatitude", "longitude": "longitude lon long lng xlongitude",
    "east": "x e east easting xeast xeasting rechtswert", "north": "y n north northing ynorth ynorthing hochwert",
    "height": "z h alt altitude height elevation elev ele zaltitude zheight ellipsoidheight ellipsoidalheight hohe",
    "sigma_plan": "acch accuracyh accuracyhorizontal horizontalaccuracy hacc hzacc accuracyxy sigmaplan sigmaxy",
    "sigma_height": "accv accuracyv accuracyvertical verticalaccuracy vacc accuracyz sigmaheight sigmaz",
    "sigma_east": "accuracyx sigmax", "sigma_north": "accuracyy sigmay", "sigma": "accuracy sigma acc",
    "photo": "image photo filename file picture imagename photoname img",
    "px": "px u imagex pixelx xpixel imx", "py": "py v imagey pixely ypixel imy",
    "sigma_pixels": "sigmapixels pixelaccuracy", "role": "role type usage kind",
}
_MEANING = {word: column for column, words in _COLUMNS.items() for word in words.split()}
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)(e[+-]?\d+)?", re.IGNORECASE)
_PHOTO = re.compile(r"\.(jpe?g|png|tiff?|dng|heic|heif|webp|bmp)$", re.IGNORECASE)
_NOTHING = ("", "nan", "-", "none", "null")


@dataclass(frozen=True)
class Table:
    """The rows of a file, each with its number and its cells by column. `system` is what the file says its coordinates
    are in, "" where it says nothing; with `by_axes` degrees come as longitude, latitude."""

    path: Path
    rows: list[tuple[int, dict[str, str]]]
    system: str = ""
    by_axes: bool = False
    columns: frozenset[str] = field(default_factory=frozenset)

    def where(self, line: int) -> str:
        return f"{self.path.name}, line {line}"


def read_table(path: Path) -> Table:
    """Read a file in any of the known forms. Raises ControlError, naming the line."""
    lines = _lines(path)
    system, by_axes = "", False
    header: list[str] | None = None
    body: list[tuple[int, str]] = []
    for number, line in lines:
        bare, comment = line.lstrip("#").strip(), line.startswith("#")
        begins = not body and header is None
        if named := _system_in_comment(bare) if comment else system_named(bare) if begins else None:
            system, by_axes = named, True
        elif begins and (columns := _header(bare)):
            header = columns
        elif not comment:
            body.append((number, line))
    if not body:
        raise ControlError(Text("{} holds no points.", path.name), path=path,
                           remedy="Choose a file with one point or one mark a line.")
    first = body[0][1]
    if header is None and not system and (first.startswith("+") or first.lower().startswith(("epsg", "wgs"))):
        raise ControlError(
            Text("{}, line {}: the system {} is not known.", path.name, body[0][0], first[:60]), path=path,
            remedy="Write it as WGS84 UTM 16N, EPSG:4326 or EPSG:2180.",
        )
    split = _splitter(path, [line for _, line in body])
    cells = [(number, split(line)) for number, line in body]
    columns = header or _layout(path, cells, bool(system))
    rows = [(number, dict(zip(columns, values, strict=False))) for number, values in cells]
    if "latitude" in columns:
        system, by_axes = system or WGS84, False
    elif header and "east" in columns:
        by_axes = True
    return Table(path, rows, system, by_axes, frozenset(columns))


def number_in(text: str) -> float | None:
    """The number that a cell holds, with a point or a comma; None where it holds nothing. Raises ValueError."""
    text = text.strip()
    if text.casefold() in _NOTHING:
        return None
    if not _NUMBER.fullmatch(text):
        raise ValueError(f"{text[:40]!r} is no number")
    return float(text.replace(",", "."))


def _lines(path: Path) -> list[tuple[int, str]]:
    """The file's lines that are not blank, with their numbers."""
    try:
        content = read_bytes(path, MOST_BYTES)
    except (OSError, ValueError) as error:
        raise ControlError(Text("{} cannot be read ({}).", path, Text(str(error))), path=path,
                           remedy="Choose a text file with control points.") from error
    text = _decoded(content)
    if text is None or "\0" in text:
        raise ControlError(
            Text("{} is no text file.", path.name), path=path,
            remedy="Save the points as CSV or as plain text; a table of a spreadsheet program must be exported first.",
        )
    lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), start=1) if line.strip()]
    if len(lines) > MOST_ROWS:
        raise ControlError(Text("{} has more than {:,} lines.", path.name, MOST_ROWS), path=path,
                           remedy="Choose the file with the control points; a cloud's points are too many.")
    return lines


def _decoded(content: bytes) -> str | None:
    if content.startswith(codecs.BOM_UTF8):
        return _try(content, "utf-8-sig")
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return _try(content, "utf-16")
    zeros = content[:4000]
    if zeros.count(0) > len(zeros) // 4:  # UTF-16 without its mark: every second byte of plain letters is zero
        return _try(content, "utf-16-le" if zeros[1:2] == b"\0" else "utf-16-be")
    return _try(content, "utf-8") or _try(content, "cp1252") or ""


def _try(content: bytes, encoding: str) -> str | None:
    try:
        return content.decode(encoding)
    except UnicodeDecodeError:
        return None


def _system_in_comment(text: str) -> str | None:
    """The system in Metashape's comment "CoordinateSystem: PROJCS[... AUTHORITY["EPSG","32650"]]"."""
    if not re.match(r"coordinate\s*system", text, re.IGNORECASE):
        return None
    if "LOCAL_CS" in text:
        return LOCAL
    codes = re.findall(r'"EPSG"\s*,\s*"(\d+)"', text)
    return system_named(f"EPSG:{codes[-1]}") if codes else None


def _header(line: str) -> list[str] | None:
    """The columns that a line names; None where it names too few."""
    cells = next(csv.reader([line.replace(";", ",").replace("\t", ",")], skipinitialspace=True), [])
    if len(cells) < 3:
        cells = line.split()
    if len(cells) < 3 or any(_NUMBER.fullmatch(cell.strip()) for cell in cells):
        return None
    plain = [re.sub(r"[^a-z]", "", re.sub(r"[(\[].*?[)\]]", "", cell).casefold()) for cell in cells]
    columns = [_MEANING.get(word, f"?{place}") for place, word in enumerate(plain)]
    if "photo" in columns and "px" not in columns and {"east", "north"} <= set(columns):  # marks
        columns = [{"east": "px", "north": "py"}.get(column, column) for column in columns]
    for place, column in enumerate(columns):
        if column in columns[:place]:  # the first of a name counts: Metashape's X_est comes after X/East
            columns[place] = f"?{place}"
    places = {"latitude", "longitude"} <= set(columns) or {"east", "north"} <= set(columns)
    return columns if places or {"photo", "px", "py"} <= set(columns) else None


def _splitter(path: Path, lines: list[str]) -> Callable[[str], list[str]]:
    """How the lines are cut into cells. Raises ControlError where decimal commas and commas between cells mix."""
    sample = lines[:50]
    if all(";" in line for line in sample):
        return lambda line: _cells(line, ";")
    if all(line.count("\t") >= 2 for line in sample):
        return lambda line: _cells(line, "\t")
    if all(_in_spaces(line) for line in sample):
        return str.split
    if not all("," in line for line in sample):
        return str.split
    rows = [_cells(line, ",") for line in sample]
    if all(len(row) in (7, 9, 11) and all(re.fullmatch(r"[+-]?\d+", cell) for cell in row[1:]) for row in rows):
        raise ControlError(
            Text("{} has commas between its columns and in its numbers, which cannot be told apart.",
                 path.name), path=path,
            remedy="Save it with semicolons between the columns, or with points in the numbers.",
        )
    return lambda line: _cells(line, ",")


def _in_spaces(line: str) -> bool:
    """Whether a line is cut by spaces: three numbers or more stand alone between them."""
    return sum(bool(_NUMBER.fullmatch(cell)) for cell in line.split()) >= 3


def _cells(line: str, separator: str) -> list[str]:
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, skipinitialspace=True))]
    except (csv.Error, StopIteration):
        return [cell.strip() for cell in line.split(separator)]


def _layout(path: Path, rows: list[tuple[int, list[str]]], says_system: bool) -> list[str]:
    """The columns of a file without a header, from its first row. Raises ControlError."""
    number, cells = rows[0]
    numbers = [bool(_NUMBER.fullmatch(cell)) for cell in cells]
    photos = [bool(_PHOTO.search(cell)) for cell in cells]
    if len(cells) > MOST_CELLS:
        cells = cells[:MOST_CELLS]
    if len(cells) >= 6 and photos[5] and numbers[0] and numbers[1] and numbers[3] and numbers[4]:  # ODM's gcp_list.txt
        return ["east", "north", "height", "px", "py", "photo", "name", *(f"extra{i}" for i in range(MOST_CELLS))]
    if len(cells) >= 3 and photos[0] and numbers[1] and numbers[2]:  # ODM's geo.txt
        angles = ["?yaw", "?pitch", "?roll"] if max(len(row) for _, row in rows) >= 7 else []
        return ["photo", "east", "north", "height", *angles, "sigma_plan", "sigma_height"]
    if len(cells) >= 4 and numbers[2] and numbers[3] and (photos[0] or photos[1]) and not says_system:  # Pix4D's marks
        return ["photo", "name", "px", "py"] if photos[0] else ["name", "photo", "px", "py"]
    if len(cells) >= 3 and all(numbers[1:3]):
        return ["name", "east", "north", "height", "sigma_plan", "sigma_height"]
    raise ControlError(
        Text("{}, line {}: this is no point and no mark: {}", path.name, number, ' '.join(cells)[:60]), path=path,
        remedy="A point is name,x,y,z and a mark photo,name,x,y; ODM's lines are x y z px py photo name. A first line "
        "may name the columns.",
    )
