# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The fused cloud to a surface: screened Poisson (Kazhdan and Hoppe 2013), cut back to what is known.

Poisson closes everything: it spans the sky between two roofs as readily as a missing roof tile. So it is told more than
the cloud holds, and each piece of its surface is asked what carries it:

* what two photos or more measured is *measured*, what one sure photo alone tells is *weak* (sight.py);
* where walls, roofs and ground go on over a gap that no photo looks through (continuation.py), walls that stand unseen
  under eaves (eaves.py), the ground of a site (terrain.py), and small flat pieces with supported surface all around,
  are *filled*;
* anything else (balloons, skirts beyond the site's edge, bags under eaves) is cut away, along an iso-line of how far
  the nearest point is (borders.py).

Lengths are in spacings: the local spacing is the side of the square that one point of the cloud has to itself.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np

from ..base.files import disk_errors
from ..base.language import Text
from ..base.messages import Reporter
from ..cloud.ply import Cloud, joined
from .borders import clip, smoothed
from .clean import clean, drop_small_parts, orient, worth_keeping
from .continuation import continued, over_wide_gaps
from .crossing import uncrossed
from .eaves import under_eaves
from .extent import FAR, NEAR, find_building, within
from .mesh import Mesh, MeshError
from .poisson import poisson, read_triangles, simplify, write_triangles
from .refine import refined
from .sight import Sight, weak_points
from .slivers import flipped
from .support import LEAST_POINTS, Support, median_spacing, remove_outliers, thin, usable_points
from .terrain import Outline, closed_ground

# More than that many points for each face that may stay do not show: they are thinned out, or a large site's mesh would
# need memory without end.
POINTS_A_FACE = 3
_FEWEST_FACES = 250_000  # a smaller face target gets the points and the octree of this one
_LARGEST_HOLE = 25.0  # median spacings from any measured point to the middle of a hole that is closed
_GAP_REACH = 2.5  # median spacings from the points that continue a gap to what closes it
_ROUNDING = 3  # rounds of averaging with the neighbours that make the surface's border smooth
_MARGIN = 10.0  # median spacings: what lies just outside of region or site still shapes the surface within


SHARES = (25, 35, 15, 15, 10)  # per cent of the time that each step takes
_PASSES = 7  # times that each depth map is read
WAITS = 15.0, 10.0  # seconds in which a million points go half through Poisson, and a million faces to fewer


@dataclass(frozen=True, kw_only=True)
class MeshOptions:
    """How the surface is made.

    `fill_holes`: close small holes and mark them as filled; False leaves them open, so that every face was measured.
    `extent`: "site", without the background that photos saw only from afar, its ground closed and its end smooth,
    "building", what stands on the ground of it, or "everything".
    `max_faces`: simplify to at most so many triangles. `region`: low and high corner of an upright box in the site
    frame; only surface inside it is made.
    """

    fill_holes: bool = True
    extent: str = "site"
    max_faces: int = 1_000_000
    region: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None


def most_points(max_faces: int) -> int:
    """How many points at most a mesh of so many faces is made of."""
    return int(POINTS_A_FACE * max(max_faces, _FEWEST_FACES))


def build_mesh(
    cloud: Cloud, options: MeshOptions, scratch: Path, reporter: Reporter, sight: Sight | None = None
) -> Mesh:
    """The surface of `cloud` (site frame) as triangles, with colour, support and what is filled; no UVs.

    `sight` are the photos' depth maps, in the cloud's axes: without them nothing is known of what is empty, holes are
    closed only where they are small and flat, and a warning says so.
    `scratch` is a folder for Poisson's and the simplification's files, which are deleted again; beside it Poisson's
    surface is kept until the mesh is finished, so that what is cancelled later goes on from there. Progress is in
    per cent. The mesh is finite, without degenerate faces or unused vertices, with at most two faces an edge, and faces
    look to where the cloud's normals look. Raises MeshError for options or a cloud that give no surface, and
    WorkspaceError for a full or read-only disk.
    """
    _check(options)
    reporter.progress(0, 100)
    if sight:
        sight.each = _counted(reporter, _PASSES * len(sight.views))
    cloud, local_spacing, thinned = _measured(cloud, options, sight, reporter)
    spacing = median_spacing(cloud.points)
    gaps, outline = _continued(cloud, spacing, options, sight, reporter)
    if outline is not None:
        held = outline.depths(cloud.points) > -_MARGIN * spacing
        cloud, local_spacing = cloud.take(held), local_spacing[held]
    if options.extent == "building":
        building, standing = find_building(cloud, sight.views if sight else (), spacing)
        cloud, local_spacing = cloud.take(standing), local_spacing[standing]
        gaps = gaps.take(building.holds(gaps.points, gaps.normals))
    support = Support(cloud, local_spacing, thinned, gaps.points, _GAP_REACH * spacing)
    _begin(reporter, 1)
    count = max(options.max_faces, _FEWEST_FACES)
    vertices, faces = _untrimmed(joined(cloud, gaps), spacing, count, scratch, reporter)
    _begin(reporter, 2)
    vertices, faces = _trimmed(vertices, faces, support, spacing, options, outline)
    _begin(reporter, 3)
    if len(faces) > options.max_faces:
        vertices, faces = _simplified(vertices, faces, spacing, options, scratch, reporter)
    if not len(faces):
        raise MeshError(
            "The cloud's points are too few or too scattered to carry a surface.",
            remedy="Reconstruct with a higher quality or more photos, or choose a larger region.",
        )
    _begin(reporter, 4)
    vertices, faces = _refined(vertices, faces, support, spacing, options)
    filled, weak = support.judged(vertices, faces)
    if not options.fill_holes and filled.any():  # faces that bridge a gap from one measured point to another
        vertices, faces = clean(vertices, faces[~filled], spacing)
        weak = support.judged(vertices, faces)[1]
        filled = np.zeros(len(faces), bool)
    mesh = support.with_attributes(vertices, orient(vertices, faces, support), filled, weak)
    for kept in scratch.parent.glob(".poisson_*.ply"):
        kept.unlink(missing_ok=True)
    reporter.progress(100, 100)
    return mesh


def _begin(reporter: Reporter, step: int, part: float = 0.0) -> None:
    """Tell that a step is so far: `part` in [0, 1] of it."""
    reporter.progress(int(sum(SHARES[:step]) + SHARES[step] * part), 100)


def _counted(reporter: Reporter, of: int) -> Callable[[], None]:
    """What tells that the first step is a little further, `of` times in all."""
    count = itertools.count(1)
    return lambda: _begin(reporter, 0, min(next(count) / of, 1.0))


class _Waiting(Reporter):
    """For a step that says nothing while it works: its progress moves with the time, ever slower, and never comes to
    its end by itself. `half` is how many seconds the first half usually takes."""

    def __init__(self, reporter: Reporter, step: int, half: float) -> None:
        super().__init__()
        self._outer, self._step, self._half, self._began = reporter, step, half, time.monotonic()

    def check_cancelled(self) -> None:
        _begin(self._outer, self._step, 1 - 0.5 ** ((time.monotonic() - self._began) / self._half))


def _untrimmed(
    cloud: Cloud, spacing: float, count: int, scratch: Path, reporter: Reporter
) -> tuple[np.ndarray, np.ndarray]:
    """Poisson's surface; that of an earlier run which was cut off, where its points were the same."""
    keep = scratch.parent
    digest = sha256(b"".join(array.tobytes() for array in (cloud.points, cloud.normals, np.array([spacing, count]))))
    kept = keep / f".poisson_{digest.hexdigest()[:16]}.ply"
    for other in {*keep.glob(".poisson_*.ply")} - {kept}:
        other.unlink(missing_ok=True)
    if kept.is_file():
        with suppress(ValueError):  # it was cut short
            vertices, faces = read_triangles(kept)
            if len(faces) and faces.min() >= 0 and faces.max() < len(vertices):
                return vertices, faces
    half = WAITS[0] * (len(cloud) / 1e6 + 0.1)
    vertices, faces = poisson(cloud, spacing, count, scratch, _Waiting(reporter, 1, half))
    with disk_errors(kept):
        write_triangles(kept, vertices, faces)
    return vertices, faces


def _check(options: MeshOptions) -> None:
    if options.max_faces < 1:
        raise MeshError(Text("A mesh of {} faces cannot be made.", options.max_faces),
                        remedy="Give a face target of at least 1; 1000000 suits most sites.")
    if options.region is not None:
        corners = np.array(options.region, float)
        if corners.shape != (2, 3) or not np.isfinite(corners).all() or not (corners[0] < corners[1]).all():
            raise MeshError(Text("The region {} is no box.", options.region),
                            remedy="Give its low and its high corner, each x, y, z, the high one larger in all three.")


def _measured(
    cloud: Cloud, options: MeshOptions, sight: Sight | None, reporter: Reporter
) -> tuple[Cloud, np.ndarray, float]:
    """The points that the surface is made of, the local spacing (n,) of each before they were thinned, and the side of
    the cubes that they were thinned by."""
    cloud = usable_points(cloud, reporter)
    if options.region is not None:
        cloud = _crop(cloud, np.array(options.region), _MARGIN * median_spacing(cloud.points))
    spacing = median_spacing(cloud.points)
    if sight:
        weak = weak_points(cloud, sight, spacing)
        reporter.log(f"{len(weak)} points are told by one photo alone.")
        cloud = joined(cloud, weak)
    elif sight is not None:
        reporter.warning("There are no depth maps: what photos looked through is not known, and only small flat holes "
                         "are closed.")
    if options.extent != "everything" and sight is not None:
        cloud = cloud.take(within(cloud.points, sight.views, spacing, FAR))
    cloud, local_spacing = remove_outliers(cloud, spacing)
    kept, side = thin(cloud, most_points(options.max_faces), reporter)
    return cloud.take(kept), local_spacing[kept], side


def _continued(
    cloud: Cloud, spacing: float, options: MeshOptions, sight: Sight | None, reporter: Reporter
) -> tuple[Cloud, Outline | None]:
    """Points (with 0 views) where surfaces go on that nobody measured, and where the site ends, if that is asked for
    and known."""
    gaps, outline = cloud.take(np.zeros(0, np.int64)), None
    if options.fill_holes and sight:
        subject = cloud.take(within(cloud.points, sight.views, spacing, NEAR))
        gaps = continued(subject, spacing, sight)
        if sight.z_up:
            walls = under_eaves(subject, gaps, spacing, sight)
            reporter.log(f"{len(walls)} points stand for walls under eaves that no photo saw.")
            gaps = joined(gaps, walls)
        # What was closed goes on as well, and the ground to walls under eaves.
        gaps = joined(gaps, continued(joined(subject, gaps), spacing, sight))
        if sight.z_up:
            gaps = joined(gaps, over_wide_gaps(joined(subject, gaps), spacing, sight))
        reporter.log(f"{len(gaps)} points continue walls, roofs and ground over gaps.")
    if options.extent == "site" and sight and sight.z_up:
        ground, site = closed_ground(cloud, gaps, spacing, sight)
        outline = site if options.region is None else None  # the region's own box says where it ends
        if options.fill_holes:
            gaps = joined(gaps, ground)
            reporter.log(f"{len(ground)} points close the ground.")
    return gaps, outline


def _crop(cloud: Cloud, region: np.ndarray, margin: float) -> Cloud:
    """The points within `margin` of the region (2,3). Raises MeshError when too few lie in it."""
    low, high = region
    inside = ((cloud.points >= low) & (cloud.points <= high)).all(axis=1)
    if inside.sum() < LEAST_POINTS:
        raise MeshError(Text("Only {} of the cloud's points lie in the region; a surface needs {}.", inside.sum(),
                             LEAST_POINTS), remedy="Choose a larger region, or one that lies on the cloud.")
    return cloud.take(((cloud.points >= low - margin) & (cloud.points <= high + margin)).all(axis=1))


def _trimmed(
    vertices: np.ndarray, faces: np.ndarray, support: Support, spacing: float, options: MeshOptions,
    outline: Outline | None,
) -> tuple[np.ndarray, np.ndarray]:
    """The sound part of Poisson's surface that lies in the region and the site's outline and is measured, or closes a
    hole."""
    distance, nearest = support.nearest(vertices)
    slack = (1 - distance / support.radius[nearest]).clip(-1, 1)
    loose = np.flatnonzero(slack < 0)
    slack[loose[support.goes_on(vertices[loose])]] = 1
    supported = slack >= 0
    largest_hole = _LARGEST_HOLE * spacing if options.fill_holes else 0.0
    slack[worth_keeping(vertices, faces, supported, distance, largest_hole) & ~supported] = 1
    before = len(vertices)
    vertices, faces = clip(vertices, faces, smoothed(slack, faces, _ROUNDING))
    if outline is not None:
        vertices, faces = clip(vertices, faces, outline.depths(vertices))
    if options.region is not None:
        for axis, (low, high) in enumerate(np.array(options.region).T):
            vertices, faces = clip(vertices, faces, vertices[:, axis] - np.float32(low))
            vertices, faces = clip(vertices, faces, np.float32(high) - vertices[:, axis])
        vertices = np.clip(vertices, *np.array(options.region, np.float32))
    if len(vertices) > before:
        more, more_nearest = support.nearest(vertices[before:])
        nearest = np.concatenate([nearest, more_nearest])
        supported = np.concatenate([supported, more <= support.radius[more_nearest]])
    faces = drop_small_parts(vertices, faces, supported, support.spacing[nearest])
    return clean(vertices, faces, spacing)


def _refined(
    vertices: np.ndarray, faces: np.ndarray, support: Support, spacing: float, options: MeshOptions
) -> tuple[np.ndarray, np.ndarray]:
    moved = refined(vertices, faces, support)
    faces = flipped(moved, faces)
    moved = uncrossed(vertices, moved, faces)
    if options.region is not None:
        moved = np.clip(moved, *np.array(options.region, np.float32))
    return clean(moved, faces, spacing)


def _simplified(
    vertices: np.ndarray, faces: np.ndarray, spacing: float, options: MeshOptions, scratch: Path, reporter: Reporter
) -> tuple[np.ndarray, np.ndarray]:
    waiting = _Waiting(reporter, 3, WAITS[1] * (len(faces) / 1e6 + 0.1))
    vertices, faces = simplify(vertices, faces, options.max_faces, scratch, waiting)
    if options.region is not None:
        vertices = np.clip(vertices, *np.array(options.region, np.float32))  # simplification moves vertices
    vertices, faces = clean(vertices, faces, spacing)
    if not len(faces):
        raise MeshError(Text("Nothing is left of the surface when it is simplified to {} face(s).", options.max_faces),
                        remedy="Give a larger face target; 1000000 suits most sites.")
    return vertices, faces
