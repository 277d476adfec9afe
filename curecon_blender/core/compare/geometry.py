# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Thinned clouds with normals, and the small tools that laying one on another needs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

_NEIGHBOURS = 16  # that a normal is taken from
_BITS = 21  # of a voxel's place along an axis


@dataclass(frozen=True)
class Similarity:
    """x -> scale rotation x + translation."""

    scale: float
    rotation: np.ndarray  # (3,3)
    translation: np.ndarray  # (3,)

    @classmethod
    def identity(cls) -> Similarity:
        return cls(1.0, np.eye(3), np.zeros(3))

    def apply(self, points: np.ndarray) -> np.ndarray:
        """Points (N,3) moved, float64."""
        moved: np.ndarray = self.scale * np.asarray(points, np.float64) @ self.rotation.T + self.translation
        return moved

    def after(self, first: Similarity) -> Similarity:
        """What `first` and then this one do."""
        shift = self.apply(first.translation[None])[0]
        return Similarity(self.scale * first.scale, self.rotation @ first.rotation, shift)

    def inverse(self) -> Similarity:
        rotation = self.rotation.T
        return Similarity(1 / self.scale, rotation, -rotation @ self.translation / self.scale)


@dataclass(frozen=True)
class Thin:
    """Points (n,3) float64 with unit normals (n,3) of either sign, and a tree of them; `tones` (n,) are the logarithms
    of their brightness, where it is known."""

    points: np.ndarray
    normals: np.ndarray
    tree: cKDTree
    tones: np.ndarray | None = None

    @property
    def spacing(self) -> float:
        """The median distance of a point from its nearest neighbour."""
        return float(np.median(self.tree.query(self.points[:2000], k=2)[0][:, 1]))


def thin_of(points: np.ndarray, tones: np.ndarray | None = None) -> Thin:
    tree = cKDTree(points)
    return Thin(points, normals_of(points, tree), tree, tones)


def voxel_numbers(points: np.ndarray, size: float) -> np.ndarray:
    """A number (N,) for the voxel of this side that each point is in."""
    cells = np.floor((points - points.min(axis=0)) / size).astype(np.int64)
    cells = np.minimum(cells, (1 << _BITS) - 1)
    numbers: np.ndarray = (cells[:, 0] << (2 * _BITS)) | (cells[:, 1] << _BITS) | cells[:, 2]
    return numbers


def one_a_voxel(points: np.ndarray, size: float) -> np.ndarray:
    """The first point's number in each voxel: never a mean, which would hide noise."""
    return np.sort(np.unique(voxel_numbers(points, size), return_index=True)[1])


def thinned(points: np.ndarray, most: int) -> np.ndarray:
    """At most about `most` points, spread evenly over what is there: one a voxel of a size to match."""
    if len(points) > 20 * most:
        points = points[np.sort(np.random.default_rng(0).choice(len(points), 20 * most, replace=False))]
    extent = float(np.linalg.norm(np.percentile(points, 98, axis=0) - np.percentile(points, 2, axis=0)))
    if len(points) <= most or extent <= 0:
        return points
    low, high = extent / 4000, extent
    for _ in range(12):
        size = float(np.sqrt(low * high))
        count = len(np.unique(voxel_numbers(points, size)))
        low, high = (size, high) if count > most else (low, size)
    kept: np.ndarray = points[one_a_voxel(points, high)]
    return kept


def normals_of(points: np.ndarray, tree: cKDTree, neighbours: int = _NEIGHBOURS) -> np.ndarray:
    """Unit normals (n,3) of the planes that lie best in each point's neighbours; their sign means nothing."""
    k = min(neighbours, len(points))
    if k < 3:
        return np.tile([0.0, 0.0, 1.0], (len(points), 1))
    normals = np.empty_like(points)
    for start in range(0, len(points), 1 << 16):
        part = slice(start, start + (1 << 16))
        near = points[tree.query(points[part], k=k)[1]]
        near = near - near.mean(axis=1, keepdims=True)
        normals[part] = np.linalg.eigh(np.einsum("nki,nkj->nij", near, near))[1][:, :, 0]
    return normals


def fitted(source: np.ndarray, target: np.ndarray, *, scaled: bool, weights: np.ndarray | None = None) -> Similarity:
    """The motion that brings `source` (n,3) nearest to `target` (n,3) in the least squares sense (Umeyama 1991)."""
    weights = np.full(len(source), 1 / len(source)) if weights is None else weights / weights.sum()
    source_mean, target_mean = weights @ source, weights @ target
    a, b = source - source_mean, target - target_mean
    u, singular, vt = np.linalg.svd((b * weights[:, None]).T @ a)
    mirror = np.array([1, 1, np.sign(np.linalg.det(u @ vt))])
    rotation = u @ np.diag(mirror) @ vt
    scale = float((singular * mirror).sum() / (weights @ (a**2).sum(axis=1))) if scaled else 1.0
    return Similarity(scale, rotation, target_mean - scale * rotation @ source_mean)


def turned(vector: np.ndarray) -> np.ndarray:
    """The rotation (3,3) about a vector (3,) by its length in radians."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-15:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rotation: np.ndarray = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return rotation


def angle_of(rotation: np.ndarray) -> float:
    """Degrees that a rotation (3,3) turns by."""
    return float(np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))))
