# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The few records that stages hand to each other. Arrays are numpy; frames and units are in each field's comment."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Annotated

import numpy as np

from .reading import FARTHEST, FILE_NAME, INSIDE, OneOf, Shape, Within

# What altitudes are counted from. The two lie up to 105 metres apart (the geoid's undulation).
ELLIPSOID, SEA_LEVEL, UNKNOWN = "ellipsoid", "sea level", "unknown"


_SIGMA = Annotated[float, Within(1e-4, 1000)]
_Coordinate = Annotated[float, Within(-FARTHEST, FARTHEST)]


@dataclass(frozen=True, kw_only=True)
class GeoPosition:
    """A geodetic position on WGS84: degrees, degrees, metres above what `altitude_datum` says; without an altitude
    where nothing tells it."""

    latitude: Annotated[float, Within(-90, 90)]
    longitude: Annotated[float, Within(-180, 180)]
    altitude: Annotated[float, Within(-100_000, 100_000)] | None
    altitude_datum: Annotated[str, OneOf(ELLIPSOID, SEA_LEVEL, UNKNOWN)] = UNKNOWN


@dataclass(frozen=True, kw_only=True)
class Gimbal:
    """The camera's attitude as DJI's XMP has it, in degrees: yaw clockwise from north, pitch -90 at the nadir."""

    yaw: Annotated[float, Within(-360, 360)]
    pitch: Annotated[float, Within(-360, 360)]
    roll: Annotated[float, Within(-360, 360)]


@dataclass(frozen=True, kw_only=True)
class Lens:
    """A lens as OpenCV has it, in pixels of its photo, pixel centres at .5: f along x and f times aspect along y."""

    f: Annotated[float, Within(1e-6, FARTHEST)]
    aspect: Annotated[float, Within(0.5, 2)]
    cx: Annotated[float, Within(-FARTHEST, FARTHEST)]
    cy: Annotated[float, Within(-FARTHEST, FARTHEST)]
    k1: Annotated[float, Within(-10, 10)]
    k2: Annotated[float, Within(-10, 10)]
    p1: Annotated[float, Within(-1, 1)]
    p2: Annotated[float, Within(-1, 1)]
    k3: Annotated[float, Within(-10, 10)]


@dataclass(frozen=True, kw_only=True)
class Photo:
    """One usable photo and what its metadata says.

    `name` is unique in the job, safe in every file format (no newline, control character or leading dot) and keeps
    its extension; it names the photo in the sparse model and in `depth/NAME.npz`. Sizes are in pixels, after the
    EXIF orientation has been applied.
    """

    name: Annotated[str, FILE_NAME]
    path: Path
    width: Annotated[int, Within(1, 1_000_000)]
    height: Annotated[int, Within(1, 1_000_000)]
    camera: str  # photos with the same string share one set of intrinsics
    focal_px: Annotated[float, Within(1e-6, FARTHEST)] | None  # in pixels of this photo, where its metadata tells
    focal_sigma: Annotated[float, Within(1e-6, 1)] | None = None  # of it, as a share
    centre_px: tuple[_Coordinate, _Coordinate] | None = None  # the lens's middle, where its maker tells it alone
    lens: Lens | None = None  # the maker's calibration of this very camera
    gps: GeoPosition | None = None
    gps_sigmas: tuple[_SIGMA, _SIGMA] | None = None  # metres, in plan and height, as the receiver states them (RTK)
    gimbal: Gimbal | None = None
    speed: Annotated[float, Within(0, 1000)] | None = None  # metres a second, of the drone
    relative_altitude: Annotated[float, Within(-100_000, 100_000)] | None = None  # metres above take-off
    time: str | None = None  # ISO 8601, camera's local time
    sharpness: Annotated[float, Within(0, FARTHEST)] = 0.0  # relative to the median: below BLURRED it counts as blurred
    blurred: bool = False
    overexposed: bool = False  # too much of it is pure white
    underexposed: bool = False  # too much of it is black
    sky: Annotated[float, Within(0, 1)] = 0.0  # share of it that looks like sky
    digest: str = ""  # of the picture itself: the same in a copy of the file, whatever its name, place and time
    masks: tuple[Path, ...] = ()  # files that say what of it is left out
    mask: str = ""  # a digest of what these and its own alpha leave out; empty where nothing is
    masked: Annotated[float, Within(0, 1)] = 0.0  # share of it that is left out

    @property
    def clock(self) -> datetime | None:
        """When it was taken, by the clock's face; None where that is not known, or where a record was changed."""
        try:
            return datetime.fromisoformat(self.time or "").replace(tzinfo=None)
        except ValueError:
            return None


@dataclass(frozen=True, kw_only=True)
class SkippedPhoto:
    """A file that was found and not used, with the reason in words for the user."""

    path: Path
    reason: str
    kind: str = ""  # what it is, where it is no photo of the job ("thermal picture", "video"...)


@dataclass(frozen=True, kw_only=True)
class PhotoSet:
    """What the photo check found: usable photos in name order, and the files left out."""

    photos: tuple[Photo, ...]
    skipped: tuple[SkippedPhoto, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Frame:
    """What is known of a component's world frame.

    `scale` is "metres" or "unknown"; `up` says where Z up came from: "gps", "gravity" (inferred from the cameras),
    "given" (the frame of a model that was brought in), or "control" (points that were measured). `north` tells whether
    y is north (ENU). `scale_sigma` is the relative standard deviation of a scale that control points gave. `shift` is
    where the frame's origin lies in a given model's coordinates, whose axes are the frame's: what to add to come back
    to them; earth-centred ones are turned as well, to east, north and up of `origin`.
    """

    scale: Annotated[str, OneOf("metres", "unknown")]
    up: Annotated[str, OneOf("gps", "gravity", "given", "measured", "control")]
    north: bool = False
    origin: GeoPosition | None = None  # geodetic position of the frame's origin
    gps_residual: Annotated[float, Within(0, FARTHEST)] | None = None  # metres, median, of cameras from their GPS
    shift: tuple[_Coordinate, _Coordinate, _Coordinate] | None = None
    note: str = ""  # one sentence for the user
    doubt: str = ""  # why heights are doubtful, in one sentence; empty where they are not
    scale_sigma: Annotated[float, Within(0, FARTHEST)] | None = None


_Pixels = Annotated[int, Within(1, 1_000_000)]


@dataclass(frozen=True, kw_only=True)
class View:
    """An undistorted photo with its camera, ready for multi-view stereo.

    `K` (3,3) in pixels of the undistorted image, pixel centres at .5; `cam_from_world` (3,4), x right, y down,
    z forward; `near` and `far` bound the z-depth in world units; `sources` are (name, S_i) by falling matching
    score (Algorithm 1). `overlaps` are all the views that share enough sparse points, for fusion. `points` is how many
    of the site's sparse points lie in the picture (sparse_points.py).
    """

    name: Annotated[str, FILE_NAME]
    image: Annotated[str, INSIDE]  # undistorted picture, path relative to the workspace, posix
    width: Annotated[int, Within(1, 1_000_000)]
    height: Annotated[int, Within(1, 1_000_000)]
    K: Annotated[np.ndarray, Shape(3, 3)]
    cam_from_world: Annotated[np.ndarray, Shape(3, 4)]
    near: Annotated[float, Within(1e-9, FARTHEST)]
    far: Annotated[float, Within(1e-9, FARTHEST)]
    sources: tuple[tuple[str, Annotated[float, Within(0, FARTHEST)]], ...]
    overlaps: tuple[str, ...] = ()
    original: str = ""  # the photo's own file, absolute path; "" where that is not known or not to be looked at
    points: Annotated[int, Within(0, 100_000_000)] = 0
    lens: Lens | None = None  # of the photo itself, where its kind is known
    photo_size: tuple[_Pixels, _Pixels] | None = None
    photo_turn: Annotated[int, Within(1, 8)] = 1  # EXIF's orientation of the photo's file
    mask: Annotated[str, INSIDE] | None = None  # picture of what masks leave of it, as `image` is; None: all

    @property
    def centre(self) -> np.ndarray:
        """Camera centre (3,) in the world frame."""
        rotation, translation = self.cam_from_world[:, :3], self.cam_from_world[:, 3]
        centre: np.ndarray = -rotation.T @ translation
        return centre


@dataclass(frozen=True, kw_only=True)
class Component:
    """One connected part of the reconstruction. Component 0 is the largest.

    `sparse` is its COLMAP model and `cloud` its fused cloud, as paths relative to the workspace, posix.
    """

    index: Annotated[int, Within(0, 100_000)]
    sparse: Annotated[str, INSIDE]
    cloud: Annotated[str, INSIDE]
    frame: Frame
    views: tuple[View, ...] = field(default_factory=tuple)
