# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The textured mesh as a photo's camera sees it, to be held beside the photo."""

from __future__ import annotations

import cv2
import numpy as np

from ..base.records import View
from ..base.sampling import sample
from ..surface.mesh import Mesh
from ..surface.triangles import triangle_areas
from .rasterise import inverse_depth_buffer, scan_convert
from .visibility import in_camera, project


def render(mesh: Mesh, pages: list[np.ndarray], view: View) -> tuple[np.ndarray, np.ndarray]:
    """The textured mesh as `view` sees it: (H,W,3) uint8 sRGB, unlit, and the face at each pixel (H,W) int32, -1 where
    there is none. Texels are averaged where several fall on a pixel."""
    assert mesh.uv is not None and mesh.page is not None
    camera = in_camera(mesh.vertices, view)
    corners = project(camera, view.K)[mesh.faces]
    with np.errstate(divide="ignore"):
        inverse = (1 / camera[:, 2])[mesh.faces]
    nearest = inverse_depth_buffer(corners, inverse, view.width, view.height).ravel()
    shown = np.full(view.height * view.width, -1, np.int32)
    uv = np.zeros((view.height * view.width, 2), np.float32)
    for face, pixel, weights in scan_convert(corners, view.width, view.height):
        share = weights * inverse[face]
        depth = share.sum(axis=1)
        front = depth >= nearest[pixel]
        face, pixel, share, depth = face[front], pixel[front], share[front], depth[front]
        shown[pixel] = face
        uv[pixel] = np.einsum("nk,nkc->nc", share / depth[:, None], mesh.uv[face])
    picture = np.zeros((view.height * view.width, 3), np.uint8)
    levels = _levels(corners, mesh.uv, pages[0].shape[0])
    at = np.flatnonzero(shown >= 0)
    for number, page in enumerate(pages):
        for level in np.unique(levels[shown[at]]):
            here = at[(mesh.page[shown[at]] == number) & (levels[shown[at]] == level)]
            side = max(1, page.shape[0] >> int(level))
            small = page if level == 0 else cv2.resize(page, (side, side), interpolation=cv2.INTER_AREA)
            picture[here] = sample(small, uv[here, 0] * side, (1 - uv[here, 1]) * side)
    return picture.reshape(view.height, view.width, 3), shown.reshape(view.height, view.width)


def _levels(corners: np.ndarray, uv: np.ndarray, side: int) -> np.ndarray:
    """How many times a page is halved for each face (M,) so that a texel is about a pixel."""
    with np.errstate(invalid="ignore", divide="ignore"):
        level = 0.5 * np.log2(triangle_areas(uv * side) / triangle_areas(corners))
    result: np.ndarray = np.clip(np.rint(np.nan_to_num(level, posinf=0, neginf=0)), 0, 6).astype(np.int8)
    return result


def matched(picture: np.ndarray, photo: np.ndarray, counted: np.ndarray) -> np.ndarray:
    """The picture (H,W,3) uint8 with one gain a channel that takes it to the photo's exposure over the pixels `counted`
    (H,W)."""
    gain = photo[counted].mean(axis=0) / np.maximum(picture[counted].mean(axis=0), 1)
    result: np.ndarray = np.clip(np.rint(picture * gain), 0, 255).astype(np.uint8)
    return result


def psnr(picture: np.ndarray, photo: np.ndarray, counted: np.ndarray) -> float:
    """Peak signal to noise in dB over the pixels `counted` (H,W)."""
    error = (picture[counted].astype(np.float64) - photo[counted]) ** 2
    return float(10 * np.log10(255**2 / max(error.mean(), 1e-9)))
