# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How well each photo shows each face: size in pixels, angle, sharpness, and what stands in between."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ..base import images
from ..base.errors import PhotoError, WorkspaceError
from ..base.language import Text
from ..base.messages import Reporter
from ..base.sampling import sample
from ..depth.maps import read_depth
from ..surface.mesh import Mesh
from ..views.masks import left_out
from .photo_sources import Source
from .visibility import Seen, in_camera, project, visible_faces

CANDIDATES = 8  # photos kept a face
UNSEEN = -1
_RIM = 5 / 800  # of the longest side: nearer than this to the mesh's outline or the picture's edge a photo counts less
_RIM_LEAST = 0.03
_GRADIENT_FLOOR = 2.0  # of 255 a pixel: flat plaster is not blurred because it has no edges
_CONFIDENT, _IN_FRONT = 0.3, 0.03  # a depth that counts, and how far before a face it must be, of its depth
_BEHIND = 0.02  # of its quality is left to a photo that has something else in front of a face


@dataclass(frozen=True)
class Candidates:
    """The best photos of each of M faces, in no order, filled in place.

    `view` (M,K) int16, index of a photo or UNSEEN; `quality` (M,K) float32, 0 where there is none, negative where the
    photo sees the face's centroid but not all of it for sure: it may be laid out by that photo, but takes no colour;
    `colour` (M,K,3) uint8, mean sRGB about the face in that photo.
    """

    view: np.ndarray
    quality: np.ndarray
    colour: np.ndarray

    @classmethod
    def empty(cls, faces: int) -> Candidates:
        return cls(
            np.full((faces, CANDIDATES), UNSEEN, np.int16), np.zeros((faces, CANDIDATES), np.float32),
            np.zeros((faces, CANDIDATES, 3), np.uint8),
        )

    def add(self, view: int, face: np.ndarray, quality: np.ndarray, colour: np.ndarray) -> None:
        """Let photo `view` take the place of the poorest candidate of each `face` (n,), where it is better."""
        worth = np.where(self.view[face] == UNSEEN, -np.inf, self.quality[face])
        slot = worth.argmin(axis=1)
        better = quality > worth[np.arange(len(face)), slot]
        face, slot = face[better], slot[better]
        self.view[face, slot] = view
        self.quality[face, slot] = quality[better]
        self.colour[face, slot] = colour[better]


def add_candidates(
    candidates: Candidates, number: int, source: Source, mesh: Mesh, normals: np.ndarray, reporter: Reporter
) -> None:
    """Let photo `number` be a candidate of the faces that it shows. `normals` (M,3) are the smooth ones. A picture that
    cannot be used gives none, with a warning."""
    picture = _picture(source, reporter)
    if picture is None:
        return
    view = source.view
    seen = visible_faces(mesh.vertices, mesh.faces, view)
    centroids = mesh.vertices[mesh.faces[seen.face]].mean(axis=1)
    ray = (centroids - view.centre).astype(np.float32)
    cosine = -np.einsum("nk,nk->n", normals[seen.face], ray) / np.linalg.norm(ray, axis=1)
    size = max(view.width, view.height)
    window = 2 * round(size / 400) + 1
    gradient = cv2.blur(_gradient(picture), (4 * window + 1, 4 * window + 1))
    sharpness = sample(gradient, *seen.centre.T) + _GRADIENT_FLOOR
    rim = np.clip(seen.rim / (_RIM * size), _RIM_LEAST, 1)
    resolution = source.full.K[0, 0] / seen.depth
    quality = (resolution * np.clip(cosine, 0.05, 1)) ** 2 * np.sqrt(sharpness) * rim
    occluded = _occluded(source, seen, mesh.filled[seen.face])
    quality[occluded] *= _BEHIND
    colour = sample(cv2.blur(picture, (window, window)), *seen.centre.T)
    quality[~seen.whole] *= -1
    # Nothing measured says that a filled face is where the photo shows anything: what stands before it is no colour.
    shown = ~_masked(source, seen, mesh) & ~(occluded & mesh.filled[seen.face])
    candidates.add(number, seen.face[shown], quality[shown].astype(np.float32), colour[shown])


def _picture(source: Source, reporter: Reporter) -> np.ndarray | None:
    """The undistorted picture at the view's own size, or None, with a warning, when it cannot be used."""
    try:
        picture = images.read_rgb(source.picture)
    except PhotoError as error:
        reporter.warning(Text("{} It gives no texture.", error.message), source.view.name)
        return None
    if picture.shape[:2] != (source.view.height, source.view.width):
        reporter.warning(Text("{} has changed its size. It gives no texture.", source.picture.name), source.view.name)
        return None
    return picture


def _occluded(source: Source, seen: Seen, filled: np.ndarray) -> np.ndarray:
    """Whether each face seen (n,) lies behind what the photo's depth map has there: a branch or a passer-by that is
    no part of the mesh. Before a `filled` face (n,) unsure depth counts too. All False where the workspace has no depth
    map that fits."""
    try:
        depth, confidence = read_depth(source.workspace, source.view)
    except WorkspaceError:
        return np.zeros(len(seen.face), bool)
    column, row = seen.centre.astype(np.int64).T
    reach = max(7, 2 * round(max(depth.shape) / 200) + 1)
    nearest = np.zeros(len(seen.face), np.float32)
    for least, which in ((_CONFIDENT, ~filled), (0.0, filled)):
        # Without speckles, then widened: the photo at a face's corner counts as much as at its middle.
        known = cv2.medianBlur(np.where(confidence >= least, depth, 0).astype(np.float32), 5)
        near = np.asarray(cv2.erode(np.where(known > 0, known, np.float32(np.inf)), np.ones((reach, reach), np.uint8)))
        nearest[which] = near[row[which], column[which]]
    behind: np.ndarray = nearest < (1 - _IN_FRONT) * seen.depth
    return behind


def _masked(source: Source, seen: Seen, mesh: Mesh) -> np.ndarray:
    """Whether a mask of the photo leaves out any of each face seen (n,): its middle or a corner, or what is beside."""
    view = source.view
    hidden = left_out(source.workspace, view)
    if hidden is None:
        return np.zeros(len(seen.face), bool)
    reach = 2 * max(1, round(max(hidden.shape) / 400)) + 1
    wide = np.asarray(cv2.dilate(hidden.astype(np.uint8), np.ones((reach, reach), np.uint8)))
    corners = project(in_camera(mesh.vertices, view), view.K)[mesh.faces[seen.face]]
    places = np.concatenate([corners, seen.centre[:, None]], axis=1).astype(np.int64)
    masked: np.ndarray = wide[places[..., 1], places[..., 0]].any(axis=1)
    return masked


def _gradient(picture: np.ndarray) -> np.ndarray:
    """Length (H,W) float32 of the brightness' gradient, 0 to 255 a pixel."""
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    gx, gy = (cv2.Sobel(grey, cv2.CV_32F, dx, 1 - dx, scale=1 / 8) for dx in (1, 0))
    return np.asarray(cv2.magnitude(gx, gy))
