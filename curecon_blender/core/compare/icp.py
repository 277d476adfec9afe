# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The fine step: points to planes, with a scale step on pairs that are each other's nearest (ICP)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .geometry import Similarity, Thin, turned

_ROUNDS = 24
_LEAST = 20  # pairs
_ALONG = 0.5  # cosine that the normals of a pair have in common, at least
_WIDE = 4.0  # reaches, within which partners are sought at first
_AROUND, _OFF = 3.0, 0.7  # reaches within which a missing partner tells against a motion, if so much is along a normal
_SURFACE = 3.0  # times what two thinned halves of one cloud lie off each other: still the same surface


@dataclass(frozen=True)
class Fine:
    """The motion, the shares of the source's and of the target's points that have a partner within `reach`, and the
    root mean square of the partners' distances along the target's normals."""

    motion: Similarity
    share: float
    target_share: float
    rms: float
    reach: float


@dataclass(frozen=True)
class Evidence:
    """For and against a motion: the shares of the source's points that lie on the target's surface, and that lie near
    it but off it. What lies beside the target says nothing."""

    on: float
    off: float


def refine(
    source: Thin, target: Thin, start: Similarity, reach: float, *, scaled: bool, rounds: int = _ROUNDS,
    wide: float = _WIDE,
) -> Fine:
    """From a start that is right to within `wide` times `reach`, which shrinks to it."""
    motion = start
    for step in range(rounds):
        within = reach * max(wide * 0.75**step, 1.0)
        pairs = _pairs(source, target, motion, within, mutual=scaled)
        if len(pairs[0]) < _LEAST:
            break
        change, scale = _step(motion.apply(source.points[pairs[0]]), target.points[pairs[1]], target.normals[pairs[1]],
                              scaled=scaled and step >= rounds // 4)
        middle = motion.apply(source.points.mean(axis=0)[None])[0]
        motion = change.after(motion)
        moved = np.linalg.norm(motion.apply(source.points.mean(axis=0)[None])[0] - middle)
        if within == reach and moved < 1e-5 * reach and abs(scale) < 1e-7 and step > rounds // 2:
            break
    return measured(source, target, motion, reach)


def measured(source: Thin, target: Thin, motion: Similarity, reach: float) -> Fine:
    """How well a motion fits."""
    mine, theirs = _pairs(source, target, motion, reach, mutual=False)
    if len(mine) < 2:
        return Fine(motion, 0.0, 0.0, float("nan"), reach)
    off = ((motion.apply(source.points[mine]) - target.points[theirs]) * target.normals[theirs]).sum(axis=1)
    back = motion.inverse()
    met = source.tree.query(back.apply(target.points), distance_upper_bound=reach / motion.scale)[0]
    return Fine(motion, len(mine) / len(source.points), float(np.isfinite(met).mean()),
                float(np.sqrt((off**2).mean())), reach)


def thickness(first: Thin, second: Thin) -> float:
    """How far two thinned halves of one cloud lie off each other, at most, where they are the same surface."""
    mine, theirs = _pairs(first, second, Similarity.identity(), np.inf, mutual=False)
    if not len(mine):
        return 0.0
    off = ((first.points[mine] - second.points[theirs]) * second.normals[theirs]).sum(axis=1)
    return _SURFACE * float(np.percentile(np.abs(off), 68))


def evidence(source: Thin, target: Thin, motion: Similarity, reach: float, thick: float) -> Evidence:
    """What the clouds say of a motion; `thick` is what a surface may lie off itself, in the target's units."""
    moved = motion.apply(source.points)
    distance, nearest = target.tree.query(moved, distance_upper_bound=_AROUND * reach)
    near = np.flatnonzero(np.isfinite(distance))
    normals = target.normals[nearest[near]]
    off = np.abs(((moved[near] - target.points[nearest[near]]) * normals).sum(axis=1))
    alike = np.abs((source.normals[near] @ motion.rotation.T * normals).sum(axis=1)) > _ALONG
    close = distance[near] <= reach
    on = close & alike & (off <= thick)
    against = (close & ~on) | (~close & (off > _OFF * distance[near]))
    return Evidence(float(on.sum()) / len(moved), float(against.sum()) / len(moved))


def _pairs(
    source: Thin, target: Thin, motion: Similarity, within: float, *, mutual: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of source and target points that are near each other and face alike."""
    moved = motion.apply(source.points)
    distance, nearest = target.tree.query(moved, distance_upper_bound=within)
    mine = np.flatnonzero(np.isfinite(distance))
    theirs = nearest[mine]
    alike = np.abs((source.normals[mine] @ motion.rotation.T * target.normals[theirs]).sum(axis=1)) > _ALONG
    mine, theirs = mine[alike], theirs[alike]
    if mutual and len(mine):
        back = source.tree.query(motion.inverse().apply(target.points[theirs]))[1]
        near = np.linalg.norm(source.points[back] - source.points[mine], axis=1) <= 0.5 * within / motion.scale
        mine, theirs = mine[near], theirs[near]
    return mine, theirs


def _step(points: np.ndarray, planes: np.ndarray, normals: np.ndarray, *, scaled: bool) -> tuple[Similarity, float]:
    """The small motion that brings points (n,3) to planes through (n,3), far ones counting less; its scale's log."""
    middle = points.mean(axis=0)
    arms = points - middle
    size = max(float(np.sqrt((arms**2).sum(axis=1).mean())), 1e-12)
    off = ((planes - points) * normals).sum(axis=1)
    columns = [np.cross(arms / size, normals), normals]
    if scaled:
        columns.append(((arms / size) * normals).sum(axis=1, keepdims=True))
    A = np.hstack(columns)
    spread = max(1.4826 * float(np.median(np.abs(off))), 1e-12)
    weights = 1 / (1 + (off / (2 * spread)) ** 2)
    H = (A * weights[:, None]).T @ A
    H += np.eye(len(H)) * 1e-9 * np.trace(H)
    x = np.linalg.solve(H, (A * weights[:, None]).T @ off)
    rotation = turned(x[:3] / size)
    scale = float(np.exp(np.clip(x[6] / size, -0.2, 0.2))) if scaled else 1.0
    return Similarity(scale, rotation, middle + x[3:6] - scale * rotation @ middle), float(np.log(scale))
