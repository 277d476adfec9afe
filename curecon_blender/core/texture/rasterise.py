# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which pixels triangles cover, and a depth buffer of them, in compiled loops.

Pixels have their centres at .5, x right and y down. A pixel belongs to a triangle when its centre is inside, edges half
open, so that triangles side by side share none and leave none out. Triangles with a corner that is NaN are left out.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numba import njit

_BLOCK = 1 << 20  # pixels worked on at once: some tens of bytes each, and a good size for the processor's cache
_FAR = 3.0  # barycentric coordinates: farther than that outside of a triangle, its middle stands for it
_compiled: Any = njit(nogil=True, error_model="numpy")  # exact: neighbours must agree on where their edge crosses a row


def scan_convert(
    corners: np.ndarray, width: int, height: int, block: int = _BLOCK
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """The pixels that triangles (M,3,2) cover, in blocks of about `block` pixels.

    Yields (face (n,) int64, pixel (n,) int64, barycentric (n,3) float32): `pixel` is the flat index y * width + x.
    """
    corners = np.ascontiguousarray(corners, np.float64)
    ends = np.cumsum(_pixel_counts(corners, width, height))
    start = 0
    while start < len(corners):
        done = ends[start - 1] if start else 0
        stop = max(int(np.searchsorted(ends, done + block, "right")), start + 1)
        count = int(ends[stop - 1] - done)
        if count:
            face, pixel = np.empty(count, np.int64), np.empty(count, np.int64)
            weights = np.empty((count, 3), np.float32)
            _fill(corners, start, stop, width, height, face, pixel, weights)
            yield face, pixel, weights
        start = stop


def inverse_depth_buffer(corners: np.ndarray, inverse_depth: np.ndarray, width: int, height: int) -> np.ndarray:
    """The nearest surface at each pixel as inverse depth (H,W) float32, 0 where there is none.

    `corners` (M,3,2) pixels and `inverse_depth` (M,3) at them; a face with a corner behind the camera is left out.
    """
    buffer = np.zeros((height, width), np.float32)
    _keep_nearest(np.ascontiguousarray(corners, np.float64), inverse_depth, buffer)
    return buffer


def nearest_faces(
    corners: np.ndarray, nearness: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray]:
    """The face that an orthographic viewer sees at each pixel (H,W) int32, -1 for none, and the pixel's barycentric
    coordinates (H,W,3) float32 on it. `corners` (M,3,2) pixels; `nearness` (M,3) grows towards the viewer."""
    face, weights = np.full((height, width), -1, np.int32), np.zeros((height, width, 3), np.float32)
    _keep_nearest_face(np.ascontiguousarray(corners, np.float64), np.ascontiguousarray(nearness, np.float32), face,
                       weights)
    return face, weights


@_compiled
def _first_centre(position, size):  # type: ignore[no-untyped-def]
    """The first of `size` pixels along an axis whose centre is at `position` or beyond."""
    return int(np.ceil(min(max(position, 0.0), size) - 0.5))


@_compiled
def _rows(triangle, height):  # type: ignore[no-untyped-def]
    """The rows (first, end) whose centres a triangle (3,2) may cover."""
    x0, x1, x2 = triangle[0, 0], triangle[1, 0], triangle[2, 0]
    y0, y1, y2 = triangle[0, 1], triangle[1, 1], triangle[2, 1]
    if not np.isfinite(x0 + x1 + x2 + y0 + y1 + y2):
        return 0, 0
    return _first_centre(min(y0, y1, y2), height), _first_centre(max(y0, y1, y2), height)


@_compiled
def _columns(triangle, row, width):  # type: ignore[no-untyped-def]
    """The columns (first, end) of a row that a triangle covers."""
    centre = row + 0.5
    left, right = np.inf, -np.inf
    for start in range(3):
        end = (start + 1) % 3
        x0, y0, x1, y1 = triangle[start, 0], triangle[start, 1], triangle[end, 0], triangle[end, 1]
        if y0 > y1:  # from the upper to the lower end, so that both triangles at an edge compute the same crossing
            x0, y0, x1, y1 = x1, y1, x0, y0
        if y0 <= centre < y1:
            crossing = x0 + (centre - y0) * ((x1 - x0) / (y1 - y0))
            left, right = min(left, crossing), max(right, crossing)
    return _first_centre(left, width), _first_centre(right, width)


@_compiled
def _slopes(triangle):  # type: ignore[no-untyped-def]
    """How the weights of the second and the third corner change over x and y."""
    ax, ay = triangle[1, 0] - triangle[0, 0], triangle[1, 1] - triangle[0, 1]
    bx, by = triangle[2, 0] - triangle[0, 0], triangle[2, 1] - triangle[0, 1]
    area = ax * by - ay * bx
    if area == 0:
        return 0.0, 0.0, 0.0, 0.0
    return by / area, -bx / area, -ay / area, ax / area


@_compiled
def _weights(triangle, slopes, column, row):  # type: ignore[no-untyped-def]
    """A pixel's barycentric coordinates."""
    dx, dy = column + 0.5 - triangle[0, 0], row + 0.5 - triangle[0, 1]
    second = np.float32(slopes[0] * dx + slopes[1] * dy)
    third = np.float32(slopes[2] * dx + slopes[3] * dy)
    return np.float32(1) - second - third, second, third


@_compiled
def _pixel_counts(corners, width, height):  # type: ignore[no-untyped-def]
    counts = np.zeros(len(corners), np.int64)
    for face in range(len(corners)):
        triangle = corners[face]
        first_row, end_row = _rows(triangle, height)
        for row in range(first_row, end_row):
            first, end = _columns(triangle, row, width)
            counts[face] += max(end - first, 0)
    return counts


@_compiled
def _fill(corners, start, stop, width, height, faces, pixels, weights):  # type: ignore[no-untyped-def]
    at = 0
    for face in range(start, stop):
        triangle = corners[face]
        slopes = _slopes(triangle)
        first_row, end_row = _rows(triangle, height)
        for row in range(first_row, end_row):
            first, end = _columns(triangle, row, width)
            for column in range(first, end):
                faces[at], pixels[at] = face, row * width + column
                weights[at, 0], weights[at, 1], weights[at, 2] = _weights(triangle, slopes, column, row)
                at += 1


@_compiled
def _keep_nearest(corners, inverse_depth, buffer):  # type: ignore[no-untyped-def]
    height, width = buffer.shape
    for face in range(len(corners)):
        triangle = corners[face]
        slopes = _slopes(triangle)
        first_row, end_row = _rows(triangle, height)
        for row in range(first_row, end_row):
            first, end = _columns(triangle, row, width)
            for column in range(first, end):
                a, b, c = _weights(triangle, slopes, column, row)
                value = a * inverse_depth[face, 0] + b * inverse_depth[face, 1] + c * inverse_depth[face, 2]
                buffer[row, column] = max(buffer[row, column], value)


@_compiled
def _keep_nearest_face(corners, nearness, faces, weights):  # type: ignore[no-untyped-def]
    height, width = faces.shape
    nearest = np.full((height, width), -np.inf, np.float32)
    for face in range(len(corners)):
        triangle = corners[face]
        slopes = _slopes(triangle)
        first_row, end_row = _rows(triangle, height)
        for row in range(first_row, end_row):
            first, end = _columns(triangle, row, width)
            for column in range(first, end):
                a, b, c = _weights(triangle, slopes, column, row)
                value = a * nearness[face, 0] + b * nearness[face, 1] + c * nearness[face, 2]
                if value > nearest[row, column]:
                    nearest[row, column], faces[row, column] = value, face
                    weights[row, column, 0], weights[row, column, 1], weights[row, column, 2] = a, b, c


@_compiled
def blend_photo(corners, pages, border, points, weights, K, picture, gain, lens, total):  # type: ignore[no-untyped-def]
    """Add a photo's colours to the texels of triangles: `corners` (M,3,2) on `pages` (M,), whose points in the camera's
    frame are `points` (M,3,3) and the photo's weights there `weights` (M,3). `picture` (H,W,3) uint8 with `K` (3,3) and
    `gain` (3,) and `lens` (2,) of levelling.py; `total` (P,S,S,4) float32, sums of weighted colours and of weights, is
    added to.

    The texel's place in the photo is found by way of the point in space: right also where a large face is seen at an
    angle. Triangles at the `border` (M,) of a chart, and those that cover no texel's centre, also colour the texels
    around them, with so little weight that it only shows where nothing else does: bilinear viewers mix them in.
    """
    size = total.shape[1]
    colour = np.empty(3, np.float32)
    for face in range(len(corners)):
        triangle, page = corners[face], pages[face]
        slopes = _slopes(triangle)
        first_row, end_row = _rows(triangle, size)
        hit = False
        for row in range(first_row, end_row):
            first, end = _columns(triangle, row, size)
            for column in range(first, end):
                a, b, c = _weights(triangle, slopes, column, row)
                _add(points[face], weights[face], a, b, c, np.float32(1), K, picture, gain, lens,
                     total[page, row, column], colour)
                hit = True
        if border[face] or not hit:
            _add_around(triangle, slopes, points[face], weights[face], K, picture, gain, lens, total[page], colour)


@_compiled
def _add_around(  # type: ignore[no-untyped-def]
    triangle, slopes, points, weights, K, picture, gain, lens, total, colour
):
    """Add the photo's colours to the texels within one texel of a triangle, with next to no weight."""
    size = len(total)
    x0, x1, x2 = triangle[0, 0], triangle[1, 0], triangle[2, 0]
    y0, y1, y2 = triangle[0, 1], triangle[1, 1], triangle[2, 1]
    if not np.isfinite(x0 + x1 + x2 + y0 + y1 + y2):
        return
    flat = slopes[0] == 0 and slopes[1] == 0
    for row in range(_first_centre(min(y0, y1, y2) - 1, size), _first_centre(max(y0, y1, y2) + 1, size)):
        for column in range(_first_centre(min(x0, x1, x2) - 1, size), _first_centre(max(x0, x1, x2) + 1, size)):
            a = b = c = np.float32(1 / 3)
            if not flat:
                a, b, c = _weights(triangle, slopes, column, row)
                if abs(a) > _FAR or abs(b) > _FAR or abs(c) > _FAR:  # on the plane of a sliver one soon is far away
                    a = b = c = np.float32(1 / 3)
            least = min(a, b, c)
            _add(points, weights, a, b, c, np.float32(1e-6) / (np.float32(1) + least * least), K, picture, gain,
                 lens, total[row, column], colour)


@_compiled
def _add(points, weights, a, b, c, times, K, picture, gain, lens, total, colour):  # type: ignore[no-untyped-def]
    """Add the photo's colour, times the weight, at one place of a triangle to `total` (4,)."""
    x = a * points[0, 0] + b * points[1, 0] + c * points[2, 0]
    y = a * points[0, 1] + b * points[1, 1] + c * points[2, 1]
    z = a * points[0, 2] + b * points[1, 2] + c * points[2, 2]
    if not z > 1e-6:
        return
    weight = times * max(a * weights[0] + b * weights[1] + c * weights[2], min(weights[0], weights[1], weights[2]))
    _cubic(picture, K[0, 0] * x / z + K[0, 1] * y / z + K[0, 2], K[1, 1] * y / z + K[1, 2], colour)
    off_axis = (x * x + y * y) / (z * z)
    levelled = weight * np.exp(off_axis * (lens[0] + off_axis * lens[1]))
    for channel in range(3):
        total[channel] += levelled * gain[channel] * colour[channel]
    total[3] += weight


@_compiled
def _cubic(picture, u, v, colour):  # type: ignore[no-untyped-def]
    """The colour of a picture (H,W,3) at a place, by Keys's cubic convolution, into `colour` (3,)."""
    height, width = picture.shape[:2]
    left, top = int(np.floor(u - 0.5)), int(np.floor(v - 0.5))
    s, t = np.float32(u - 0.5 - left), np.float32(v - 0.5 - top)
    colour[:] = 0
    for i in range(-1, 3):
        row = min(max(top + i, 0), height - 1)
        vertical = _kernel(t - i)
        for j in range(-1, 3):
            column = min(max(left + j, 0), width - 1)
            weight = vertical * _kernel(s - j)
            for channel in range(3):
                colour[channel] += weight * picture[row, column, channel]


@_compiled
def _kernel(x):  # type: ignore[no-untyped-def]
    x = abs(x)
    if x < 1:
        return np.float32((1.5 * x - 2.5) * x * x + 1)
    if x < 2:
        return np.float32(((-0.5 * x + 2.5) * x - 4) * x + 2)
    return np.float32(0)
