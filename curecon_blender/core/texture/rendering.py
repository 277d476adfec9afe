# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A mesh with its texture or its vertex colours, drawn unlit as a camera sees it, to be held beside a photo."""

from __future__ import annotations

import cv2
import numpy as np

from ..base.records import View
from ..base.sampling import sample
from ..surface.mesh import Mesh
from ..surface.triangles import triangle_areas
from .rasterise import inverse_depth_buffer, scan_convert
from .visibility import in_camera, project


def render(mesh: Mesh, pages: list[np.ndarray], view: View) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The mesh as `view` sees it: (H,W,3) uint8 sRGB, unlit; z-depth (H,W) float32, 0 where there is none; and the face
    at each pixel (H,W) int32, -1 where there is none. Texels are averaged where several fall on a pixel."""
    camera = in_camera(mesh.vertices, view)
    corners = project(camera, view.K)[mesh.faces]
    with np.errstate(divide="ignore"):
        inverse = (1 / camera[:, 2])[mesh.faces]
    nearest = inverse_depth_buffer(corners, inverse, view.width, view.height).ravel()
    shown = np.full(view.height * view.width, -1, np.int32)
    share_of = np.zeros((view.height * view.width, 3), np.float32)
    for face, pixel, weights in scan_convert(corners, view.width, view.height):
        share = weights * inverse[face]
        depth = share.sum(axis=1)
        front = depth >= nearest[pixel]
        face, pixel, share, depth = face[front], pixel[front], share[front], depth[front]
        shown[pixel] = face
        share_of[pixel] = share / depth[:, None]
    at = np.flatnonzero(shown >= 0)
    picture = np.zeros((view.height * view.width, 3), np.uint8)
    if mesh.uv is not None:
        picture[at] = _texels(mesh, pages, corners, shown[at], share_of[at])
    else:
        colours = mesh.colours[mesh.faces[shown[at]]].astype(np.float32)
        picture[at] = np.rint(np.einsum("nk,nkc->nc", share_of[at], colours))
    with np.errstate(divide="ignore"):
        z = np.where(nearest > 0, 1 / nearest, 0).astype(np.float32)
    shape = view.height, view.width
    return picture.reshape(*shape, 3), z.reshape(shape), shown.reshape(shape)


def _texels(
    mesh: Mesh, pages: list[np.ndarray], corners: np.ndarray, face: np.ndarray, share: np.ndarray
) -> np.ndarray:
    """Colours (n,3) uint8 at barycentric places `share` (n,3) of faces (n,)."""
    assert mesh.uv is not None and mesh.page is not None
    uv = np.einsum("nk,nkc->nc", share, mesh.uv[face])
    levels, page_of = _levels(corners, mesh.uv, pages[0].shape[0])[face], mesh.page[face]
    result = np.zeros((len(face), 3), np.uint8)
    for number, page in enumerate(pages):
        for level in np.unique(levels):
            here = np.flatnonzero((page_of == number) & (levels == level))
            side = max(1, page.shape[0] >> int(level))
            small = page if level == 0 else cv2.resize(page, (side, side), interpolation=cv2.INTER_AREA)
            result[here] = sample(small, uv[here, 0] * side, (1 - uv[here, 1]) * side)
    return result


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
