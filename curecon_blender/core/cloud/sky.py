# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which pixels of a photo show sky: it has no depth, yet beside a roof it takes on the roof's.

No photo says where its sky is, but five things together do: one looks level or upwards there, it is smooth, it is
bright and not warm in colour, the network, which finds nothing to match, is unsure of it, and it mostly goes on beyond
the picture's upper edge, which pale plaster between windows does not. What is left of the sky
beside roofs and between branches, where the depth map is sure by the roof's doing, has the sky's colour.
"""

from __future__ import annotations

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


def sky_mask(picture: np.ndarray, confidence: np.ndarray, K: np.ndarray, cam_from_world: np.ndarray) -> np.ndarray:
    """Sky (H,W) bool of a picture (H,W,3) uint8 RGB with its depth map's confidence (H,W) and camera, whose world has
    Z up."""
    height, width = confidence.shape
    elevation = _elevation(height, width, K, cam_from_world)
    upwards = elevation > LOWEST
    if not upwards.any():
        return upwards
    colours = picture.astype(np.float32)
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).astype(np.float32)
    variation = np.sqrt(np.maximum(cv2.blur(grey * grey, (5, 5)) - cv2.blur(grey, (5, 5)) ** 2, 0))
    cool = upwards & (grey > BRIGHT) & (colours[..., 0] - colours[..., 2] < WARM)
    count, part = cv2.connectedComponents((cool & (variation < SMOOTH)).astype(np.uint8), connectivity=4)
    reaching = set(np.unique(part[_upper_edge(elevation)]))
    clear = np.zeros(count, bool)
    order = np.argsort(part, axis=None, kind="stable")
    ends = np.searchsorted(part.ravel()[order], np.arange(count + 1))
    for number in range(1, count):
        pixels = order[ends[number] : ends[number + 1]]
        if len(pixels) > LEAST_AREA * part.size:
            clear[number] = np.median(confidence.ravel()[pixels]) < (UNSURE if number in reaching else ENCLOSED)
    sky: np.ndarray = clear[part]
    if not sky.any():
        return sky
    # The sky's colour nearby: a mean over the clear sky within reach, where there is any.
    reach = 2 * int(np.ceil(REACH * max(height, width))) + 1
    weight = cv2.blur(sky.astype(np.float32), (reach, reach))
    mean = cv2.blur(colours * sky[..., None], (reach, reach)) / np.maximum(weight, 1e-6)[..., None]
    alike = (np.abs(colours - mean).max(axis=2) < ALIKE) & (weight > 1e-4)
    # A pixel on the outline mixes sky and roof, and the network's features do over a few more.
    return cv2.dilate((sky | (cool & alike)).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0


def _elevation(height: int, width: int, K: np.ndarray, cam_from_world: np.ndarray) -> np.ndarray:
    """Angle (H,W) in degrees of each pixel's ray above the horizon."""
    rows, columns = np.mgrid[:height, :width] + 0.5
    rays = np.stack([(columns - K[0, 2]) / K[0, 0], (rows - K[1, 2]) / K[1, 1], np.ones_like(rows)])
    up = cam_from_world[:, 2]  # the world's Z axis in the camera
    return np.degrees(np.arcsin(np.clip(np.einsum("chw,c->hw", rays, up) / np.linalg.norm(rays, axis=0), -1, 1)))


def _upper_edge(elevation: np.ndarray) -> tuple[slice | int, ...]:
    """Where in (H,W) the edge of the picture lies that looks highest, however the camera was held."""
    edges: list[tuple[slice | int, ...]] = [np.s_[0, :], np.s_[-1, :], np.s_[:, 0], np.s_[:, -1]]
    return max(edges, key=lambda edge: float(elevation[edge].mean()))
