# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which pixels of a photo show sky: it has no depth, yet beside a roof it takes on the roof's.

No photo says where its sky is, but five things together do: one looks level or upwards there, it is smooth, it is
bright and not warm in colour, the network, which finds nothing to match, is unsure of it, and it mostly goes on beyond
the picture's upper edge, which pale plaster between windows does not. What is left of the sky
beside roofs and between branches, where the depth map is sure by the roof's doing, has the sky's colour.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

LOWEST = -3.0  # degrees above the horizon from which sky can begin
SMOOTH = 4.0  # of 255: how much brightness varies within a few pixels of clear or clouded sky
BRIGHT = 110  # of 255
WARM = 12  # of 255: by how much red may exceed blue
UNSURE = 0.5  # median confidence above which a smooth bright part is taken to be a wall
ENCLOSED = 0.25  # the same for a part that does not reach the picture's upper edge
LEAST_AREA = 0.002  # of the photo
REACH = 0.02  # of the photo's longest side: how far from clear sky its colour is looked for
ALIKE = 22.0  # of 255: the largest difference of a channel from the sky's colour nearby
STRIP_BYTES = 256 << 20  # of memory for the rows worked on at once
_BYTES_PER_STRIP_PIXEL = 60


def sky_mask(picture: np.ndarray, confidence: np.ndarray, K: np.ndarray, cam_from_world: np.ndarray) -> np.ndarray:
    """Sky (H,W) bool of a picture (H,W,3) uint8 RGB with its depth map's confidence (H,W) and camera, whose world has
    Z up. Takes some 12 bytes of memory a pixel and STRIP_BYTES."""
    height, width = confidence.shape
    cool, smooth = _candidates(picture, K, cam_from_world)
    clear = _clear(cool & smooth, confidence, _upper_edge(height, width, K, cam_from_world))
    if not clear.any():
        return clear
    # A pixel on the outline mixes sky and roof, and the network's features do over a few more.
    return cv2.dilate((clear | (cool & _alike(picture, clear))).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0


def _candidates(picture: np.ndarray, K: np.ndarray, cam_from_world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where (H,W) bool a picture looks level or upwards at what is bright and not warm, and where there it is
    smooth."""
    height, width = picture.shape[:2]
    cool, smooth = np.zeros((2, height, width), bool)
    for rows, inner, outer in _strips(height, width, 2):
        row, column = np.arange(height)[rows, None], np.arange(width)
        upwards = _sine(row, column, K, cam_from_world) > np.sin(np.radians(LOWEST))
        if not upwards.any():
            continue
        grey = cv2.cvtColor(picture[outer], cv2.COLOR_RGB2GRAY).astype(np.float32)
        variation = np.sqrt(np.maximum(cv2.blur(grey * grey, (5, 5)) - cv2.blur(grey, (5, 5)) ** 2, 0))
        warmth = picture[rows, :, 0].astype(np.int16) - picture[rows, :, 2]
        cool[rows] = upwards & (grey[inner] > BRIGHT) & (warmth < WARM)
        smooth[rows] = variation[inner] < SMOOTH
    return cool, smooth


def _clear(likely: np.ndarray, confidence: np.ndarray, upper_edge: tuple[slice | int, ...]) -> np.ndarray:
    """The connected parts (H,W) bool of `likely` that are large enough, and unsure enough, to be sky."""
    _, part, facts, _ = cv2.connectedComponentsWithStats(likely.astype(np.uint8), connectivity=4)
    clear = np.zeros(likely.shape, bool)
    reaching = set(np.unique(part[upper_edge]))
    large = np.flatnonzero(facts[:, cv2.CC_STAT_AREA] > LEAST_AREA * part.size)
    for number in large[large > 0]:  # 0 is all that is not likely
        left, top, width, height = facts[number, :4]
        box = np.s_[top : top + height, left : left + width]
        here = part[box] == number
        if np.median(confidence[box][here].astype(np.float32)) < (UNSURE if number in reaching else ENCLOSED):
            clear[box] |= here
    return clear


def _alike(picture: np.ndarray, clear: np.ndarray) -> np.ndarray:
    """Where (H,W) bool a picture has the colour of the clear sky nearby: its mean there within reach, if there is
    any."""
    height, width = clear.shape
    reach = int(np.ceil(REACH * max(height, width)))
    side = (2 * reach + 1, 2 * reach + 1)
    alike = np.zeros_like(clear)
    for rows, inner, outer in _strips(height, width, reach):
        sky = clear[outer].astype(np.uint8)
        if not sky.any():
            continue
        weight = cv2.boxFilter(sky, cv2.CV_32F, side)[inner]
        mean = cv2.boxFilter(picture[outer] * sky[..., None], cv2.CV_32F, side)[inner]
        mean /= np.maximum(weight, 1e-6)[..., None]
        alike[rows] = (np.abs(picture[rows] - mean).max(axis=2) < ALIKE) & (weight > 1e-4)
    return alike


def _strips(height: int, width: int, margin: int) -> Iterator[tuple[slice, slice, slice]]:
    """A picture cut into strips of rows: each with its rows, where these are among those with a margin, and those."""
    most = max(1, STRIP_BYTES // (_BYTES_PER_STRIP_PIXEL * width) - 2 * margin, margin)
    for top in range(0, height, most):
        bottom = min(top + most, height)
        outer = slice(max(top - margin, 0), min(bottom + margin, height))
        yield slice(top, bottom), slice(top - outer.start, bottom - outer.start), outer


def _sine(row: np.ndarray, column: np.ndarray, K: np.ndarray, cam_from_world: np.ndarray) -> np.ndarray:
    """Sine of the angle above the horizon of the rays through pixels."""
    x, y = (column + 0.5 - K[0, 2]) / K[0, 0], (row + 0.5 - K[1, 2]) / K[1, 1]
    up = cam_from_world[:, 2]  # the world's Z axis in the camera
    sine: np.ndarray = (up[0] * x + up[1] * y + up[2]) / np.sqrt(x * x + y * y + 1)
    return sine


def _upper_edge(height: int, width: int, K: np.ndarray, cam_from_world: np.ndarray) -> tuple[slice | int, ...]:
    """Where in (H,W) the edge of the picture lies that looks highest, however the camera was held."""
    edges: list[tuple[slice | int, ...]] = [np.s_[0, :], np.s_[-1, :], np.s_[:, 0], np.s_[:, -1]]

    def elevation(edge: tuple[slice | int, ...]) -> float:
        row, column = np.broadcast_arrays(np.arange(height)[edge[0]], np.arange(width)[edge[1]])
        return float(np.arcsin(np.clip(_sine(row, column, K, cam_from_world), -1, 1)).mean())

    return max(edges, key=elevation)
