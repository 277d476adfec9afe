# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The part of a texture that a tile's faces use, on a picture of its own: its charts are moved by whole texels, so that
nothing is sampled a second time."""

from __future__ import annotations

import cv2
import numpy as np

from ..base.graphs import connected_components
from ..texture.baking import fill_gaps

_PADDING = 3  # texels about a chart: as many as the texture itself has
_QUALITY = 85  # of WebP: as near to the texture as JPEG of 78, and 12 % smaller; of 90 it would be 28 %
_SIDES = 64  # sides are multiples of it, so that mipmaps divide evenly for long


def cut(
    corner: np.ndarray, index: np.ndarray, page: np.ndarray, pages: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Texture coordinates (N,2), v downwards from 0 to 1, and the picture (H,W,3) uint8 sRGB that they are for.

    `corner` (N,2) are corners in texels from their page's top left, `index` (M,3) the faces' corners among them, `page`
    (M,) the faces' pages and `pages` (P,S,S,3) the whole texture.
    """
    chart = connected_components(index[:, [0, 1, 1, 2]].reshape(-1, 2), len(corner))
    count = int(chart.max()) + 1
    page_of = np.zeros(count, np.int64)
    page_of[chart[index[:, 0]]] = page
    side = pages.shape[1]
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    np.minimum.at(low, chart, corner)
    np.maximum.at(high, chart, corner)
    first = np.clip(np.floor(low).astype(int) - _PADDING, 0, side - 1)
    size = np.clip(np.ceil(high).astype(int) + _PADDING, 1, side) - first
    place, width, height = _shelves(size)
    picture, covered = np.zeros((height, width, 3), np.uint8), np.zeros((height, width), np.uint8)
    for number in np.unique(page):
        used = np.zeros((side, side), np.uint8)
        # In sixteenths of a texel; OpenCV's pixels have their middles at whole numbers.
        triangles = np.rint(corner[index[page == number]] * 16 - 8).astype(np.int32)
        cv2.fillPoly(used, list(triangles), (1,), shift=4)
        used = np.asarray(cv2.dilate(used, np.ones((2 * _PADDING - 1, 2 * _PADDING - 1), np.uint8)))
        for one in np.flatnonzero(page_of == number):
            (x, y), (w, h), (left, top) = first[one], size[one], place[one]
            picture[top : top + h, left : left + w] = pages[number, y : y + h, x : x + w]
            covered[top : top + h, left : left + w] = used[y : y + h, x : x + w]
    return (corner + (place - first)[chart]) / [width, height], fill_gaps(picture, covered)


def _shelves(size: np.ndarray) -> tuple[np.ndarray, int, int]:
    """Places (C,2) for rectangles of `size` (C,2) on shelves below each other, tallest first, and the width and height
    that hold all."""
    area = float((size[:, 0] * size[:, 1]).sum())
    width = _whole(max(np.sqrt(1.1 * area), size[:, 0].max()))
    place = np.zeros_like(size)
    left = top = shelf = 0
    for one in np.argsort(-size[:, 1], kind="stable"):
        w, h = size[one]
        if left + w > width:
            left, top, shelf = 0, top + shelf, 0
        place[one] = left, top
        left, shelf = left + w, max(shelf, h)
    return place, width, _whole(top + shelf)


def _whole(length: float) -> int:
    return int(np.ceil(length / _SIDES) * _SIDES)


def encoded(picture: np.ndarray, share: float = 1.0) -> bytes:
    """The picture (H,W,3) uint8 sRGB as WebP without any metadata, its sides `share` of what they were."""
    if share < 1:
        picture = cv2.resize(picture, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
    data: bytes = cv2.imencode(".webp", picture[..., ::-1], [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])[1].tobytes()
    return data
