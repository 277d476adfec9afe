# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reading records that a stranger may have made: JSON into dataclasses, and arrays, all bounded before they are made.

What a field may hold stands beside it, as a mark in its annotation (`Within`, `Shape`, `OneOf`, FILE_NAME, INSIDE).
The readers raise OSError for a file that cannot be opened, ValueError for whatever else may be wrong with it; their
callers name the file and the remedy.
"""

from __future__ import annotations

import json
import math
import os
import re
import types
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import cache
from pathlib import Path
from tokenize import TokenError
from typing import TYPE_CHECKING, Annotated, Any, Literal, Protocol, Union, get_args, get_origin, get_type_hints

if TYPE_CHECKING:  # messages pass through here, and where numpy is missing the worker has to tell of it
    import numpy as np

MOST_JSON = 64 << 20  # bytes; views.json holds some 3 kB a photo
MOST_TEXT = 10_000  # characters of one value
FARTHEST = 1e9  # world units: squares of what lies nearer stay finite in float32
_EXACT = 1 << 53  # whole numbers that floating point holds exactly
_RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\.|$)", re.IGNORECASE)  # devices, in any folder of Windows


class Mark(Protocol):
    """What a field may hold. `check` raises ValueError."""

    def check(self, value: Any) -> None: ...


@dataclass(frozen=True)
class Within:
    low: float
    high: float

    def check(self, value: float) -> None:
        if not self.low <= value <= self.high:
            raise ValueError(f"{value:g} is not within {self.low:g} and {self.high:g}")


class OneOf:
    def __init__(self, *known: str) -> None:
        self._known = known

    def check(self, value: str) -> None:
        if value not in self._known:
            raise ValueError(f"{value[:40]!r} is none of {', '.join(self._known)}")


class Shape:
    """Of an array of finite numbers."""

    def __init__(self, *shape: int) -> None:
        self._shape = shape

    def check(self, value: np.ndarray) -> None:
        if value.shape != self._shape:
            raise ValueError(f"an array is {value.shape}, not {self._shape}")


class _FileName:
    def check(self, value: str) -> None:
        if not is_file_name(value):
            raise ValueError(f"{value[:80]!r} is no plain file name")


class _Inside:
    def check(self, value: str) -> None:
        if not all(map(is_file_name, value.split("/"))):
            raise ValueError(f"{value[:80]!r} leads out of the workspace")


FILE_NAME = _FileName()  # a plain name, on every system
INSIDE = _Inside()  # a path below the workspace, with forward slashes


def is_file_name(name: str) -> bool:
    """Whether `name` is a file's name and no path, on any system."""
    return (0 < len(name) <= 255 and name.isprintable() and not set(name) & set('/\\:*?"<>|')
            and name.strip(". ") != "" and _RESERVED.match(name) is None)


def read_bytes(path: Path, most: int) -> bytes:
    """A file of at most `most` bytes."""
    if not path.is_file():  # a pipe would never come to its end
        raise FileNotFoundError(f"{path} does not exist")
    with open(path, "rb") as file:
        size = os.fstat(file.fileno()).st_size
        if size > most:
            raise ValueError(f"it is larger than {most >> 20} MiB")
        return file.read(size)  # asks for that much at once


def read_json(path: Path, most: int = MOST_JSON) -> Any:
    """What a JSON file of at most `most` bytes holds; NaN and Infinity, which JSON does not know, are refused."""
    return parse_json(read_bytes(path, most).decode())


def parse_json(text: str) -> Any:
    """`read_json` for a text at hand. Raises ValueError."""
    try:
        return json.loads(text, parse_constant=_no_number)
    except RecursionError as error:
        raise ValueError("its values are nested too deeply") from error
    except MemoryError as error:
        raise ValueError("it holds more than fits into memory") from error


def build(kind: Any, value: Any, name: str = "it") -> Any:
    """A JSON value as a `kind`: a dataclass of such, a tuple, an array, a Path, text, a finite number, a truth value.

    Raises ValueError, naming the field, for another type, a missing or an unknown field, or what a mark forbids.
    """
    try:
        return _build(kind, value)
    except ValueError as error:
        raise ValueError(f"{name}: {error}" if name != "it" else str(error)) from error


def _build(kind: Any, value: Any) -> Any:
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Annotated:
        made = _build(arguments[0], value)
        for mark in arguments[1:]:
            mark.check(made)
        return made
    if origin in (Union, types.UnionType):
        if value is None and type(None) in arguments:
            return None
        return _build(next(argument for argument in arguments if argument is not type(None)), value)
    if origin is Literal:
        if value not in arguments or type(value) is not type(arguments[0]):
            raise ValueError(f"not one of {', '.join(map(str, arguments))}")
        return value
    if origin is tuple:
        if not isinstance(value, list):
            raise ValueError("no list")
        wanted = arguments[:1] * len(value) if arguments[-1] is ... else arguments
        if len(wanted) != len(value):
            raise ValueError(f"{len(value)} values instead of {len(wanted)}")
        return tuple(_build(one, item) for one, item in zip(wanted, value, strict=True))
    if origin is dict or kind is dict:
        if not isinstance(value, dict):
            raise ValueError("no record")
        return value
    if is_dataclass(kind):
        return _record(kind, value)
    if getattr(kind, "__module__", "") == "numpy":
        return _array(value)
    return _plain(kind, value)


def _record(kind: Any, value: Any) -> Any:
    if not isinstance(value, dict):
        raise ValueError("no record")
    hints = _hints(kind)
    if unknown := set(value) - set(hints):
        raise ValueError(f"the unknown field {min(unknown)[:40]!r}")
    needed = (f.name for f in fields(kind) if f.default is MISSING and f.default_factory is MISSING)
    if missing := next((name for name in needed if name not in value), None):
        raise ValueError(f"{missing} is missing")
    return kind(**{name: build(hints[name], item, name) for name, item in value.items()})


@cache
def _hints(kind: Any) -> dict[str, Any]:
    return get_type_hints(kind, include_extras=True)


def _plain(kind: Any, value: Any) -> Any:
    if kind is float and type(value) in (int, float):
        if not abs(value) <= 1e300 or not math.isfinite(value):
            raise ValueError("no finite number")
        return float(value)
    if kind is int and type(value) is int:
        if abs(value) > _EXACT:
            raise ValueError("too large a number")
        return value
    if kind in (str, Path) and type(value) is str:
        if len(value) > MOST_TEXT or "\0" in value:
            raise ValueError("no text of a reasonable length")
        if kind is str and any("\ud800" <= letter <= "\udfff" for letter in value):  # a file's name may be no text
            raise ValueError("letters that are none")
        return kind(value)
    if kind is bool and type(value) is bool:
        return value
    raise ValueError(f"{type(value).__name__} instead of {getattr(kind, '__name__', kind)}")


def _array(value: Any) -> np.ndarray:
    import numpy as np

    rows = value if isinstance(value, list) and value and isinstance(value[0], list) else [value]
    if len(rows) > 16 or not all(isinstance(row, list) and len(row) <= 16 for row in rows):
        raise ValueError("no small array")
    numbers = [[_plain(float, item) for item in row] for row in rows]
    made: np.ndarray = np.array(numbers if rows is value else numbers[0], np.float64)
    return made


# ---- arrays

@dataclass(frozen=True)
class Expected:
    """An array that must have this shape, and a type of this kind ("f" floating point, "u" whole, "U" text)."""

    shape: tuple[int, ...]
    kind: str


def read_arrays(path: Path, expected: Mapping[str, Expected]) -> dict[str, np.ndarray]:
    """The named arrays of an .npz file. Nothing is read before its type and shape are the expected ones, so that a file
    cannot make more be unpacked than its reader asked for; no file can bring objects (pickle)."""
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist")
    try:
        with zipfile.ZipFile(path) as archive:
            return {name: _member(archive, name, wanted) for name, wanted in expected.items()}
    except (zipfile.BadZipFile, zlib.error, EOFError, KeyError, RuntimeError, TokenError, MemoryError) as error:
        raise ValueError(f"no sound archive of arrays ({error})") from error


def _member(archive: zipfile.ZipFile, name: str, expected: Expected) -> np.ndarray:
    import numpy as np

    with archive.open(f"{name}.npy") as file:
        version = np.lib.format.read_magic(file)
        read_header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
        if version not in read_header:
            raise ValueError(f"{name} has a version that NumPy does not write")
        shape, by_column, kind = read_header[version](file)  # of 10 kB at most
        if shape != expected.shape or kind.kind != expected.kind or kind.itemsize > 4 * MOST_TEXT:
            raise ValueError(f"{name} is {kind} {shape}, not {expected.shape}")
        size = math.prod(shape) * kind.itemsize
        content = file.read(size)
    if len(content) != size:
        raise ValueError(f"{name} is cut short")
    flat = np.frombuffer(content, kind)
    return flat.reshape(shape[::-1]).T if by_column else flat.reshape(shape)


def _no_number(name: str) -> float:
    raise ValueError(f"{name} is no number of JSON")


def left_bytes(path: Path, position: int) -> int:
    """Bytes of a file behind a position."""
    return os.path.getsize(path) - position
