# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Clouds as surveyors have them: LAS and LAZ, E57, and coordinates as text (XYZ, TXT, CSV, PTS, ASC)."""

from __future__ import annotations

import io
import re
import struct
from pathlib import Path

import laspy
import lazrs
import numpy as np

from ..base.errors import SetupError
from ..base.reading import read_bytes
from .result import MOST_POINTS, Result, result_of

_BLOCK = 1 << 21  # points of LAS at once
_MOST_TEXT = 4 << 30  # bytes
_SOME = 1000  # rows that tell what the columns are
_NOTES = re.compile(rb"^\s*(#|//|;)")


def read_las(path: Path) -> Result:
    """Raises OSError, ValueError."""
    try:
        with laspy.open(path) as reader:
            header = reader.header
            count = header.point_count
            size = 0 if header.are_points_compressed else header.point_format.size
            sound = count <= MOST_POINTS and count * size <= path.stat().st_size
            coloured = "red" in header.point_format.dimension_names
            xyz, colours = [np.empty((0, 3))], [np.empty((0, 3), np.uint16)]
            for block in reader.chunk_iterator(_BLOCK) if sound else ():
                xyz.append(np.column_stack([block.x, block.y, block.z]))
                if coloured:
                    colours.append(np.column_stack([block.red, block.green, block.blue]))
    except (laspy.LaspyException, lazrs.LazrsError, RuntimeError, ValueError, OverflowError, IndexError, KeyError,
            TypeError, AttributeError, MemoryError, struct.error) as error:
        raise ValueError(f"no sound LAS ({str(error)[:120] or type(error).__name__})") from error
    places = np.concatenate(xyz)
    if len(places) < count:
        raise ValueError(f"it claims {count:,} points, and is cut short or has more than can be compared")
    shades = np.concatenate(colours)
    return result_of(path.stem, places, colours=shades if coloured and shades.any() else None)


def read_e57(path: Path) -> Result:
    """All scans of a file in its own coordinates. Raises OSError, ValueError, SetupError where pye57 is missing."""
    try:
        import pye57
        from pye57 import libe57
    except ImportError as error:
        raise SetupError(
            "E57 needs the library pye57, which this Python does not have.",
            remedy="Save it as LAZ or PLY; or install it in the Worker Python: python -m pip install pye57",
        ) from error
    xyz, colours = [], []
    try:
        with pye57.E57(str(path)) as file:
            headers = [file.get_header(scan) for scan in range(file.scan_count)]
            count = sum(header.point_count for header in headers)
            if count > min(MOST_POINTS, 8 * path.stat().st_size):  # a point takes a bit at least
                raise ValueError(f"it claims {count:,} points")
            coloured = all({"colorRed", "colorGreen", "colorBlue"} <= set(header.point_fields) for header in headers)
            for scan in range(len(headers)):
                data = file.read_scan(scan, colors=coloured, ignore_missing_fields=True)
                xyz.append(np.column_stack([data[f"cartesian{axis}"] for axis in "XYZ"]).astype(np.float64))
                if coloured:
                    colours.append(np.column_stack([data[f"color{name}"] for name in ("Red", "Green", "Blue")]))
    except (libe57.E57Exception, RuntimeError, KeyError, TypeError, MemoryError) as error:
        raise ValueError(f"no sound E57 ({str(error).splitlines()[0][:120]})") from error
    if not xyz:
        raise ValueError("it has no scan")
    return result_of(path.stem, np.concatenate(xyz), colours=np.concatenate(colours) if colours else None)


def read_text(path: Path) -> Result:
    """Rows of x, y, z, and colours, an intensity or normals as far as the columns show. Raises OSError, ValueError."""
    content = read_bytes(path, _MOST_TEXT)
    if b"\0" in content[:4096]:
        raise ValueError("it is no text")
    lines = content[:100_000].splitlines()
    head = next((number for number, line in enumerate(lines) if _numbers(line) >= 3), None)
    if head is None:
        raise ValueError("it has no line of three numbers")
    first = lines[head]
    separator = next((mark for mark in (";", ",") if len(first.split(mark.encode())) > 2), None)
    if separator == ";" and b"," in first:
        content = content.replace(b",", b".")
    rows = np.loadtxt(io.BytesIO(content), delimiter=separator, skiprows=head, ndmin=2,
                      comments=("#", "//"), max_rows=MOST_POINTS, encoding="latin-1")
    colours, normals = _meaning(rows)
    return result_of(path.stem, rows[:, :3], colours=colours, normals=normals)


def _numbers(line: bytes) -> int:
    """How many numbers a line consists of; 0 where it has anything else."""
    if _NOTES.match(line):
        return 0
    words = re.split(rb"[;\s]+|,(?=\s)|,(?!\d)", line.strip()) if b";" in line else re.split(rb"[,\s]+", line.strip())
    try:
        return len([float(word.replace(b",", b".")) for word in words if word])
    except ValueError:
        return 0


def _meaning(rows: np.ndarray) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Colours (N,3) and normals (N,3) of the columns behind x, y, z: three whole numbers are colours, three that make
    a unit vector normals; a single one before them is an intensity (PTS)."""
    rest = rows[:, 3:]
    if rest.shape[1] in (1, 4, 7):
        rest = rest[:, 1:]
    colours = normals = None
    while rest.shape[1] >= 3:
        three, some = rest[:, :3], rest[:_SOME, :3]
        if normals is None and (np.abs((some**2).sum(axis=1) - 1) < 0.01).mean() > 0.9:
            normals = three
        elif colours is None and (some >= 0).all() and (some == np.rint(some)).all() and some.max() <= 65535:
            colours = three.astype(np.uint16)
        rest = rest[:, 3:]
    return colours, normals
