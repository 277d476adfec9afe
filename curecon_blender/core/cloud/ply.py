# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The fused cloud and its file: a binary PLY, written in pieces, read whole with numpy alone (Blender reads it too)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from ..base.errors import WorkspaceError
from ..base.language import Text
from ..base.ply import RowWriter, column, read_header, read_ply, row_type, table
from ..base.reading import FARTHEST, left_bytes

_POINT = row_type([
    ("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("nx", "<f4"), ("ny", "<f4"), ("nz", "<f4"),
    ("red", "u1"), ("green", "u1"), ("blue", "u1"), ("confidence", "<f4"), ("views", "u1"),
    ("sigma_x", "<f4"), ("sigma_y", "<f4"), ("sigma_z", "<f4"),
])
_REMEDY = "Export it as a binary little-endian PLY, or run Reconstruct again."


@dataclass(frozen=True)
class Cloud:
    """A fused cloud in the component's world frame.

    `points` (N,3) float32; `colours` (N,3) uint8 sRGB; `normals` (N,3) float32 unit; `confidence` (N,) float32 in
    [0, 1]; `views` (N,) uint8, the number of views that confirm a point (its own included); `sigmas` (N,3) float32, the
    standard deviation of a point's place within the site along x, y, z, 0 where unknown (left out: all of it).
    """

    points: np.ndarray
    colours: np.ndarray
    normals: np.ndarray
    confidence: np.ndarray
    views: np.ndarray
    sigmas: np.ndarray = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        if self.sigmas is None:
            object.__setattr__(self, "sigmas", np.zeros((len(self.points), 3), np.float32))

    def __len__(self) -> int:
        return len(self.points)

    def take(self, which: np.ndarray) -> Cloud:
        """The points that `which` names, by number (n,) or as (N,) bool."""
        return Cloud(**{field.name: getattr(self, field.name)[which] for field in fields(self)})

    def rotated(self, rotation: np.ndarray) -> Cloud:
        """The same points in axes to which `rotation` (3,3) takes the cloud's own."""
        return replace(self, points=(self.points @ rotation.T).astype(np.float32),
                       normals=(self.normals @ rotation.T).astype(np.float32))


def joined(*clouds: Cloud) -> Cloud:
    """One cloud of several."""
    return Cloud(**{field.name: np.concatenate([getattr(cloud, field.name) for cloud in clouds])
                    for field in fields(Cloud)})


class CloudWriter(RowWriter):
    """Streams points into a PLY file that appears under its name only when the `with` block ends well. `shift` is what
    to add to come back to a given model's coordinates."""

    def __init__(self, path: Path, shift: Sequence[float] | None = None) -> None:
        comments = [] if shift is None else ["shift " + " ".join(f"{number:.4f}" for number in shift)]
        super().__init__(path, "vertex", _POINT, ["CU-Recon", *comments])

    def __enter__(self) -> CloudWriter:
        super().__enter__()
        return self

    def write(self, cloud: Cloud) -> None:
        self.write_rows(table(_POINT, {
            "x y z": cloud.points, "nx ny nz": cloud.normals, "red green blue": cloud.colours,
            "confidence": cloud.confidence, "views": cloud.views,
            "sigma_x sigma_y sigma_z": cloud.sigmas,
        }))


def read_cloud(path: Path) -> Cloud:
    """Read a binary little-endian PLY with at least x, y, z; missing colour, normal, confidence, views or sigmas
    become white, zero, 1, 0 and 0. Raises WorkspaceError for a file that is missing, cut short or of another kind."""
    with _cloud_errors(path):
        return _cloud_of(read_ply(path, ["vertex"])[1]["vertex"])


def cloud_blocks(path: Path, size: int) -> Iterator[Cloud]:
    """The points of a file, see `read_cloud`, at most `size` at once. Raises WorkspaceError."""
    with _cloud_errors(path), open(path, "rb") as file:
        count, kind = read_header(file, ["vertex"]).elements["vertex"]
        if count * kind.itemsize > left_bytes(path, file.tell()):
            raise ValueError("it is cut short")
        for start in range(0, count, size):
            yield _cloud_of(np.fromfile(file, kind, min(size, count - start)))


def _cloud_of(rows: np.ndarray) -> Cloud:
    return Cloud(
        points=_values(rows, "x y z", np.float32, None),
        colours=_values(rows, "red green blue", np.uint8, 255),
        normals=_values(rows, "nx ny nz", np.float32, 0),
        confidence=_values(rows, "confidence", np.float32, 1)[:, 0],
        views=_values(rows, "views", np.uint8, 0)[:, 0],
        sigmas=_values(rows, "sigma_x sigma_y sigma_z", np.float32, 0),
    )


def _values(rows: np.ndarray, names: str, kind: type, default: float | None) -> np.ndarray:
    """The values (N,k) of k properties, or the default where one is missing. Raises ValueError where there is none, or
    for values that are no numbers or beyond reach."""
    wanted = names.split()
    if not set(wanted) <= set(rows.dtype.names or ()):
        if default is None:
            raise ValueError(f"it has no {', '.join(wanted)}")
        return np.full((len(rows), len(wanted)), default, kind)
    values = column(rows, names)
    if kind is np.float32 and not (np.abs(values) < FARTHEST).all():  # nor is what is no number
        raise ValueError(f"{wanted[0]} has values that are no numbers, or beyond reach")
    with np.errstate(invalid="ignore"):  # a colour in floating point may be anything
        return values.astype(kind, copy=False)


def point_count(path: Path) -> int:
    """Points that a cloud's file says it holds; 0 where there is no file. Raises WorkspaceError."""
    if not path.is_file():  # not fused yet, or nothing to fuse
        return 0
    with _cloud_errors(path), open(path, "rb") as file:
        return read_header(file, ["vertex"]).elements["vertex"][0]


@contextmanager
def _cloud_errors(path: Path) -> Iterator[None]:
    try:
        yield
    except FileNotFoundError as error:
        raise WorkspaceError(
            Text("{} does not exist.", path), remedy="Run Reconstruct to the end first.", path=path
        ) from error
    except (OSError, ValueError) as error:
        raise WorkspaceError(
            Text("{} is not a point cloud that CU-Recon can read: {}.", path,
                 Text(str(error))), remedy=_REMEDY, path=path
        ) from error

