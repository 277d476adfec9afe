# SPDX-License-Identifier: GPL-3.0-or-later
"""What lies about the Tulou: ground, terraces, paths, plots, pond, houses and sheds.

Site frame: metres, x east, y north, z up. `azimuth` is clockwise from north in degrees, as on a map.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from site_mesh import Opening, boxes, grid_part, noise, ridge, stones, tiled_slope, wall
from tulou_model import wall_paint
from tulou_plan import GATE, WOOD, Site, polar

POND_CENTRE, POND_RADIUS, POND_LEVEL = np.array([-17.0, -38.5]), 8.5, -0.75


def place(azimuth: float, radius: float) -> np.ndarray:
    """Site x, y of a point by azimuth (degrees) and distance (metres) from the centre."""
    angle = np.radians(90 - azimuth)
    return radius * np.array([np.cos(angle), np.sin(angle)])


def smooth(value: np.ndarray, low: float, high: float) -> np.ndarray:
    """A smooth step from 0 at `low` to 1 at `high`."""
    t = np.clip((value - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def terrain(xy: np.ndarray) -> np.ndarray:
    """Height of the ground at xy (..., 2): level at the building, terraces north-west, hills far off."""
    flat = np.concatenate([xy, np.zeros((*xy.shape[:-1], 1))], -1)
    radius = np.hypot(xy[..., 0], xy[..., 1])
    away = smooth(radius, 26, 46)
    z = away * (1.3 * noise(flat, 38.0, 101, 3) + 0.018 * (xy[..., 1] - xy[..., 0]))
    uphill = (xy @ place(318, 1.0)) - 38 + 4 * noise(flat, 25.0, 102, 2)
    climb = np.clip(uphill, 0, 90) * 0.14
    level = np.floor(climb / 1.3)
    stepped = 1.3 * (level + smooth(climb / 1.3 - level, 0.86, 0.98))
    z = z * (1 - 0.8 * smooth(uphill, 0, 8)) + stepped
    z = z + smooth(radius, 80, 420) * (38 + 45 * noise(flat, 160.0, 103, 4))
    shore = np.linalg.norm(xy - POND_CENTRE, axis=-1)
    inside = 1 - smooth(shore, POND_RADIUS - 1.5, POND_RADIUS + 1.2)
    z = z * (1 - inside) - 1.6 * inside
    return z + 0.05 * noise(flat, 1.1, 104, 3) * smooth(radius, 22.5, 25)


def on_ground(xy: np.ndarray) -> np.ndarray:
    """Points (N, 3) of the ground at xy (N, 2)."""
    xy = np.atleast_2d(xy)
    return np.concatenate([xy, terrain(xy)[:, None]], 1)


PATHS = [
    np.array([place(158, 27), place(158, 48), place(168, 70), place(160, 130)]),
    np.array([place(158, 44), place(120, 39), place(85, 37), place(50, 36), place(15, 45), place(5, 90)]),
    np.array([place(62, 24), place(60, 36)]),
    np.array([place(279, 24), place(275, 45), place(255, 62), place(262, 120)]),
    np.array([place(275, 45), place(305, 42), place(335, 36), place(10, 36)]),
]
PLOTS = [  # centre azimuth and radius, length, width (metres), turn (degrees)
    (232, 33, 13, 9, 25),
    (247, 33.5, 8, 7, 40),
    (22, 32.5, 9, 7, -10),
    (118, 31.5, 7, 5, 60),
    (140, 55, 16, 10, 15),
    (205, 58, 18, 11, -30),
    (72, 54, 13, 10, 30),
    (262, 31.5, 6, 6, 10),
    (330, 31.5, 9, 4, 60),
]


def segment_distance(xy: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Distance of points (..., 2) from a polyline (N, 2)."""
    best = np.full(xy.shape[:-1], 1e9)
    for a, b in itertools.pairwise(line):
        d = b - a
        t = np.clip(((xy - a) @ d) / (d @ d), 0, 1)
        best = np.minimum(best, np.linalg.norm(xy - a - t[..., None] * d, axis=-1))
    return best


def plot_frame(plot: tuple) -> tuple[np.ndarray, np.ndarray]:
    """Centre and 2x2 rotation (columns: along the length, along the width) of a vegetable plot."""
    azimuth, radius, _, _, turn = plot
    a = np.radians(turn)
    return place(azimuth, radius), np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])


def _ground(site: Site) -> None:
    """One graded grid: 0.26 m cells near the building, metres far away."""
    u = np.linspace(-1, 1, 701)
    axis = 28.0 * np.sinh(3.7 * u) * (620 / (28.0 * np.sinh(3.7)))
    x, y = np.meshgrid(axis, axis)
    xy = np.stack([x, y], -1)
    z = terrain(xy)
    radius = np.hypot(x, y)
    flat = np.stack([x, y, 0 * x], -1)
    rough = 2.2 * noise(flat, 6.0, 111, 3)
    trodden = smooth(-(radius + rough), -31, -25) * 0.95
    for path in PATHS:
        trodden = np.maximum(trodden, smooth(-segment_distance(xy, path) - 0.3 * rough, -2.0, -0.9))
    plaza = np.abs((xy - place(158, 34)) @ np.array([[np.cos(GATE), -np.sin(GATE)], [np.sin(GATE), np.cos(GATE)]]))
    trodden = np.maximum(trodden, smooth(-np.maximum(plaza[..., 0] / 7, plaza[..., 1] / 9), -1.1, -0.95))
    tilled = np.zeros_like(x)
    for plot in PLOTS:
        centre, turn = plot_frame(plot)
        local = (xy - centre) @ turn
        inside = smooth(
            -np.maximum(np.abs(local[..., 0]) - plot[2] / 2, np.abs(local[..., 1]) - plot[3] / 2), -0.2, 0.3
        )
        tilled = np.maximum(tilled, inside)
        z = z + inside * 0.10 * np.cos(2 * np.pi * local[..., 1] / 0.9)
    uphill = smooth(xy @ place(318, 1.0), 40, 46)
    tilled = np.maximum(tilled, uphill * smooth(noise(flat, 22.0, 112, 2), 0.1, 0.2) * (radius < 130))
    lush = np.clip(
        0.45 + 0.9 * noise(flat, 13.0, 113) + 0.9 * smooth(radius, 90, 180) * noise(flat, 45.0, 115, 4), 0, 1
    )
    inner = radius < 16.6
    paint = np.stack([trodden, tilled * (trodden < 0.6), lush, np.ones_like(x)], -1)
    part = grid_part(np.stack([x, y, np.where(inner, -0.25, z)], -1), paint)
    site["ground"].add(part)
    cx, cy = np.meshgrid(np.linspace(-10, 10, 60), np.linspace(-10, 10, 60))
    level = POND_LEVEL + 0.012 * noise(np.stack([cx, cy, 0 * cx], -1), 1.2, 114)
    site["water"].add(grid_part(np.stack([cx + POND_CENTRE[0], cy + POND_CENTRE[1], level], -1)))


@dataclass(frozen=True, kw_only=True)
class House:
    """A gabled house: centre (metres), yaw of its ridge (degrees anticlockwise from east), sizes in metres."""

    x: float
    y: float
    yaw: float
    length: float
    width: float
    eaves: float
    rise: float
    material: str
    seed: int
    floor: float | None = None
    overhang: float = 0.8
    upsweep: float = 0.0
    moss: float = 0.4


def add_house(site: Site, house: House) -> None:
    """Walls with openings, gables, two tiled slopes, ridge and a stone plinth."""
    rng = np.random.default_rng(house.seed)
    yaw = np.radians(house.yaw)
    base = float(terrain(np.array([[house.x, house.y]]))[0]) if house.floor is None else house.floor
    turn = np.array([[np.cos(yaw), np.sin(yaw), 0], [-np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    origin = np.array([house.x, house.y, base])
    half_l, half_w, thick = house.length / 2, house.width / 2, 0.3

    def world(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        x, y, z = np.broadcast_arrays(x, y, z)
        return np.stack([x, y, z], -1).astype(float) @ turn + origin

    def paint(points: np.ndarray) -> np.ndarray:
        return wall_paint(points - [0, 0, base])

    for side in range(4):
        long_side = side % 2 == 0
        span, sign = (house.length, 1 if side == 0 else -1) if long_side else (house.width, 1 if side == 1 else -1)

        def surface(s: np.ndarray, z: np.ndarray, d: float, span=span, sign=sign, long_side=long_side) -> np.ndarray:
            if long_side:
                plain = world(s - span / 2, sign * (half_w - d), z)
            else:
                plain = world(sign * (half_l - d), s - span / 2, z)
            return plain + 0.03 * noise(plain, 1.3, house.seed)[..., None] * turn[1 if long_side else 0]

        openings = []
        for storey in np.arange(0, house.eaves - 2.2, 2.7):
            for s in np.arange(0.9, span - 1.4, rng.uniform(2.0, 2.8)):
                door = storey == 0 and long_side and rng.random() < 0.3
                if door or rng.random() < (0.6 if long_side else 0.4):
                    openings.append(
                        Opening(
                            left=s,
                            bottom=storey + (0.2 if door else 1.1),
                            width=1.0 if door else 0.8,
                            height=2.0 if door else 1.0,
                            depth=thick,
                        )
                    )
        front, backs = wall(surface, span, house.eaves, 0.2, openings, paint)
        site[house.material].add(front)
        if backs:
            site["wood"].add(backs)
    for sign in (-1, 1):
        t, v = np.meshgrid(np.linspace(-1, 1, 41), np.linspace(0, 1, 8))
        gable = world(sign * half_l, t * half_w, house.eaves + v * (1 - np.abs(t)) * (house.rise - 0.1))
        site[house.material].add(grid_part(gable, paint(gable)))

    reach = half_w + house.overhang
    drop = house.rise * house.overhang / half_w
    for sign in (-1, 1):

        def slope(s: np.ndarray, t: np.ndarray, sign=sign) -> np.ndarray:
            along = (s - 0.5) * (house.length + 2 * house.overhang * 0.8)
            z = house.eaves - drop + (house.rise + drop) * (0.85 * t + 0.15 * t * t) + 0.12
            z = z + house.upsweep * np.abs(2 * s - 1) ** 4 * (0.3 + 0.7 * t)
            points = world(along, sign * reach * (1 - t), z)
            points[..., 2] += 0.10 * noise(points * [1, 1, 0], 3.5, house.seed + 1)
            return points

        s0, t0 = rng.uniform(0, 0.7), rng.uniform(0, 0.5)
        repaired = [(s0, t0, s0 + rng.uniform(0.08, 0.25), t0 + rng.uniform(0.3, 0.6))] if rng.random() < 0.7 else []
        tiles, under = tiled_slope(
            slope,
            house.length + 1.6 * house.overhang,
            float(np.hypot(reach, house.rise + drop)),
            house.seed * 7 + sign,
            repaired=repaired,
            moss=house.moss,
        )
        site["tile"].add(tiles)
        site["wood"].add(under)
    s = np.linspace(0, 1, int(house.length / 0.3))
    site["tile"].add(ridge(slope(s, np.ones_like(s)), 0.42, 0.3 + 0.15 * (house.upsweep > 0), house.seed))
    s, v = np.meshgrid(np.linspace(0, 1, int((house.length + house.width) * 2 / 0.1)), np.linspace(-1.8, 0.5, 20))
    corner = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * [half_l + 0.1, half_w + 0.1]
    walked = np.cumsum([0, house.length, house.width, house.length, house.width]) / (2 * (house.length + house.width))
    height, tone = stones(s * (house.length + house.width) * 2 / 0.5, v / 0.35, house.seed)
    swell = 1 + 0.012 * height
    x, y = np.interp(s, walked, corner[:, 0]) * swell, np.interp(s, walked, corner[:, 1]) * swell
    joints = np.stack([tone, 1 - height, 0.4 + 0 * tone, 1 + 0 * tone], -1)
    site["stone"].add(grid_part(world(x, y, v), joints))


HOUSES = [
    House(
        x=0.2,
        y=0.4,
        yaw=np.degrees(GATE) + 90,
        length=8.0,
        width=5.6,
        eaves=3.7,
        rise=2.4,
        material="plaster",
        seed=201,
        floor=0.0,
        overhang=0.9,
        upsweep=0.55,
        moss=0.3,
    ),
    House(x=43.5, y=-5, yaw=78, length=15, width=7, eaves=5.6, rise=2.3, material="earth", seed=202),
    House(x=39, y=-33, yaw=30, length=11, width=6.5, eaves=3.4, rise=2.1, material="plaster", seed=203, moss=0.6),
    House(x=31, y=31, yaw=-35, length=13, width=7, eaves=5.8, rise=2.2, material="plaster", seed=204, moss=0.25),
    House(x=-9, y=44, yaw=8, length=17, width=8, eaves=5.6, rise=2.6, material="earth", seed=205),
    House(x=-38, y=15, yaw=60, length=8, width=5, eaves=2.9, rise=1.6, material="earth", seed=206, moss=0.75),
    House(x=-46, y=-14, yaw=100, length=12, width=6.5, eaves=3.6, rise=2.0, material="plaster", seed=207),
    House(x=12, y=62, yaw=-12, length=12, width=7, eaves=5.4, rise=2.2, material="plaster", seed=208),
    House(x=-58, y=-40, yaw=40, length=14, width=7, eaves=5.6, rise=2.2, material="earth", seed=209),
    House(x=66, y=14, yaw=95, length=13, width=7, eaves=3.8, rise=2.0, material="plaster", seed=210),
    House(x=52, y=42, yaw=-50, length=12, width=6.5, eaves=5.4, rise=2.2, material="earth", seed=211),
    House(x=10, y=-66, yaw=-14, length=14, width=7, eaves=5.4, rise=2.3, material="earth", seed=212, moss=0.55),
    House(x=-32, y=58, yaw=35, length=9, width=6, eaves=3.2, rise=1.9, material="plaster", seed=213),
]


def _sheds(site: Site) -> None:
    """Two lean-to sheds against the outer wall: one under metal sheet, one under tiles."""
    for azimuth, width, metal in ((95, 6.0, True), (246, 7.5, False), (12, 4.5, True)):
        angle = np.radians(90 - azimuth)
        span = width / 22

        def slope(s: np.ndarray, t: np.ndarray, angle=angle, span=span) -> np.ndarray:
            points = polar(angle + span * (s - 0.5), 25.2 - 3.4 * t, 2.35 + 0.95 * t)
            points[..., 2] += 0.05 * noise(points, 2.0, 121)
            return points

        if metal:
            s, t = np.meshgrid(np.linspace(0, 1, 220), np.linspace(0, 1, 12))
            points = slope(s, t)
            points[..., 2] += 0.035 * np.sin(s * width / 0.2 * 2 * np.pi)
            rust = np.clip(0.5 + noise(points, 1.6, 122, 4), 0, 1)[..., None]
            colour = rust * [0.26, 0.12, 0.06, 1] + (1 - rust) * [0.34, 0.36, 0.37, 1]
            site["goods"].add(grid_part(points, colour))
        else:
            tiles, under = tiled_slope(slope, width, 3.6, 123, moss=0.7)
            site["tile"].add(tiles)
            site["wood"].add(under)
        for s in (0.03, 0.5, 0.97):
            post = polar(angle + span * (s - 0.5), 24.9, 1.15)
            site["wood"].add(boxes(post, (0.14, 0.14, 2.4), angle, WOOD))
        s, v = np.meshgrid(np.linspace(0.02, 0.98, 40), np.linspace(0, 1, 14))
        front = polar(angle + span * (s - 0.5), 24.6 + 0.03 * np.sin(s * width * 20), 1.7 * v)
        site["wood" if metal else "plaster"].add(grid_part(front, wall_paint(front)))


def build_surroundings(site: Site) -> None:
    """Add the ground, the pond, the houses (the ancestral hall included) and the sheds."""
    _ground(site)
    for house in HOUSES:
        add_house(site, house)
    _sheds(site)
