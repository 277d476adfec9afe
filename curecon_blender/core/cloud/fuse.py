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

A point is kept on its evidence (Sums.evidence): how sure the views are that agree, and how far apart their rays are.
Two sure photos from different sides are enough; three unsure ones from one side are not. Neither is a point kept that
surer photos look through. Where N_c (`Options.min_views`) is given, it alone decides: so many views must agree, the
reference among them, as `Cloud.views` counts and Vis-MVSNet's filter does.

A reference is fused in bands of rows, and the depth maps of other photos wait in a cache: both are as large as the
memory budget allows, and the cloud is the same for any. The depths accepted wait on disk (4 bytes a pixel until the
end).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..base import memory
from ..base.errors import CuReconError
from ..base.files import disk_errors, scratch_folder
from ..base.language import Text
from ..base.messages import Reporter
from ..base.options import Options
from ..base.records import Component, View
from .agreement import BLOCK, Pixels, Sums, are_duplicates, confirm, meet
from .depth_maps import BYTES_PER_PIXEL, DepthMap, DepthMaps, finest_first
from .normals import RADIUS, normals
from .ply import Cloud, CloudWriter
from .precision import SparsePrecision

_SPARSE = 16  # one pixel in so many, along rows and columns, tells whether two pictures have anything in common
# By precision and recall on rendered flights (docs/design/fusion_and_surface.md).
_EVIDENCE = 0.005  # of two sure photos whose rays are 4 degrees apart, of two of confidence 0.5 at 16 degrees
_THROUGH = 1 / 3  # of the confidence of those that agree: more must not look through a point
# Peak memory, measured (benchmarks/scale.py): fixed; for each pixel of the largest depth map, besides what is kept of
# it, while one is read and its sky is found; and for each pixel of a band.
BASE_BYTES, READING_BYTES, BAND_BYTES = 300 << 20, 10, 55
MOST_CACHE = 2 << 30  # bytes: the dozen neighbours of a photo of 20 megapixels; of larger ones, reading is a small part
LEAST_BAND = 1 << 20  # pixels: smaller bands would read the neighbours again and again


class NoPointsError(CuReconError):
    """Not one point of a component was seen alike by enough views."""

    exit_code = 8
    kind = "fusion"


@dataclass(frozen=True)
class Plan:
    """How a memory budget is used: pixels of a band, and bytes of depth maps that are kept."""

    band: int
    cache: int


def plan(pixels: Iterable[float], budget: int) -> Plan:
    """For views of so many pixels: half of what one reference and one neighbour leave is for a band, the rest for
    more neighbours. A budget that is too small for one neighbour and LEAST_BAND is exceeded."""
    sizes = [round(count) for count in pixels]
    largest = max(sizes)
    left = budget - BASE_BYTES - largest * (2 * BYTES_PER_PIXEL + READING_BYTES)
    band = min(max(left // 2 // BAND_BYTES, LEAST_BAND), largest)
    more = min(left - band * BAND_BYTES, MOST_CACHE, sum(sizes) * BYTES_PER_PIXEL)
    return Plan(band, largest * BYTES_PER_PIXEL + max(more, 0))


def peak_bytes(pixels: Iterable[float], budget: int) -> int:
    """Memory that fusion takes of views of so many pixels, with the budget given."""
    sizes = [round(count) for count in pixels]
    planned = plan(sizes, budget)
    kept = min(planned.cache + max(sizes) * BYTES_PER_PIXEL, sum(sizes) * BYTES_PER_PIXEL)  # with the reference
    return BASE_BYTES + max(sizes) * READING_BYTES + kept + planned.band * BAND_BYTES


def fuse(component: Component, workspace: Path, options: Options, reporter: Reporter) -> int:
    """Fuse the depth maps of `component` into its cloud (PLY, site frame, site units); returns the number of points.

    Reads `depth/NAME.npz` and the undistorted pictures of the workspace, all of the size that their View gives.
    Progress is in percent. Confidence of a point: the mean over the views that agree on it. Raises WorkspaceError
    for a depth map or picture that is missing, damaged or of another camera, and NoPointsError when too few views
    agree anywhere; a cloud from an earlier run is then left as it was.
    """
    min_views = options.min_views
    if len(component.views) < (min_views or 3):
        min_views = len(component.views)
        reporter.warning(Text("Only {} photos hang together here: points need no more than their agreement.",
                              min_views))
    planned = plan((view.width * view.height for view in component.views), memory.budget(options))
    order = finest_first(component.views, workspace, reporter)
    neighbours = _neighbours(component.views)
    with scratch_folder(workspace / "fusion") as folder, CloudWriter(
        workspace / component.cloud, component.frame.shift
    ) as writer:
        depth_maps = DepthMaps(workspace, planned.cache, folder, z_up=component.frame.up != "given")
        precision = SparsePrecision(workspace / component.sparse, component.views)
        job = _Job(depth_maps, writer, precision, options, min_views, reporter)
        fused: list[tuple[View, Path]] = []  # views done, with the file of what they accepted
        for number, view in enumerate(order):
            near, file = neighbours[view.name], folder / f"{number}.accepted"
            reporter.progress(100 * number // len(order), 100)
            depth_map = depth_maps[view]
            reference = _Reference(view, depth_map, near, _known_before(view, depth_map, near, fused), file)
            rows = max(1, planned.band // view.width)
            for top in range(0, view.height, rows):
                bottom = min(top + rows, view.height)
                for share in _fuse_band(reference, top, bottom, job):
                    done = number + (top + share * (bottom - top)) / view.height
                    reporter.progress(int(100 * done / len(order)), 100)
            fused.append((view, file))
        reporter.progress(100, 100)
        if writer.count == 0:
            raise NoPointsError(
                Text("Too few views agree: none of the {} photos' depth has a point that {} of them see at the same "
                     "place with confidence {:g}.", len(order), min_views or 2, options.min_confidence),
                remedy="Take photos that overlap more, or try again with a lower minimum confidence or fewer "
                "confirming views.",
                path=workspace / component.cloud,
            )
    return writer.count


@dataclass(frozen=True)
class _Job:
    """What all references of a component are fused with."""

    depth_maps: DepthMaps
    writer: CloudWriter
    precision: SparsePrecision
    options: Options
    min_views: int | None  # None: by the evidence
    reporter: Reporter


@dataclass(frozen=True)
class _Reference:
    """A view to fuse: its neighbours, the views fused before that may know its points, with the files of what they
    accepted, and the file that takes what it accepts: inverse depth (H,W) float32, NaN = none."""

    view: View
    depth_map: DepthMap
    near: list[View]
    before: list[tuple[View, Path]]
    accepted: Path

    def pixels(self, top: int, bottom: int, least: float) -> tuple[Pixels, np.ndarray]:
        """The pixels of some rows that have depth of at least such a confidence; and which they are, (n,) bool."""
        flat = slice(top * self.view.width, bottom * self.view.width)
        inverse_depth = self.depth_map.inverse_depth.ravel()
        found = self.depth_map.confidence.ravel()[flat].astype(np.float32) >= least
        found &= ~np.isnan(inverse_depth[flat])
        index = np.flatnonzero(found)
        index += flat.start
        return Pixels(self.view, index, inverse_depth[index]), found


def _known_before(
    view: View, depth_map: DepthMap, near: list[View], fused: list[tuple[View, Path]]
) -> list[tuple[View, Path]]:
    """Those of the views fused that overlap a view, neighbours first: they know most duplicates, so that little is
    left to ask of the others."""
    row, column = np.mgrid[: view.height : _SPARSE, : view.width : _SPARSE]
    index = (row * view.width + column).ravel()
    inverse_depth = depth_map.inverse_depth.ravel()[index]
    with_depth = ~np.isnan(inverse_depth)
    few = Pixels(view, index[with_depth], inverse_depth[with_depth])
    names = {other.name for other in near}
    return ([pair for pair in fused if pair[0].name in names]
            + [pair for pair in fused if pair[0].name not in names and meet(few, pair[0])])


def _fuse_band(reference: _Reference, top: int, bottom: int, job: _Job) -> Iterator[float]:
    """Write the new points of some rows of a reference; yields, now and then, the share that is done."""
    view, options, reporter = reference.view, job.options, job.reporter
    # With the rows around them, which normals are made of.
    first, last = max(top - RADIUS, 0), min(bottom + RADIUS, view.height)
    fresh, candidates = reference.pixels(first, last, options.min_confidence)
    for other, known in reference.before:
        accepted = np.memmap(known, np.float32, "r", shape=(other.height, other.width))
        fresh = fresh[~are_duplicates(fresh, other, accepted, options, reporter)]
    sums = Sums.of(fresh, reference.depth_map, reporter)
    for number, other in enumerate(reference.near):
        yield number / len(reference.near)
        confirm(fresh, other, job.depth_maps[other], sums, options, reporter)
    band = _Band(reference, first, last, candidates, fresh, sums, _is_known(sums, job))
    strip = max(1, BLOCK // view.width)
    with disk_errors(reference.accepted), open(reference.accepted, "ab") as file:
        for start in range(top, bottom, strip):
            reporter.check_cancelled()
            stop = min(start + strip, bottom)
            cloud = band.cloud(start, stop)
            job.writer.write(replace(cloud, sigmas=job.precision.sigmas(cloud.points, cloud.confidence, cloud.views)))
            file.write(band.accepted(start, stop).data)


def _is_known(sums: Sums, job: _Job) -> np.ndarray:
    """Which of n points (n,) bool there is enough evidence for."""
    if job.min_views is not None:
        known: np.ndarray = sums.views >= job.min_views
    else:
        known = (sums.evidence() >= _EVIDENCE) & (sums.through <= _THROUGH * sums.weight)
    return known


@dataclass(frozen=True)
class _Band:
    """Rows `first` to `last` of a reference with what its neighbours say of them.

    `candidates` (n,) bool: which of their pixels have depth that is sure enough. Of the m of these that no view before
    accepted (`fresh`), `sums` and whether to `keep` them (m,) bool.
    """

    reference: _Reference
    first: int
    last: int
    candidates: np.ndarray
    fresh: Pixels
    sums: Sums
    keep: np.ndarray

    def cloud(self, top: int, bottom: int) -> Cloud:
        """The points of rows that are RADIUS or more away from those without a neighbour in the band."""
        view, sums = self.reference.view, self.sums
        kept = self._fresh_in(top, bottom)
        kept = kept[self.keep[kept]]
        weight, views = sums.weight[kept], sums.views[kept]
        rotation, translation = view.cam_from_world[:, :3], view.cam_from_world[:, 3]
        in_camera = np.linalg.inv(view.K) @ (sums.points[:, kept] / weight)
        above = max(top - RADIUS, self.first)
        depth = self._depth(above, min(bottom + RADIUS, self.last))
        return Cloud(
            points=(rotation.T @ (in_camera - translation[:, None])).T.astype(np.float32),
            colours=np.rint(sums.colours[:, kept] / weight).T.astype(np.uint8),
            normals=(rotation.T @ normals(depth, above, view.K, self.fresh.index[kept])).T.astype(np.float32),
            confidence=np.minimum(weight / views, 1).astype(np.float32),
            views=np.minimum(views, 255).astype(np.uint8),
        )

    def accepted(self, top: int, bottom: int) -> np.ndarray:
        """Inverse depth (h,W) float32 of rows where it is accepted, elsewhere NaN."""
        rejected = self._fresh_in(top, bottom)
        rejected = rejected[~self.keep[rejected]]
        width = self.reference.view.width
        inverse_depth = self._candidates(top, bottom)
        inverse_depth[self.fresh.index[rejected] - top * width] = np.nan
        return inverse_depth.reshape(-1, width)

    def _depth(self, top: int, bottom: int) -> np.ndarray:
        """Depth (h,W) float32 of rows, NaN = none: the mean of the views that agree, where they were asked."""
        fresh = self._fresh_in(top, bottom)
        width = self.reference.view.width
        depth = 1 / self._candidates(top, bottom)
        depth[self.fresh.index[fresh] - top * width] = self.sums.points[2, fresh] / self.sums.weight[fresh]
        return depth.reshape(-1, width)

    def _candidates(self, top: int, bottom: int) -> np.ndarray:
        """Inverse depth of the candidates among the pixels of rows, elsewhere NaN; flat."""
        width = self.reference.view.width
        rows = self.candidates[(top - self.first) * width : (bottom - self.first) * width]
        return np.where(rows, self.reference.depth_map.inverse_depth[top:bottom].ravel(), np.float32(np.nan))

    def _fresh_in(self, top: int, bottom: int) -> np.ndarray:
        """Places in `fresh` of the pixels of rows."""
        width = self.reference.view.width
        return np.arange(*np.searchsorted(self.fresh.index, (top * width, bottom * width)))


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
