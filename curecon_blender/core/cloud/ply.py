# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The coloured cloud as binary PLY: written in pieces, read whole with numpy alone (Blender reads it too)."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

import numpy as np

from ..base import reading
from ..base.errors import WorkspaceError
from ..base.files import disk_errors, partial_path

VERTEX = np.dtype([
    ("x", "<f4"), ("y", "<f4"), ("z", "<f4"),
    ("nx", "<f4"), ("ny", "<f4"), ("nz", "<f4"),
    ("red", "u1"), ("green", "u1"), ("blue", "u1"),
    ("confidence", "<f4"), ("views", "u1"),
])
_PLY_TYPES = {"<f4": "float", "|u1": "uchar"}
_NUMPY_TYPES = {
    "float": "<f4", "float32": "<f4", "double": "<f8", "float64": "<f8", "uchar": "u1", "uint8": "u1", "char": "i1",
    "int8": "i1", "short": "<i2", "int16": "<i2", "ushort": "<u2", "uint16": "<u2", "int": "<i4", "int32": "<i4",
    "uint": "<u4", "uint32": "<u4",
}
_COUNT_DIGITS = 12  # room kept in the header for the number of points, known only at the end
_REMEDY = "Export it as a binary little-endian PLY, or run Reconstruct again."
_LONGEST_LINE, _MOST_LINES = 1000, 1000  # of a header


@dataclass(frozen=True)
class Cloud:
    """A fused cloud in the component's world frame.

    `points` (N,3) float32; `colours` (N,3) uint8 sRGB; `normals` (N,3) float32 unit; `confidence` (N,) float32 in
    [0, 1]; `views` (N,) uint8, the number of views that confirm a point (its own included).
    """

    points: np.ndarray
    colours: np.ndarray
    normals: np.ndarray
    confidence: np.ndarray
    views: np.ndarray

    def __len__(self) -> int:
        return len(self.points)


class CloudWriter:
    """Streams points into a PLY file that appears under its name only when the `with` block ends well."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._partial = partial_path(path)
        self.count = 0

    def __enter__(self) -> CloudWriter:
        with disk_errors(self._path):
            self._file = open(self._partial, "wb")
            self._file.write(_header(0))
        return self

    def write(self, cloud: Cloud) -> None:
        rows = np.empty(len(cloud), VERTEX)
        for names, values in ((("x", "y", "z"), cloud.points), (("nx", "ny", "nz"), cloud.normals),
                              (("red", "green", "blue"), cloud.colours)):
            for column, name in enumerate(names):
                rows[name] = values[:, column]
        rows["confidence"], rows["views"] = cloud.confidence, cloud.views
        with disk_errors(self._path):
            self._file.write(rows.tobytes())
        self.count += len(rows)

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        with disk_errors(self._path):
            try:
                if kind is None:
                    self._file.seek(0)
                    self._file.write(_header(self.count))
                    self._file.flush()
                    os.fsync(self._file.fileno())
                self._file.close()
                if kind is None:
                    os.replace(self._partial, self._path)
            finally:
                self._file.close()
                self._partial.unlink(missing_ok=True)


def read_cloud(path: Path) -> Cloud:
    """Read a binary little-endian PLY with at least x, y, z; missing colour, normal, confidence or views become
    white, zero, 1 and 0. Raises WorkspaceError for a file that is missing, cut short or of another kind."""
    with _cloud_errors(path), open(path, "rb") as file:
        count, dtype = _read_header(file.readline)
        whole = reading.left_bytes(path, file.tell()) // dtype.itemsize
        if count > whole:
            raise WorkspaceError(f"{path} is cut short: {whole} of {count} points.", remedy=_REMEDY, path=path)
        rows = np.fromfile(file, dtype, count)
    names = dtype.names or ()

    def columns(wanted: tuple[str, ...], kind: type, default: float) -> np.ndarray:
        if not set(wanted) <= set(names):
            return np.full((count, len(wanted)), default, kind)
        values = np.stack([rows[name] for name in wanted], axis=1)
        if kind is np.float32 and not (np.abs(values) < reading.FARTHEST).all():  # nor is what is no number
            raise WorkspaceError(f"{path} is damaged: {wanted[0]} has values that are no numbers, or beyond reach.",
                                 remedy=_REMEDY, path=path)
        with np.errstate(invalid="ignore"):  # a colour in floating point may be anything
            return values.astype(kind, copy=False)

    return Cloud(
        points=columns(("x", "y", "z"), np.float32, 0),
        colours=columns(("red", "green", "blue"), np.uint8, 255),
        normals=columns(("nx", "ny", "nz"), np.float32, 0),
        confidence=columns(("confidence",), np.float32, 1)[:, 0],
        views=columns(("views",), np.uint8, 0)[:, 0],
    )


def point_count(path: Path) -> int:
    """Points that a cloud's file says it holds; 0 where there is no file. Raises WorkspaceError."""
    if not path.is_file():  # not fused yet, or nothing to fuse
        return 0
    with _cloud_errors(path), open(path, "rb") as file:
        return _read_header(file.readline)[0]


@contextmanager
def _cloud_errors(path: Path) -> Iterator[None]:
    try:
        yield
    except FileNotFoundError as error:
        raise WorkspaceError(
            f"{path} does not exist.", remedy="Run Reconstruct to the end first.", path=path
        ) from error
    except (OSError, ValueError) as error:
        raise WorkspaceError(
            f"{path} is not a point cloud that CU-Recon can read: {error}.", remedy=_REMEDY, path=path
        ) from error


def _header(count: int) -> bytes:
    lines = ["ply", "format binary_little_endian 1.0", "comment CU-Recon",
             f"element vertex {count:<{_COUNT_DIGITS}d}"]
    lines += [f"property {_PLY_TYPES[VERTEX[name].str]} {name}" for name in VERTEX.names or ()]
    return ("\n".join([*lines, "end_header"]) + "\n").encode("ascii")


def _read_header(readline: Callable[[int], bytes]) -> tuple[int, np.dtype]:
    """The number of points and what each holds. Raises ValueError."""
    if readline(_LONGEST_LINE).strip() != b"ply":
        raise ValueError("it does not begin as PLY")
    count, fields, in_vertex = None, [], False
    for _ in range(_MOST_LINES):
        line = readline(_LONGEST_LINE)
        if line.strip() == b"end_header":
            break
        match line.decode("ascii", "replace").split():
            case ["format", kind, *_] if kind != "binary_little_endian":
                raise ValueError(f"its format is {kind}")
            case ["element", "vertex", digits] if count is None and re.fullmatch(r"\d{1,12}", digits, re.ASCII):
                in_vertex, count = True, int(digits)
            case ["element", name, *_]:
                if count is None or name == "vertex":
                    raise ValueError(f"its element {name} is out of place")
                in_vertex = False
            case ["property", kind, name] if in_vertex and kind in _NUMPY_TYPES:
                fields.append((name, _NUMPY_TYPES[kind]))
            case ["property", *words] if in_vertex:
                raise ValueError(f"its points have a property {' '.join(words)}")
    else:
        raise ValueError("its header has no end")
    names = [name for name, _ in fields]
    if count is None or not {"x", "y", "z"} <= set(names) or len(set(names)) != len(names):
        raise ValueError("it has no x, y, z, or a property twice")
    return count, np.dtype(fields)
