# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How far results lie apart: point to point, point to mesh, and signed along the normal with what can be told at all
(M3C2, Lague et al. 2013); and how clean and how dense a cloud is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError, cKDTree

from .geometry import one_a_voxel, voxel_numbers

SURE = 1.96  # standard deviations of 95 %
_LEAST_FOUND = 4  # points in a cylinder, on either side, to have a spread
_PATCHES, _PATCH_POINTS, _FLAT = 300, 12, 0.5  # of the noise: places, points in each, the share of the flattest ones
_CLUSTER_POINTS = 5


@dataclass(frozen=True)
class Shares:
    """At a threshold: the share of a cloud within it of the reference (precision), of the reference within it of the
    cloud (completeness)."""

    threshold: float
    precision: float
    completeness: float


@dataclass(frozen=True)
class Signed:
    """At places (n,3): the distance along the normals (n,3), NaN where either side has too few points; and the least
    distance that is significant with 95 % (n,)."""

    places: np.ndarray
    normals: np.ndarray
    distance: np.ndarray
    limit: np.ndarray

    @property
    def known(self) -> np.ndarray:
        found: np.ndarray = np.isfinite(self.distance)
        return found

    @property
    def significant(self) -> np.ndarray:
        with np.errstate(invalid="ignore"):
            found: np.ndarray = np.abs(self.distance) > self.limit
        return found


@dataclass(frozen=True)
class Change:
    """Something that came or went: its middle, how far it reaches along x, y, z, the area of what is seen of it, and
    the mean distance along its normals (negative: lost)."""

    place: tuple[float, float, float]
    size: tuple[float, float, float]
    area: float
    distance: float


def to_cloud(points: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Distance (N,) of each point to the nearest one of the reference."""
    distances: np.ndarray = cKDTree(reference).query(points, workers=-1)[0]
    return distances


def reached(points: np.ndarray, reference: np.ndarray, margin: float) -> np.ndarray:
    """Which points (N,3) lie where the reference reaches (N,): in its hull in plan and its heights, and a margin."""
    low, high = reference.min(axis=0) - margin, reference.max(axis=0) + margin
    inside: np.ndarray = ((points >= low) & (points <= high)).all(axis=1)
    try:
        sides = ConvexHull(reference[:, :2]).equations
    except QhullError:  # a straight wall has none
        return inside
    for a, b, off in sides:
        inside &= points[:, 0] * a + points[:, 1] * b + off <= margin
    return inside


def _near(points: np.ndarray, at: np.ndarray, radius: float) -> np.ndarray:
    """Those of the points (N,3) that lie within `radius` of any place (n,3): a tree of all would be large."""
    distance = cKDTree(at).query(points, distance_upper_bound=radius, workers=-1)[0]
    kept: np.ndarray = points[np.isfinite(distance)]
    return kept


def shares(to_reference: np.ndarray, to_cloud_: np.ndarray, thresholds: Sequence[float]) -> tuple[Shares, ...]:
    return tuple(Shares(threshold, float((to_reference < threshold).mean()), float((to_cloud_ < threshold).mean()))
                 for threshold in thresholds)


def sampled(vertices: np.ndarray, faces: np.ndarray, spacing: float, most: int = 20_000_000) -> np.ndarray:
    """Points (n,3) spread evenly over a mesh, about `spacing` apart, the same at every call."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    total = float(area.sum())
    count = int(min(max(total / spacing**2, 1), most))
    if not total > 0:
        return vertices
    rng = np.random.default_rng(0)
    places = np.cumsum(area)
    face = np.minimum(np.searchsorted(places, (np.arange(count) + 0.5) / count * total), len(faces) - 1)
    u, v = rng.random((2, count, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    points: np.ndarray = a[face] + u * (b[face] - a[face]) + v * (c[face] - a[face])
    return points


def to_mesh(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Distance (N,) of each point to a mesh, exactly: to the nearest place of any triangle."""
    corners = vertices[faces]
    middle = corners.mean(axis=1)
    radius = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    tree = cKDTree(middle)
    best = np.full(len(points), np.inf)
    todo = np.arange(len(points))
    largest = float(radius.max())
    k = 8
    while len(todo):
        k = min(k, len(faces))
        distance, near = tree.query(points[todo], k=k)
        distance, near = distance.reshape(len(todo), k), near.reshape(len(todo), k)
        for column in range(k):
            best[todo] = np.minimum(best[todo], _to_triangles(points[todo], corners[near[:, column]]))
        # A triangle farther down the list has its middle at least as far away as the last one looked at.
        todo = todo[(best[todo] > distance[:, -1] - largest)] if k < len(faces) else todo[:0]
        k *= 4
        if k > 512 and len(todo):
            _search_all(points, corners, tree, largest, best, todo)
            break
    return best


def _search_all(
    points: np.ndarray, corners: np.ndarray, tree: cKDTree, largest: float, best: np.ndarray, todo: np.ndarray
) -> None:
    """One by one, for meshes with triangles far larger than most."""
    for number in todo:
        near = tree.query_ball_point(points[number], best[number] + largest)
        best[number] = _to_triangles(np.repeat(points[number][None], len(near), axis=0), corners[near]).min()


def _to_triangles(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Distance (n,) of points (n,3) to a triangle (n,3,3) each."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    normal = np.cross(b - a, c - a)
    square = np.maximum((normal**2).sum(axis=1), 1e-300)
    off = ((points - a) * normal).sum(axis=1)
    foot = points - normal * (off / square)[:, None]
    inside = np.ones(len(points), bool)
    edge_distance = np.full(len(points), np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        side = end - start
        inside &= (np.cross(side, foot - start) * normal).sum(axis=1) >= 0
        length = np.maximum((side**2).sum(axis=1), 1e-300)
        t = np.clip(((points - start) * side).sum(axis=1) / length, 0, 1)
        edge_distance = np.minimum(edge_distance, np.linalg.norm(points - start - t[:, None] * side, axis=1))
    plane = np.abs(off) / np.sqrt(square)
    return np.where(inside & (square > 1e-299), plane, edge_distance)


# ---- M3C2

def signed(
    ours: np.ndarray, other: np.ndarray, *, places: np.ndarray, normals: np.ndarray, width: float, depth: float,
    registration: float = 0.0,
) -> Signed:
    """M3C2 at places (n,3): the mean of the other's points less that of ours, along the normal, in a cylinder of this
    width (diameter) that reaches `depth` to either side. `registration` is the standard deviation of how one lies on
    the other; the limit is 1.96 (sqrt(s1^2 / n1 + s2^2 / n2) + registration)."""
    found = []
    for cloud in (ours, other):
        grid, order, starts, keys = _bucketed(cloud, width)
        sums = np.zeros((len(places), 3))
        _in_cylinders(cloud[order], starts, keys, grid, width, places, normals, width / 2, depth, sums)
        found.append(sums)
    (n1, m1, v1), (n2, m2, v2) = (_moments(sums) for sums in found)
    enough = (n1 >= _LEAST_FOUND) & (n2 >= _LEAST_FOUND)
    with np.errstate(invalid="ignore", divide="ignore"):
        limit = SURE * (np.sqrt(v1 / n1 + v2 / n2) + registration)
    return Signed(places, normals, np.where(enough, m2 - m1, np.nan), np.where(enough, limit, np.nan))


def _moments(sums: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Number, mean and variance (n,) of number, sum and sum of squares (n,3)."""
    n = sums[:, 0]
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = sums[:, 1] / n
        variance = np.maximum(sums[:, 2] - n * mean**2, 0) / (n - 1)
    return n, mean, variance


def _bucketed(cloud: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The lowest corner (3,), the points' order by voxel, where each voxel begins in it (with the end), its number."""
    low = cloud.min(axis=0)
    numbers = voxel_numbers(cloud, size)
    order = np.argsort(numbers, kind="stable")
    keys, starts = np.unique(numbers[order], return_index=True)
    return low, order, np.append(starts, len(cloud)).astype(np.int64), keys


@njit(cache=False, nogil=True)
def _in_cylinders(
    points: np.ndarray, starts: np.ndarray, keys: np.ndarray, low: np.ndarray, size: float, places: np.ndarray,
    normals: np.ndarray, radius: float, depth: float, sums: np.ndarray,
) -> None:  # pragma: no cover - compiled
    for core in range(places.shape[0]):
        x, y, z = places[core]
        a, b, c = normals[core]
        ex = depth * abs(a) + radius * np.sqrt(max(1 - a * a, 0.0))
        ey = depth * abs(b) + radius * np.sqrt(max(1 - b * b, 0.0))
        ez = depth * abs(c) + radius * np.sqrt(max(1 - c * c, 0.0))
        for i in range(int(np.floor((x - ex - low[0]) / size)), int(np.floor((x + ex - low[0]) / size)) + 1):
            if i < 0:
                continue
            for j in range(int(np.floor((y - ey - low[1]) / size)), int(np.floor((y + ey - low[1]) / size)) + 1):
                if j < 0:
                    continue
                k0 = max(int(np.floor((z - ez - low[2]) / size)), 0)
                k1 = int(np.floor((z + ez - low[2]) / size))
                if k1 < 0:
                    continue
                # The voxels of a column follow one another.
                first = (i << 42) | (j << 21) | k0
                at = np.searchsorted(keys, first)
                last = (i << 42) | (j << 21) | k1
                while at < keys.shape[0] and keys[at] <= last:
                    for number in range(starts[at], starts[at + 1]):
                        dx, dy, dz = points[number, 0] - x, points[number, 1] - y, points[number, 2] - z
                        along = dx * a + dy * b + dz * c
                        if abs(along) <= depth and dx * dx + dy * dy + dz * dz - along * along <= radius * radius:
                            sums[core, 0] += 1
                            sums[core, 1] += along
                            sums[core, 2] += along * along
                    at += 1


def facing(normals: np.ndarray, points: np.ndarray, known: np.ndarray | None) -> np.ndarray:
    """Normals (n,3) with their sign by `known` ones, else upwards, else away from the middle."""
    if known is not None:
        sign = (normals * known).sum(axis=1)
    else:
        out = ((points - points.mean(axis=0)) * normals)[:, :2].sum(axis=1)
        sign = np.where(np.abs(normals[:, 2]) > 0.3, normals[:, 2], out)
    turned: np.ndarray = np.where(sign[:, None] < 0, -normals, normals)
    return turned


def changes(signed_: Signed, least: float, spacing: float, most: int = 20) -> tuple[Change, ...]:
    """Connected groups of places whose distance is significant and at least `least`, the largest first."""
    with np.errstate(invalid="ignore"):
        moved = np.flatnonzero(signed_.significant & (np.abs(signed_.distance) >= least))
    if not len(moved):
        return ()
    places, distance = signed_.places[moved], signed_.distance[moved]
    pairs = cKDTree(places).query_pairs(2.5 * spacing, output_type="ndarray")
    pairs = pairs[np.sign(distance[pairs[:, 0]]) == np.sign(distance[pairs[:, 1]])]
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(moved),) * 2)
    label = connected_components(graph, directed=False)[1]
    found = []
    for group in np.flatnonzero(np.bincount(label) >= _CLUSTER_POINTS):
        inside = label == group
        area, mean = float(inside.sum()) * spacing**2, float(distance[inside].mean())
        x, y, z = places[inside].mean(axis=0).tolist()
        width, depth, height = np.ptp(places[inside], axis=0).tolist()
        found.append(Change((x, y, z), (width, depth, height), area, mean))
    return tuple(sorted(found, key=lambda one: -abs(one.area * one.distance))[:most])


# ---- noise and density

def noise_and_density(points: np.ndarray, at: np.ndarray, radius: float) -> tuple[float, float]:
    """Where the reference is flat, at places (n,3): the median standard deviation of a cloud's points within `radius`
    of a place from the plane that fits them, and the median number of points a unit of area. NaN where there are too
    few points."""
    kept = _near(points, at, radius)
    if not len(kept):
        return float("nan"), float("nan")
    noise, density = [], []
    for near in cKDTree(kept).query_ball_point(at, radius):
        density.append(len(near) / (np.pi * radius**2))
        if len(near) >= _PATCH_POINTS:
            patch = kept[near]
            values = np.linalg.eigvalsh(np.cov(patch.T))
            noise.append(float(np.sqrt(max(values[0], 0.0))))
    return (float(np.median(noise)) if noise else float("nan"), float(np.median(density)) if density else float("nan"))


def flat_places(reference: np.ndarray, radius: float) -> np.ndarray:
    """Places (n,3) of a cloud about which it is flattest."""
    chosen = np.random.default_rng(0).choice(len(reference), min(_PATCHES, len(reference)), replace=False)
    kept = _near(reference, reference[chosen], 2 * radius)
    flatness = []
    for near in cKDTree(kept).query_ball_point(reference[chosen], 2 * radius):
        values = np.linalg.eigvalsh(np.cov(kept[near].T)) if len(near) >= _PATCH_POINTS else np.array([1.0, 1, 1])
        flatness.append(values[0] / max(values[1], 1e-30))
    order = np.argsort(flatness)
    places: np.ndarray = reference[chosen[order[: max(int(_FLAT * len(order)), 1)]]]
    return places


def cores_of(points: np.ndarray, normals: np.ndarray | None, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Places (n,3) of a cloud, one a voxel of `spacing`, and their normals (n,3) that face outwards."""
    which = one_a_voxel(points, spacing)
    places = points[which]
    tree = cKDTree(points[one_a_voxel(points, spacing / 2)])
    near = tree.query(places, k=min(24, tree.n))[1]
    local = tree.data[near.reshape(len(places), -1)]
    local = local - local.mean(axis=1, keepdims=True)
    made = np.linalg.eigh(np.einsum("nki,nkj->nij", local, local))[1][:, :, 0]
    return places, facing(made, places, None if normals is None else normals[which])
