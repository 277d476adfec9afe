# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Normals of the surface in a depth map."""

from __future__ import annotations

import numpy as np

RADIUS = 2  # pixels: the neighbours that a normal is made of
_SAME_SURFACE = 0.02  # relative depth difference up to which a neighbouring pixel counts


def normals(depth: np.ndarray, top: int, K: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Unit normals (3,n) in the camera frame, facing the camera, at flat pixels `index` of a picture.

    `depth` (h,W), NaN = none, are the picture's rows from `top` on: those of the pixels, and RADIUS more on either
    side where the picture has them. The plane n X = 1 has inverse depth n K^-1 (u, v, 1): its slopes over u and v are
    those of inverse depth.
    """
    width = depth.shape[1]
    inverse = np.pad(1 / depth, RADIUS, constant_values=np.nan)
    here = index - top * width
    slopes = _slopes(inverse).reshape(2, -1)[:, here].astype(np.float64)
    row, column = np.divmod(index, width)
    constant = 1 / depth.ravel()[here] - slopes[0] * (column + 0.5) - slopes[1] * (row + 0.5)
    toward = -(K.T @ np.stack([*slopes, constant]))  # n X = 1 > 0 on the ray, so its negative faces the camera
    unit: np.ndarray = toward / np.linalg.norm(toward, axis=0)
    return unit


def _slopes(inverse: np.ndarray) -> np.ndarray:
    """Slopes (2,H,W) over u and v of inverse depth (H,W and a rim of the radius; NaN = none), by least squares over
    the neighbours on the same surface. A pixel with too few of them is taken to face the image plane."""
    height, width = inverse.shape[0] - 2 * RADIUS, inverse.shape[1] - 2 * RADIUS
    centre = inverse[RADIUS:-RADIUS, RADIUS:-RADIUS]
    limit = _SAME_SURFACE * centre
    uu, uv, vv, uq, vq = np.zeros((5, height, width), np.float32)
    for dv in range(-RADIUS, RADIUS + 1):
        for du in range(-RADIUS, RADIUS + 1):
            step = inverse[RADIUS + dv : RADIUS + dv + height, RADIUS + du : RADIUS + du + width] - centre
            near = np.abs(step) < limit
            step[~near] = 0
            uu += du * du * near
            uv += du * dv * near
            vv += dv * dv * near
            uq += du * step
            vq += dv * step
    determinant = uu * vv - uv * uv
    determinant[determinant == 0] = np.inf
    return np.stack([uq * vv - vq * uv, vq * uu - uq * uv]) / determinant
