# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The coarse step: how one cloud lies on another is found alone, from any start, by what their surfaces look like.

Points of both, one a voxel, are described by how the normals around them stand to each other, which neither turning
nor mirroring nor the normals' sign changes. Pairs that look alike vote: two agree when their distances do, and a pair
counts by how many others agree with it and its friends (spatial compatibility of second order, Chen et al. 2022).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .geometry import Similarity, Thin, angle_of, fitted, one_a_voxel, thin_of, turned, voxel_numbers
from .icp import refine

VOXELS = 2500  # points of the smaller cloud, about
_MOST = 8_000  # of the larger one
_PAIRS, _SEEDS, _FRIENDS, _TRIED = 1200, 60, 24, 5
_NEAR, _AROUND = 1.5, 5.0  # voxels: a partner; near enough that a missing partner speaks against a motion
_OFF = 0.7  # of a distance that is along the normal
_RADII = (3.0, 6.0)  # voxels that a point is described by
_BINS = 5
_NEIGHBOURS = 60
_SLACK = 0.05  # of a distance, where the scale is open
_TURNS, _SLID = 36, 2  # around; by so many of them a part of a ring still lies on the ring
_SLIDES, _SLIDE = 8, 0.6  # to either side, and up to what share of the source's length
_CLEAR, _CLEAR_AGAINST = 0.7, 0.05  # shares that leave no need to try another scale
_TELLING = 50  # partners whose colours say something
_DISTINCT_ANGLE, _DISTINCT_SHIFT = 8.0, 6.0  # degrees, voxels: from there on two motions are two


Coloured = tuple[np.ndarray, np.ndarray | None]  # points (N,3) float64, their colours (N,3) uint8


@dataclass(frozen=True)
class Guess:
    """A motion: of the source's voxels the shares that have a partner, and that lie off the target's surface;
    `colours` is 1 where they say nothing, more where they agree; `score` puts all together, times the area met."""

    motion: Similarity
    partners: float
    against: float
    score: float
    colours: float = 1.0


@dataclass(frozen=True)
class Found:
    """The best motion, the others that are distinct, best first, and the voxel's side in the target's units."""

    best: Guess
    others: tuple[Guess, ...]
    voxel: float


def search(source: Coloured, target: Coloured, scales: Sequence[float], *, scaled: bool) -> Found | None:
    """How the source may lie on the target. `scales` are tried one after another; where `scaled` they need only be
    right to about a tenth. None where nothing agrees."""
    voxel = _voxel(source[0] * scales[0], target[0])
    b = _described(_grid(target, voxel, 1.0))
    found: list[tuple[Guess, float]] = []
    for scale in scales:
        a = _described(_grid(source, voxel, scale))
        voted = _vote(a, b, voxel, scaled=scaled)
        found += [(guess, scale) for guess in voted]
        if any(guess.partners > _CLEAR and guess.against < _CLEAR_AGAINST for guess in voted):
            break
    if not found:
        return None
    best, scale = max(found, key=lambda one: one[0].score)
    a = _described(_grid(source, voxel, scale))
    same_scale = [guess for guess, of in found if of == scale]
    alike = _alike_motions(a.thin, b.thin, best, voxel, scaled=scaled)
    others = _distinct([*same_scale, *alike], a.thin.points, voxel)
    best = others[0]
    middle = a.thin.points.mean(axis=0)
    kept = [other for other in others if differ(other.motion, best.motion, middle, voxel)]
    first, *rest = (
        replace(one, motion=Similarity(one.motion.scale * scale, one.motion.rotation, one.motion.translation))
        for one in (best, *kept))
    return Found(first, tuple(rest), voxel)


def _voxel(a: np.ndarray, b: np.ndarray) -> float:
    """The side of voxels of which the smaller of the clouds fills VOXELS, and the larger at most _MOST."""
    def side(points: np.ndarray, wanted: int) -> float:
        points = points[:: max(len(points) // 60_000, 1)]
        extent = float(np.linalg.norm(np.percentile(points, 98, axis=0) - np.percentile(points, 2, axis=0)))
        low, high = extent / 2000, extent / 2
        for _ in range(12):
            size = float(np.sqrt(low * high))
            low, high = (size, high) if len(one_a_voxel(points, size)) > wanted else (low, size)
        return high

    return max(min(side(a, VOXELS), side(b, VOXELS)), side(a, _MOST), side(b, _MOST))


def _grid(cloud: Coloured, voxel: float, scale: float) -> Thin:
    """The middle of the points in each voxel."""
    every = max(len(cloud[0]) // 300_000, 1)
    points = cloud[0][::every] * scale
    _, inverse, counts = np.unique(voxel_numbers(points, voxel), return_inverse=True, return_counts=True)
    sums = np.stack([np.bincount(inverse.ravel(), points[:, axis]) for axis in range(3)], axis=1)
    tones = None
    if cloud[1] is not None:
        light = np.bincount(inverse.ravel(), cloud[1][::every].astype(np.float64).mean(axis=1)) / counts
        tones = np.log(light + 16)
    return thin_of(sums / counts[:, None], tones)


@dataclass(frozen=True)
class _Described:
    thin: Thin
    features: np.ndarray  # (n,f)
    told: np.ndarray  # (n,) how much a point differs from most


def _described(thin: Thin) -> _Described:
    points, normals = thin.points, thin.normals
    k = min(_NEIGHBOURS + 1, len(points))
    distance, near = thin.tree.query(points, k=k)
    spacing = float(np.median(distance[:, 1]))
    parts = []
    for radius in _RADII:
        inside = (distance[:, 1:] < radius * spacing * 1.3).astype(np.float64)
        weight = inside / np.maximum(inside.sum(axis=1, keepdims=True), 1)
        way = (points[near[:, 1:]] - points[:, None]) / np.maximum(distance[:, 1:, None], 1e-12)
        mine = np.abs(np.einsum("nkj,nj->nk", way, normals))
        theirs = np.abs(np.einsum("nkj,nkj->nk", way, normals[near[:, 1:]]))
        between = np.abs(np.einsum("nkj,nj->nk", normals[near[:, 1:]], normals))
        bins = [np.minimum((_BINS * value).astype(np.int64), _BINS - 1) for value in (mine, theirs, between)]
        cell = (bins[0] * _BINS + bins[1]) * _BINS + bins[2] + np.arange(len(points))[:, None] * _BINS**3
        histogram = np.bincount(cell.ravel(), weight.ravel(), minlength=len(points) * _BINS**3)
        parts.append(np.sqrt(histogram.reshape(len(points), -1)))
    features = np.hstack(parts)
    return _Described(thin, features, np.linalg.norm(features - features.mean(axis=0), axis=1))


def _vote(a: _Described, b: _Described, voxel: float, *, scaled: bool) -> list[Guess]:
    mine, theirs = _alike(a, b)
    if len(mine) < 4:
        return []
    p, q = a.thin.points[mine], b.thin.points[theirs]
    da, db = _distances(p), _distances(q)
    allowed = 1.5 * voxel + (_SLACK * np.maximum(da, db) if scaled else 0)
    agree = ((np.abs(da - db) < allowed) & (np.minimum(da, db) > 3 * voxel)).astype(np.float32)
    friends = agree * (agree @ agree)
    order = np.argsort(-friends.sum(axis=1))
    tried: list[Similarity] = []
    used = np.zeros(len(p), bool)
    for seed in order:
        if used[seed]:
            continue
        chosen = np.append(np.argsort(-friends[seed])[:_FRIENDS], seed)
        chosen = chosen[(friends[seed][chosen] > 0) | (chosen == seed)]
        if len(chosen) < 4:
            continue
        motion = fitted(p[chosen], q[chosen], scaled=scaled)
        close = np.linalg.norm(motion.apply(p) - q, axis=1) < 2.5 * voxel
        if close.sum() >= 4:
            motion = fitted(p[close], q[close], scaled=scaled)
        used |= np.linalg.norm(motion.apply(p) - q, axis=1) < 2.5 * voxel
        if 0.5 < motion.scale < 2:
            tried.append(motion)
        if len(tried) == _SEEDS:
            break
    first = sorted((scored(a.thin, b.thin, motion, voxel) for motion in tried), key=lambda guess: -guess.score)
    refined = [refine(a.thin, b.thin, guess.motion, _NEAR * voxel, scaled=scaled, rounds=12).motion
               for guess in _distinct(first, a.thin.points, voxel)[:_TRIED]]
    return [scored(a.thin, b.thin, motion, voxel) for motion in refined]


def _alike(a: _Described, b: _Described) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of points that are each other's likest, the most telling first."""
    likeness = a.features @ b.features.T
    best_b, best_a = likeness.argmax(axis=1), likeness.argmax(axis=0)
    mine = np.flatnonzero(best_a[best_b] == np.arange(len(best_b)))
    order = np.argsort(-(a.told[mine] + b.told[best_b[mine]]))[:_PAIRS]
    return mine[order], best_b[mine[order]]


def _distances(points: np.ndarray) -> np.ndarray:
    squares = (points**2).sum(axis=1)
    found: np.ndarray = np.sqrt(np.maximum(squares[:, None] + squares - 2 * points @ points.T, 0))
    return found


def scored(source: Thin, target: Thin, motion: Similarity, voxel: float) -> Guess:
    moved = motion.apply(source.points)
    distance, nearest = target.tree.query(moved, distance_upper_bound=_AROUND * voxel)
    around = np.isfinite(distance)
    partner = np.zeros(len(moved), bool)
    close = np.flatnonzero(around & (distance < _NEAR * voxel))
    turned_normals = source.normals[close] @ motion.rotation.T
    partner[close] = np.abs((turned_normals * target.normals[nearest[close]]).sum(axis=1)) > 0.7
    # What lies beside the target's edge says little; what lies off its surface says more.
    lonely = np.flatnonzero(around & ~partner)
    off = ((moved[lonely] - target.points[nearest[lonely]]) * target.normals[nearest[lonely]]).sum(axis=1)
    against = float((np.abs(off) > _OFF * distance[lonely]).sum()) / len(moved)
    partners = float(partner.mean())
    # A source of another scale has other voxels: what counts is the area that is met.
    score = (partners - 0.5 * len(lonely) / len(moved) - 0.5 * against) * len(moved) * motion.scale**2
    colours = _colours_agree(source, target, partner, nearest)
    return Guess(motion, partners, against, score * colours, colours)


def _colours_agree(source: Thin, target: Thin, partner: np.ndarray, nearest: np.ndarray) -> float:
    """1 where nothing is known; up to 1.5 for partners that are bright and dark together."""
    if source.tones is None or target.tones is None or partner.sum() < _TELLING:
        return 1.0
    a, b = source.tones[partner], target.tones[nearest[partner]]
    if a.std() < 1e-3 or b.std() < 1e-3:
        return 1.0
    return 1 + 0.5 * float(np.clip(np.corrcoef(a, b)[0, 1], 0, 1))


def _distinct(found: Sequence[Guess], points: np.ndarray, voxel: float) -> list[Guess]:
    kept: list[Guess] = []
    middle = points.mean(axis=0)
    for guess in sorted(found, key=lambda one: -one.score):
        if all(differ(guess.motion, other.motion, middle, voxel) for other in kept):
            kept.append(guess)
    return kept


def differ(one: Similarity, other: Similarity, middle: np.ndarray, voxel: float) -> bool:
    """Whether two motions lay a cloud about `middle` (3,) differently."""
    shift = np.linalg.norm(one.apply(middle[None])[0] - other.apply(middle[None])[0])
    return angle_of(one.rotation.T @ other.rotation) > _DISTINCT_ANGLE or float(shift) > _DISTINCT_SHIFT * voxel


def _alike_motions(source: Thin, target: Thin, best: Guess, voxel: float, *, scaled: bool) -> list[Guess]:
    """Other motions that fit because what is there looks alike from several sides or places: the best one turned about
    the axes of the target's normals, as a ring's or a square's middle has them, and slid along them, as on a wall. Half
    a ring slides on the other half with no best place: it is turned a little, too."""
    found: list[Guess] = []
    normals = target.normals
    for axis in np.linalg.eigh(normals.T @ normals)[1].T:
        centre = _centre(target, axis)
        turns = [turned(axis * 2 * np.pi * turn / _TURNS) for turn in range(1, _TURNS)]
        changes = [Similarity(1.0, turn, centre - turn @ centre) for turn in turns]
        found += _peaks(source, target, best, changes, voxel, scaled=scaled)
        found += [_settled(source, target, change.after(best.motion), voxel, scaled=scaled)
                  for change in (changes[_SLID - 1], changes[-_SLID])]
        along = source.points @ (best.motion.rotation.T @ axis) * best.motion.scale
        step = max(_DISTINCT_SHIFT * voxel, _SLIDE * float(np.ptp(along)) / _SLIDES)
        slides = [slide for slide in range(-_SLIDES, _SLIDES + 1) if slide]
        found += _peaks(source, target, best, [Similarity(1.0, np.eye(3), axis * step * slide) for slide in slides],
                        voxel, scaled=scaled)
    return found


def _peaks(
    source: Thin, target: Thin, best: Guess, changes: Sequence[Similarity], voxel: float, *, scaled: bool
) -> list[Guess]:
    """The best motion changed by each of a row of changes: those that score better than their neighbours, refined."""
    scores = [scored(source, target, change.after(best.motion), 2 * voxel) for change in changes]
    peaks = [one for place, one in enumerate(scores) if one.score > 0.5 * best.score
             and one.score >= max(other.score for other in scores[max(place - 1, 0) : place + 2])]
    return [_settled(source, target, peak.motion, voxel, scaled=scaled)
            for peak in sorted(peaks, key=lambda one: -one.score)[:4]]


def _settled(source: Thin, target: Thin, motion: Similarity, voxel: float, *, scaled: bool) -> Guess:
    fine = refine(source, target, motion, _NEAR * voxel, scaled=scaled, rounds=12)
    return scored(source, target, fine.motion, voxel)


def _centre(target: Thin, axis: np.ndarray) -> np.ndarray:
    """The place (3,) that the normals across an axis point at, as those of a ring point at its middle."""
    across = target.normals - np.outer(target.normals @ axis, axis)
    kept = np.linalg.norm(across, axis=1) > 0.8
    points, n = target.points[kept], across[kept]
    if len(points) < 10:
        return target.points.mean(axis=0)
    n = n / np.linalg.norm(n, axis=1, keepdims=True)
    lines = np.eye(3) - np.einsum("ni,nj->nij", n, n)
    A = lines.sum(axis=0) + np.outer(axis, axis) * len(points)
    b = np.einsum("nij,nj->i", lines, points) + axis * (points @ axis).sum()
    return np.linalg.solve(A + 1e-9 * len(points) * np.eye(3), b)
