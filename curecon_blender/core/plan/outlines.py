# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Outlines of buildings, and ways around them at a distance. NumPy alone; metres east and north."""

from __future__ import annotations

import numpy as np

from ..base.errors import PlanError
from ..base.language import Text

MOST_PHOTOS = 3000  # of one form


def hull(points: np.ndarray) -> np.ndarray:
    """The convex hull of points (N,2), anticlockwise."""
    rest = sorted({(float(x), float(y)) for x, y in points})

    def half(places: list[tuple[float, float]]) -> list[tuple[float, float]]:
        chain: list[tuple[float, float]] = []
        for place in places:
            while len(chain) > 1 and _turn(chain[-2], chain[-1], place) <= 0:
                chain.pop()
            chain.append(place)
        return chain[:-1]

    return np.array(half(rest) + half(rest[::-1]))


def area(outline: np.ndarray) -> float:
    """Of a simple polygon (N,2), in square metres; negative where it runs clockwise."""
    x, y = outline.T
    return float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum() / 2)


def middle(outline: np.ndarray) -> np.ndarray:
    """The centroid (2,) of a simple polygon."""
    x, y = outline.T
    cross = x * np.roll(y, -1) - np.roll(x, -1) * y
    return np.array([((x + np.roll(x, -1)) * cross).sum(), ((y + np.roll(y, -1)) * cross).sum()]) / (6 * area(outline))


def around(outline: np.ndarray, distance: float, step: float, most_turn: float) -> tuple[np.ndarray, np.ndarray]:
    """Places (N,2) on a closed way around the hull of an outline at a distance, evenly spread, and the directions (N,2)
    that look at the outline. Neighbours lie `step` metres apart or less and turn by `most_turn` degrees or less."""
    corners = hull(outline)
    edges = np.roll(corners, -1, axis=0) - corners
    edges = edges[np.linalg.norm(edges, axis=1) > 1e-9]
    normals = np.stack([edges[:, 1], -edges[:, 0]], axis=1) / np.linalg.norm(edges, axis=1)[:, None]
    angles = np.unwrap(np.arctan2(normals[:, 1], normals[:, 0]))
    places, ways = [], []
    for n, corner in enumerate(corners):
        before = angles[n - 1] - (2 * np.pi if n == 0 else 0)
        for angle in np.linspace(before, angles[n], max(int(np.degrees(angles[n] - before)), 1) + 1):
            ways.append(angle)
            places.append(corner + distance * np.array([np.cos(angle), np.sin(angle)]))
    line, angle = np.array([*places, places[0]]), np.array([*ways, ways[0] + 2 * np.pi])
    cost = np.maximum(np.linalg.norm(np.diff(line, axis=0), axis=1) / step, np.degrees(np.diff(angle)) / most_turn)
    along = np.concatenate([[0.0], np.cumsum(cost)])
    count = _bounded(max(along[-1], 4))
    wanted = np.arange(count) / count * along[-1]
    found = np.stack([np.interp(wanted, along, line[:, axis]) for axis in range(2)], axis=1)
    turned = np.interp(wanted, along, angle)
    return found, -np.stack([np.cos(turned), np.sin(turned)], axis=1)


def lines(outline: np.ndarray, direction: float, across: float, along: float, margin: float) -> np.ndarray:
    """Places (N,2) of a grid over an outline and a margin about it, line by line, every second one flown backwards.
    Lines run along `direction` (degrees clockwise from north) `across` metres apart; places lie `along` apart."""
    forward = heading_vector(direction)
    side = np.array([forward[1], -forward[0]])
    corners = hull(outline)
    frame = hull(corners @ np.stack([forward, side], axis=1))  # anticlockwise again in its mirrored axes
    low, high = frame.min(axis=0) - margin, frame.max(axis=0) + margin
    # A place counts where the photo's middle is no farther than the margin from the hull.
    rows = _bounded((high[1] - low[1]) / across)
    _bounded(rows * (high[0] - low[0]) / along)
    found: list[np.ndarray] = []
    for row, v in enumerate(np.linspace(low[1], high[1], rows + 1)):
        count = max(int(np.ceil((high[0] - low[0]) / along)), 1)
        line = np.stack([np.linspace(low[0], high[0], count + 1), np.full(count + 1, v)], axis=1)
        line = line[_distance(line, frame) <= margin + 1e-6]
        found.append(line if row % 2 == 0 else line[::-1])
    return np.concatenate(found) @ np.stack([forward, side])


def _bounded(count: float) -> int:
    """Rounded up, at least 1; raises PlanError for far more photos than anybody takes."""
    if count > MOST_PHOTOS:
        raise PlanError(Text("This plan would need {:,.0f} photos.", count),
                        remedy="Ask for more millimetres a pixel or less overlap, or plan a part of the site.")
    return max(int(np.ceil(count)), 1)


def heading_vector(heading: float) -> np.ndarray:
    """East and north (2,) of a heading in degrees clockwise from north."""
    return np.array([np.sin(np.radians(heading)), np.cos(np.radians(heading))])


def headings_of(directions: np.ndarray) -> np.ndarray:
    """Degrees (N,) clockwise from north, 0 to 360, of directions (N,2)."""
    return np.degrees(np.arctan2(directions[:, 0], directions[:, 1])) % 360


def _distance(places: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Metres (N,) from places to a convex anticlockwise polygon, 0 inside; an outline of two corners is a line."""
    ends = np.roll(corners, -1, axis=0)
    edge = ends - corners
    share = ((places[:, None] - corners) * edge).sum(axis=2) / np.maximum((edge**2).sum(axis=1), 1e-12)
    nearest = corners + np.clip(share, 0, 1)[..., None] * edge
    distance = np.linalg.norm(places[:, None] - nearest, axis=2).min(axis=1)
    cross = edge[:, 0] * (places[:, None, 1] - corners[:, 1]) - edge[:, 1] * (places[:, None, 0] - corners[:, 0])
    return np.where((cross >= 0).all(axis=1) & (len(corners) > 2), 0.0, distance)


def _turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
