# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A mesh cut by a plane: the lines in which they meet, measured ones apart from those of filled faces."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Line:
    """Points (N,3) in a row; a closed one ends where it begins, without saying so twice. `filled`: no photo measured
    it."""

    points: np.ndarray
    closed: bool
    filled: bool


def cut(vertices: np.ndarray, faces: np.ndarray, filled: np.ndarray, height: np.ndarray, level: float) -> list[Line]:
    """The lines on which `height` (N,), a linear measure at the vertices (N,3), is `level`. `filled` (M,) tells of the
    faces (M,3) that no photo measured."""
    above = height >= level
    corners = above[faces]
    crossed = corners.any(axis=1) & ~corners.all(axis=1)
    lines: list[Line] = []
    for which in (False, True):
        chosen = np.flatnonzero(crossed & (filled == which))
        if len(chosen):
            lines += [Line(points, closed, which) for points, closed in
                      _lines(vertices, faces[chosen], corners[chosen], height - level)]
    return lines


def _lines(
    vertices: np.ndarray, faces: np.ndarray, above: np.ndarray, height: np.ndarray
) -> Iterator[tuple[np.ndarray, bool]]:
    """Of faces that the plane crosses: two edges of each."""
    following = np.roll(faces, -1, axis=1)
    crosses = above != np.roll(above, -1, axis=1)
    low, high = np.minimum(faces, following)[crosses], np.maximum(faces, following)[crosses]
    names, edge = np.unique(low.astype(np.int64) * len(vertices) + high, return_inverse=True)
    first, second = np.divmod(names, len(vertices))
    # From the lower numbered vertex, so that both faces at an edge have the very same point.
    share = (height[first] / (height[first] - height[second]))[:, None]
    places = vertices[first] + share * (vertices[second] - vertices[first])
    for chain, closed in _chains(edge.reshape(-1), len(names)):
        yield places[chain], closed


def _chains(ends: np.ndarray, count: int) -> Iterator[tuple[list[int], bool]]:
    """Segments, whose ends (2S,) are numbers of `count` points, joined where exactly two meet."""
    order = np.argsort(ends, kind="stable")
    meeting = np.bincount(ends, minlength=count)
    firsts = (np.cumsum(meeting) - meeting)[meeting == 2]
    partner = np.full(len(ends), -1)
    partner[order[firsts]], partner[order[firsts + 1]] = order[firsts + 1], order[firsts]
    point, other = ends.tolist(), partner.tolist()
    done = [False] * (len(point) // 2)
    starts = [*np.flatnonzero(partner < 0).tolist(), *range(0, len(point), 2)]  # open ones first, then rings
    for start in starts:
        if done[start // 2]:
            continue
        chain, at = [point[start]], start
        while True:
            done[at // 2] = True
            far = at ^ 1
            chain.append(point[far])
            at = other[far]
            if at < 0 or done[at // 2]:
                break
        closed = at >= 0 and len(chain) > 3 and chain[0] == chain[-1]
        yield (chain[:-1] if closed else chain), closed


def clipped(line: Line, along: np.ndarray, low: float, high: float) -> Iterator[Line]:
    """The parts of a line that lie between `low` and `high` of a measure `along` (3,)."""
    points = np.vstack([line.points, line.points[:1]]) if line.closed else line.points
    place = points @ along
    if low <= place.min() and place.max() <= high:
        yield line
        return
    part: list[np.ndarray] = []
    for a, b, s, t in zip(points[:-1], points[1:], place[:-1], place[1:], strict=True):
        shares = sorted(np.clip((bound - s) / (t - s), 0, 1) for bound in (low, high)) if s != t else [0.0, 1.0]
        middle = s + (t - s) * (shares[0] + shares[1]) / 2
        if shares[0] == shares[1] or not low <= middle <= high:
            if len(part) > 1:
                yield Line(np.array(part), False, line.filled)
            part = []
            continue
        begin, end = a + (b - a) * shares[0], a + (b - a) * shares[1]
        if shares[0] > 0 and len(part) > 1:
            yield Line(np.array(part), False, line.filled)
        part = [*part, end] if part and shares[0] == 0 else [begin, end]
    if len(part) > 1:
        yield Line(np.array(part), False, line.filled)
