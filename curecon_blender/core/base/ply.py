# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Binary little-endian PLY, written and read with numpy alone: elements of rows behind a header that describes them.

A row's type is a structured dtype whose field names are the properties'; a field of several values is a list of that
fixed length, with its length in one byte before it. `table` makes such rows.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

import numpy as np

from .files import atomic_write
from .reading import left_bytes

Field = tuple[str, str] | tuple[str, str, int]  # a property and its dtype; of a list, its length too

_TYPES = {"<f4": "float", "<f8": "double", "|u1": "uchar", "|i1": "char", "<i2": "short", "<u2": "ushort",
          "<i4": "int", "<u4": "uint"}
_DTYPES = {name: dtype for dtype, name in _TYPES.items()} | {
    "float32": "<f4", "float64": "<f8", "uint8": "|u1", "int8": "|i1", "int16": "<i2", "uint16": "<u2",
    "int32": "<i4", "uint32": "<u4",
}
_SYNONYMS = {"vertex_index": "vertex_indices"}  # both are common
_LENGTH = " length"  # no property's name holds a space, so no other field ends so
_COUNT_DIGITS = 12  # room kept in a header for a number of rows that is known only at the end
_LONGEST_LINE, _MOST_LINES = 1000, 1000  # of a header


@dataclass(frozen=True)
class Header:
    """What a file says of itself: its comments, and (rows, type of a row) of the elements that were asked for."""

    comments: tuple[str, ...]
    elements: dict[str, tuple[int, np.dtype]]


def row_type(fields: Sequence[Field]) -> np.dtype:
    """The type of a row in a file."""
    stored: list[Field] = []
    for field in fields:
        stored += [field] if len(field) == 2 else [(field[0] + _LENGTH, "u1"), field]
    return np.dtype(stored)


def table(kind: np.dtype, columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """Rows (N,) of `kind`. `columns` gives values (N,) or, for a list of length k, (N,k) by the property's name, and
    (N,k) by k properties' names with spaces between them."""
    rows = np.empty(len(next(iter(columns.values()))), kind)
    for names, values in columns.items():
        if " " in names:
            for column, name in enumerate(names.split()):
                rows[name] = values[:, column]
        else:
            rows[names] = values
    for name in kind.names or ():
        if name.endswith(_LENGTH):
            rows[name] = kind[name.removesuffix(_LENGTH)].shape[0]
    return rows


def column(rows: np.ndarray, names: str) -> np.ndarray:
    """The values (N,k) of k properties, whose names have spaces between them."""
    return np.stack([rows[name] for name in names.split()], axis=1)


def write_ply(path: Path, elements: Mapping[str, np.ndarray], comments: Sequence[str] = ()) -> None:
    """Write elements, rows by `table` each; the file appears under its name only when it is whole. Raises
    WorkspaceError."""
    with atomic_write(path) as file:
        file.write(_header({name: (str(len(rows)), rows.dtype) for name, rows in elements.items()}, comments))
        for rows in elements.values():
            file.write(rows.tobytes())


class RowWriter:
    """Streams rows of one element into a file that appears under its name only when the `with` block ends well.
    Raises WorkspaceError."""

    def __init__(self, path: Path, element: str, kind: np.dtype, comments: Sequence[str] = ()) -> None:
        self._path, self._element, self._kind, self._comments = path, element, kind, comments
        self._stack = ExitStack()
        self.count = 0

    def __enter__(self) -> RowWriter:
        self._file = self._stack.enter_context(atomic_write(self._path))
        self._write_header()
        return self

    def write_rows(self, rows: np.ndarray) -> None:
        self._file.write(rows.tobytes())
        self.count += len(rows)

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._stack:
            if value is not None:
                raise value
            self._file.seek(0)
            self._write_header()

    def _write_header(self) -> None:
        count = f"{self.count:<{_COUNT_DIGITS}d}"
        self._file.write(_header({self._element: (count, self._kind)}, self._comments))


def _header(elements: Mapping[str, tuple[str, np.dtype]], comments: Sequence[str]) -> bytes:
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {comment}" for comment in comments)]
    for element, (count, kind) in elements.items():
        lines.append(f"element {element} {count}")
        for name in kind.names or ():
            if name + _LENGTH in (kind.names or ()):
                lines.append(f"property list uchar {_TYPES[kind[name].base.str]} {name}")
            elif not name.endswith(_LENGTH):
                lines.append(f"property {_TYPES[kind[name].str]} {name}")
    return ("\n".join([*lines, "end_header"]) + "\n").encode("ascii")


def read_ply(
    path: Path, wanted: Sequence[str], lists: Mapping[str, int] | None = None
) -> tuple[Header, dict[str, np.ndarray]]:
    """The header, and the rows of the elements `wanted`, which must be the file's first ones, in that order.

    `lists` gives the length of each list that may be met. Nothing is read before the file is known to be long enough.
    Raises OSError for a file that cannot be opened, ValueError for one of another kind, or cut short.
    """
    lists = lists or {}
    with open(path, "rb") as file:
        header = read_header(file, wanted, lists)
        left = left_bytes(path, file.tell())
        if sum(count * kind.itemsize for count, kind in header.elements.values()) > left:
            raise ValueError("it is cut short")
        rows = {name: np.fromfile(file, kind, count) for name, (count, kind) in header.elements.items()}
    for name, (_, kind) in header.elements.items():
        for field in kind.names or ():
            if field.endswith(_LENGTH) and (rows[name][field] != lists[field.removesuffix(_LENGTH)]).any():
                raise ValueError(f"its {field.removesuffix(_LENGTH)} have another length than "
                                 f"{lists[field.removesuffix(_LENGTH)]}")
    return header, rows


def read_header(file: BinaryIO, wanted: Sequence[str], lists: Mapping[str, int] | None = None) -> Header:
    """A file's header, see `read_ply`; the file then stands at its first row. Raises ValueError."""
    if file.readline(_LONGEST_LINE).strip() != b"ply":
        raise ValueError("it does not begin as PLY")
    comments: list[str] = []
    counts: list[int] = []  # of the elements met, as far as they are wanted
    fields: list[list[Field]] = []
    known = True  # whether the properties that come are of a wanted element
    for _ in range(_MOST_LINES):
        line = file.readline(_LONGEST_LINE).decode("ascii", "replace").strip()
        match line.split():
            case ["end_header"]:
                break
            case ["comment", *_]:
                comments.append(line.removeprefix("comment").strip())
            case ["format", kind, *_] if kind != "binary_little_endian":
                raise ValueError(f"its format is {kind}")
            case ["element", name, digits] if len(counts) < len(wanted) and name == wanted[len(counts)]:
                if not re.fullmatch(r"\d{1,12}", digits, re.ASCII):
                    raise ValueError(f"it has {digits[:40]} as a number of rows")
                counts.append(int(digits))
                fields.append([])
            case ["element", name, *_]:
                if len(counts) < len(wanted) or name in wanted:
                    raise ValueError(f"its element {name} is out of place")
                known = False
            case ["property", *words] if known:
                if not fields:
                    raise ValueError("a property stands before all elements")
                fields[-1] += _fields(words, lists or {})
    else:
        raise ValueError("its header has no end")
    if len(counts) < len(wanted):
        raise ValueError(f"it has no element {wanted[len(counts)]}")
    if not all(fields):
        raise ValueError("an element has no properties")
    try:
        kinds = [np.dtype(row) for row in fields]
    except ValueError as error:  # one name twice
        raise ValueError("a property is there twice") from error
    return Header(tuple(comments), dict(zip(wanted, zip(counts, kinds, strict=True), strict=True)))


def _fields(words: list[str], lists: Mapping[str, int]) -> list[Field]:
    """The fields of one property, from the words behind "property". Raises ValueError for a type or list unknown."""
    match words:
        case [kind, name] if kind in _DTYPES:
            return [(name, _DTYPES[kind])]
        case ["list", length, kind, name] if length in _DTYPES and kind in _DTYPES:
            name = _SYNONYMS.get(name, name)
            if name in lists:
                return [(name + _LENGTH, _DTYPES[length]), (name, _DTYPES[kind], lists[name])]
    raise ValueError(f"it has a property {' '.join(words)[:80]}")
