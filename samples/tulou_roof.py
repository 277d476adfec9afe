# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The roofs of the Tulou's rings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from site_mesh import boxes, grid_part, noise, ridge, tiled_slope
from tulou_plan import GATE, Site, polar


@dataclass(frozen=True, kw_only=True)
class RingRoof:
    """A ring's two slopes over an arc: radii and heights of ridge and eaves, metres and radians."""

    start: float
    end: float
    ridge_radius: float
    ridge_z: float
    outer_radius: float
    outer_z: float
    inner_radius: float
    inner_z: float
    seed: int
    sag: float = 0.13

    def surface(self, eave_radius: float, eave_z: float):
        """The slope from an eave to the ridge, slightly hollow and uneven."""

        def point(s: np.ndarray, t: np.ndarray) -> np.ndarray:
            theta = self.start + (self.end - self.start) * s
            radius = eave_radius + (self.ridge_radius - eave_radius) * t
            z = eave_z + (self.ridge_z - eave_z) * (0.82 * t + 0.18 * t * t)
            flat = polar(theta, radius, 0 * radius)
            return polar(theta, radius, z + self.sag * noise(flat, 5.0, self.seed, 3))

        return point

    def add(self, site: Site, repaired_out: list, repaired_in: list) -> None:
        angle = self.end - self.start
        for eave, z, repaired, moss, seed in (
            (self.outer_radius, self.outer_z, repaired_out, 0.42, 1),
            (self.inner_radius, self.inner_z, repaired_in, 0.55, 2),
        ):
            run = float(np.hypot(eave - self.ridge_radius, self.ridge_z - z))
            tiles, under = tiled_slope(
                self.surface(eave, z),
                angle * (eave + self.ridge_radius) / 2,
                run,
                self.seed * 10 + seed,
                repaired=repaired,
                moss=moss,
            )
            site["tile"].add(tiles)
            site["wood"].add(under)
        s = np.linspace(0, 1, int(angle * self.ridge_radius / 0.3))
        line = self.surface(self.outer_radius, self.outer_z)(s, np.ones_like(s))
        site["tile"].add(ridge(line, 0.5, 0.42, self.seed))

    def radial_ridge(self, site: Site, s: float) -> None:
        """A raised line of brick down both slopes, as where two households' roofs meet."""
        t = np.linspace(0.02, 1, 24)
        for eave, z in ((self.outer_radius, self.outer_z), (self.inner_radius, self.inner_z)):
            site["tile"].add(ridge(self.surface(eave, z)(np.full_like(t, s), t), 0.34, 0.22, self.seed + 5))


def outer_roof(site: Site) -> None:
    roof = RingRoof(
        start=GATE + np.pi,
        end=GATE + 3 * np.pi,
        ridge_radius=18.4,
        ridge_z=12.2,
        outer_radius=23.9,
        outer_z=9.75,
        inner_radius=14.3,
        inner_z=9.55,
        seed=41,
    )
    roof.add(
        site,
        [(0.06, 0, 0.13, 1), (0.33, 0.45, 0.37, 1), (0.655, 0, 0.70, 0.55), (0.9, 0.2, 0.93, 0.8)],
        [(0.2, 0, 0.245, 1), (0.52, 0.3, 0.56, 1), (0.8, 0, 0.86, 0.6)],
    )
    for s in (0.0005, 0.13, 0.245, 0.41, 0.587, 0.7, 0.885):
        roof.radial_ridge(site, s)
    tarpaulin = roof.surface(23.9, 9.75)
    s, t = np.meshgrid(np.linspace(0.765, 0.795, 40), np.linspace(0.25, 0.85, 50))
    cloth = tarpaulin(s, t)
    cloth[..., 2] += 0.14 + 0.04 * noise(cloth, 0.8, 43)
    stripe = (np.floor(s * 550) % 3 == 0)[..., None]
    site["goods"].add(grid_part(cloth, np.where(stripe, [0.55, 0.55, 0.55, 1], [0.06, 0.15, 0.38, 1])))
    weights = tarpaulin(np.array([0.767, 0.78, 0.793, 0.77, 0.79]), np.array([0.3, 0.28, 0.3, 0.8, 0.82]))
    site["stone"].add(boxes(weights + [0, 0, 0.25], (0.4, 0.3, 0.22), np.arange(5.0), np.array([0.6, 0, 0.2, 1])))
