# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The figures of a part, from the files of its workspace."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

from ..adjust.precision_record import Precision, read_precision
from ..adjust.record import Accuracy, PhotoResidual, PointResidual, read_accuracy
from ..base.errors import WorkspaceError
from ..base.ground import LEVEL, lowest_wide_level
from ..base.language import Text
from ..base.messages import Reporter
from ..base.records import Component, Frame, Photo, View
from ..cloud.edits import read_removed
from ..cloud.ply import Cloud, read_cloud
from ..surface.mesh import Mesh, filled_share, mesh_file, read_mesh, textured_folder, unseen_share, weak_share
from ..surface.triangles import triangle_areas
from ..views import sparse_points
from .figures import (
    Authenticity,
    Camera,
    Clearness,
    Correctness,
    Integrity,
    Lens,
    Part,
    Residuals,
    Sigmas,
    Spread,
    Survey,
)
from .likeness import Likeness, compare
from .observations import Pattern, TiePoints, observe

MOST_OF = 75  # percent of a kind's points whose standard deviation speaks for it
SEEN_WELL = 3  # photos that must see a surface for it to count as well seen
CELLS = 400  # along the longest side of the site: cells of its surface, so that dense parts count no more than others
SCALES = (20, 50, 100, 200, 500, 1000)  # of drawings
ON_PAPER = 0.3e-3  # metres that a line of a drawing may be off, one sigma
PIXEL_ON_PAPER = 0.25e-3  # metres: a photo's pixel in the drawing; a coarser one shows
NEAR = 2.5  # times the points' median distance from the site's middle: land farther off is not the subject
LEAST_SHARE = 0.03  # of the surface that a kind must have to be named
FEWEST_TESTS = 3  # check points whose common shift can be told from what they are off otherwise
_WALL, _ROOF = 0.5, 2.0  # |z| of a wall's normal at most; metres above the ground from where on a flat thing is a roof
WALLS, ROOFS, GROUND = "walls", "roofs", "ground"


@dataclass(frozen=True)
class Standing:
    """How a part stands, as reconstructed or put right since by what was measured on it: its frame's record, the (4,4)
    that takes the reconstructed frame to it, and the relative standard deviation of a scale that was measured."""

    frame: Frame
    matrix: np.ndarray
    scale_sigma: float | None = None

    @property
    def linear(self) -> np.ndarray:
        """(3,3) scale and turn."""
        return np.asarray(self.matrix[:3, :3])

    @property
    def scale(self) -> float:
        return float(np.cbrt(np.linalg.det(self.linear)))

    def places(self, points: np.ndarray) -> np.ndarray:
        """Places (N,3) in the frame as it stands, in their own precision."""
        return (points @ self.linear.T + self.matrix[:3, 3]).astype(points.dtype)

    def cloud(self, cloud: Cloud) -> Cloud:
        if np.array_equal(self.matrix, np.eye(4)):
            return cloud
        return replace(
            cloud, points=self.places(cloud.points),
            normals=(cloud.normals @ (self.linear / self.scale).T).astype(np.float32),
            sigmas=np.sqrt(cloud.sigmas**2 @ (self.linear**2).T).astype(np.float32),
        )


@dataclass(frozen=True)
class Site:
    """The figures of a part, and what its pictures are drawn of: the points of its subject, its mesh, where its cameras
    stand and how far each is off its GPS (N,3), nan where it has none, the lenses' residuals, and how like the photos
    the textured mesh is; and the part itself with the widths of its photos, and how it stands."""

    part: Part
    cloud: Cloud
    mesh: Mesh | None
    cameras: np.ndarray
    off_gps: np.ndarray
    patterns: list[Pattern]
    likeness: Likeness | None
    component: Component
    widths: dict[str, int]
    standing: Standing


def measure(
    component: Component, photos: Sequence[Photo], workspace: Path, standing: Standing, reporter: Reporter
) -> Site:
    """The figures of a part whose cloud is finished. Raises WorkspaceError and SparseError for what is missing or
    damaged, and Cancelled."""
    path = workspace / component.cloud
    cloud = standing.cloud(read_cloud(path))
    removed = read_removed(path, len(cloud))
    kept = cloud if removed is None else cloud.take(~removed)
    if not len(kept):
        raise WorkspaceError(Text("All points of {} were removed by hand.", path), path=path,
                             remedy="Take points back in, or run Reconstruct again.")
    near, reach = subject(kept.points)
    shown = kept.take(near)
    bare = workspace / mesh_file(component.index)
    mesh = read_mesh(bare) if bare.exists() else None
    painted = workspace / textured_folder(component.index) / "mesh.ply"
    textured = read_mesh(painted) if painted.exists() else None
    tied, patterns = observe(workspace / component.sparse)
    reporter.check_cancelled()
    likeness = None if textured is None else compare(textured, component, workspace, reporter)
    pixel = ground_sampling(component, photos, workspace, standing.scale)
    correctness = _correctness(component, photos, shown, pixel, workspace, standing, patterns)
    filled = None if mesh is None else filled_share([mesh])
    taken = [photo for photo in photos if photo.name in {view.name for view in component.views}]
    kinds = kinds_of_surface(shown)
    part = Part(
        index=component.index, points=len(kept), faces=0 if mesh is None else len(mesh.faces), reach=reach,
        survey=_survey(component, taken, shown, standing, tied),
        clearness=Clearness(
            pixel=pixel, blurred=sum(photo.blurred for photo in taken),
            texel=None if textured is None else texel_size(textured, painted.parent) * standing.scale,
        ),
        correctness=correctness,
        integrity=Integrity(
            placed=len(component.views), photos=len(photos), seen_well=seen_well(shown), filled=filled,
            seen_by_kind={kind: seen_well(shown.take(which)) for kind, which in kinds.items()},
        ),
        authenticity=Authenticity(
            filled=filled, weak=None if mesh is None else weak_share([mesh]),
            unseen=None if textured is None else unseen_share([textured]),
            removed_points=len(cloud) - len(kept), compared=0 if likeness is None else len(likeness.psnr),
            likeness=None if likeness is None or not likeness.psnr else spread(np.array(likeness.psnr)),
        ),
    )
    off = {one.name: one.off for one in correctness.gps.of} if correctness.gps else {}
    return Site(
        part, shown, None if mesh is None else replace(mesh, vertices=standing.places(mesh.vertices)),
        standing.places(np.array([view.centre for view in component.views])),
        np.array([off.get(view.name, (np.nan,) * 3) for view in component.views]), patterns, likeness,
        component, {photo.name: photo.width for photo in photos}, standing,
    )


def subject(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Which of points (N,3) belong to the subject, and how far from the middle it reaches, in plan."""
    distance = np.linalg.norm(points[:, :2] - np.median(points[:, :2], axis=0), axis=1)
    reach = NEAR * float(np.median(distance))
    return distance <= reach, reach


def _survey(
    component: Component, taken: Sequence[Photo], cloud: Cloud, standing: Standing, tied: TiePoints
) -> Survey:
    heights = standing.places(np.array([view.centre for view in component.views]))[:, 2]
    level = np.abs(cloud.normals[:, 2]) > LEVEL
    z = cloud.points[:, 2]
    ground = lowest_wide_level(z, z[level] if level.any() else None)
    cell = max(float(np.ptp(cloud.points[:, :2], axis=0).max()) / CELLS, 1e-9)
    cells = np.unique(np.floor(cloud.points[:, :2] / cell).astype(np.int64), axis=0)
    of_camera: dict[str, list[Photo]] = {}
    for photo in taken:
        of_camera.setdefault(photo.camera, []).append(photo)
    times = sorted(photo.time for photo in taken if photo.time)
    return Survey(
        taken=(times[0], times[-1]) if times else None, above=float(np.median(heights)) - ground,
        area=len(cells) * cell**2, tied=tied,
        cameras=tuple(Camera(name=name, size=(mine[0].width, mine[0].height), photos=len(mine), focal=mine[0].focal_px)
                      for name, mine in of_camera.items()),
    )


def ground_sampling(component: Component, photos: Sequence[Photo], workspace: Path, scale: float) -> Spread:
    """How much of the site a photo's pixel shows, from the sparse points that each photo has matched; `scale` takes the
    component's unit to the one that is wanted."""
    widths = {photo.name: photo.width for photo in photos}
    sizes = []
    for view in component.views:
        points = sparse_points.read(workspace, view)
        matched = points[points[:, 3] > 0, 2]
        focal = view.K[0, 0] * widths.get(view.name, view.width) / view.width
        sizes.append(matched * scale / focal)
    return spread(np.concatenate(sizes))


def finest_pixels(site: Site, points: np.ndarray) -> np.ndarray:
    """What a pixel of the photo that shows a point (N,3) finest shows there, (N,) in the part's unit, whatever stands
    between them; the coarsest of all where it lies in no photo."""
    places = np.linalg.solve(site.standing.matrix, np.column_stack([points, np.ones(len(points))]).T).T[:, :3]
    finest = np.full(len(points), np.inf, np.float32)
    for view in site.component.views:
        depth, inside = _seen(places, view)
        focal = view.K[0, 0] * site.widths.get(view.name, view.width) / view.width
        finest[inside] = np.minimum(finest[inside], depth[inside] * site.standing.scale / focal)
    known = np.isfinite(finest)
    return np.where(known, finest, finest[known].max() if known.any() else 0)


def _seen(places: np.ndarray, view: View) -> tuple[np.ndarray, np.ndarray]:
    """Depths (N,) of places (N,3) from a view, and which lie in its picture."""
    camera = places @ view.cam_from_world[:, :3].T + view.cam_from_world[:, 3]
    depth = camera[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels = (camera @ view.K.T)[:, :2] / depth[:, None]
        inside = (depth > 0) & (pixels >= 0).all(axis=1) & (pixels < (view.width, view.height)).all(axis=1)
    return depth, inside


def spread(values: np.ndarray) -> Spread:
    low, median, high = np.percentile(values, [5, 50, 95]).tolist() if len(values) else (0.0, 0.0, 0.0)
    return Spread(low=low, median=median, high=high)


def texel_size(mesh: Mesh, folder: Path) -> float:
    """The side of the texture's typical texel on the surface: the median over the faces' area."""
    assert mesh.uv is not None and mesh.page is not None
    sizes = []
    for page in mesh.pages:
        with Image.open(folder / page) as picture:
            sizes.append(picture.size)
    corners = mesh.uv * np.array(sizes, float)[mesh.page][:, None]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    texels = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / 2
    areas = triangle_areas(mesh.vertices[mesh.faces])
    side = np.sqrt(areas / np.maximum(texels, 1e-9))
    order = np.argsort(side)
    return float(side[order][np.searchsorted(np.cumsum(areas[order]), areas.sum() / 2)])


def surface_cells(points: np.ndarray) -> np.ndarray:
    """(N,) the number of the cell of the surface that each point lies in."""
    low, high = np.percentile(points, [0.5, 99.5], axis=0)
    cell = max(float((high - low).max()) / CELLS, 1e-9)
    places = np.clip((points - low) / cell, -1, CELLS + 1).astype(np.int64) + 1
    number = (places[:, 0] * (CELLS + 3) + places[:, 1]) * (CELLS + 3) + places[:, 2]
    result: np.ndarray = np.unique(number, return_inverse=True)[1].ravel()
    return result


def seen_well(cloud: Cloud) -> float:
    """The share of the surface that at least SEEN_WELL photos see."""
    cells = surface_cells(cloud.points)
    most = np.zeros(cells.max() + 1, np.uint8)
    np.maximum.at(most, cells, cloud.views)
    return float((most >= SEEN_WELL).mean())


def kinds_of_surface(cloud: Cloud) -> dict[str, np.ndarray]:
    """Which points (N,) bool are walls, roofs and ground, for the kinds that are there."""
    steep = np.abs(cloud.normals[:, 2]) <= _WALL
    high = cloud.points[:, 2] > _ROOF
    kinds = {WALLS: steep, ROOFS: ~steep & high, GROUND: ~steep & ~high}
    return {kind: which for kind, which in kinds.items() if which.mean() >= LEAST_SHARE}


def _correctness(
    component: Component, photos: Sequence[Photo], cloud: Cloud, pixel: Spread, workspace: Path, standing: Standing,
    patterns: Sequence[Pattern],
) -> Correctness:
    frame, sparse = standing.frame, workspace / component.sparse
    precision, accuracy = read_precision(sparse), read_accuracy(sparse)
    told = accuracy or Accuracy(adjusted=False, reprojection_error=0.0)
    check, left_out = _residuals(told.check, standing), _residuals(told.left_out, standing)
    supports: dict[str, int | None] = {}
    for kind, which in kinds_of_surface(cloud).items():
        sigma = float(np.percentile(cloud.sigmas[which].max(axis=1), MOST_OF))
        known = frame.scale == "metres" and sigma > 0
        supports[kind] = supported_scale(max(sigma, sigma_shown(check or left_out)), pixel.median) if known else None
    scale = standing.scale_sigma
    if scale is None and precision is not None and precision.held:
        scale = float(precision.datum_sigmas[6])
    extent = float(np.ptp(np.percentile(cloud.points, [1, 99], axis=0), axis=0).max())
    return Correctness(
        rests_on=frame.note, doubt=frame.doubt, metres=frame.scale == "metres", north=frame.north,
        adjusted=told.adjusted, reprojection_error=None if accuracy is None else accuracy.reprojection_error,
        lenses=_lenses(told, photos, patterns), domes=told.domes, focal_sigma=told.focal_sigma,
        shutter_shift=told.shutter_shift, gps=_residuals(told.gps, standing),
        control=_residuals(told.control, standing), check=check, left_out=left_out,
        sigmas=_sigmas(cloud, precision, standing), scale=scale, extent=extent, supports=supports,
    )


def _lenses(told: Accuracy, photos: Sequence[Photo], patterns: Sequence[Pattern]) -> tuple[Lens, ...]:
    cameras = {photo.name: photo.camera for photo in photos}
    found = told.lenses if len(told.lenses) == len(patterns) else (None,) * len(patterns)
    return tuple(Lens(camera=cameras.get(pattern.photo, ""), found=one, rms=pattern.rms)
                 for pattern, one in zip(patterns, found, strict=True))


def _residuals(
    found: Sequence[PhotoResidual | PointResidual], standing: Standing
) -> Residuals | None:
    """Residuals along the axes as they stand."""
    if not found:
        return None
    off = np.array([residual.off for residual in found]) @ standing.linear.T
    east, north, up = np.sqrt((off**2).mean(axis=0)).tolist()
    moved = tuple(replace(one, off=tuple(axes)) for one, axes in zip(found, off.tolist(), strict=True))
    return Residuals(count=len(found), rms=(east, north, up), of=moved)


def sigma_shown(points: Residuals | None) -> float:
    """The standard deviation, along the worst axis, of what points are off that took no part; 0 where there are none. A
    shift that they have in common moves the site and bends no drawing, where they are enough to tell it."""
    if points is None:
        return 0.0
    off = np.array([one.off for one in points.of])
    if len(off) < FEWEST_TESTS:
        return max(points.rms)
    return float(off.std(axis=0, ddof=1).max())


def _sigmas(cloud: Cloud, precision: Precision | None, standing: Standing) -> Sigmas | None:
    if precision is None or not cloud.sigmas.any():
        return None
    x, y, z = np.median(cloud.sigmas, axis=0).tolist()
    moved = precision.moved(standing.scale, standing.linear / standing.scale, standing.matrix[:3, 3])
    cx, cy, cz = np.median(np.sqrt(np.diagonal(moved.centres, axis1=1, axis2=2)), axis=0).tolist()
    east, north, up = moved.datum_sigmas[:3].tolist()
    return Sigmas(within=(max(x, y), z), cameras=(max(cx, cy), cz),
                  whole=(max(east, north), up) if precision.held else None)


def supported_scale(sigma: float, pixel: float) -> int | None:
    """The largest scale of a drawing that points of this sigma and photos of this pixel carry, both in metres."""
    return next((scale for scale in SCALES if sigma <= ON_PAPER * scale and pixel <= PIXEL_ON_PAPER * scale), None)
