# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The fused cloud to a surface: screened Poisson (Kazhdan and Hoppe 2013), cut back to what the photos measured.

Poisson closes everything: it spans the sky between two roofs as readily as a missing roof tile. So each piece of its
surface is asked how far the nearest measured point is, against how densely the cloud was measured there:

* near enough is *supported*;
* a small, flat unsupported piece with supported surface all around it is a hole, closed and marked *filled*;
* anything else that is unsupported (balloons, skirts beyond the site's edge, bags under eaves) is cut away.

On the sample site 57 % of the area of such flat pieces lies within 20 cm of the truth, of others as small 13 %.

Lengths are in spacings: the local spacing is the side of the square that one point of the cloud has to itself.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ..base.allocator import release
from ..base.errors import SurfaceError
from ..base.files import disk_errors
from ..base.messages import Reporter
from ..cloud.ply import Cloud, CloudWriter
from .mesh import Mesh, triangle_areas

_LEAST_POINTS = 1000
_DEPTHS = (6, 12)  # of the octree; its memory grows with the points, not with the depth
# More than that many points for each face that may stay do not show: they are thinned out, or a large site's mesh would
# need memory without end. (A smaller face target than the usual one gets the usual one's points.)
POINTS_A_FACE = 4
_POISSON_MARGIN = 1.1  # Poisson's cube is this much larger than the cloud
_CELL = 4.0  # median spacings: side of the cells, 3x3x3 of which are a point's block; no local spacing is larger
_TRUSTED = 0.4  # of the cloud's median confidence: a point with less is not used
_DENSE = 20  # trusted points in a block from which on a point need not be surer than that
_SUPPORT = 2.5  # local spacings from a measured point to what it supports
_LARGEST_HOLE = 25.0  # median spacings from any measured point to the middle of a hole that is closed
_FLAT = 0.85  # length of a piece's mean unit normal, from which on it goes on as the surface around it does
_SMALLEST_PART = 500  # points' worth of surface: a part with less is floating dust
_REGION_MARGIN = 10.0  # median spacings: what lies just outside the region still shapes the surface within
_NEIGHBOURS = 4  # measured points that a vertex takes its colour and views from
_LEAST_FREE = 1 << 20  # bytes: a disk with less is full
_SHORTEST_EDGE = 1e-3  # median spacings: vertices nearer than this are one
# The process goes with the worker, even if that is killed; where the system cannot arrange it, it ends when it is done.
_CHILD = """
import ctypes, json, sys
if sys.platform == "linux":
    ctypes.CDLL(None).prctl(1, 9)
import pycolmap
call, kind, source, target, settings = sys.argv[1:]
options = getattr(pycolmap, kind)()
for name, value in json.loads(settings).items():
    setattr(options, name, value)
getattr(pycolmap, call)(source, target, options)
"""
_TRIANGLE = np.dtype([("corners", "u1"), ("vertices", "<i4", 3)])


class MeshError(SurfaceError):
    """No surface can be made of this cloud with these options."""


@dataclass(frozen=True, kw_only=True)
class MeshOptions:
    """How the surface is made.

    `fill_holes`: close small holes and mark them as filled; False leaves them open, so that every face was measured.
    `max_faces`: simplify to at most so many triangles. `region`: low and high corner of an upright box in the site
    frame; only surface inside it is made.
    """

    fill_holes: bool = True
    max_faces: int = 1_000_000
    region: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None


def build_mesh(cloud: Cloud, options: MeshOptions, scratch: Path, reporter: Reporter) -> Mesh:
    """The surface of `cloud` (site frame) as triangles, with colour, support and what is filled; no UVs.

    `scratch` is a folder for Poisson's and the simplification's files, which are deleted again. Progress counts
    steps. The mesh is finite, without degenerate faces or unused vertices, with at most two faces an edge, and faces
    look to where the cloud's normals look. Raises MeshError for options or a cloud that give no surface, and
    WorkspaceError for a full or read-only disk.
    """
    _check(options)
    steps = 5
    reporter.progress(0, steps)
    cloud = _usable(cloud, reporter)
    cloud = _near_region(cloud, options, _median_spacing(cloud.points))
    cloud = _thinned(cloud, int(POINTS_A_FACE * max(options.max_faces, MeshOptions.max_faces)), reporter)
    spacing = _median_spacing(cloud.points)
    cloud, local_spacing = _without_strays(cloud, spacing)
    support = _Support(cloud, local_spacing)
    reporter.progress(1, steps)
    vertices, faces = _poisson(cloud, spacing, scratch, reporter)
    reporter.progress(2, steps)
    distance, nearest = support.nearest(vertices)
    supported = distance <= support.radius[nearest]
    faces = faces[_worth_keeping(vertices, faces, supported, distance, options.fill_holes, _LARGEST_HOLE * spacing)]
    if options.region is not None:
        low, high = np.array(options.region)
        faces = faces[((vertices >= low) & (vertices <= high)).all(axis=1)[faces].all(axis=1)]
    faces = _large_parts(vertices, faces, supported, local_spacing[nearest])
    vertices, faces = _clean(vertices, faces, spacing)
    reporter.progress(3, steps)
    if len(faces) > options.max_faces:
        vertices, faces = _simplify(vertices, faces, options.max_faces, scratch, reporter)
        if options.region is not None:
            vertices = np.clip(vertices, *np.array(options.region, np.float32))  # simplification moves vertices
        vertices, faces = _clean(vertices, faces, spacing)
        if not len(faces):
            raise MeshError(f"Nothing is left of the surface when it is simplified to {options.max_faces} face(s).",
                            remedy="Give a larger face target; 1000000 suits most sites.")
    if not len(faces):
        raise MeshError(
            "The cloud's points are too few or too scattered to carry a surface.",
            remedy="Reconstruct with a higher quality or more photos, or choose a larger region.",
        )
    reporter.progress(4, steps)
    filled = support.is_missing(vertices, faces)
    if not options.fill_holes and filled.any():  # faces that bridge a gap from one measured point to another
        vertices, faces = _clean(vertices, faces[~filled], spacing)
        filled = np.zeros(len(faces), bool)
    mesh = support.describe(vertices, _outward(vertices, faces, support), filled)
    reporter.progress(5, steps)
    return mesh


def _check(options: MeshOptions) -> None:
    if options.max_faces < 1:
        raise MeshError(f"A mesh of {options.max_faces} faces cannot be made.",
                        remedy="Give a face target of at least 1; 1000000 suits most sites.")
    if options.region is not None:
        corners = np.array(options.region, float)
        if corners.shape != (2, 3) or not np.isfinite(corners).all() or not (corners[0] < corners[1]).all():
            raise MeshError(f"The region {options.region} is no box.",
                            remedy="Give its low and its high corner, each x, y, z, the high one larger in all three.")


def _take(cloud: Cloud, which: np.ndarray) -> Cloud:
    return Cloud(cloud.points[which], cloud.colours[which], cloud.normals[which], cloud.confidence[which],
                 cloud.views[which])


def _usable(cloud: Cloud, reporter: Reporter) -> Cloud:
    """The points that are finite and have a normal. Raises MeshError when too few are."""
    finite = np.isfinite(cloud.points).all(axis=1)
    length = np.linalg.norm(cloud.normals, axis=1)
    oriented = np.isfinite(length) & (length > 0)
    usable = finite & oriented
    if usable.sum() < _LEAST_POINTS:
        again = "Run Reconstruct again"
        if not len(cloud):
            raise MeshError("The cloud is empty: there is nothing to make a surface of.",
                            remedy=f"{again}, with photos that overlap more.")
        if finite.sum() < min(_LEAST_POINTS, len(cloud)):
            raise MeshError(f"Only {finite.sum()} of the cloud's {len(cloud)} points have finite coordinates.",
                            remedy=f"{again}: the cloud's file is damaged.")
        if len(cloud) >= _LEAST_POINTS:
            raise MeshError(f"Only {usable.sum()} of the cloud's {len(cloud)} points have normals, which tell the "
                            "surface's inside from its outside.",
                            remedy=f"{again}, or compute normals in the program that the cloud comes from.")
        raise MeshError(f"The cloud has {len(cloud)} points; a surface needs at least {_LEAST_POINTS}.",
                        remedy=f"{again} with a higher quality, or with more photos.")
    if not usable.all():
        reporter.warning(f"{(~usable).sum()} of {len(cloud)} points have no finite position or no normal: left out.")
    return cloud if usable.all() else _take(cloud, usable)


def _median_spacing(points: np.ndarray) -> float:
    """Of points (n,3): the side of a point's share of the surface, so that a fine grid has its pitch."""
    sample = np.random.default_rng(0).choice(len(points), min(len(points), 10_000), replace=False)
    near = 8
    distance = cKDTree(points, balanced_tree=False, compact_nodes=False).query(points[sample], k=near + 1)[0][:, near]
    spacing = float(np.median(distance)) * np.sqrt(np.pi / near)
    if spacing <= 0:
        raise MeshError("Most of the cloud's points lie at the same place.",
                        remedy="Remove the double points, or run Reconstruct again.")
    return spacing


def _near_region(cloud: Cloud, options: MeshOptions, spacing: float) -> Cloud:
    if options.region is None:
        return cloud
    low, high = np.array(options.region)
    inside = ((cloud.points >= low) & (cloud.points <= high)).all(axis=1)
    if inside.sum() < _LEAST_POINTS:
        raise MeshError(f"Only {inside.sum()} of the cloud's points lie in the region; a surface needs "
                        f"{_LEAST_POINTS}.", remedy="Choose a larger region, or one that lies on the cloud.")
    margin = _REGION_MARGIN * spacing
    return _take(cloud, ((cloud.points >= low - margin) & (cloud.points <= high + margin)).all(axis=1))


def _thinned(cloud: Cloud, most: int, reporter: Reporter) -> Cloud:
    """At most so many points, evenly: the surest of every cube of a grid, as fine a grid as that allows."""
    if len(cloud) <= most:
        return cloud
    side = _median_spacing(cloud.points) * np.sqrt(len(cloud) / most)
    surest = np.argsort(-cloud.confidence, kind="stable")
    while True:
        places = np.floor((cloud.points - cloud.points.min(axis=0)) / side).astype(np.int64)
        _, rows, layers = places.max(axis=0) + 1
        first = np.unique((places @ np.array([rows * layers, layers, 1]))[surest], return_index=True)[1]
        if len(first) <= most:
            break
        side *= 1.02 * np.sqrt(len(first) / most)  # a surface's cubes become fewer with the square of their side
    reporter.log(f"The surface is made of {len(first)} of the cloud's {len(cloud)} points.")
    return _take(cloud, np.sort(surest[first]))


def _without_strays(cloud: Cloud, spacing: float) -> tuple[Cloud, np.ndarray]:
    """The cloud without what is unsure or lies nearly alone, and the local spacing (n,) float32 of the others.

    On the sample site this takes out 83 % of the points that are wrong by more than 30 cm, and 2 % of the others. It
    is also what keeps most of the sky, which photos match weakly and scattered over all depths, out of the surface.
    """
    least = _TRUSTED * float(np.median(cloud.confidence))
    cloud = _take(cloud, cloud.confidence >= least)
    count, occupied = _block_around(cloud.points, _CELL * spacing)
    keep = cloud.confidence * np.minimum(1, count / _DENSE) >= least
    if keep.sum() < _LEAST_POINTS:
        raise MeshError("The cloud's points are too scattered to carry a surface.",
                        remedy="Reconstruct with a higher quality, or with photos that overlap more.")
    local = _CELL * spacing * np.sqrt(occupied[keep] / count[keep])  # a cell that a surface crosses holds a cell²
    return _take(cloud, keep), local.astype(np.float32)


def _block_around(points: np.ndarray, cell: float) -> tuple[np.ndarray, np.ndarray]:
    """Of the 3x3x3 cells of side `cell` about that of each of points (n,3): how many points lie in them, itself
    included, and how many of them hold any; both (n,)."""
    places = np.floor((points - points.min(axis=0)) / cell).astype(np.int64) + 1  # a rim, so that no sum wraps around
    _, rows, layers = places.max(axis=0) + 2
    steps = np.array([rows * layers, layers, 1])
    cells, index, inside = np.unique(places @ steps, return_inverse=True, return_counts=True)
    count, occupied = np.zeros((2, len(cells)), np.int64)
    for offset in (np.stack(np.meshgrid(*[[-1, 0, 1]] * 3), axis=-1).reshape(-1, 3) @ steps).tolist():
        at = np.minimum(np.searchsorted(cells, cells + offset), len(cells) - 1)
        there = cells[at] == cells + offset
        count += np.where(there, inside[at], 0)
        occupied += there
    return count[index], occupied[index]


class _Support:
    """The measured points, and how far from each the surface counts as measured: `radius` (n,) float32."""

    def __init__(self, cloud: Cloud, local_spacing: np.ndarray) -> None:
        self.cloud = cloud
        self.radius = _SUPPORT * local_spacing
        self._tree = cKDTree(cloud.points, balanced_tree=False, compact_nodes=False)

    def nearest(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance (m,) float32 and index (m,) of the measured point nearest to each of places (m,3)."""
        distance, index = self._tree.query(places, workers=-1)
        return distance.astype(np.float32), index

    def describe(self, vertices: np.ndarray, faces: np.ndarray, filled: np.ndarray) -> Mesh:
        """The mesh with colours, distances and views."""
        distance, index = self._tree.query(vertices, k=_NEIGHBOURS, workers=-1)
        weight = 1 / (distance + 1e-3 * self.radius[index[:, :1]])
        weight *= distance <= 2 * np.maximum(distance[:, :1], self.radius[index[:, :1]] / _SUPPORT)
        colours = np.einsum("nk,nkc->nc", weight, self.cloud.colours[index]) / weight.sum(axis=1)[:, None]
        views = np.round(np.median(self.cloud.views[index], axis=1))
        views[distance[:, 0] > self.radius[index[:, 0]]] = 0
        return Mesh(
            vertices=vertices, faces=faces, colours=np.rint(colours).astype(np.uint8),
            distance=distance[:, 0].astype(np.float32), views=views.astype(np.uint8),
            filled=filled,
        )

    def is_missing(self, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
        """Faces (m,) bool of which no photo measured the larger part.

        A simplified face may be far larger than the hole in it or than the holes that it bridges, so that its corners
        do not tell: it is probed at places spread over it, as many as support radii fit into it.
        """
        corners = vertices[faces]
        area = triangle_areas(corners)
        reach = float(np.median(self.radius))
        probes = np.clip(np.ceil(area / reach**2), 1, 256).astype(np.int64)
        face = np.repeat(np.arange(len(faces)), probes)
        number = np.arange(len(face)) - np.repeat(np.cumsum(probes) - probes, probes)
        places = np.einsum("nk,nkc->nc", _spread(number), corners[face])
        distance, index = self.nearest(places)
        unsupported = np.bincount(face, weights=distance > self.radius[index], minlength=len(faces))
        filled: np.ndarray = 2 * unsupported > probes
        return filled


def _spread(number: np.ndarray) -> np.ndarray:
    """Barycentric coordinates (n,3) of the number-th place of an even sequence over a triangle, the centroid first
    (Roberts' R2 sequence, folded)."""
    plastic = 1.32471795724474602596
    u, v = ((1 / 3 + number / plastic) % 1, (1 / 3 + number / plastic**2) % 1)
    fold = u + v > 1
    u, v = np.where(fold, 1 - u, u), np.where(fold, 1 - v, v)
    return np.stack([u, v, 1 - u - v], axis=1)


def _poisson(cloud: Cloud, spacing: float, scratch: Path, reporter: Reporter) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n,3) float32 and faces (m,3) int32 of the untrimmed Poisson surface."""
    extent = _POISSON_MARGIN * float(np.ptp(cloud.points, axis=0).max())
    depth = int(np.clip(np.round(np.log2(extent / spacing)), *_DEPTHS))
    points, surface = scratch / "poisson_points.ply", scratch / "poisson_surface.ply"
    try:
        with disk_errors(scratch):
            scratch.mkdir(parents=True, exist_ok=True)
            with CloudWriter(points) as writer:
                writer.write(cloud)
            with _native_writing(scratch):
                _pycolmap("poisson_meshing", "PoissonMeshingOptions", points, surface, reporter, depth=depth, trim=0,
                          color=False)
                return _read_triangles(surface)
    except (FileNotFoundError, RuntimeError, ValueError) as error:
        raise MeshError(f"No surface could be made of the cloud: {error}",
                        remedy="See that the disk is not full; reconstruct again if the cloud looks wrong.",
                        path=points) from error
    finally:
        points.unlink(missing_ok=True)
        surface.unlink(missing_ok=True)


@contextmanager
def _native_writing(folder: Path) -> Iterator[None]:
    """A native library that meets a full disk may say nothing and leave half a file: then OSError in its place."""
    try:
        yield
    except (FileNotFoundError, RuntimeError, ValueError) as error:
        if shutil.disk_usage(folder).free < _LEAST_FREE:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)) from error
        raise


def _pycolmap(call: str, kind: str, source: Path, target: Path, reporter: Reporter, **settings: Any) -> None:
    """`pycolmap.call(source, target, kind(**settings))` in a process of its own: it holds Python's lock for as long as
    it works, and nobody could cancel. Raises RuntimeError with its last words when it fails."""
    arguments = [call, kind, str(source), str(target), json.dumps(settings)]
    words = source.with_suffix(".log")
    release()  # that process will need it
    # Threads that wait must not spin: beside other work they would take the cores from those that have something to do.
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p), "OMP_WAIT_POLICY": "passive"}
    try:
        with words.open("wb") as log, subprocess.Popen(
            [sys.executable, "-c", _CHILD, *arguments], stdin=subprocess.DEVNULL, stdout=log, stderr=log,
            env=environment,
        ) as process:
            try:
                while process.poll() is None:
                    reporter.check_cancelled()
                    time.sleep(0.05)
            finally:
                process.kill()
        if process.returncode:
            said = words.read_text("utf-8", "replace").strip().splitlines()
            raise RuntimeError(said[-1] if said else f"it ended with {process.returncode}")
    finally:
        words.unlink(missing_ok=True)


def _simplify(
    vertices: np.ndarray, faces: np.ndarray, count: int, scratch: Path, reporter: Reporter
) -> tuple[np.ndarray, np.ndarray]:
    """At most `count` faces, by quadric edge collapse."""
    fine, coarse = scratch / "fine.ply", scratch / "coarse.ply"
    try:
        with disk_errors(scratch):
            _write_triangles(fine, vertices, faces)
            with _native_writing(scratch):
                _pycolmap("simplify_mesh", "MeshSimplificationOptions", fine, coarse, reporter,
                          target_face_ratio=count / len(faces), interpolate_colors=False)
                return _read_triangles(coarse)
    except (FileNotFoundError, RuntimeError, ValueError) as error:
        raise MeshError(f"The surface could not be simplified: {error}",
                        remedy="See that the disk is not full, or give a larger face target.", path=fine) from error
    finally:
        fine.unlink(missing_ok=True)
        coarse.unlink(missing_ok=True)


def _worth_keeping(
    vertices: np.ndarray, faces: np.ndarray, supported: np.ndarray, distance: np.ndarray, fill_holes: bool,
    largest_hole: float,
) -> np.ndarray:
    """Faces (m,) bool that are supported at all corners, or that close a small, flat hole between such faces.

    `supported` (n,) bool and `distance` (n,) are the vertices'.
    """
    keep: np.ndarray = supported[faces].all(axis=1)
    if not fill_holes or keep.all():
        return keep
    loose = np.flatnonzero(~keep)
    neighbours = _neighbours(faces)
    within = neighbours[~keep[neighbours].any(axis=1)]
    piece = _components(np.searchsorted(loose, within), len(loose))
    depth = np.zeros(piece.max() + 1, np.float32)
    np.maximum.at(depth, piece, distance[faces[loose]].max(axis=1))
    inner_edges = np.bincount(neighbours.ravel(), minlength=len(faces))[loose]
    at_rim = np.bincount(piece, weights=inner_edges < 3) > 0  # ends in the air: nothing around it to close
    corners = vertices[faces[loose]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    mean = np.stack([np.bincount(piece, weights=normals[:, axis]) for axis in range(3)], axis=1)
    flat = np.linalg.norm(mean, axis=1) >= _FLAT * np.bincount(piece, weights=np.linalg.norm(normals, axis=1))
    keep[loose] = ((depth <= largest_hole) & flat & ~at_rim)[piece]
    return keep


def _large_parts(
    vertices: np.ndarray, faces: np.ndarray, supported: np.ndarray, local_spacing: np.ndarray
) -> np.ndarray:
    """Faces (k,3) without the parts that only a few points carry. The last two (n,) are the vertices'."""
    if not len(faces):
        return faces
    part = _components(faces[:, [0, 1, 1, 2]].reshape(-1, 2), len(vertices))[faces[:, 0]]
    measured = supported[faces].all(axis=1)
    squares = triangle_areas(vertices[faces]) / local_spacing[faces].mean(axis=1) ** 2
    points = np.bincount(part, weights=measured * squares)
    large: np.ndarray = faces[points[part] >= _SMALLEST_PART]
    return large


def _clean(vertices: np.ndarray, faces: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces without double vertices, degenerate faces, edges of three faces, and unused vertices."""
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    short = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1) < _SHORTEST_EDGE * spacing
    if short.any():
        merged = _components(edges[short], len(vertices))
        vertices, faces = vertices[np.unique(merged, return_index=True)[1]], merged[faces]
    faces = faces[triangle_areas(vertices[faces]) > (_SHORTEST_EDGE * spacing) ** 2]
    faces = faces[np.unique(np.sort(faces, axis=1), axis=0, return_index=True)[1]]
    while len(faces):
        _, edge, count = _edges(faces)
        crowded = (count[edge] > 2).reshape(-1, 3).any(axis=1)
        if not crowded.any():
            break
        # The smaller half of what meets there goes: the fins of a fold, seldom the surface.
        area = triangle_areas(vertices[faces])
        faces = faces[~crowded | (area > np.median(area[crowded]))]
    used, index = np.unique(faces, return_inverse=True)
    return np.ascontiguousarray(vertices[used], np.float32), index.reshape(-1, 3).astype(np.int32)


def _outward(vertices: np.ndarray, faces: np.ndarray, support: _Support) -> np.ndarray:
    """The faces (m,3), turned over together where most of them look away from the cloud's normals."""
    sample = np.random.default_rng(0).choice(len(faces), min(len(faces), 20_000), replace=False)
    corners = vertices[faces[sample]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    agree = np.einsum("nc,nc->n", normals, support.cloud.normals[support.nearest(corners.mean(axis=1))[1]])
    return faces if agree.sum() >= 0 else faces[:, ::-1].copy()


def _edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of faces (m,3): the edges' keys (e,), each face's three edges as places among them (3m,), and faces an edge
    (e,)."""
    ends = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64), axis=1)
    keys, edge, count = np.unique(ends[:, 0] << 32 | ends[:, 1], return_inverse=True, return_counts=True)
    return keys, edge, count


def _neighbours(faces: np.ndarray) -> np.ndarray:
    """Pairs (p,2) of faces that share an edge of two faces."""
    _, edge, count = _edges(faces)
    order = np.argsort(edge, kind="stable")
    order = order[count[edge[order]] == 2]
    pairs: np.ndarray = (order // 3).reshape(-1, 2)
    return pairs


def _components(pairs: np.ndarray, count: int) -> np.ndarray:
    """Component number of each of `count` things of which pairs (p,2) hang together; (count,) int32."""
    links = coo_array((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    labels: np.ndarray = connected_components(links, directed=False)[1]
    return labels


def _write_triangles(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    rows = np.zeros(len(faces), _TRIANGLE)
    rows["corners"], rows["vertices"] = 3, faces
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}", "property float x",
              "property float y", "property float z", f"element face {len(faces)}",
              "property list uchar int vertex_indices", "end_header\n"]
    with open(path, "wb") as file:
        file.write("\n".join(header).encode())
        file.write(vertices.astype("<f4").tobytes())
        file.write(rows.tobytes())


def _read_triangles(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n,3) float32 and faces (m,3) int32 of a PLY by pycolmap. Raises ValueError where it is cut short."""
    counts: dict[str, int] = {}
    vertex: list[tuple[str, str]] = []
    corners = "u1"
    with open(path, "rb") as file:
        while (words := file.readline().decode("ascii", "replace").split()) != ["end_header"]:
            if not words:
                raise ValueError(f"{path.name} has no header")
            if words[0] == "element":
                counts[words[1]] = int(words[2])
            elif words[:2] == ["property", "list"]:
                corners = {"uchar": "u1", "int": "<i4", "uint8": "u1", "int32": "<i4"}[words[2]]
            elif words[0] == "property":
                vertex.append((words[2], {"float": "<f4", "double": "<f8", "uchar": "u1"}[words[1]]))
        vertices = np.fromfile(file, np.dtype(vertex), counts["vertex"])
        faces = np.fromfile(file, np.dtype([("corners", corners), ("vertices", "<i4", 3)]), counts["face"])
    if len(vertices) != counts["vertex"] or len(faces) != counts["face"]:
        raise ValueError(f"{path.name} is cut short")
    return np.stack([vertices[axis] for axis in "xyz"], axis=1).astype(np.float32), faces["vertices"].copy()
