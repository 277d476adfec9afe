# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""`accuracy.json` beside a component's COLMAP model: what its cameras rest on, and how well they agree with it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from ..base.files import read_record
from ..base.reading import FARTHEST, FILE_NAME, Within

ACCURACY_FILE = "accuracy.json"
_Number = Annotated[float, Within(-FARTHEST, FARTHEST)]
_Nine = tuple[_Number, _Number, _Number, _Number, _Number, _Number, _Number, _Number, _Number]
_METRES = Annotated[float, Within(-FARTHEST, FARTHEST)]


@dataclass(frozen=True, kw_only=True)
class PhotoResidual:
    """How far a photo's camera lies from its GPS: metres east, north and up, 0 up where it tells no altitude."""

    name: Annotated[str, FILE_NAME]
    off: tuple[_METRES, _METRES, _METRES]


@dataclass(frozen=True, kw_only=True)
class PointResidual:
    """How far the marks of a control or check point put it from its coordinates: metres along x, y and z of the frame.
    `pixels` is the RMS distance of its marks from where all of them put it."""

    name: str
    off: tuple[_METRES, _METRES, _METRES]
    marks: Annotated[int, Within(0, 1_000_000)]
    pixels: Annotated[float, Within(0, FARTHEST)]


@dataclass(frozen=True, kw_only=True)
class Dome:
    """By how much the cameras' heights bend from the middle of the flight to its edge against what `source` says,
    metres, up where positive; `sigma` of it, and `limit` up to which the source itself may be off."""

    source: str
    bend: _METRES
    sigma: Annotated[float, Within(0, FARTHEST)]
    limit: Annotated[float, Within(0, FARTHEST)]


@dataclass(frozen=True, kw_only=True)
class LensFound:
    """A camera's lens as adjusted, by bundle.LENS_PARAMETERS: `known` is what was known beforehand, from `source`;
    `sigmas` are what the adjustment leaves open."""

    source: str
    known: _Nine
    values: _Nine
    sigmas: _Nine


@dataclass(frozen=True, kw_only=True)
class Accuracy:
    """What a component's cameras rest on. `adjusted` is false for cameras as the mapper or a given model has them.

    Points stand apart by what they tell: `control` holds the cameras, and shows how well its points agree; `check` took
    no part; `left_out` are control points, each off as the cameras are without it. `checked` tells of which check
    points and marks.
    """

    adjusted: bool
    reprojection_error: Annotated[float, Within(0, FARTHEST)]  # pixels, mean over the observations
    gps: tuple[PhotoResidual, ...] = ()
    lenses: tuple[LensFound, ...] = ()
    focal_sigma: Annotated[float, Within(0, FARTHEST)] | None = None  # of focal lengths, a share: the least sure
    domes: tuple[Dome, ...] = ()
    shutter_shift: Annotated[float, Within(0, FARTHEST)] | None = None  # pixels while a photo is read out, median
    control: tuple[PointResidual, ...] = ()
    check: tuple[PointResidual, ...] = ()
    left_out: tuple[PointResidual, ...] = ()
    checked: str = ""


def rms(found: Sequence[PointResidual]) -> tuple[float, float]:
    """The root-mean-square of what points are off in plan and in height, metres; none are off by nothing."""
    if not found:
        return 0.0, 0.0
    plan = sum(one.off[0] ** 2 + one.off[1] ** 2 for one in found) / len(found)
    return math.sqrt(plan), math.sqrt(sum(one.off[2] ** 2 for one in found) / len(found))


def read_accuracy(folder: Path) -> Accuracy | None:
    """The record in a component's folder; None where there is none, as in a workspace of before. Raises WorkspaceError
    when it is damaged."""
    path = folder / ACCURACY_FILE
    return read_record(Accuracy, path) if path.is_file() else None
