# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The few records that stages hand to each other. Arrays are numpy; frames and units are in each field's comment."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np


@dataclass(frozen=True, kw_only=True)
class GeoPosition:
    """A geodetic position on WGS84: degrees, degrees, metres."""

    latitude: float
    longitude: float
    altitude: float


@dataclass(frozen=True, kw_only=True)
class Gimbal:
    """The camera's attitude as DJI's XMP has it, in degrees: yaw clockwise from north, pitch -90 at the nadir."""

    yaw: float
    pitch: float
    roll: float


@dataclass(frozen=True, kw_only=True)
class Photo:
    """One usable photo and what its metadata says.

    `name` is unique in the job, safe in every file format (no newline, control character or leading dot) and keeps
    its extension; it names the photo in the sparse model and in `depth/NAME.npz`. Sizes are in pixels, after the
    EXIF orientation has been applied.
    """

    name: str
    path: Path
    width: int
    height: int
    camera: str  # photos with the same string share one set of intrinsics
    focal_px: float | None  # focal length in pixels of this photo, where its metadata tells
    gps: GeoPosition | None = None
    gimbal: Gimbal | None = None
    relative_altitude: float | None = None  # metres above take-off
    time: str | None = None  # ISO 8601, camera's local time
    sharpness: float = 0.0  # relative to the job's median photo: below BLURRED it counts as blurred
    blurred: bool = False
    overexposed: bool = False  # too much of it is pure white
    underexposed: bool = False  # too much of it is black


@dataclass(frozen=True, kw_only=True)
class SkippedPhoto:
    """A file that was found and not used, with the reason in words for the user."""

    path: Path
    reason: str


@dataclass(frozen=True, kw_only=True)
class PhotoSet:
    """What the photo check found: usable photos in name order, and the files left out."""

    photos: tuple[Photo, ...]
    skipped: tuple[SkippedPhoto, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Frame:
    """What is known of a component's world frame.

    `scale` is "metres" or "unknown"; `up` says where Z up came from: "gps", "gravity" (inferred from the cameras),
    or "given" (the frame of a model that was brought in). `north` tells whether y is north (ENU).
    """

    scale: str
    up: str
    north: bool = False
    origin: GeoPosition | None = None  # geodetic position of the frame's origin
    gps_residual: float | None = None  # metres, median distance of camera centres from their GPS after alignment
    note: str = ""  # one sentence for the user


@dataclass(frozen=True, kw_only=True)
class View:
    """An undistorted photo with its camera, ready for multi-view stereo.

    `K` (3,3) in pixels of the undistorted image, pixel centres at .5; `cam_from_world` (3,4), x right, y down,
    z forward; `near` and `far` bound the z-depth in world units; `sources` are (name, S_i) by falling matching
    score (Algorithm 1). `overlaps` are all the views that share enough sparse points, for fusion.
    """

    name: str
    image: str  # undistorted picture, path relative to the workspace, posix
    width: int
    height: int
    K: np.ndarray
    cam_from_world: np.ndarray
    near: float
    far: float
    sources: tuple[tuple[str, float], ...]
    overlaps: tuple[str, ...] = ()
    original: str = ""  # the photo's own file, absolute path

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

    index: int
    sparse: str
    cloud: str
    frame: Frame
    views: tuple[View, ...] = field(default_factory=tuple)
