# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A plane sweep with normalised cross-correlation (NCC), winner takes all: the simplest of the baselines.

128 planes facing the reference, uniform in inverse depth between near and far; NCC of grey values in 7x7 windows; at
each pixel and plane the mean over the better half of the sources, which is what occlusion leaves; the best plane,
refined by a parabola through its neighbours. Confidence is that mean NCC, negative values as 0: fusion's usual
threshold then asks for NCC of at least 0.3.
"""

from __future__ import annotations

import cv2
import numpy as np

from curecon_blender.core.base.records import View

PLANES = 128
WINDOW = 7  # pixels
NOISE = 2.0  # grey levels; windows without more contrast than this correlate with nothing


def sweep(
    view: View, picture: np.ndarray, sources: list[tuple[View, np.ndarray]], planes: int = PLANES
) -> tuple[np.ndarray, np.ndarray]:
    """Depth (H,W) float32, 0 where no source sees the pixel, and confidence (H,W) float32 in [0, 1].

    `picture` (H,W) and those of the sources are grey values, uint8.
    """
    inverse = np.linspace(1 / view.far, 1 / view.near, planes, dtype=np.float32)
    reference = _Window(picture.astype(np.float32))
    moving = [(other, grey.astype(np.float32)) for other, grey in sources]
    best = np.full(picture.shape, -2, np.float32)  # NCC at the best plane, and on both sides of it
    before, after = best.copy(), best.copy()
    index = np.zeros(picture.shape, np.int16)
    previous = best.copy()
    for plane, inverse_depth in enumerate(inverse):
        score = _better_half([_ncc(reference, _warp(view, other, grey, inverse_depth)) for other, grey in moving])
        np.copyto(after, score, where=index == plane - 1)
        better = score > best
        np.copyto(before, previous, where=better)
        np.copyto(best, score, where=better)
        index[better] = plane
        previous = score
    # A parabola needs three scores: at either end of the range, or beside a plane that no source sees, it has none.
    inner = (index > 0) & (index < planes - 1) & (before > -2) & (after > -2)
    curvature = np.where(inner, before - 2 * best + after, -1)
    offset = np.where(inner & (curvature < 0), 0.5 * (before - after) / np.minimum(curvature, -1e-9), 0)
    refined = inverse[0] + (index + np.clip(offset, -0.5, 0.5)) * (inverse[1] - inverse[0])
    depth = np.where(best > -2, 1 / refined, 0).astype(np.float32)
    return depth, np.clip(best, 0, 1)


class _Window:
    """A picture with its mean and variance in the window about each pixel."""

    def __init__(self, picture: np.ndarray) -> None:
        self.picture = picture
        self.mean = _box(picture)
        self.variance = np.maximum(_box(picture * picture) - self.mean * self.mean, 0) + NOISE**2


def _box(picture: np.ndarray) -> np.ndarray:
    return np.asarray(cv2.boxFilter(picture, cv2.CV_32F, (WINDOW, WINDOW)))


def _ncc(reference: _Window, warped: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """NCC (H,W) in [-1, 1], -2 where the source does not see the whole window."""
    picture, hidden = warped
    other = _Window(picture)
    ncc = _box(reference.picture * picture)
    ncc -= reference.mean * other.mean
    other.variance *= reference.variance
    ncc /= cv2.sqrt(other.variance)
    ncc[hidden] = -2
    return ncc


def _warp(view: View, other: View, grey: np.ndarray, inverse_depth: float) -> tuple[np.ndarray, np.ndarray]:
    """The source's picture as the reference would see it on the plane, and where a part of the window lies outside."""
    rotation = other.cam_from_world[:, :3] @ view.cam_from_world[:, :3].T
    translation = other.cam_from_world[:, 3] - rotation @ view.cam_from_world[:, 3]
    plane = rotation + np.outer(translation, [0, 0, inverse_depth])
    # OpenCV counts from pixel centres, cameras from the corner of the picture.
    corner = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    homography = np.linalg.inv(corner) @ other.K @ plane @ np.linalg.inv(view.K) @ corner
    size = (view.width, view.height)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    warped = np.asarray(cv2.warpPerspective(grey, homography, size, flags=flags, borderMode=cv2.BORDER_CONSTANT,
                                            borderValue=(-1e6,)))
    hidden = warped < 0
    warped[hidden] = 0
    if homography[2] @ (view.width / 2, view.height / 2, 1) < 0:  # the plane lies behind the source
        hidden[:] = True
    return warped, cv2.dilate(hidden.view(np.uint8), np.ones((WINDOW, WINDOW), np.uint8)).view(bool)


def _better_half(scores: list[np.ndarray]) -> np.ndarray:
    """Mean (H,W) of the better half, rounded up, of the scores that are there; -2 where none is. Sorts in place."""
    for end in range(len(scores) - 1, 0, -1):  # bubble sort: np.sort over the first axis is many times slower
        for i in range(end):
            scores[i], scores[i + 1] = np.maximum(scores[i], scores[i + 1]), np.minimum(scores[i], scores[i + 1])
    total, count = scores[0].copy(), np.ones(scores[0].shape, np.float32)
    for rank in range(1, (len(scores) + 1) // 2):
        wanted = scores[2 * rank] > -2  # the rank-th counts when more than 2 rank of them are there
        total += np.where(wanted, scores[rank], 0)
        count += wanted
    total /= count
    return total
