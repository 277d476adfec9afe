# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Normals as a surface is drawn with, and the frames that a normal map is told in.

A normal map holds, for each texel, the direction of a finer surface in the frame of tangent, bitangent and normal of
the surface that it lies on, as glTF and Blender have it: x along u, y along v upwards, z outwards, -1 to 1 as 0 to 255.
Both make tangents as MikkTSpace does (Mikkelsen 2008), and so does this module: else a baked direction would come out
turned.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..base.graphs import connected_components
from ..surface.mesh import SHARP_ANGLE, Mesh
from ..surface.triangles import face_neighbours, face_normals, unit

FLAT = (128, 128, 255)  # the texel of the surface's own direction
_LEAST_Z = 0.1  # of a direction: what looks away from the surface is not to be seen on it


@dataclass(frozen=True)
class Frames:
    """At each face's corners (M,3,3) float32: unit normals and tangents; `side` (M,) float32, 1 or -1, by which their
    cross product becomes the bitangent."""

    normals: np.ndarray
    tangents: np.ndarray
    side: np.ndarray

    def encode(self, face: np.ndarray, weights: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Texels (n,3) uint8 of world `directions` (n,3) at barycentric places `weights` (n,3) on faces (n,)."""
        normal, tangent = (np.einsum("nk,nkc->nc", weights, at[face]) for at in (self.normals, self.tangents))
        across = self.side[face, None] * np.cross(normal, tangent)
        # Between corners the three are neither of unit length nor square to each other: the inverse, by cofactors.
        axes = np.stack([np.cross(across, normal), np.cross(normal, tangent), np.cross(tangent, across)], axis=1)
        local = np.einsum("nkc,nc->nk", axes, directions) * np.sign(np.einsum("nc,nc->n", tangent, axes[:, 0]))[:, None]
        local /= np.maximum(np.linalg.norm(local, axis=1, keepdims=True), 1e-12)
        local[:, 2] = np.maximum(local[:, 2], _LEAST_Z)
        local /= np.linalg.norm(local, axis=1, keepdims=True)
        texels: np.ndarray = np.rint(127.5 * (local + 1)).astype(np.uint8)
        return texels


def corner_normals(mesh: Mesh) -> np.ndarray:
    """Unit normals (M,3,3) float32 at the faces' corners: smooth across edges of less than SHARP_ANGLE."""
    return _Corners(mesh).normals


def frames(mesh: Mesh) -> Frames:
    """Of a mesh with UVs."""
    assert mesh.uv is not None
    corners = _Corners(mesh)
    at, uv = mesh.vertices[mesh.faces].astype(np.float64), mesh.uv.astype(np.float64)
    (first, second), (one, two) = ((p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]) for p in (at, uv))
    side = np.where(one[:, 0] * two[:, 1] < one[:, 1] * two[:, 0], -1.0, 1.0)
    along = side[:, None] * (two[:, 1:] * first - one[:, 1:] * second)
    along = unit(np.repeat(along[:, None], 3, axis=1) - corners.normals * (corners.normals @ along[..., None]))
    # One tangent where faces are smooth and go on in the texture, too.
    same = side[corners.face] == side[corners.other]
    same &= (np.abs(uv[corners.face, corners.corner] - uv[corners.other, corners.theirs]).max(axis=1) < 1e-6)
    whole = same.reshape(2, -1).all(axis=0)  # both ends of the edge
    tangents = corners.mean(along, np.tile(whole, 2))
    return Frames(corners.normals, tangents.astype(np.float32), side.astype(np.float32))


class _Corners:
    """Which corners (`face`, `corner`) and (`other`, `theirs`), (E,) each, of smooth edges lie at one vertex: first
    the start of every edge, then the end of every edge."""

    def __init__(self, mesh: Mesh) -> None:
        faces = mesh.faces
        self._angles = _angles(mesh.vertices[mesh.faces].astype(np.float64))
        flat = unit(face_normals(mesh.vertices.astype(np.float64), faces))
        neighbours = face_neighbours(faces)
        face, edge = np.nonzero(neighbours > np.arange(len(faces))[:, None])
        other = neighbours[face, edge]
        start, end = ((faces[other] == faces[face, at][:, None]).argmax(axis=1) for at in (edge, (edge + 1) % 3))
        smooth = np.einsum("nc,nc->n", flat[face], flat[other]) > np.cos(np.radians(SHARP_ANGLE))
        smooth &= start == (end + 1) % 3  # both faces look to the same side
        face, edge, other, start, end = (values[smooth] for values in (face, edge, other, start, end))
        self.face, self.corner = np.tile(face, 2), np.concatenate([edge, (edge + 1) % 3])
        self.other, self.theirs = np.tile(other, 2), np.concatenate([start, end])
        everywhere = np.ones(len(self.face), bool)
        self.normals = self.mean(np.repeat(flat[:, None], 3, axis=1), everywhere).astype(np.float32)

    def mean(self, values: np.ndarray, joined: np.ndarray) -> np.ndarray:
        """Unit vectors (M,3,3): means of those at the corners that the edges `joined` (E,) join, by their angles."""
        pairs = np.stack([3 * self.face + self.corner, 3 * self.other + self.theirs], axis=1)[joined]
        fan = connected_components(pairs, values.shape[0] * 3)
        weighted = (values * self._angles[..., None]).reshape(-1, 3)
        total = np.stack([np.bincount(fan, weighted[:, axis]) for axis in range(3)], axis=1)
        return unit(total)[fan].reshape(values.shape)


def _angles(corners: np.ndarray) -> np.ndarray:
    """The angle (M,3) at each corner of triangles (M,3,3)."""
    following = unit(np.roll(corners, -1, axis=1) - corners)
    before = unit(np.roll(corners, 1, axis=1) - corners)
    angles: np.ndarray = np.arccos(np.clip(np.einsum("nkc,nkc->nk", following, before), -1, 1))
    return angles
