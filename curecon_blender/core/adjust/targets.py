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

TARGET_SIGMA = 0.2  # pixels, of a target's centre
SMALLEST = 12.0  # pixels of a target's side; smaller ones are often no targets


def find_targets(
    photos: Iterable[Photo], control: ControlSet, dictionary: str, reporter: Reporter
) -> tuple[tuple[Mark, ...], dict[int, int]]:
    """Marks at the centres of the targets in the photos at their full size, and in how many photos each number was
    seen that is no point's. `dictionary` is one of base/options.py's. Raises PhotoError, Cancelled."""
    names, photos = numbered(control), tuple(photos)
    detector = _detector(dictionary)
    marks: list[Mark] = []
    unknown: Counter[int] = Counter()
    for done, photo in enumerate(photos):
        reporter.progress(done, len(photos))
        for number, (x, y) in targets_in(images.read_rgb(photo.path), detector).items():
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


def targets_in(rgb: np.ndarray, detector: cv2.aruco.ArucoDetector) -> dict[int, tuple[float, float]]:
    """The centres of the targets in a photo (H,W,3) uint8, by their numbers, in its pixels with pixel centres at .5. A
    number that is seen twice in a photo is left out."""
    corners, numbers, _ = detector.detectMarkers(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY))
    found: dict[int, list[tuple[float, float]]] = {}
    for four, number in zip(corners, [] if numbers is None else numbers.ravel(), strict=True):
        four = four.reshape(4, 2).astype(np.float64)
        if np.linalg.norm(four - np.roll(four, 1, axis=0), axis=1).min() >= SMALLEST:
            found.setdefault(int(number), []).append(_crossing(four))
    return {number: places[0] for number, places in found.items() if len(places) == 1}


def _crossing(corners: np.ndarray) -> tuple[float, float]:
    """Where the diagonals of four corners (4,2) cross: the target's centre in every perspective. OpenCV's pixel centres
    are at 0."""
    first, second = corners[2] - corners[0], corners[3] - corners[1]
    start = corners[1] - corners[0]
    along = (start[0] * second[1] - start[1] * second[0]) / (first[0] * second[1] - first[1] * second[0])
    x, y = corners[0] + along * first + 0.5
    return float(x), float(y)


def _detector(dictionary: str) -> cv2.aruco.ArucoDetector:
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    settings.minMarkerPerimeterRate = 0.005  # of the photo's longer side: targets are small in photos from the air
    chosen = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{dictionary}"))
    return cv2.aruco.ArucoDetector(chosen, settings)
