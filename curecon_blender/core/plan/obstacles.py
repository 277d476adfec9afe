# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a drone must not touch: heights of the ground and everything on it, as columns of a grid. NumPy alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

CELL = 0.5  # metres
_STEP = 1.0  # metres between the places of a way that are looked at
_CHUNK = 20_000_000  # distances at once
_MOST_CELLS = 4_000_000


@dataclass(frozen=True)
class Heights:
    """Columns of `cell` metres that stand on the ground: `tops` (H,W) metres, row 0 in the south, the lower left
    corner of column 0, 0 at `corner` (2,) metres east and north. Outside of them the ground lies at 0."""

    tops: np.ndarray
    corner: np.ndarray
    cell: float

    def at(self, places: np.ndarray) -> np.ndarray:
        """Tops (N,) under places (N,2+)."""
        index = np.floor((places[:, :2] - self.corner) / self.cell).astype(int)
        rows, columns = index[:, 1], index[:, 0]
        inside = (rows >= 0) & (rows < self.tops.shape[0]) & (columns >= 0) & (columns < self.tops.shape[1])
        found = np.zeros(len(places))
        found[inside] = self.tops[rows[inside], columns[inside]]
        return found

    def clearance(self, places: np.ndarray, most: float) -> np.ndarray:
        """Metres (N,) from places (N,3) to the nearest column or to the ground, `most` where it is farther."""
        reach = int(np.ceil(most / self.cell)) + 1
        offsets = np.stack(np.meshgrid(np.arange(-reach, reach + 1), np.arange(-reach, reach + 1)), -1).reshape(-1, 2)
        nearest = np.minimum(places[:, 2], most).astype(float)
        for begin in range(0, len(places), max(1, _CHUNK // len(offsets))):
            part = slice(begin, begin + max(1, _CHUNK // len(offsets)))
            some = places[part]
            index = np.floor((some[:, :2] - self.corner) / self.cell).astype(int)[:, None] + offsets
            low = self.corner + index * self.cell
            beside = np.maximum(np.maximum(low - some[:, None, :2], some[:, None, :2] - low - self.cell), 0)
            rows, columns = index[..., 1], index[..., 0]
            inside = (rows >= 0) & (rows < self.tops.shape[0]) & (columns >= 0) & (columns < self.tops.shape[1])
            tops = np.where(inside, self.tops[np.clip(rows, 0, self.tops.shape[0] - 1),
                                              np.clip(columns, 0, self.tops.shape[1] - 1)], 0.0)
            above = np.maximum(some[:, None, 2] - tops, 0)
            distance = np.sqrt((beside**2).sum(axis=2) + above**2)
            nearest[part] = np.minimum(nearest[part], distance.min(axis=1))
        return nearest

    def hidden(self, eyes: np.ndarray, places: np.ndarray, steps: int = 48) -> np.ndarray:
        """Whether (N,) a column stands between each eye (N,3) and its place (N,3); the last metre before the place,
        which is part of what stands there, does not count."""
        length = np.linalg.norm(places - eyes, axis=1)
        reached = np.clip(1 - 1.0 / np.maximum(length, 1e-9), 0, 1)
        blocked = np.zeros(len(eyes), bool)
        for share in np.linspace(0, 1, steps):
            on_way = eyes + (places - eyes) * (share * reached)[:, None]
            blocked |= self.at(on_way) > on_way[:, 2] + 0.05
        return blocked

    @property
    def highest(self) -> float:
        return float(self.tops.max(initial=0.0))


def of_outline(outline: np.ndarray, height: float, court: np.ndarray | None = None) -> Heights:
    """A block of `height` metres on an outline (N,2), with a hole where the court (M,2) is."""
    low, high = outline.min(axis=0) - CELL, outline.max(axis=0) + CELL
    cell = _cell(high - low)
    size = np.ceil((high - low) / cell).astype(int)
    x, y = np.meshgrid(low[0] + (np.arange(size[0]) + 0.5) * cell, low[1] + (np.arange(size[1]) + 0.5) * cell)
    centres = np.stack([x.ravel(), y.ravel()], axis=1)
    solid = inside(centres, outline)
    if court is not None:
        solid &= ~inside(centres, court)
    return Heights(np.where(solid, height, 0.0).reshape(x.shape), low, cell)


def of_points(points: np.ndarray) -> Heights:
    """The highest of points (N,3) in each column, metres above the ground at 0."""
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    cell = _cell(high - low)
    size = np.floor((high - low) / cell).astype(int) + 1
    index = np.minimum(((points[:, :2] - low) / cell).astype(int), size - 1)
    tops = np.zeros((size[1], size[0]))
    np.maximum.at(tops, (index[:, 1], index[:, 0]), points[:, 2])
    return Heights(tops, low, cell)


def joined(first: Heights, second: Heights) -> Heights:
    """The higher of two everywhere, in the finer one's columns."""
    cell = min(first.cell, second.cell)
    low = np.minimum(first.corner, second.corner)
    high = np.maximum(*(part.corner + np.array(part.tops.shape[::-1]) * part.cell for part in (first, second)))
    cell = max(cell, _cell(high - low))
    size = np.ceil((high - low) / cell).astype(int)
    x, y = np.meshgrid(low[0] + (np.arange(size[0]) + 0.5) * cell, low[1] + (np.arange(size[1]) + 0.5) * cell)
    centres = np.stack([x.ravel(), y.ravel()], axis=1)
    return Heights(np.maximum(first.at(centres), second.at(centres)).reshape(x.shape), low, cell)


def along(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Places (N,3) on the straight way between two, a metre or less apart, both ends among them."""
    count = max(int(np.ceil(float(np.linalg.norm(end - start)) / _STEP)), 1)
    return start + np.linspace(0, 1, count + 1)[:, None] * (end - start)


def inside(places: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """Whether each place (N,2) lies within a simple polygon (M,2)."""
    found = np.zeros(len(places), bool)
    for (x0, y0), (x1, y1) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        if y0 == y1:
            continue
        crosses = (places[:, 1] < y0) != (places[:, 1] < y1)
        found ^= crosses & (places[:, 0] < x0 + (places[:, 1] - y0) / (y1 - y0) * (x1 - x0))
    return found


def _cell(size: np.ndarray) -> float:
    """Half a metre, or coarser where the site is so large that its columns would be too many."""
    return float(max(CELL, np.sqrt(np.prod(np.maximum(size, CELL)) / _MOST_CELLS)))
