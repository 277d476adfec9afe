# SPDX-License-Identifier: GPL-3.0-or-later
"""The things of daily life about the Tulou, and the dry-stone walls. Site frame: metres, z up."""

from __future__ import annotations

import numpy as np
from site_mesh import boxes, grid_part, lathe, noise, rod, stones
from tulou_model import CLOTH
from tulou_plan import GATE, WOOD, Site
from tulou_surroundings import on_ground, place, terrain


def _stone_wall(site: Site, line: np.ndarray, height: float, seed: int) -> None:
    """A dry-stone wall along xy points (N, 2), following the ground."""
    lengths = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    s = np.arange(0, lengths[-1], 0.09)
    xy = np.stack([np.interp(s, lengths, line[:, 0]), np.interp(s, lengths, line[:, 1])], 1)
    forward = np.gradient(xy, axis=0)
    side = np.stack([-forward[:, 1], forward[:, 0]], 1) / np.linalg.norm(forward, axis=1, keepdims=True)
    profile = np.array([[0.28, -0.4]] + [[0.26 - 0.02 * i, 0.1 * i] for i in range(int(height * 10) + 1)])
    profile = np.concatenate([profile, profile[::-1] * [-1, 1]])
    around = np.cumsum(np.concatenate([[0], np.linalg.norm(np.diff(profile, axis=0), axis=1)]))
    ss, vv = np.meshgrid(s, around, indexing="ij")
    relief, tone = stones(ss / 0.42, vv / 0.3, seed)
    out = profile[None, :, 0] * (0.85 + 0.4 * relief)
    z = terrain(xy)[:, None] + profile[None, :, 1] * (1 + 0.25 * noise(np.stack([ss, vv * 0, vv * 0], -1), 1.6, seed))
    points = np.concatenate([xy[:, None] + side[:, None] * out[..., None], z[..., None]], -1)
    site["stone"].add(grid_part(points, np.stack([tone, 1 - relief, 0.6 + 0 * tone, 1 + 0 * tone], -1)))


def add_clutter(site: Site, rng: np.random.Generator) -> None:
    """Drying trays, racks, firewood, a cart, jars, sacks, rocks and dry-stone walls."""
    crops = np.array([[0.42, 0.06, 0.02], [0.5, 0.32, 0.05], [0.46, 0.2, 0.04], [0.35, 0.27, 0.15], [0.16, 0.2, 0.07]])
    tangent = np.array([-np.sin(GATE), np.cos(GATE)])
    outward = np.array([np.cos(GATE), np.sin(GATE)])
    for row in range(4):
        for column in range(9):
            if rng.random() < 0.25:
                continue
            xy = outward * (29.0 + 2.0 * row) + tangent * (1.5 * column - 7.5) + rng.normal(0, 0.16, 2)
            wide = rng.uniform(0.5, 0.72)
            profile = np.array([(0, 0.06), (wide * 0.55, 0.075), (wide * 0.9, 0.06), (wide, 0.14), (wide * 1.03, 0.02)])
            tray = lathe(profile, on_ground(xy)[0], np.array([0.33, 0.25, 0.13, 1]), 22)
            middle = np.hypot(*(tray.vertices[:, :2] - xy).T) < wide * 0.91
            tray.paint[middle, :3] = crops[rng.integers(len(crops))]
            site["goods"].add(tray)
    for azimuth, radius, turn in ((72, 25.4, 0.2), (225, 25.6, -0.6), (346, 26, 0.1), (131, 38, 0.8), (42, 39, 1.2)):
        foot = on_ground(place(azimuth, radius))[0]
        along = np.array([np.cos(turn), np.sin(turn), 0])
        across = np.array([-np.sin(turn), np.cos(turn), 0])
        for layer in range(8):
            for column in range(14):
                start = foot + along * (0.2 * column + 0.1 * (layer % 2)) + [0, 0, 0.1 + 0.18 * layer]
                depth = across * rng.uniform(0.4, 0.55)
                log = rod(
                    np.array([start - depth, start + depth]),
                    rng.uniform(0.075, 0.11),
                    np.array([rng.uniform(0.1, 0.9), 0, 0, 1]),
                    6,
                )
                site["bark"].add(log)
    for azimuth, radius, turn in ((150, 40, 0.3), (205, 28.5, 1.1), (28, 28, 2.0), (300, 28, 0.7)):
        a = on_ground(place(azimuth, radius))[0]
        d = np.array([np.cos(turn), np.sin(turn), 0]) * 4.2
        for end in (a, a + d):
            site["wood"].add(rod(np.array([end - [0, 0, 0.3], end + [0, 0, 2.1]]), 0.05, WOOD))
        site["wood"].add(rod(np.array([a + [0, 0, 2.0], a + d + [0, 0, 2.0]]), 0.035, WOOD))
        for share in (0.14, 0.33, 0.52, 0.68, 0.87):
            u, v = np.meshgrid(np.linspace(-0.36, 0.36, 12), np.linspace(0, rng.uniform(0.7, 1.4), 9))
            swing = 0.07 * np.sin(11 * u + share * 20) * v
            normal = np.array([-d[1], d[0], 0]) / 4.2
            cloth = (
                a + d * share + (d / 4.2) * u[..., None] + normal * swing[..., None] + [0, 0, 1] * (1.98 - v[..., None])
            )
            colour = np.append(CLOTH[rng.integers(len(CLOTH))], 1.0)
            site["goods"].add(grid_part(cloth, np.broadcast_to(colour, (*u.shape, 4))))
    cart = on_ground(place(148, 30.5))[0]
    site["wood"].add(boxes(cart + [0, 0, 0.72], (2.4, 1.3, 0.1), 0.5, WOOD))
    for side in (-1, 1):
        shift = np.array([-np.sin(0.5), np.cos(0.5), 0]) * side
        site["wood"].add(boxes(cart + shift * 0.62 + [0, 0, 0.95], (2.4, 0.06, 0.4), 0.5, WOOD))
        turn = np.linspace(0, 2 * np.pi, 25)[:, None]
        hub = cart + shift * 0.78 + [0, 0, 0.5]
        rim = hub + 0.46 * (np.cos(turn) * [np.cos(0.5), np.sin(0.5), 0] + np.sin(turn) * [0, 0, 1])
        site["wood"].add(rod(rim, 0.05, WOOD))
        site["wood"].add(
            rod(np.array([cart + shift * 0.5 + [0, 0, 0.72], cart + shift * 0.5 + [2.3, 1.3, 0.3]]), 0.045, WOOD)
        )
    sacks = on_ground(place(141, 27.5) + rng.normal(0, 0.9, (14, 2)))
    for sack in sacks:
        profile = np.array([(0, 0.5), (0.2, 0.5), (0.36, 0.32), (0.38, 0.12), (0.3, 0)]) * rng.uniform(0.8, 1.3)
        colour = rng.choice([[0.42, 0.33, 0.19], [0.5, 0.44, 0.33], [0.3, 0.2, 0.1]])
        site["goods"].add(lathe(profile, sack, np.append(colour, 1), 12))
    for azimuths, radius, height, seed in (
        ((172, 196), 33, 1.0, 301),
        ((98, 116), 36, 1.3, 302),
        ((222, 262), 38.5, 0.9, 303),
        ((2, 40), 38.5, 1.1, 304),
        ((288, 322), 34, 1.2, 305),
        ((60, 82), 47, 1.0, 306),
        ((150, 132), 45, 0.8, 307),
    ):
        line = np.array([place(a, radius + 1.5 * np.sin(a * 0.35)) for a in np.linspace(*azimuths, 12)])
        _stone_wall(site, line, height, seed)
