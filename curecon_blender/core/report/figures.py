# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the report tells in figures, each traced to a file of the workspace. Lengths are in the part's own units."""

from __future__ import annotations

from dataclasses import dataclass

from ..adjust.record import Dome, LensFound, PhotoResidual, PointResidual
from .observations import TiePoints


@dataclass(frozen=True, kw_only=True)
class Spread:
    """The 5th, 50th and 95th percentile of something."""

    low: float
    median: float
    high: float


@dataclass(frozen=True, kw_only=True)
class Camera:
    """A camera of the part: how it calls itself, its photos' size and number, and their focal length in pixels as
    their metadata have it."""

    name: str
    size: tuple[int, int]
    photos: int
    focal: float | None


@dataclass(frozen=True, kw_only=True)
class Survey:
    """What was flown: `taken`, when the first and the last photo were; `above`, the cameras' median height above the
    ground; `area`, what is covered of the subject, in plan."""

    taken: tuple[str, str] | None
    cameras: tuple[Camera, ...]
    above: float
    area: float
    tied: TiePoints


@dataclass(frozen=True, kw_only=True)
class Clearness:
    """`pixel`: the ground sampling distance of the photos; `texel` of the texture; photos that are blurred."""

    pixel: Spread
    texel: float | None
    blurred: int


@dataclass(frozen=True, kw_only=True)
class Residuals:
    """Of `count` places, RMS east, north and up in metres; and each of them."""

    count: int
    rms: tuple[float, float, float]
    of: tuple[PhotoResidual | PointResidual, ...]


@dataclass(frozen=True, kw_only=True)
class Sigmas:
    """Standard deviations in plan (each axis) and in height: of a point `within` the site, the median; of its `cameras`
    likewise; of the site as a `whole`; None where nothing but the photos says where it stands."""

    within: tuple[float, float]
    cameras: tuple[float, float]
    whole: tuple[float, float] | None


@dataclass(frozen=True, kw_only=True)
class Lens:
    """A lens as adjusted, and what was known of it; `rms` of its residuals in pixels."""

    camera: str
    found: LensFound | None
    rms: float


@dataclass(frozen=True, kw_only=True)
class Correctness:
    """What the lengths rest on, and how well that agrees. Check points took no part in the adjustment; `left_out` are
    control points, each off as the cameras are without it; each kind stands by itself. `scale` is the relative standard
    deviation of all lengths, `extent` the site's largest. `supports` is, for each kind of surface, the largest scale
    (its denominator) of a drawing that the figures carry; None where none does or nothing is known."""

    rests_on: str
    doubt: str
    metres: bool
    north: bool
    adjusted: bool
    reprojection_error: float | None
    lenses: tuple[Lens, ...]
    domes: tuple[Dome, ...]
    focal_sigma: float | None
    shutter_shift: float | None
    gps: Residuals | None
    control: Residuals | None
    check: Residuals | None
    left_out: Residuals | None
    sigmas: Sigmas | None
    scale: float | None
    extent: float
    supports: dict[str, int | None]


@dataclass(frozen=True, kw_only=True)
class Integrity:
    """Photos placed, of all; the share of the site's surface, and of each kind of it, that at least SEEN_WELL photos
    see; and of the mesh's area that no photo measured."""

    placed: int
    photos: int
    seen_well: float
    seen_by_kind: dict[str, float]
    filled: float | None


@dataclass(frozen=True, kw_only=True)
class Authenticity:
    """Shares of the mesh's area that no photo measured, that one alone did, and whose colour none shows; points that
    the user removed; `likeness` of the textured mesh to the photos, PSNR in dB, as it looks from `compared` of them."""

    filled: float | None
    weak: float | None
    unseen: float | None
    removed_points: int
    likeness: Spread | None
    compared: int


@dataclass(frozen=True, kw_only=True)
class Part:
    """One part of the site, largest first. `points` and `faces` say how large it is; all other figures of its surface
    are of what lies within `reach` of its middle, in plan."""

    index: int
    points: int
    faces: int
    reach: float
    survey: Survey
    clearness: Clearness
    correctness: Correctness
    integrity: Integrity
    authenticity: Authenticity
