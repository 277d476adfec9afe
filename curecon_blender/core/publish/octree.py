# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Cubes that are halved along each axis, by which surfaces and clouds are cut into tiles."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

_DEEPEST = 20  # halvings: places that are still together then are one place


@dataclass(frozen=True)
class Cell:
    """A cube: its lowest corner (3,), its side, and how often the first one was halved for it."""

    low: np.ndarray
    side: float
    depth: int = 0

    def parts(
        self, places: Sequence[np.ndarray], members: Sequence[np.ndarray]
    ) -> Iterator[tuple[Cell, list[np.ndarray]]]:
        """The eighths that hold something. For each of several sets of `places` (N,3), `members` are the rows that lie
        in this cell, and what is yielded those that lie in its part."""
        half = self.side / 2
        octants = [(each[inside] >= self.low + half) @ np.array([1, 2, 4])
                   for each, inside in zip(places, members, strict=True)]
        for number in range(8):
            found = [inside[octant == number] for inside, octant in zip(members, octants, strict=True)]
            if any(map(len, found)):
                corner = self.low + half * np.array([(number >> axis) & 1 for axis in range(3)])
                yield Cell(corner, half, self.depth + 1), found

    @property
    def deepest(self) -> bool:
        return self.depth >= _DEEPEST


def around(places: np.ndarray) -> Cell:
    """The cube about places (N,3)."""
    low, high = places.min(axis=0), places.max(axis=0)
    side = max(float((high - low).max()), 1e-9)
    return Cell((low + high - side) / 2, side)
