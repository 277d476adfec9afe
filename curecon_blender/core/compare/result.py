# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A result of any program, as points or as a mesh, in its own coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..base.errors import CuReconError

MOST_POINTS = 200_000_000  # of one result: some ten gigabytes while it is compared
FARTHEST = 1e9  # metres from the origin of any coordinates on Earth, with room to spare
_WHOLE = 1000.0  # an offset's multiple, so that it reads well


class CompareError(CuReconError):
    """Results that cannot be read, laid on one another, or compared."""

    exit_code = 16
    kind = "compare"


@dataclass(frozen=True, kw_only=True)
class Result:
    """Points, or the vertices of a mesh: `places` (N,3) float32 about `offset` (3,) float64, in the file's own axes;
    `colours` (N,3) uint8 sRGB, `normals` (N,3) float32 unit, `faces` (M,3) int32, each None where the file has none.
    `remarks` tell what was left out."""

    name: str
    places: np.ndarray
    offset: np.ndarray
    colours: np.ndarray | None = None
    normals: np.ndarray | None = None
    faces: np.ndarray | None = None
    remarks: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.places)

    def take(self, which: np.ndarray) -> Result:
        """The points that `which` names, by number or as (N,) bool, without faces."""
        return replace(self, places=self.places[which], faces=None,
                       colours=None if self.colours is None else self.colours[which],
                       normals=None if self.normals is None else self.normals[which])

    def about(self, offset: np.ndarray) -> np.ndarray:
        """Places (N,3) float64 about another offset."""
        moved: np.ndarray = self.places.astype(np.float64) + (self.offset - offset)
        return moved


def result_of(
    name: str, xyz: np.ndarray, *, colours: np.ndarray | None = None, normals: np.ndarray | None = None,
    faces: np.ndarray | None = None, remarks: Sequence[str] = (),
) -> Result:
    """Of coordinates (N,3) in float64; colours may be of 8 bits, 16 bits or from 0 to 1. What is not finite or beyond
    reach is left out, and told. Raises ValueError where nothing is left."""
    told = list(remarks)
    sound = (np.abs(xyz) < FARTHEST).all(axis=1)  # nor is what is no number
    if not sound.any():
        raise ValueError("it has no point with finite coordinates")
    if not sound.all():
        told.append(f"{int((~sound).sum()):,} points without finite coordinates were left out.")
        if faces is not None:
            number = np.cumsum(sound) - 1
            faces = number[faces[sound[faces].all(axis=1)]]
        xyz = xyz[sound]
        colours = None if colours is None else colours[sound]
        normals = None if normals is None else normals[sound]
    middle = np.median(xyz[:: max(len(xyz) // 100_000, 1)], axis=0)
    offset = np.where(np.abs(middle) < _WHOLE, 0.0, np.round(middle / _WHOLE) * _WHOLE)
    return Result(
        name=name, places=(xyz - offset).astype(np.float32), offset=offset, remarks=tuple(told),
        colours=None if colours is None else eight_bits(colours),
        normals=None if normals is None else _unit(normals), faces=None if faces is None else faces.astype(np.int32),
    )


def eight_bits(colours: np.ndarray) -> np.ndarray:
    """Colours (N,3) as uint8: of 16 bits where a value needs them, from 0 to 1 where they are fractions."""
    if colours.dtype == np.uint8:
        return colours
    if colours.dtype.kind == "f":
        whole = np.nan_to_num(colours)
        return np.clip(np.rint(whole * (255 if whole.max(initial=0) <= 1 else 1)), 0, 255).astype(np.uint8)
    made: np.ndarray = (colours >> 8 if colours.max(initial=0) > 255 else colours).astype(np.uint8)
    return made


def _unit(normals: np.ndarray) -> np.ndarray | None:
    """None where most are no directions, as when a file has the columns and nothing in them."""
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        unit: np.ndarray = np.where(length > 0, normals / length, 0).astype(np.float32)
    return np.nan_to_num(unit) if (length > 0).mean() > 0.5 else None


def triangles(corners: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Fans (M,3) of polygons, whose corners follow one another in `corners` and are as many as `lengths` says."""
    first = np.repeat(np.cumsum(lengths) - lengths, np.maximum(lengths - 2, 0))
    count = np.maximum(lengths - 2, 0)
    within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    fans: np.ndarray = np.stack([corners[first], corners[first + within + 1], corners[first + within + 2]], axis=1)
    return fans
