# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""From a photo with its lens to a pinhole picture of the size that multi-view stereo works at."""

from __future__ import annotations

import cv2
import numpy as np
import pycolmap

from ..base.images import scaled_size

_ROWS = 256  # of the picture at a time: the maps of a whole 8000x6000 photo would take over a gigabyte


def undistort(rgb: np.ndarray, camera: pycolmap.Camera, max_size: int) -> tuple[np.ndarray, np.ndarray]:
    """Undistort and scale down a photo (H,W,3) uint8 of the size that `camera` (any COLMAP model but a panorama) has.

    Returns the picture (H',W',3) uint8, longest side at most `max_size` and never larger than the photo, and its
    K (3,3) float64 in pixels, pixel centres at .5. No pixel is left blank. A pinhole photo that is small enough
    comes back as it is. Raises ValueError when photo and camera differ in size.
    """
    height, width = rgb.shape[:2]
    if (width, height) != (camera.width, camera.height):
        raise ValueError(f"the photo has {width}x{height} pixels, its camera {camera.width}x{camera.height}")
    pinhole = undistorted_camera(camera)
    size = scaled_size(pinhole.width, pinhole.height, min(max_size, max(width, height)))
    scale_x, scale_y = size[0] / pinhole.width, size[1] / pinhole.height
    K = np.diag([scale_x, scale_y, 1.0]) @ pinhole.calibration_matrix()
    if is_pinhole(camera):
        return (rgb if size == (width, height) else cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)), K
    # Sampling a photo much larger than the picture would alias, so the photo is averaged down first.
    shrink = min(1.0, K[0, 0] / _focal_at_centre(camera))
    source = rgb
    if shrink < 1.0:
        source = cv2.resize(rgb, (round(width * shrink), round(height * shrink)), interpolation=cv2.INTER_AREA)
    source_scale = np.array([source.shape[1] / width, source.shape[0] / height])
    picture = np.empty((size[1], size[0], 3), np.uint8)
    for top in range(0, size[1], _ROWS):
        bottom = min(top + _ROWS, size[1])
        y, x = np.mgrid[top:bottom, : size[0]] + 0.5
        rays = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], np.ones_like(x)], axis=-1)
        pixels = camera.img_from_cam(rays.reshape(-1, 3)) * source_scale - 0.5  # OpenCV's pixel centres are at 0
        pixels = pixels.reshape(*x.shape, 2).astype(np.float32)
        picture[top:bottom] = cv2.remap(
            source, pixels[..., 0], pixels[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
    return picture, K


def is_pinhole(camera: pycolmap.Camera) -> bool:
    return camera.model_name in ("PINHOLE", "SIMPLE_PINHOLE")


def undistorted_camera(camera: pycolmap.Camera) -> pycolmap.Camera:
    """The pinhole camera that sees as much of the photo as it can without a blank pixel; a pinhole stays itself."""
    if is_pinhole(camera):
        return camera
    return pycolmap.undistort_camera(pycolmap.UndistortCameraOptions(blank_pixels=0.0), camera)


def _focal_at_centre(camera: pycolmap.Camera) -> float:
    """Pixels of the photo per unit of the image plane at its centre, whatever the model calls its parameters."""
    step = 1e-3
    pixels = camera.img_from_cam(np.array([[0.0, 0.0, 1.0], [step, 0.0, 1.0]]))
    return float(np.linalg.norm(pixels[1] - pixels[0])) / step
