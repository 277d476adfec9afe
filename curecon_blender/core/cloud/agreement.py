# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether views see a surface at the same place, pixel by pixel: reprojection there and back, and depth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from ..base.messages import Reporter
from ..base.options import Options
from ..base.records import View
from ..base.sampling import ROW, sample
from .depth_maps import DepthMap

BLOCK = 256 * ROW  # pixels worked on at once: small enough for the processor's cache
_THROUGH = 2.0  # times the limit of depth difference: a photo that sees farther than that looks through a point
_LEAST_WEIGHT = 1e-6  # confidence 0 still counts as a view, and must not divide by zero
_DUPLICATE = 2.0  # times the confirming limits: a point nearer than this to an accepted one is the same point, noisier


@dataclass(frozen=True)
class Pixels:
    """Some pixels of a view: `index` (n,) int64, flat and rising, and `inverse_depth` (n,) float32."""

    view: View
    index: np.ndarray
    inverse_depth: np.ndarray

    def __len__(self) -> int:
        return len(self.index)

    def __getitem__(self, which: slice | np.ndarray) -> Pixels:
        return Pixels(self.view, self.index[which], self.inverse_depth[which])

    def blocks(self, reporter: Reporter) -> Iterator[tuple[int, Pixels]]:
        """The pixels in pieces of BLOCK, each with its place in the list. Raises Cancelled between them."""
        for start in range(0, len(self), BLOCK):
            reporter.check_cancelled()
            yield start, self[start : start + BLOCK]

    def centres(self) -> tuple[np.ndarray, np.ndarray]:
        """u, v (n,) float32."""
        row, column = np.divmod(self.index, self.view.width)
        return (column + 0.5).astype(np.float32), (row + 0.5).astype(np.float32)


@dataclass(frozen=True)
class Sums:
    """What the views that agree on each of n reference pixels add up to, filled in place.

    `points` (3,n) float32 confidence-weighted sums of (u z, v z, z) in the reference camera, u and v in pixels;
    `colours` (3,n) float32 and `weight` (n,) float32 likewise; `views` (n,) uint16 how many agree, the reference
    included; `spread` (n,) float32 confidence of those that agree times the squared sine of the angle between their ray
    and the reference's: the larger, the better depth is known; `through` (n,) float32 confidence of the views that see
    something farther there.
    """

    points: np.ndarray
    colours: np.ndarray
    weight: np.ndarray
    views: np.ndarray
    spread: np.ndarray
    through: np.ndarray

    def evidence(self) -> np.ndarray:
        """(n,) float32: the spread times the third power of the mean confidence, since sure views are right far more
        often than unsure ones."""
        evidence: np.ndarray = self.weight / self.views
        evidence **= 3
        evidence *= self.spread
        return evidence

    @classmethod
    def of(cls, pixels: Pixels, reference: DepthMap, reporter: Reporter) -> Sums:
        """The reference's own share."""
        count = len(pixels)
        points, colours = np.empty((2, 3, count), np.float32)
        spread, through = np.zeros((2, count), np.float32)
        sums = cls(points, colours, np.empty(count, np.float32), np.ones(count, np.uint16), spread, through)
        for start, block in pixels.blocks(reporter):
            here = slice(start, start + len(block))
            weight = np.maximum(reference.confidence.ravel()[block.index].astype(np.float32), _LEAST_WEIGHT)
            u, v = block.centres()
            sums.points[:, here] = np.stack([u, v, np.ones_like(u)]) * (weight / block.inverse_depth)
            sums.colours[:, here] = reference.colours.reshape(-1, 3)[block.index].T * weight
            sums.weight[here] = weight
        return sums


def meet(pixels: Pixels, other: View) -> bool:
    """Whether any of the pixels falls into the picture of `other`."""
    return len(_project(pixels, other)[0]) > 0


def are_duplicates(
    pixels: Pixels, other: View, accepted: np.ndarray, options: Options, reporter: Reporter
) -> np.ndarray:
    """Whether each of n pixels is a point that `other` has accepted (inverse depth (H,W), NaN = none); (n,) bool."""
    duplicate = np.zeros(len(pixels), bool)
    for start, block in pixels.blocks(reporter):
        seen, u, v = _project(block, other)
        found = _sample_inverse_depth(accepted, u, v, options.max_depth_difference)
        duplicate[start + seen] = _disagreement(block[seen], other, u, v, found, options)[0] < _DUPLICATE
    return duplicate


def confirm(
    pixels: Pixels, other: View, depth_map: DepthMap, sums: Sums, options: Options, reporter: Reporter
) -> None:
    """Add to the sums of n pixels what `other` has where it agrees."""
    for start, block in pixels.blocks(reporter):
        seen, u, v = _project(block, other)
        block = block[seen]
        found = _sample_inverse_depth(depth_map.inverse_depth, u, v, options.max_depth_difference)
        error, points = _disagreement(block, other, u, v, found, options)
        farther = _depth_in(block, other) * found < 1 - _THROUGH * options.max_depth_difference
        sums.through[start + seen[farther]] += depth_map.confidence_at(u[farther], v[farther])
        agrees = error < 1
        which, u, v = start + seen[agrees], u[agrees], v[agrees]
        weight = np.maximum(depth_map.confidence_at(u, v), _LEAST_WEIGHT)
        sums.points[:, which] += points[:, agrees] * weight
        sums.colours[:, which] += sample(depth_map.colours, u, v, cv2.INTER_LINEAR).T * weight
        sums.weight[which] += weight
        sums.views[which] += 1
        sums.spread[which] += weight * _squared_sine(block[agrees], other)


def _project(pixels: Pixels, other: View) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which of n pixels fall into the picture of `other`, as positions in the list (m,), and where: u, v (m,)."""
    matrix, offset = _transfer(pixels.view, other)
    u, v = pixels.centres()
    x, y, z = (a * u + b * v + c + d * pixels.inverse_depth for (a, b, c), d in zip(matrix, offset, strict=True))
    in_front = np.flatnonzero(z > 0)
    u, v = x[in_front] / z[in_front], y[in_front] / z[in_front]
    inside = (u > 0) & (u < other.width) & (v > 0) & (v < other.height)
    return in_front[inside], u[inside], v[inside]


def _depth_in(pixels: Pixels, other: View) -> np.ndarray:
    """z-depth (m,) that the points of m pixels have in `other`."""
    matrix, offset = _transfer(pixels.view, other)
    u, v = pixels.centres()
    depth: np.ndarray = (matrix[2, 0] * u + matrix[2, 1] * v + matrix[2, 2]) / pixels.inverse_depth + offset[2]
    return depth


def _squared_sine(pixels: Pixels, other: View) -> np.ndarray:
    """Of the angle (m,) between the rays from the points of m pixels to their own view and to `other`."""
    rotation, translation = pixels.view.cam_from_world[:, :3], pixels.view.cam_from_world[:, 3]
    centre = (rotation @ other.centre + translation).astype(np.float32)
    inverse_K = np.linalg.inv(pixels.view.K).astype(np.float32)
    ray = inverse_K @ np.stack([*pixels.centres(), np.ones(len(pixels), np.float32)])
    from_other = ray / pixels.inverse_depth - centre[:, None]
    cosine = (ray * from_other).sum(axis=0) ** 2 / ((ray**2).sum(axis=0) * (from_other**2).sum(axis=0))
    sine: np.ndarray = 1 - np.minimum(cosine, 1)
    return sine


def _disagreement(
    pixels: Pixels, other: View, other_u: np.ndarray, other_v: np.ndarray, found: np.ndarray, options: Options
) -> tuple[np.ndarray, np.ndarray]:
    """How far the surface that `other` has is from each of m pixels, by the larger of reprojection error and relative
    depth difference, in units of their limits (NaN: none there); and its points (3,m) as (u z, v z, z) in the pixels'
    view."""
    matrix, offset = _transfer(other, pixels.view)
    with np.errstate(invalid="ignore", divide="ignore"):
        points = np.stack([(a * other_u + b * other_v + c) / found + d
                           for (a, b, c), d in zip(matrix, offset, strict=True)])
        u, v = pixels.centres()
        reprojection = np.hypot(points[0] / points[2] - u, points[1] / points[2] - v)
        difference = np.abs(points[2] * pixels.inverse_depth - 1)
    error = np.maximum(reprojection / np.float32(options.max_reprojection_error),
                       difference / np.float32(options.max_depth_difference))
    return error, points


def _transfer(view: View, other: View) -> tuple[np.ndarray, np.ndarray]:
    """(M, m) float32 with (u' z', v' z', z') = z M (u, v, 1) + m, from pixels of `view` to those of `other`.

    Going from camera to camera, never through the world, float32 stays exact far from the world's origin.
    """
    rotation = other.cam_from_world[:, :3] @ view.cam_from_world[:, :3].T
    translation = other.cam_from_world[:, 3] - rotation @ view.cam_from_world[:, 3]
    matrix = other.K @ rotation @ np.linalg.inv(view.K)
    return matrix.astype(np.float32), (other.K @ translation).astype(np.float32)


def _sample_inverse_depth(image: np.ndarray, u: np.ndarray, v: np.ndarray, max_difference: float) -> np.ndarray:
    """Bilinear on a surface; the nearest pixel's at its rim (NaN next door) and where depth jumps between pixels."""
    nearest = sample(image, u, v, cv2.INTER_NEAREST)
    bilinear = sample(image, u, v, cv2.INTER_LINEAR)
    smooth = np.abs(bilinear - nearest) < 0.5 * max_difference * nearest
    return np.where(smooth, bilinear, nearest)
