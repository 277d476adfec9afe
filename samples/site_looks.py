# SPDX-License-Identifier: GPL-3.0-or-later
"""Views that no photo of the sample site has, to judge what a person sees of its surface (evaluation.looks).

Twelve at eye level (eight about the building, four in the court), twelve as a drone flies.
"""

from __future__ import annotations

import numpy as np
from PIL import Image
from site_flight import pose
from site_truth import back_project
from tulou_plan import GATE, polar
from tulou_surroundings import terrain

WIDTH, HEIGHT, FOCAL = 480, 360, 330.0
EYE = 1.7  # metres above the ground
BUILDING = 24.5  # metres from the axis: the building and its court, without the plants and houses about it
UNIT = 0.02  # metres
ELSEWHERE = 0xFFFF  # what is neither sky (0) nor the building


def looks() -> np.ndarray:
    """The poses (24, 4, 4), cam_from_world."""
    eyes, targets = [], []
    for step in range(8):
        eyes.append(_standing(GATE + 0.12 + step * np.pi / 4, 33.0))
        targets.append(polar(GATE + 0.12 + step * np.pi / 4, 3.0 * (-1) ** step, 4.2))
    for angle, radius, towards in ((0.5, 8.2, 3.4), (2.9, 8.2, 5.6), (1.3, 13.4, 2.2), (4.3, 13.4, 5.2)):
        eyes.append(_standing(GATE + angle, radius))
        targets.append(polar(GATE + towards, 13.4, 3.6))
    for count, first, radius, height, look in ((4, 0.4, 41.0, 13.0, 5.0), (4, 0.9, 30.0, 30.0, 4.0),
                                               (4, 0.2, 11.0, 21.0, 2.0)):
        for step in range(count):
            eyes.append(polar(GATE + first + step * 2 * np.pi / count, radius, height))
            targets.append(polar(GATE + first + np.pi + step * 2 * np.pi / count, 9.0 if radius < 12 else 0.0, look))
    return np.stack([_aimed(eye, target) for eye, target in zip(eyes, targets, strict=True)])


def _standing(angle: float, radius: float) -> np.ndarray:
    foot = polar(angle, radius, 0.0)
    ground = float(terrain(foot[None, :2])[0]) if radius > BUILDING else 0.0
    return foot + [0, 0, ground + EYE]


def _aimed(eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    x, y, z = target - eye
    return pose(eye, float(np.degrees(np.arctan2(x, y))), float(np.degrees(np.arctan2(z, np.hypot(x, y)))), 0.0)


def packed(depth: np.ndarray, cam_from_world: np.ndarray) -> np.ndarray:
    """A z-depth map (H, W) in metres as uint16 in UNIT: 0 in the sky, ELSEWHERE beyond the building."""
    result = np.where(depth > 0, ELSEWHERE, 0).astype(np.uint16)
    points = back_project(depth, FOCAL, cam_from_world)
    y, x = np.nonzero(depth > 0)
    building = np.hypot(points[:, 0], points[:, 1]) < BUILDING
    result[y[building], x[building]] = np.round(depth[y[building], x[building]] / UNIT)
    return result


def write_picture(source: str, target: str) -> None:
    Image.open(source).convert("RGB").save(target, quality=88, optimize=True)
