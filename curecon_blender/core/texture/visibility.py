# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What of a mesh a camera sees, by a depth buffer of the mesh."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ..base.records import View
from ..surface.triangles import face_normals, triangle_areas
from .rasterise import inverse_depth_buffer, scan_convert

_MARGIN = 1 / 800  # of the picture's longest side: a point this near to an occluder's edge counts as hidden
_SLACK = 2.5  # pixels of depth along the surface that two visits to the same place may differ by
_RELATIVE_SLACK = 5e-4  # of the depth: what a surface of single precision and rough triangles needs
_STEEPEST = 5.0  # tangent of the angle from the surface's normal beyond which the slack grows no further
_SMOOTHINGS = 3
_LEAST_COSINE = 0.08  # a face seen at a flatter angle (85 degrees from its normal) gives no texture


@dataclass(frozen=True)
class Seen:
    """The faces whose centroids a camera sees. `face` (n,) int64; `centre` (n,2) float32, the centroid's pixel;
    `cosine` (n,) float32 between the face's normal and the ray; `depth` (n,) float32 z-depth in world units;
    `whole` (n,) bool, whether nothing at all is before the face, even if it fits the photo less than well;
    `rim` (n,) float32, pixels of the depth buffer to the nearest place where the camera sees no mesh, or to the
    picture's edge."""

    face: np.ndarray
    centre: np.ndarray
    cosine: np.ndarray
    depth: np.ndarray
    whole: np.ndarray
    rim: np.ndarray


def in_camera(points: np.ndarray, view: View) -> np.ndarray:
    """World points (N,3) in the camera's frame, (N,3) float32; differences are taken in double precision."""
    seen: np.ndarray = ((points - view.centre) @ view.cam_from_world[:, :3].T).astype(np.float32)
    return seen


def project(points: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Pixels (...,2) of points (...,3) in the camera's frame; NaN behind the camera."""
    z = points[..., 2:]
    with np.errstate(divide="ignore", invalid="ignore"):
        ray = np.where(z > 1e-6, points / z, np.nan)
    return np.asarray(ray @ K[:2].T.astype(ray.dtype))


def visible_faces(vertices: np.ndarray, faces: np.ndarray, view: View) -> Seen:
    """The faces (M,3) that `view` sees from their front, inside its picture, with nothing before their centroid.

    Whether it sees them whole is tested at the centroid, at points near the corners and at every pixel that a face
    covers, against a depth buffer of the mesh whose occluders are widened a little: a photo and the mesh never fit to
    the last pixel, and what is hidden must not take its occluder's colour.
    """
    camera = in_camera(vertices, view)
    pixels = project(camera, view.K)
    corners = pixels[faces]
    centroid = (camera[faces[:, 0]] + camera[faces[:, 1]] + camera[faces[:, 2]]) / 3
    normal = face_normals(camera, faces)
    lengths = np.linalg.norm(normal, axis=1) * np.linalg.norm(centroid, axis=1)
    cosine = -np.einsum("nk,nk->n", normal, centroid) / np.maximum(lengths, np.finfo(np.float32).tiny)
    with np.errstate(divide="ignore"):
        inverse = (1 / camera[:, 2])[faces]
    del normal, lengths
    buffer = inverse_depth_buffer(corners, inverse, view.width, view.height)
    with np.errstate(invalid="ignore"):
        inside = ((corners > 1) & (corners < (view.width - 1, view.height - 1))).all(axis=(1, 2))
    candidates = np.flatnonzero(inside & (cosine > _LEAST_COSINE))
    margin = max(1, round(_MARGIN * max(view.width, view.height)))
    nearest = np.asarray(cv2.dilate(buffer, np.ones((2 * margin + 1, 2 * margin + 1), np.uint8)))

    corners, inverse, cosine = corners[candidates], inverse[candidates], cosine[candidates]
    tangent = np.minimum(np.sqrt(np.maximum(1 / cosine**2 - 1, 0)), _STEEPEST)
    # In relative depth: a step of one pixel along the surface changes the depth by tan / f of itself.
    pixel_angle = np.float32(1 / view.K[0, 0])
    slack = ((1 + margin) * _SLACK * tangent + 0.5) * pixel_angle + np.float32(_RELATIVE_SLACK)

    def hidden(face: np.ndarray, pixel: np.ndarray, at: np.ndarray, depths: np.ndarray = nearest) -> np.ndarray:
        result: np.ndarray = depths.ravel()[pixel] > at * (1 + slack[face])
        return result

    every = np.arange(len(candidates))
    x, y = corners.mean(axis=1).T.astype(np.int64)
    shown = ~hidden(every, y * view.width + x, inverse.mean(axis=1), buffer)
    candidates, corners, inverse, cosine, slack = (
        values[shown] for values in (candidates, corners, inverse, cosine, slack))
    whole = np.ones(len(candidates), bool)
    every = np.arange(len(candidates))
    for weights in (np.full(3, 1 / 3), *(np.eye(3) * 0.85 + 0.05)):
        # Inverse depth is linear over the picture, so the weights hold for it and for the pixels alike.
        x, y = (np.einsum("nkc,k->cn", corners, weights)).astype(np.int64)
        whole &= ~hidden(every, y * view.width + x, inverse @ weights.astype(np.float32))
    large = np.flatnonzero(whole & (triangle_areas(corners) > 4))
    for face, pixel, barycentric in scan_convert(corners[large], view.width, view.height):
        which = large[face]
        at = np.einsum("nk,nk->n", barycentric, inverse[which])
        whole[which[hidden(which, pixel, at)]] = False

    centre = corners.mean(axis=1).astype(np.float32)
    surface = np.pad((buffer > 0).astype(np.uint8), 1)
    rim = np.asarray(cv2.distanceTransform(surface, cv2.DIST_L2, 3))[1:-1, 1:-1]
    at = centre.astype(np.int64)
    return Seen(candidates, centre, cosine.astype(np.float32), centroid[candidates, 2], whole, rim[at[:, 1], at[:, 0]])


def smooth_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals (M,3) float32 of the faces, averaged over their surroundings: choices by them change gradually."""
    normals = face_normals(vertices, faces)
    for _ in range(_SMOOTHINGS):
        at_vertex = np.stack([
            sum(np.bincount(faces[:, corner], normals[:, axis], len(vertices)) for corner in range(3))
            for axis in range(3)
        ], axis=1)
        at_vertex /= np.maximum(np.linalg.norm(at_vertex, axis=1, keepdims=True), 1e-30)
        normals = at_vertex[faces].sum(axis=1)
    unit: np.ndarray = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    return unit.astype(np.float32)
