# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the report tells in figures, each traced to a file of the workspace. Lengths are in the part's own units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from ..adjust.precision_record import Precision, read_precision
from ..adjust.record import Accuracy, PhotoResidual, PointResidual, read_accuracy
from ..base.records import Component, Photo
from ..cloud.edits import read_removed
from ..cloud.ply import Cloud, read_cloud
from ..surface.mesh import Mesh, filled_share, mesh_file, read_mesh, textured_folder
from ..surface.triangles import triangle_areas
from ..views import sparse_points

MOST_OF = 75  # percent of a kind's points whose standard deviation speaks for it
SEEN_WELL = 3  # photos that must see a surface for it to count as well seen
CELLS = 400  # along the longest side of the site: cells of its surface, so that dense parts count no more than others
SCALES = (20, 50, 100, 200, 500, 1000)  # of drawings
ON_PAPER = 0.3e-3  # metres that a line of a drawing may be off, one sigma
PIXEL_ON_PAPER = 0.25e-3  # metres: a photo's pixel in the drawing; a coarser one shows
NEAR = 2.5  # times the points' median distance from the site's middle: land farther off is not the subject
LEAST_SHARE = 0.03  # of the surface that a kind must have to be named
_WALL, _ROOF = 0.5, 2.0  # |z| of a wall's normal at most; metres above the ground from where on a flat thing is a roof
WALLS, ROOFS, GROUND = "walls", "roofs", "ground"


@dataclass(frozen=True, kw_only=True)
class Spread:
    """The 5th, 50th and 95th percentile of something."""

    low: float
    median: float
    high: float


@dataclass(frozen=True, kw_only=True)
class Clearness:
    """`pixel`: the ground sampling distance of the photos; `texel` of the texture; photos that are blurred."""

    pixel: Spread
    texel: float | None
    blurred: int


@dataclass(frozen=True, kw_only=True)
class Residuals:
    """Of `count` places, RMS east, north and up."""

    count: int
    rms: tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Sigmas:
    """Standard deviations in plan (each axis) and in height: of a point `within` the site, the median; of the site as a
    `whole`, and its `scale`, relative; None where nothing but the photos says where it stands."""

    within: tuple[float, float]
    whole: tuple[float, float] | None
    scale: float | None


@dataclass(frozen=True, kw_only=True)
class Correctness:
    """What the lengths rest on, and how well that agrees. Check points took no part in the adjustment; `left_out` are
    control points, each off as the cameras are without it. `supports` is, for each kind of surface, the largest scale
    (its denominator) of a drawing that the figures carry; None where none does or nothing is known."""

    rests_on: str
    doubt: str
    metres: bool
    adjusted: bool
    reprojection_error: float | None
    gps: Residuals | None
    control: Residuals | None
    check: Residuals | None
    left_out: Residuals | None
    sigmas: Sigmas | None
    supports: dict[str, int | None]


@dataclass(frozen=True, kw_only=True)
class Integrity:
    """Photos placed, of all; the share of the site's surface that at least SEEN_WELL photos see; and of the mesh's area
    that no photo measured."""

    placed: int
    photos: int
    seen_well: float
    filled: float | None


@dataclass(frozen=True, kw_only=True)
class Authenticity:
    """Shares of the mesh's area that no photo measured, and that no photo shows; points that the user removed."""

    filled: float | None
    unshown: float | None
    removed_points: int


@dataclass(frozen=True, kw_only=True)
class Part:
    """One part of the site, largest first. `points` and `faces` say how large it is; all other figures of its surface
    are of what lies within `reach` of its middle, in plan."""

    index: int
    points: int
    faces: int
    reach: float
    clearness: Clearness
    correctness: Correctness
    integrity: Integrity
    authenticity: Authenticity


@dataclass(frozen=True)
class Site:
    """The figures of a part, and what its maps are drawn of: the points of its subject, and its mesh."""

    part: Part
    cloud: Cloud
    mesh: Mesh | None


def measure(component: Component, photos: Sequence[Photo], workspace: Path) -> Site:
    """The figures of a part whose cloud is finished. Raises WorkspaceError for what is missing or damaged."""
    path = workspace / component.cloud
    cloud = read_cloud(path)
    removed = read_removed(path, len(cloud))
    kept = cloud if removed is None else cloud.take(~removed)
    near, reach = subject(kept.points)
    shown = kept.take(near)
    bare = workspace / mesh_file(component.index)
    mesh = read_mesh(bare) if bare.exists() else None
    painted = workspace / textured_folder(component.index) / "mesh.ply"
    textured = read_mesh(painted) if painted.exists() else None
    pixel = ground_sampling(component, photos, workspace)
    filled = None if mesh is None else filled_share([mesh])
    of_part = {view.name for view in component.views}
    return Site(Part(
        index=component.index, points=len(kept), faces=0 if mesh is None else len(mesh.faces), reach=reach,
        clearness=Clearness(
            pixel=pixel, texel=None if textured is None else texel_size(textured, painted.parent),
            blurred=sum(photo.blurred for photo in photos if photo.name in of_part),
        ),
        correctness=_correctness(component, shown, pixel, workspace / component.sparse),
        integrity=Integrity(placed=len(component.views), photos=len(photos), seen_well=seen_well(shown), filled=filled),
        authenticity=Authenticity(
            filled=filled, unshown=None if textured is None else filled_share([textured]),
            removed_points=len(cloud) - len(kept),
        ),
    ), shown, mesh)


def subject(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Which of points (N,3) belong to the subject, and how far from the middle it reaches, in plan."""
    distance = np.linalg.norm(points[:, :2] - np.median(points[:, :2], axis=0), axis=1)
    reach = NEAR * float(np.median(distance))
    return distance <= reach, reach


def ground_sampling(component: Component, photos: Sequence[Photo], workspace: Path) -> Spread:
    """How much of the site a photo's pixel shows, from the sparse points that each photo has matched."""
    widths = {photo.name: photo.width for photo in photos}
    sizes = []
    for view in component.views:
        points = sparse_points.read(workspace, view)
        matched = points[points[:, 3] > 0, 2]
        focal = view.K[0, 0] * widths.get(view.name, view.width) / view.width
        sizes.append(matched / focal)
    return spread(np.concatenate(sizes))


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


def _correctness(component: Component, cloud: Cloud, pixel: Spread, sparse: Path) -> Correctness:
    frame, precision = component.frame, read_precision(sparse)
    accuracy = read_accuracy(sparse)
    told = accuracy or Accuracy(adjusted=False, reprojection_error=0.0)
    supports: dict[str, int | None] = {}
    for kind, which in kinds_of_surface(cloud).items():
        sigma = float(np.percentile(cloud.sigmas[which].max(axis=1), MOST_OF))
        known = frame.scale == "metres" and sigma > 0
        supports[kind] = supported_scale(sigma, pixel.median) if known else None
    return Correctness(
        rests_on=frame.note, doubt=frame.doubt, metres=frame.scale == "metres", adjusted=told.adjusted,
        reprojection_error=None if accuracy is None else accuracy.reprojection_error, gps=_residuals(told.gps),
        control=_residuals(told.control), check=_residuals(told.check), left_out=_residuals(told.left_out),
        sigmas=_sigmas(cloud, precision), supports=supports,
    )


def _residuals(found: Sequence[PhotoResidual] | Sequence[PointResidual]) -> Residuals | None:
    if not found:
        return None
    east, north, up = np.sqrt((np.array([residual.off for residual in found]) ** 2).mean(axis=0)).tolist()
    return Residuals(count=len(found), rms=(east, north, up))


def _sigmas(cloud: Cloud, precision: Precision | None) -> Sigmas | None:
    if precision is None or not cloud.sigmas.any():
        return None
    x, y, z = np.median(cloud.sigmas, axis=0).tolist()
    east, north, up, *_, scale = precision.datum_sigmas.tolist()
    return Sigmas(within=(max(x, y), z), whole=(max(east, north), up) if precision.held else None,
                  scale=scale if precision.held else None)


def supported_scale(sigma: float, pixel: float) -> int | None:
    """The largest scale of a drawing that points of this sigma and photos of this pixel carry, both in metres."""
    return next((scale for scale in SCALES if sigma <= ON_PAPER * scale and pixel <= PIXEL_ON_PAPER * scale), None)
