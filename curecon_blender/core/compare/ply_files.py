# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""PLY of any program: text or binary of either byte order, points or meshes, with whatever properties."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..base.reading import left_bytes
from .result import MOST_POINTS, Result, result_of, triangles

_TYPES = {"char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
          "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
          "double": "f8", "float64": "f8"}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_LONGEST_LINE, _MOST_LINES, _MOST_LIST = 10_000, 1000, 1000
_COLOURS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
_NORMALS = (("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z"), ("scalar_Nx", "scalar_Ny", "scalar_Nz"))
_CORNERS = ("vertex_indices", "vertex_index")


@dataclass
class _Element:
    """`fields` are a property's name, type, and the type of its length where it is a list."""

    name: str
    count: int
    fields: list[tuple[str, str, str]] = field(default_factory=list)

    @property
    def plain(self) -> bool:
        return not any(length for _, _, length in self.fields)

    def row(self, order: str) -> np.dtype:
        return np.dtype([(name, order + kind) for name, kind, _ in self.fields])


def read_ply_file(path: Path) -> Result:
    """Raises OSError, ValueError."""
    with open(path, "rb") as file:
        order, elements = _header(file)
        left = left_bytes(path, file.tell())
        vertex, faces = None, None
        tokens = _Tokens(file.read(left)) if not order else None
        for element in elements:
            if element.count > MOST_POINTS:
                raise ValueError(f"it claims {element.count:,} of {element.name}, more than {MOST_POINTS:,}")
            if element.name == "vertex":
                vertex = tokens.table(element) if tokens else _table(file, path, element, order)
            elif element.name == "face" and vertex is not None:
                faces = tokens.faces(element) if tokens else _faces(file, path, element, order)
            elif vertex is not None:
                break  # what follows points and faces is not needed
            elif tokens:
                tokens.table(element)
            else:
                _table(file, path, element, order)
    if vertex is None:
        raise ValueError("it has no points")
    names = vertex.dtype.names or ()
    if not {"x", "y", "z"} <= set(names):
        raise ValueError("its points have no x, y and z")
    if faces is not None and (not len(faces) or faces.min() < 0 or faces.max() >= len(vertex)):
        if len(faces):
            raise ValueError("its faces name points that are not there")
        faces = None
    return result_of(path.stem, _columns(vertex, ("x", "y", "z")), faces=faces, colours=_first(vertex, _COLOURS),
                     normals=_first(vertex, _NORMALS))


def _first(rows: np.ndarray, choices: tuple[tuple[str, str, str], ...]) -> np.ndarray | None:
    for names in choices:
        if set(names) <= set(rows.dtype.names or ()):
            kind = rows.dtype[names[0]]
            return np.stack([rows[name].astype(kind.newbyteorder("=")) for name in names], axis=1)
    return None


def _columns(rows: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
    return np.stack([rows[name].astype(np.float64) for name in names], axis=1)


def _header(file: BinaryIO) -> tuple[str, list[_Element]]:
    if file.readline(_LONGEST_LINE).strip() != b"ply":
        raise ValueError("it does not begin as PLY")
    order: str | None = None
    elements: list[_Element] = []
    for _ in range(_MOST_LINES):
        match file.readline(_LONGEST_LINE).decode("ascii", "replace").split():
            case ["end_header"]:
                break
            case ["format", kind, *_] if kind in _ORDERS:
                order = _ORDERS[kind]
            case ["element", name, digits] if re.fullmatch(r"\d{1,15}", digits, re.ASCII):
                elements.append(_Element(name, int(digits)))
            case ["property", "list", length, kind, name] if elements and {length, kind} <= set(_TYPES):
                elements[-1].fields.append((name, _TYPES[kind], _TYPES[length]))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].fields.append((name, _TYPES[kind], ""))
            case ["comment" | "obj_info", *_] | []:
                pass
            case words:
                raise ValueError(f"its header has the line {' '.join(words)[:80]}")
    else:
        raise ValueError("its header has no end")
    if order is None:
        raise ValueError("its header names no format")
    for element in elements:
        names = [name for name, _, _ in element.fields]
        if not names or len(set(names)) < len(names):
            raise ValueError(f"its element {element.name} has no properties, or one twice")
    return order, elements


def _table(file: BinaryIO, path: Path, element: _Element, order: str) -> np.ndarray:
    if not element.plain:
        raise ValueError(f"its {element.name} has a list of values")
    kind = element.row(order)
    if element.count * kind.itemsize > left_bytes(path, file.tell()):
        raise ValueError(f"it is cut short: it claims {element.count:,} of {element.name}")
    return np.fromfile(file, kind, element.count)


def _faces(file: BinaryIO, path: Path, element: _Element, order: str) -> np.ndarray:
    """Triangles (M,3). Rows whose lists are all as long as the first one's are read at once, others one by one."""
    corners = next((name for name, _, length in element.fields if length and name in _CORNERS), None)
    if corners is None or not element.count:
        return np.empty((0, 3), np.int64)
    start = file.tell()
    left = left_bytes(path, start)
    row = _walk(memoryview(file.read(min(left, 1 << 16))), 0, element, order)[0]
    fields: list[tuple[str, str] | tuple[str, str, int]] = []
    for (name, kind, length), values in zip(element.fields, row, strict=True):
        fields += [(name + " length", order + length), (name, order + kind, len(values))] if length else [
            (name, order + kind)]
    kind_of_row = np.dtype(fields)
    file.seek(start)
    if element.count * kind_of_row.itemsize <= left:
        rows = np.fromfile(file, kind_of_row, element.count)
        if all((rows[name + " length"] == len(values)).all()
               for (name, _, length), values in zip(element.fields, row, strict=True) if length):
            polygons = rows[corners].reshape(len(rows), -1).astype(np.int64)
            return triangles(polygons.ravel(), np.full(len(polygons), polygons.shape[1]))
        file.seek(start)
    return _mixed_faces(memoryview(file.read(left)), element, order, corners)


def _mixed_faces(content: memoryview, element: _Element, order: str, corners: str) -> np.ndarray:
    place = [name for name, _, _ in element.fields].index(corners)
    if element.count > len(content):
        raise ValueError(f"it is cut short: it claims {element.count:,} faces")
    found, at = [], 0
    for _ in range(element.count):
        row, at = _walk(content, at, element, order)
        found.append(row[place])
    lengths = np.array([len(polygon) for polygon in found], np.int64)
    return triangles(np.concatenate(found).astype(np.int64), lengths)


def _walk(content: memoryview, at: int, element: _Element, order: str) -> tuple[list[np.ndarray], int]:
    """The values of each property of the row at a position, and where the next row begins."""
    row = []
    for _, kind, length in element.fields:
        count = 1
        if length:
            count, at = int(_number(content, at, order + length)), at + np.dtype(length).itemsize
        size = count * np.dtype(kind).itemsize
        if not 0 <= count <= _MOST_LIST or at + size > len(content):
            raise ValueError("its faces are cut short, or have lists of no sensible length")
        row.append(np.frombuffer(content, order + kind, count, at))
        at += size
    return row, at


def _number(content: memoryview, at: int, kind: str) -> float:
    if at + np.dtype(kind).itemsize > len(content):
        raise ValueError("it is cut short")
    return float(np.frombuffer(content, kind, 1, at)[0])


class _Tokens:
    """The numbers of a PLY in text, one after another."""

    def __init__(self, content: bytes) -> None:
        if re.search(rb"[^-+.\deEinfaINFA\s]", content):
            raise ValueError("it has values that are no numbers")
        try:
            with warnings.catch_warnings(action="error"):
                self._numbers = np.fromstring(content, sep=" ")
        except DeprecationWarning as error:
            raise ValueError("it has values that are no numbers") from error
        self._at = 0

    def table(self, element: _Element) -> np.ndarray:
        if not element.plain:
            raise ValueError(f"its {element.name} has a list of values")
        flat = self._next(element.count * len(element.fields), element)
        rows = np.empty(element.count, element.row("="))
        for (name, kind, _), column in zip(element.fields, flat.reshape(element.count, -1).T, strict=True):
            rows[name] = column if kind[0] == "f" else np.nan_to_num(column)
        return rows

    def faces(self, element: _Element) -> np.ndarray:
        if element.fields[0][0] not in _CORNERS or not element.fields[0][2]:
            raise ValueError("its faces do not begin with their corners")
        found, lengths = [], []
        for _ in range(element.count):
            for place, (_, _, length) in enumerate(element.fields):
                count = self._next(1, element)[0] if length else 1.0
                if not 0 <= count <= _MOST_LIST:
                    raise ValueError("its faces have lists of no sensible length")
                values = self._next(int(count), element)
                if not place:
                    found.append(values)
                    lengths.append(int(count))
        flat = np.nan_to_num(np.concatenate(found)).astype(np.int64) if found else np.empty(0, np.int64)
        return triangles(flat, np.array(lengths, np.int64))

    def _next(self, count: int, element: _Element) -> np.ndarray:
        if self._at + count > len(self._numbers):
            raise ValueError(f"it is cut short: it claims {element.count:,} of {element.name}")
        self._at += count
        values: np.ndarray = self._numbers[self._at - count : self._at]
        return values
