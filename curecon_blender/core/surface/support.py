# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which points of the cloud carry the surface, and where they support it.

Lengths are in spacings: the local spacing is the side of the square that one point of the cloud has to itself.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from ..base.language import Text
from ..base.messages import Reporter
from ..cloud.ply import Cloud
from .cells import cell_numbers
from .mesh import Mesh, MeshError
from .triangles import triangle_areas, unit, vertex_normals

LEAST_POINTS = 1000
_CELL = 4.0  # median spacings: side of the cells, 3x3x3 of which are a point's block; no local spacing is larger
_TRUSTED = 0.4  # of the cloud's median confidence: a point with less is not used
_DENSE = 20  # trusted points in a block from which on a point need not be surer than that
_REACH = 2.5  # local spacings from a measured point to what it supports
_REACH_THIN = 1.25  # sides of the cubes that a cloud was thinned by: no radius is smaller
_NEIGHBOURS = 4  # measured points that a vertex takes its colour and views from
_PATCH = 6.0  # spacings: side of the cells of measured points that unmeasured vertices may be like
_LIKE = 200.0  # spacings that such a cell may lie farther off for each unit that its normal is more alike
_ALIKE = 4  # cells that give an unmeasured vertex its colour


def usable_points(cloud: Cloud, reporter: Reporter) -> Cloud:
    """The points that are finite and have a normal. Raises MeshError when too few are."""
    finite = np.isfinite(cloud.points).all(axis=1)
    length = np.linalg.norm(cloud.normals, axis=1)
    oriented = np.isfinite(length) & (length > 0)
    usable = finite & oriented
    if usable.sum() < LEAST_POINTS:
        if not len(cloud):
            raise MeshError("The cloud is empty: there is nothing to make a surface of.",
                            remedy="Run Reconstruct again, with photos that overlap more.")
        if finite.sum() < min(LEAST_POINTS, len(cloud)):
            raise MeshError(Text("Only {} of the cloud's {} points have finite coordinates.", finite.sum(), len(cloud)),
                            remedy="Run Reconstruct again: the cloud's file is damaged.")
        if len(cloud) >= LEAST_POINTS:
            raise MeshError(Text("Only {} of the cloud's {} points have normals, which tell the surface's inside "
                                 "from its outside.", usable.sum(), len(cloud)),
                            remedy="Run Reconstruct again, or compute normals in the program that the cloud comes "
                            "from.")
        raise MeshError(Text("The cloud has {} points; a surface needs at least {}.", len(cloud), LEAST_POINTS),
                        remedy="Run Reconstruct again with a higher quality, or with more photos.")
    if not usable.all():
        reporter.warning(Text("{} of {} points have no finite position or no normal: left out.", (~usable).sum(),
                              len(cloud)))
    return cloud if usable.all() else cloud.take(usable)


def median_spacing(points: np.ndarray) -> float:
    """Of points (n,3): the side of a point's share of the surface, so that a fine grid has its pitch."""
    sample = np.random.default_rng(0).choice(len(points), min(len(points), 10_000), replace=False)
    near = 8
    distance = cKDTree(points, balanced_tree=False, compact_nodes=False).query(points[sample], k=near + 1)[0][:, near]
    spacing = float(np.median(distance)) * np.sqrt(np.pi / near)
    if spacing <= 0:
        raise MeshError("Most of the cloud's points lie at the same place.",
                        remedy="Remove the double points, or run Reconstruct again.")
    return spacing


def thin(cloud: Cloud, most: int, reporter: Reporter) -> tuple[np.ndarray, float]:
    """Indices of at most so many points, evenly: the surest of every cube of a grid, as fine a grid as that allows; and
    the side of the cubes, 0 where all points may stay."""
    if len(cloud) <= most:
        return np.arange(len(cloud)), 0.0
    side = median_spacing(cloud.points) * np.sqrt(len(cloud) / most)
    surest = np.argsort(-cloud.confidence, kind="stable")
    while True:
        places = np.floor((cloud.points - cloud.points.min(axis=0)) / side).astype(np.int64)
        _, rows, layers = places.max(axis=0) + 1
        first = np.unique((places @ np.array([rows * layers, layers, 1]))[surest], return_index=True)[1]
        if len(first) <= most:
            break
        side *= 1.02 * np.sqrt(len(first) / most)  # a surface's cubes become fewer with the square of their side
    reporter.log(f"The surface is made of {len(first)} of the cloud's {len(cloud)} points.")
    return np.sort(surest[first]), side


def remove_outliers(cloud: Cloud, spacing: float) -> tuple[Cloud, np.ndarray]:
    """The cloud without what is unsure or lies nearly alone, and the local spacing (n,) float32 of the others.

    On the sample site this takes out 83 % of the points that are wrong by more than 30 cm, and 2 % of the others. It
    is also what keeps most of the sky, which photos match weakly and scattered over all depths, out of the surface.
    """
    least = _TRUSTED * float(np.median(cloud.confidence))
    cloud = cloud.take(cloud.confidence >= least)
    count, occupied = _block_around(cloud.points, _CELL * spacing)
    keep = cloud.confidence * np.minimum(1, count / _DENSE) >= least
    if keep.sum() < LEAST_POINTS:
        raise MeshError("The cloud's points are too scattered to carry a surface.",
                        remedy="Reconstruct with a higher quality, or with photos that overlap more.")
    local = _CELL * spacing * np.sqrt(occupied[keep] / count[keep])  # a cell that a surface crosses holds a cell²
    return cloud.take(keep), local.astype(np.float32)


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


class Support:
    """The measured points, the local spacing at each before they were thinned to one in each cube of side `thinned`,
    `spacing` (n,) float32, and how far from each the surface counts as measured, `radius` (n,) float32. Points that one
    photo alone tells have 1 view. `continued` (k,3) are places where surfaces go on unmeasured, `reach` apart at most.
    """

    def __init__(
        self, cloud: Cloud, local_spacing: np.ndarray, thinned: float, continued: np.ndarray, reach: float
    ) -> None:
        self.cloud, self.spacing = cloud, local_spacing
        self.radius = np.maximum(_REACH * local_spacing, _REACH_THIN * np.float32(thinned))
        self._tree = cKDTree(cloud.points, balanced_tree=False, compact_nodes=False)
        self._continued = cKDTree(continued, balanced_tree=False, compact_nodes=False) if len(continued) else None
        self._reach = reach

    def goes_on(self, places: np.ndarray) -> np.ndarray:
        """Whether an unmeasured surface is known to go on at places (m,3), (m,) bool."""
        if self._continued is None or not len(places):
            return np.zeros(len(places), bool)
        near: np.ndarray = self._continued.query(places, distance_upper_bound=self._reach, workers=-1)[0] < np.inf
        return near

    def nearest(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance (m,) float32 and index (m,) of the measured point nearest to each of places (m,3)."""
        distance, index = self._tree.query(places, workers=-1)
        return distance.astype(np.float32), index

    def about(self, places: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Distances (m,count), infinite where there are no more, and indices of the measured points about places
        (m,3) that lie within the reach of most of them."""
        reach = float(np.median(self.radius))
        distance, index = self._tree.query(places, k=count, distance_upper_bound=reach, workers=-1)
        return distance, index

    @cached_property
    def normals(self) -> np.ndarray:
        """Unit normals (n,3) of the measured points."""
        length = np.linalg.norm(self.cloud.normals, axis=1, keepdims=True)
        units: np.ndarray = self.cloud.normals / np.maximum(length, 1e-9)
        return units

    def with_attributes(self, vertices: np.ndarray, faces: np.ndarray, filled: np.ndarray, weak: np.ndarray) -> Mesh:
        """The mesh with colours, distances and views."""
        distance, index = self._tree.query(vertices, k=_NEIGHBOURS, workers=-1)
        weight = 1 / (distance + 1e-3 * self.radius[index[:, :1]])
        weight *= distance <= 2 * np.maximum(distance[:, :1], self.spacing[index[:, :1]])
        colours = np.einsum("nk,nkc->nc", weight, self.cloud.colours[index]) / weight.sum(axis=1)[:, None]
        beyond = distance[:, 0] > self.radius[index[:, 0]]
        if beyond.any():
            colours[beyond] = self._likely_colours(vertices[beyond], vertex_normals(vertices, faces)[beyond])
        views = np.round(np.median(self.cloud.views[index], axis=1))
        views[beyond] = 0
        return Mesh(
            vertices=vertices, faces=faces, colours=np.rint(colours).astype(np.uint8),
            distance=distance[:, 0].astype(np.float32), views=views.astype(np.uint8),
            filled=filled, weak=weak & ~filled,
        )

    def _likely_colours(self, places: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Colours (m,3) for unmeasured places (m,3) with unit normals (m,3): those of measured surface that is near and
        looks the same way, so that a wall does not take the colour of its roof."""
        spacing = float(np.median(self.spacing))
        points, looks, colours = self._patches(_PATCH * spacing)
        tree = cKDTree(np.hstack([points / (_LIKE * spacing), looks]))
        index = tree.query(np.hstack([places / (_LIKE * spacing), normals]), k=min(_ALIKE, len(points)), workers=-1)[1]
        mean: np.ndarray = colours[index.reshape(len(places), -1)].mean(axis=1)
        return mean

    def _patches(self, side: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The measured points in cells of this side: mean points, unit normals and colours (c,3)."""
        cell = cell_numbers(self.cloud.points, self.cloud.points.min(axis=0), side)
        part, count = np.unique(cell, return_inverse=True, return_counts=True)[1:]
        points, normals, colours = (
            np.stack([np.bincount(part, values[:, axis]) for axis in range(3)], axis=1) / count[:, None]
            for values in (self.cloud.points, self.normals, self.cloud.colours))
        return points, unit(normals), colours

    def judged(self, vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Faces (m,) bool of which no photo measured the larger part, and those of which one photo alone measured most
        of what was measured.

        A simplified face may be far larger than the hole in it or than the holes that it bridges, so that its corners
        do not tell: it is probed at places spread over it, as many as support radii fit into it.
        """
        corners = vertices[faces]
        area = triangle_areas(corners)
        reach = float(np.median(self.radius))
        probes = np.clip(np.ceil(area / reach**2), 1, 256).astype(np.int64)
        face = np.repeat(np.arange(len(faces)), probes)
        number = np.arange(len(face)) - np.repeat(np.cumsum(probes) - probes, probes)
        places = np.einsum("nk,nkc->nc", _r2_sequence(number), corners[face])
        distance, index = self.nearest(places)
        beyond = distance > self.radius[index]
        alone = ~beyond & (self.cloud.views[index] <= 1)
        unsupported, weak = (np.bincount(face, weights=which, minlength=len(faces)) for which in (beyond, alone))
        return 2 * unsupported > probes, 2 * weak > probes - unsupported


def _r2_sequence(number: np.ndarray) -> np.ndarray:
    """Barycentric coordinates (n,3) of the number-th place of an even sequence over a triangle, the centroid first
    (Roberts' R2 sequence, folded)."""
    plastic = 1.32471795724474602596
    u, v = ((1 / 3 + number / plastic) % 1, (1 / 3 + number / plastic**2) % 1)
    fold = u + v > 1
    u, v = np.where(fold, 1 - u, u), np.where(fold, 1 - v, v)
    return np.stack([u, v, 1 - u - v], axis=1)
