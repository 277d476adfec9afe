# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A distance between two picked points, with its uncertainty.

The model. Each pick is off by two things: along the local surface by half the spacing of the measured points, since
what was meant may lie between two of them; across it by the measured points' own scatter, the root-mean-square
distance of the nearest ones from their plane. Where the pick lies farther from any measured point than their spacing,
nobody measured there, and that gap counts in full. Scatter is what the matching is off by from point to point; where
the points' standard deviations are known, which hold what cameras and lenses contribute as well, the larger of the two
counts. The two picks' parts along the measured line and the scale's own deviation times the length are independent and
add in squares. What is shown is twice the standard deviation, which holds 19 times out of 20. A model that is bent as a
whole shows in the standard deviations alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

NEAREST = 32  # measured points that tell spacing and scatter
SAMPLE = 50_000  # points that tell where the nearest may lie
SHOWN = 2.0  # standard deviations


@dataclass(frozen=True, kw_only=True)
class Surroundings:
    """Of the measured points about a pick, in their own unit: `spacing`, `scatter` off their plane, its unit `normal`
    (3,), the `gap` between the pick and the nearest of them, and their own standard deviations `sigmas` (3,)."""

    spacing: float
    scatter: float
    normal: np.ndarray
    gap: float
    sigmas: np.ndarray

    def sigma_along(self, direction: np.ndarray) -> float:
        """Standard deviation of the pick along a unit vector (3,)."""
        across = float(self.normal @ direction) ** 2
        gap = self.gap if self.gap > self.spacing else 0.0
        measured = max(across * self.scatter**2, float(self.sigmas**2 @ direction**2))
        return float(np.sqrt(measured + (1 - across) * (self.spacing / 2) ** 2 + gap**2))


def surroundings(points: np.ndarray, place: np.ndarray, sigmas: np.ndarray | None = None) -> Surroundings | None:
    """What the NEAREST of `points` (N,3) say about `place` (3,), in the points' unit; None for fewer than 4 points.
    `sigmas` (N,3) are their standard deviations, where these are known."""
    if len(points) < 4:
        return None
    about = _about(points, place)
    points = points[about]
    squared = np.square(points[:, 0] - np.float32(place[0]))
    squared += np.square(points[:, 1] - np.float32(place[1]))
    squared += np.square(points[:, 2] - np.float32(place[2]))
    count = min(NEAREST, len(points))
    chosen = np.argpartition(squared, count - 1)[:count]
    near = points[chosen].astype(np.float64)
    reach = float(np.sqrt(squared[chosen].max()))
    gap = float(np.sqrt(squared[chosen].min()))
    values, vectors = np.linalg.eigh(np.cov(near.T, bias=True))
    # The disc that holds them, or the annulus where the pick lies beside them all.
    area = np.pi * max(reach**2 - gap**2, 1e-12)
    return Surroundings(
        spacing=float(np.sqrt(area / count)), scatter=float(np.sqrt(max(values[0], 0.0))), normal=vectors[:, 0],
        gap=gap, sigmas=np.zeros(3) if sigmas is None else np.median(sigmas[about][chosen], axis=0),
    )


def _about(points: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Which of points (N,3), by number, lie in a cube about a place (3,) that holds its nearest: a sample's are no
    nearer."""
    sample = np.linalg.norm(points[:: max(1, len(points) // SAMPLE)] - place, axis=1)
    reach = np.sort(sample)[:NEAREST].max(initial=0)
    found = np.arange(len(points))
    for axis in range(3):
        found = found[np.abs(points[found, axis] - np.float32(place[axis])) <= reach]
    return found


def spread(first: np.ndarray, second: np.ndarray, around: tuple[Surroundings | None, Surroundings | None]) -> float:
    """Standard deviation (in the points' unit) that both picks give to their distance."""
    line = second - first
    direction = line / max(float(np.linalg.norm(line)), 1e-12)
    return float(np.sqrt(sum(place.sigma_along(direction) ** 2 for place in around if place is not None)))


def uncertainty(length: float, spread: float, scale_sigma: float | None) -> float:
    """What stands behind the ±: SHOWN standard deviations, in the length's unit. `scale_sigma` is relative; None where
    the scale is unknown and adds nothing."""
    return float(SHOWN * np.hypot(spread, length * (scale_sigma or 0.0)))


def in_words(length: float, plus_minus: float, *, metres: bool) -> str:
    """"12.34 m ± 0.03 m", to the digits that mean something."""
    unit = "m" if metres else "units"
    decimals = int(np.clip(-np.floor(np.log10(max(plus_minus, 1e-4))), 2 if plus_minus < 1 else 0, 4))
    return f"{length:.{decimals}f} {unit} ± {plus_minus:.{decimals}f} {unit}"
