# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth maps to one coloured cloud: a point is kept where enough views agree on it, and it is written once.

Photos are taken in the order of their ground sampling distance, finest first, so that each piece of surface is
written at the best resolution that any photo has of it. Every pixel of the photo at hand (the reference) is projected
into the views that overlap it:

* a view *confirms* the pixel when the depth it has there leads back to less than `max_reprojection_error` pixels from
  where it started, with less than `max_depth_difference` relative difference in depth;
* any view that was fused before, overlapping by many sparse points or not, makes the pixel a duplicate when it
  *accepted* a point there: wrote it, or knew it as written by another.

N_c (`Options.min_views`) counts the reference as one of the views, as `Cloud.views` does and as Vis-MVSNet's filter
does: three photos that all agree are enough for a point. Unless N_c is given, so are two that are sure in the mean, if
no photo looks through the point: what a site's few photos see from one side only, such as an outer wall, is otherwise
lost. On the sample site that adds 5 % to the recall and costs no precision.

Memory holds one reference, one block of its pixels, and a cache of other photos that is bounded in bytes; the depths
accepted wait on disk (4 bytes a pixel until the end).
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from ..base import images
from ..base.errors import CuReconError, PhotoError, WorkspaceError
from ..base.files import disk_errors, scratch_folder
from ..base.messages import Reporter
from ..base.options import Options
from ..base.records import Component, View
from ..base.sampling import ROW, sample
from ..depth.maps import read_depth
from .ply import Cloud, CloudWriter
from .sky import sky_mask

CACHE_BYTES = 512 << 20
_BLOCK = 256 * ROW  # pixels worked on at once: small enough for the processor's cache
_SPARSE = 64  # one pixel in so many tells whether two pictures have anything in common
_VIEWS = 3  # N_c, as in the paper
_THROUGH = 2.0  # times the limit of depth difference: a photo that sees farther than that looks through a point
_SURE = 0.9  # confidence: 97 % of the pixels with more are right within one depth interval
_LEAST_WEIGHT = 1e-6  # confidence 0 still counts as a view, and must not divide by zero
_DUPLICATE = 2.0  # times the confirming limits: a point nearer than this to an accepted one is the same point, noisier
_SAME_SURFACE = 0.02  # relative depth difference up to which a neighbouring pixel counts for the normal
_NORMAL_RADIUS = 2  # pixels


class NoPointsError(CuReconError):
    """Not one point of a component was seen alike by enough views."""

    exit_code = 8
    kind = "fusion"


@dataclass(frozen=True)
class _DepthMap:
    """A photo ready for lookups. `inverse_depth` (H,W) float32, NaN = none; `confidence` (H,W) float32;
    `colours` (H,W,3) uint8 RGB. Inverse depth, because it is linear over the pixels of a plane and depth is not."""

    inverse_depth: np.ndarray
    confidence: np.ndarray
    colours: np.ndarray

    @property
    def nbytes(self) -> int:
        return self.inverse_depth.nbytes + self.confidence.nbytes + self.colours.nbytes


def fuse(
    component: Component, workspace: Path, options: Options, reporter: Reporter, *, cache_bytes: int = CACHE_BYTES
) -> int:
    """Fuse the depth maps of `component` into its cloud (PLY, site frame, site units); returns the number of points.

    Reads `depth/NAME.npz` and the undistorted pictures of the workspace, all of the size that their View gives.
    Progress counts photos. Confidence of a point: the mean over the views that agree on it. Raises WorkspaceError
    for a depth map or picture that is missing, damaged or of another camera, and NoPointsError when too few views
    agree anywhere; a cloud from an earlier run is then left as it was.
    """
    min_views = options.min_views or _VIEWS
    if len(component.views) < min_views:
        min_views = len(component.views)
        reporter.warning(f"Only {min_views} photos hang together here: points need no more than their agreement.")
    order = _finest_first(component.views, workspace, reporter)
    neighbours = _neighbours(component.views)
    depth_maps = _Cache(workspace, cache_bytes, z_up=component.frame.up != "given")
    with scratch_folder(workspace / "fusion") as folder, CloudWriter(workspace / component.cloud) as writer:
        fused: dict[str, tuple[View, Path]] = {}  # views done, with the file of what they accepted
        for done, view in enumerate(order):
            reporter.progress(done, len(order))
            near = {v.name: v for v in neighbours[view.name]}
            # Neighbours first: they know most duplicates, so that little is left to ask of the others.
            before = sorted(fused.values(), key=lambda pair: pair[0].name not in near)
            cloud, accepted = _fuse_one(view, before, list(near.values()), depth_maps, options, min_views)
            writer.write(cloud)
            fused[view.name] = view, folder / f"{done}.npy"
            with disk_errors(folder):
                np.save(folder / f"{done}.npy", accepted)
        reporter.progress(len(order), len(order))
        if writer.count == 0:
            raise NoPointsError(
                f"Too few views agree: none of the {len(order)} photos' depth has a point that {min_views} of them see "
                f"at the same place with confidence {options.min_confidence:g}.",
                remedy="Take photos that overlap more, or try again with a lower minimum confidence or fewer "
                "confirming views.",
                path=workspace / component.cloud,
            )
    return writer.count


def _fuse_one(
    view: View, before: list[tuple[View, Path]], near: list[View], depth_maps: _Cache, options: Options, min_views: int
) -> tuple[Cloud, np.ndarray]:
    """The new points of one reference, and its inverse depth (H,W) float32 where it accepts one, elsewhere NaN."""
    reference = depth_maps[view]
    inverse_depth = reference.inverse_depth.ravel()
    candidates = np.flatnonzero((reference.confidence.ravel() >= options.min_confidence) & ~np.isnan(inverse_depth))
    fresh = candidates
    for other, file in before:
        fresh = fresh[~_is_duplicate(view, inverse_depth[fresh], fresh, other, file, options)]
    sums = _Sums.of(reference, fresh)
    for other in near:
        _confirm(view, inverse_depth[fresh], fresh, other, depth_maps[other], sums, options)

    means = sums.points / sums.weight
    depth = np.full(view.height * view.width, np.nan, np.float32)
    depth[candidates] = 1 / inverse_depth[candidates]
    depth[fresh] = means[2]
    keep = sums.views >= min_views
    if options.min_views is None:
        keep |= (sums.views >= 2) & (sums.weight >= _SURE * sums.views) & ~sums.seen_through
    index, weight, views = fresh[keep], sums.weight[keep], sums.views[keep]
    accepted = inverse_depth.copy()
    accepted[fresh[~keep]] = np.nan
    accepted[reference.confidence.ravel() < options.min_confidence] = np.nan

    rotation, translation = view.cam_from_world[:, :3], view.cam_from_world[:, 3]
    in_camera = np.linalg.inv(view.K) @ means[:, keep]
    normals = rotation.T @ _normals(depth.reshape(view.height, view.width), view.K, index)
    return Cloud(
        points=(rotation.T @ (in_camera - translation[:, None])).T.astype(np.float32),
        colours=np.rint(sums.colours[:, keep] / weight).T.astype(np.uint8),
        normals=normals.T.astype(np.float32),
        confidence=np.minimum(weight / views, 1).astype(np.float32),
        views=np.minimum(views, 255).astype(np.uint8),
    ), accepted.reshape(view.height, view.width)


@dataclass(frozen=True)
class _Sums:
    """What the views that agree on each of n reference pixels add up to, filled in place.

    `points` (3,n) float32 confidence-weighted sums of (u z, v z, z) in the reference camera, u and v in pixels;
    `colours` (3,n) float32 and `weight` (n,) float32 likewise; `views` (n,) uint16 how many agree, the reference
    included; `seen_through` (n,) bool, whether any sees something farther there.
    """

    points: np.ndarray
    colours: np.ndarray
    weight: np.ndarray
    views: np.ndarray
    seen_through: np.ndarray

    @classmethod
    def of(cls, reference: _DepthMap, index: np.ndarray) -> _Sums:
        """The reference's own share, at flat pixels `index`."""
        weight = np.maximum(reference.confidence.ravel()[index], _LEAST_WEIGHT)
        u, v = _pixel_centres(index, reference.confidence.shape[1])
        points = np.stack([u, v, np.ones_like(u)]) * (weight / reference.inverse_depth.ravel()[index])
        colours = reference.colours.reshape(-1, 3)[index].T * weight
        return cls(points, colours, weight, np.ones(len(index), np.uint16), np.zeros(len(index), bool))


def _is_duplicate(
    view: View, inverse_depth: np.ndarray, index: np.ndarray, other: View, file: Path, options: Options
) -> np.ndarray:
    """Whether each of n pixels (flat `index`, `inverse_depth`) is a point that `other` accepted before; (n,) bool."""
    duplicate = np.zeros(len(index), bool)
    sparse = slice(None, None, _SPARSE)
    if not len(_project(view, inverse_depth[sparse], index[sparse], other)[0]):
        return duplicate
    accepted = np.load(file, mmap_mode="r")
    for block in _blocks(len(index)):
        seen, u, v = _project(view, inverse_depth[block], index[block], other)
        found = _sample_inverse_depth(accepted, u, v, options.max_depth_difference)
        error = _disagreement(view, inverse_depth[block][seen], index[block][seen], other, u, v, found, options)[0]
        duplicate[block.start + seen] = error < _DUPLICATE
    return duplicate


def _confirm(
    view: View, inverse_depth: np.ndarray, index: np.ndarray, other: View, depth_map: _DepthMap, sums: _Sums,
    options: Options,
) -> None:
    """Add to the sums of n pixels (flat `index`, `inverse_depth`) what `other` has where it agrees."""
    for block in _blocks(len(index)):
        seen, u, v = _project(view, inverse_depth[block], index[block], other)
        found = _sample_inverse_depth(depth_map.inverse_depth, u, v, options.max_depth_difference)
        error, points = _disagreement(
            view, inverse_depth[block][seen], index[block][seen], other, u, v, found, options
        )
        farther = _depth_in(view, inverse_depth[block][seen], index[block][seen], other) * found < (
            1 - _THROUGH * options.max_depth_difference)
        sure = sample(depth_map.confidence, u[farther], v[farther], cv2.INTER_NEAREST) >= options.min_confidence
        sums.seen_through[block.start + seen[farther][sure]] = True
        agrees = error < 1
        which, u, v = block.start + seen[agrees], u[agrees], v[agrees]
        weight = np.maximum(sample(depth_map.confidence, u, v, cv2.INTER_NEAREST), _LEAST_WEIGHT)
        sums.points[:, which] += points[:, agrees] * weight
        sums.colours[:, which] += sample(depth_map.colours, u, v, cv2.INTER_LINEAR).T * weight
        sums.weight[which] += weight
        sums.views[which] += 1


def _blocks(count: int) -> Iterator[slice]:
    for start in range(0, count, _BLOCK):
        yield slice(start, min(start + _BLOCK, count))


def _pixel_centres(index: np.ndarray, width: int) -> tuple[np.ndarray, np.ndarray]:
    row, column = np.divmod(index, width)
    return (column + 0.5).astype(np.float32), (row + 0.5).astype(np.float32)


def _project(
    view: View, inverse_depth: np.ndarray, index: np.ndarray, other: View
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which of n pixels fall into the picture of `other`, as positions in the list (m,), and where: u, v (m,)."""
    matrix, offset = _transfer(view, other)
    u, v = _pixel_centres(index, view.width)
    x, y, z = (a * u + b * v + c + d * inverse_depth for (a, b, c), d in zip(matrix, offset, strict=True))
    in_front = np.flatnonzero(z > 0)
    u, v = x[in_front] / z[in_front], y[in_front] / z[in_front]
    inside = (u > 0) & (u < other.width) & (v > 0) & (v < other.height)
    return in_front[inside], u[inside], v[inside]


def _depth_in(view: View, inverse_depth: np.ndarray, index: np.ndarray, other: View) -> np.ndarray:
    """z-depth (m,) that the points of m pixels have in `other`."""
    matrix, offset = _transfer(view, other)
    u, v = _pixel_centres(index, view.width)
    depth: np.ndarray = (matrix[2, 0] * u + matrix[2, 1] * v + matrix[2, 2]) / inverse_depth + offset[2]
    return depth


def _disagreement(
    view: View, inverse_depth: np.ndarray, index: np.ndarray, other: View, other_u: np.ndarray, other_v: np.ndarray,
    found: np.ndarray, options: Options,
) -> tuple[np.ndarray, np.ndarray]:
    """How far the surface that `other` has is from each of m pixels, by the larger of reprojection error and relative
    depth difference, in units of their limits (NaN: none there); and its points (3,m) as (u z, v z, z) in `view`."""
    matrix, offset = _transfer(other, view)
    with np.errstate(invalid="ignore", divide="ignore"):
        points = np.stack([(a * other_u + b * other_v + c) / found + d
                           for (a, b, c), d in zip(matrix, offset, strict=True)])
        u, v = _pixel_centres(index, view.width)
        reprojection = np.hypot(points[0] / points[2] - u, points[1] / points[2] - v)
        difference = np.abs(points[2] * inverse_depth - 1)
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


def _normals(depth: np.ndarray, K: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Unit normals (3,n) in the camera frame, facing the camera, at rising flat pixels `index` of `depth` (H,W),
    NaN = none.

    The plane n X = 1 has inverse depth n K^-1 (u, v, 1): its slopes over u and v are those of inverse depth.
    """
    height, width = depth.shape
    inverse = np.pad(1 / depth, _NORMAL_RADIUS, constant_values=np.nan)
    slopes = np.empty((2, len(index)))
    band = max(1, _BLOCK // width)
    for top in range(0, height, band):
        rows = min(band, height - top)
        inside = slice(*np.searchsorted(index, (top * width, (top + rows) * width)))
        slopes[:, inside] = _slopes(inverse[top : top + rows + 2 * _NORMAL_RADIUS]).reshape(2, -1)[
            :, index[inside] - top * width
        ]
    row, column = np.divmod(index, width)
    constant = 1 / depth.ravel()[index] - slopes[0] * (column + 0.5) - slopes[1] * (row + 0.5)
    normals = -(K.T @ np.stack([*slopes, constant]))  # n X = 1 > 0 on the ray, so its negative faces the camera
    unit: np.ndarray = normals / np.linalg.norm(normals, axis=0)
    return unit


def _slopes(inverse: np.ndarray) -> np.ndarray:
    """Slopes (2,H,W) over u and v of inverse depth (H,W and a rim of the radius; NaN = none), by least squares over
    the neighbours on the same surface. A pixel with too few of them is taken to face the image plane."""
    radius = _NORMAL_RADIUS
    height, width = inverse.shape[0] - 2 * radius, inverse.shape[1] - 2 * radius
    centre = inverse[radius:-radius, radius:-radius]
    limit = _SAME_SURFACE * centre
    uu, uv, vv, uq, vq = np.zeros((5, height, width), np.float32)
    for dv in range(-radius, radius + 1):
        for du in range(-radius, radius + 1):
            step = inverse[radius + dv : radius + dv + height, radius + du : radius + du + width] - centre
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


def _finest_first(views: tuple[View, ...], workspace: Path, reporter: Reporter) -> list[View]:
    """The views by rising ground sampling distance (median depth over focal length), then by name."""

    def ground_sampling_distance(view: View) -> float:
        reporter.check_cancelled()
        depth, _ = read_depth(workspace, view)
        depth = depth[depth > 0]
        return float(np.median(depth) / view.K[0, 0]) if len(depth) else np.inf

    return sorted(views, key=lambda view: (ground_sampling_distance(view), view.name))


def _neighbours(views: tuple[View, ...]) -> dict[str, list[View]]:
    """For each view its overlaps, both ways: a pair listed by one of the two alone must not write a point twice."""
    by_name = {view.name: view for view in views}
    listed_by: dict[str, list[str]] = {name: [] for name in by_name}
    for name in sorted(by_name):
        for other in by_name[name].overlaps:
            listed_by.get(other, []).append(name)
    return {
        name: [by_name[other] for other in dict.fromkeys([*view.overlaps, *listed_by[name]])
               if other in by_name and other != name]
        for name, view in by_name.items()
    }


class _Cache:
    """Depth maps with their pictures, read when asked for; those used last are kept, up to a number of bytes.

    In a world with Z up the sky is left out of them.
    """

    def __init__(self, workspace: Path, limit: int, z_up: bool) -> None:
        self._workspace, self._limit, self._bytes, self._z_up = workspace, limit, 0, z_up
        self._entries: OrderedDict[str, _DepthMap] = OrderedDict()

    def __getitem__(self, view: View) -> _DepthMap:
        if view.name in self._entries:
            self._entries.move_to_end(view.name)
            return self._entries[view.name]
        entry = _read_depth_map(view, self._workspace, self._z_up)
        self._bytes += entry.nbytes
        while self._entries and self._bytes > self._limit:
            self._bytes -= self._entries.popitem(last=False)[1].nbytes
        self._entries[view.name] = entry
        return entry


def _read_depth_map(view: View, workspace: Path, z_up: bool) -> _DepthMap:
    depth, confidence = read_depth(workspace, view)
    path = workspace / view.image
    remedy = "Delete that file and run Reconstruct again."
    try:
        picture = images.read_rgb(path)
    except PhotoError as error:
        raise WorkspaceError(f"The undistorted picture {path} is missing or damaged.", remedy=remedy,
                             path=path) from error
    if picture.shape[:2] != depth.shape:
        raise WorkspaceError(f"{path} and its depth map differ in size.", remedy=remedy, path=path)
    inverse = np.full(depth.shape, np.nan, np.float32)
    np.divide(1, depth, out=inverse, where=depth > 0)
    confidence = np.nan_to_num(confidence.astype(np.float32))
    if z_up:
        sky = sky_mask(picture, confidence, view.K, view.cam_from_world)
        inverse[sky], confidence[sky] = np.nan, 0
    return _DepthMap(inverse, confidence, picture)
