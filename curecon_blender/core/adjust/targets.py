# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Coded targets (ArUco, AprilTag) in the photos, as marks of the points whose names end in their numbers."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable

import cv2
import numpy as np

from ..base import images
from ..base.messages import Reporter
from ..base.records import Photo
from .control import ControlSet, Mark

TARGET_SIGMA = 0.1  # pixels, of a target's centre
SMALLEST = 12.0  # pixels of a target's side; smaller ones are often no targets
CELL = 8  # pixels of a target's cell where it is compared with its pattern
LIKE = 0.7  # correlation with the pattern, below which it is something else


def find_targets(
    photos: Iterable[Photo], control: ControlSet, dictionary: str, reporter: Reporter
) -> tuple[tuple[Mark, ...], dict[int, int]]:
    """Marks at the centres of the targets in the photos at their full size, and in how many photos each number was
    seen that is no point's. `dictionary` is one of base/options.py's. Raises PhotoError, Cancelled."""
    names, photos = numbered(control), tuple(photos)
    kind, detector = _detector(dictionary)
    marks: list[Mark] = []
    unknown: Counter[int] = Counter()
    for done, photo in enumerate(photos):
        reporter.progress(done, len(photos))
        for number, (x, y) in targets_in(images.read_rgb(photo.path), kind, detector).items():
            if number in names:
                marks.append(Mark(point=names[number], photo=photo.name, x=x, y=y, sigma=TARGET_SIGMA))
            else:
                unknown[number] += 1
    reporter.progress(len(photos), len(photos))
    return tuple(marks), dict(unknown)


def numbered(control: ControlSet) -> dict[int, str]:
    """The points' names by the number that they end in; a number that several end in is none's."""
    found: dict[int, list[str]] = {}
    for point in control.points:
        if ends := re.search(r"(\d{1,6})$", point.name):
            found.setdefault(int(ends[1]), []).append(point.name)
    return {number: names[0] for number, names in found.items() if len(names) == 1}


def targets_in(
    rgb: np.ndarray, kind: cv2.aruco.Dictionary, detector: cv2.aruco.ArucoDetector
) -> dict[int, tuple[float, float]]:
    """The centres of the targets in a photo (H,W,3) uint8, by their numbers, in its pixels with pixel centres at .5. A
    number that is seen twice in a photo is left out."""
    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    corners, numbers, _ = detector.detectMarkers(grey)
    found: dict[int, list[tuple[float, float]]] = {}
    for four, number in zip(corners, [] if numbers is None else numbers.ravel(), strict=True):
        four = four.reshape(4, 2).astype(np.float32)
        large = np.linalg.norm(four - np.roll(four, 1, axis=0), axis=1).min() >= SMALLEST
        if large and (centre := _centre(grey, four, kind, int(number))) is not None:
            found.setdefault(int(number), []).append(centre)
    return {number: places[0] for number, places in found.items() if len(places) == 1}


def _centre(
    grey: np.ndarray, corners: np.ndarray, kind: cv2.aruco.Dictionary, number: int
) -> tuple[float, float] | None:
    """A target's centre from all of its picture: its pattern is laid over the photo from its `corners` (4,2) on, and
    moved to where it fits best. None where it fits nowhere well. OpenCV's pixel centres are at 0."""
    cells = kind.markerSize + 2
    marker = cv2.aruco.generateImageMarker(kind, number, cells * CELL)
    pattern = cv2.GaussianBlur(np.pad(marker, CELL, constant_values=255), (0, 0), CELL / 4).astype(np.float32)
    side = len(pattern)
    low, high = CELL - 0.5, side - CELL - 0.5
    photo_from_pattern = cv2.getPerspectiveTransform(
        np.array([[low, low], [high, low], [high, high], [low, high]], np.float32), corners)
    patch = cv2.warpPerspective(grey, photo_from_pattern, (side, side), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    try:
        likeness, moved = cv2.findTransformECC(
            pattern, patch.astype(np.float32), np.eye(3, dtype=np.float32), cv2.MOTION_HOMOGRAPHY,
            (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-5),
            np.ones_like(patch), 3)
    except cv2.error:  # it does not converge
        return None
    if likeness < LIKE:
        return None
    x, y, w = photo_from_pattern @ moved @ np.array([(side - 1) / 2, (side - 1) / 2, 1.0])
    return float(x / w + 0.5), float(y / w + 0.5)


def _detector(dictionary: str) -> tuple[cv2.aruco.Dictionary, cv2.aruco.ArucoDetector]:
    settings = cv2.aruco.DetectorParameters()
    settings.minMarkerPerimeterRate = 0.005  # of the photo's longer side: targets are small in photos from the air
    kind = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{dictionary}"))
    return kind, cv2.aruco.ArucoDetector(kind, settings)
