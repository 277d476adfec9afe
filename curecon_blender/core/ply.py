# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The coloured cloud as binary PLY: written in pieces, read whole with numpy alone (Blender reads it too)."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

import numpy as np

from .errors import WorkspaceError
from .files import disk_errors

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
        self._partial = path.with_name(f".{path.name}.partial")
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
    bad = f"{path} is not a point cloud that CU-Recon can read"
    remedy = "Export it as a binary little-endian PLY, or run Reconstruct again."
    try:
        with open(path, "rb") as file:
            count, dtype = _read_header(file.readline, bad, remedy, path)
            rows = np.fromfile(file, dtype, count)
    except FileNotFoundError as error:
        raise WorkspaceError(
            f"{path} does not exist.", remedy="Run Reconstruct to the end first.", path=path
        ) from error
    if len(rows) != count:
        raise WorkspaceError(f"{path} is cut short: {len(rows)} of {count} points.", remedy=remedy, path=path)
    names = dtype.names or ()

    def columns(wanted: tuple[str, ...], kind: type, default: float) -> np.ndarray:
        if not set(wanted) <= set(names):
            return np.full((count, len(wanted)), default, kind)
        return np.stack([rows[name] for name in wanted], axis=1).astype(kind, copy=False)

    return Cloud(
        points=columns(("x", "y", "z"), np.float32, 0),
        colours=columns(("red", "green", "blue"), np.uint8, 255),
        normals=columns(("nx", "ny", "nz"), np.float32, 0),
        confidence=columns(("confidence",), np.float32, 1)[:, 0],
        views=columns(("views",), np.uint8, 0)[:, 0],
    )


def _header(count: int) -> bytes:
    lines = ["ply", "format binary_little_endian 1.0", "comment CU-Recon",
             f"element vertex {count:<{_COUNT_DIGITS}d}"]
    lines += [f"property {_PLY_TYPES[VERTEX[name].str]} {name}" for name in VERTEX.names or ()]
    return ("\n".join([*lines, "end_header"]) + "\n").encode("ascii")


def _read_header(readline, bad: str, remedy: str, path: Path) -> tuple[int, np.dtype]:  # type: ignore[no-untyped-def]
    if readline().strip() != b"ply":
        raise WorkspaceError(f"{bad}: it does not begin as PLY.", remedy=remedy, path=path)
    count, fields, in_vertex = None, [], False
    while (line := readline()).strip() != b"end_header":
        words = line.decode("ascii", "replace").split()
        if not line:
            raise WorkspaceError(f"{bad}: its header has no end.", remedy=remedy, path=path)
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format" and words[1] != "binary_little_endian":
            raise WorkspaceError(f"{bad}: its format is {words[1]}.", remedy=remedy, path=path)
        if words[0] == "element":
            in_vertex = words[1] == "vertex"
            if in_vertex and count is None:
                count = int(words[2])
            elif count is None:
                raise WorkspaceError(f"{bad}: {words[1]} comes before its points.", remedy=remedy, path=path)
        if words[0] == "property" and in_vertex:
            if words[1] not in _NUMPY_TYPES:
                raise WorkspaceError(f"{bad}: property type {words[1]}.", remedy=remedy, path=path)
            fields.append((words[2], _NUMPY_TYPES[words[1]]))
    if count is None or not {"x", "y", "z"} <= {name for name, _ in fields}:
        raise WorkspaceError(f"{bad}: it has no x, y, z.", remedy=remedy, path=path)
    return count, np.dtype(fields)
