# SPDX-License-Identifier: GPL-3.0-or-later
"""The Tulou itself: two concentric rings, galleries, the ancestral hall, the paved courtyard and the well.

Site frame: metres, x east, y north, z up, origin at the courtyard's centre. Angles are radians anticlockwise
from east. Parts go into `site`, one MeshBuilder per material name.
"""

from __future__ import annotations

import numpy as np
from site_mesh import (
    Opening,
    Part,
    boxes,
    grid_part,
    lathe,
    noise,
    painted,
    rod,
    stones,
    wall,
)
from tulou_plan import (
    BASE_HEIGHT,
    BATTER,
    COLLAPSED,
    GATE,
    OUTER_RADIUS,
    SIDE_GATES,
    WALL_HEIGHT,
    WOOD,
    Site,
    polar,
    turned,
)
from tulou_roof import RingRoof, outer_roof


def _earth_paint(points: np.ndarray) -> np.ndarray:
    """Tone, repairs and damp of the outer wall: each side has its own history."""
    tone = np.clip(0.5 + 0.5 * noise(points, 7.0, 11), 0, 1)
    angle = np.degrees(np.arctan2(points[..., 1], points[..., 0]))
    z = points[..., 2]
    repair = np.zeros(z.shape)
    for centre, width, low, high in (
        (-38, 9, 1, 5.2),
        (62, 14, 4.5, 10),
        (-120, 6, 0, 3.2),
        (150, 17, 1, 4),
        (5, 4, 6, 9),
    ):
        ragged = 0.6 * noise(points, 1.8, 14)
        inside = (
            (np.abs((angle - centre + 180) % 360 - 180) < width + 2.6 * ragged)
            & (z > low + ragged)
            & (z < high + ragged)
        )
        repair = np.where(inside, 0.55, repair)
    eaves = np.clip((z - 7.6) / 2.4, 0, 1) * (0.35 + 0.5 * noise(points, 3.0, 12))
    foot = np.clip(1 - (z - BASE_HEIGHT) / 1.5, 0, 1) * 0.55
    drips = np.clip(noise(points * np.array([1, 1, 0.08]), 2.4, 13, 2), 0, 1) * 0.6
    return np.stack([tone, repair, np.clip(eaves + foot + drips, 0, 1), np.ones_like(z)], -1)


def _outer_wall(site: Site, rng: np.random.Generator) -> None:
    """The rammed-earth wall with its stone base, windows, eroded patches and three gates."""

    def surface(s: np.ndarray, z: np.ndarray, d: float) -> np.ndarray:
        theta = GATE + np.pi + s / OUTER_RADIUS
        plain = polar(theta, OUTER_RADIUS, z)
        erosion = np.clip(noise(plain, 3.4, 21, 4) - 0.42, 0, 1) * 0.35
        relief = 0.035 * noise(plain, 0.9, 22, 3) - erosion
        lean = 0.10 * noise(polar(theta, 8.0, 0 * z), 9.0, 23, 2) * z / WALL_HEIGHT
        return polar(theta, OUTER_RADIUS - BATTER * z + relief + lean - d, z)

    length = 2 * np.pi * OUTER_RADIUS
    openings = []
    for angle, width, height in ((GATE, 2.4, 3.2), (SIDE_GATES[0], 1.4, 2.4), (SIDE_GATES[1], 1.4, 2.4)):
        s = turned(angle) * OUTER_RADIUS
        openings.append(Opening(left=s - width / 2, bottom=0, width=width, height=height, depth=1.5))
    for row, (bottom, share) in enumerate(((3.9, 0.22), (5.4, 0.7), (7.6, 0.9))):
        for bay in range(44):
            s = (bay + 0.5 + rng.uniform(-0.2, 0.2)) * length / 44
            blocked = row == 0 and min(abs(s - o.left - o.width / 2) for o in openings[:3]) < 3.0
            if rng.random() > share or blocked:
                continue
            width, height = rng.choice([0.4, 0.6, 0.6, 0.8]), rng.choice([0.6, 0.8, 1.0])
            openings.append(
                Opening(left=s, bottom=bottom + rng.choice([-0.2, 0, 0, 0.2]), width=width, height=height, depth=0.5)
            )
    earth, backs = wall(surface, length, WALL_HEIGHT, 0.2, openings, _earth_paint)
    site["earth"].add(earth)
    site["wood"].add(backs)
    for opening in openings[3:]:
        middle = GATE + np.pi + (opening.left + opening.width / 2) / OUTER_RADIUS
        radius = OUTER_RADIUS - BATTER * opening.bottom
        lintel = polar(middle, radius - 0.02, opening.bottom + opening.height + 0.05)
        site["wood"].add(boxes(lintel, (0.22, opening.width + 0.4, 0.14), middle, WOOD))
        if rng.random() < 0.4:
            bars = polar(
                middle + np.array([-0.15, 0.0, 0.15]) / radius, radius - 0.12, opening.bottom + opening.height / 2
            )
            site["wood"].add(boxes(bars, (0.06, 0.05, opening.height), middle, WOOD))

    gaps = [(turned(a) * OUTER_RADIUS, w) for a, w in ((GATE, 1.9), (SIDE_GATES[0], 1.1), (SIDE_GATES[1], 1.1))]
    edges = [0.0] + [edge for s, w in sorted(gaps) for edge in (s - w, s + w)] + [length]
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        site["stone"].add(_stone_course(start, end))


def _stone_course(start: float, end: float) -> Part:
    """The base of field stones between two distances along the wall, with its sloped top."""
    s, v = np.meshgrid(np.linspace(start, end, int((end - start) / 0.085)), np.linspace(-0.3, BASE_HEIGHT, 20))
    height, tone = stones(s / 0.5, v / 0.34, 31)
    theta = GATE + np.pi + s / OUTER_RADIUS
    top = 0.12 * noise(polar(theta, OUTER_RADIUS, 0 * s), 1.5, 32, 2)
    points = polar(theta, OUTER_RADIUS + 0.14 - 0.04 * v + 0.09 * height, v + top * np.clip(v, 0, 1))
    cap = polar(theta[-1:], OUTER_RADIUS - 0.25, points[-1:, :, 2])
    points = np.concatenate([points, cap])
    paint = np.stack([tone, 1 - height, 0.4 + 0.5 * noise(points[:-1], 2.5, 33), np.ones_like(tone)], -1)
    return grid_part(points, np.concatenate([paint, paint[-1:]]))


def _gates(site: Site) -> None:
    """Dressed stone surrounds, steps, door leaves and the lanterns and scrolls of the main gate."""
    for angle, width, height in ((GATE, 2.4, 3.2), (SIDE_GATES[0], 1.4, 2.4), (SIDE_GATES[1], 1.4, 2.4)):
        tangent = np.array([-np.sin(angle), np.cos(angle), 0])
        foot = polar(angle, OUTER_RADIUS + 0.05, 0.0)
        pale = np.array([0.85, 0.1, 0.1, 1])
        for side in (-1, 1):
            blocks = [
                foot + side * tangent * (width / 2 + 0.2) + [0, 0, 0.3 + 0.6 * i] for i in range(round(height / 0.6))
            ]
            widths = [(0.5, 0.42 + 0.16 * (i % 2), 0.59) for i in range(len(blocks))]
            site["stone"].add(boxes(blocks, np.array(widths), angle, pale))
        site["stone"].add(boxes(foot + [0, 0, height + 0.2], (0.55, width + 1.5, 0.5), angle, pale))
        for step in range(2):
            centre = polar(angle, OUTER_RADIUS + 0.7 - 0.3 * step, 0.07 + 0.15 * step)
            site["stone"].add(boxes(centre, (1.3 - 0.5 * step, width + 1.2, 0.16), angle, pale * [0.7, 1, 1, 1]))
    tangent = np.array([-np.sin(GATE), np.cos(GATE), 0])
    plaque = polar(GATE, OUTER_RADIUS - 0.05, 4.25)
    site["goods"].add(boxes(plaque, (0.14, 3.0, 0.85), GATE, np.array([0.09, 0.075, 0.07, 1])))
    letters = [plaque + polar(GATE, 0.09, 0.0) + tangent * x for x in (-0.9, 0.0, 0.9)]
    site["goods"].add(boxes(np.array(letters), (0.04, 0.5, 0.55), GATE, np.array([0.55, 0.38, 0.08, 1])))
    for side in (-1, 1):
        scroll = polar(GATE, OUTER_RADIUS + 0.33, 1.7) + side * tangent * 1.42
        site["goods"].add(boxes(scroll, (0.03, 0.32, 1.9), GATE, np.array([0.5, 0.05, 0.03, 1])))
        lantern = polar(GATE, OUTER_RADIUS + 0.75, 3.55) + side * tangent * 1.9
        profile = [(0, -0.45), (0.2, -0.43), (0.42, -0.2), (0.45, 0), (0.42, 0.2), (0.2, 0.43), (0, 0.45)]
        site["goods"].add(lathe(np.array(profile), lantern, np.array([0.55, 0.035, 0.02, 1])))
        arm = np.array([polar(GATE, OUTER_RADIUS - 0.3, 4.1) + side * tangent * 1.9, lantern + [0, 0, 0.45]])
        site["wood"].add(rod(arm, 0.035, WOOD))


def _galleries(site: Site, rng: np.random.Generator) -> None:
    """Timber galleries on the courtyard side: posts, floors, railings and the boarded rooms behind."""
    bays = 40
    angles = GATE + np.arange(bays) * 2 * np.pi / bays + np.pi / bays
    posts = polar(angles + rng.normal(0, 0.004, bays), 15.35, 4.75)
    site["wood"].add(boxes(posts, (0.24, 0.24, 9.5), angles, _tones(rng, bays, 0.6)))
    stone = polar(angles, 15.35, 0.15)
    site["stone"].add(boxes(stone, (0.5, 0.5, 0.3), angles, np.array([0.7, 0, 0.3, 1])))
    for floor in (3.1, 6.3):
        edge = np.linspace(0, 2 * np.pi, 161)
        section = [(15.2, floor), (15.2, floor + 0.2), (16.9, floor + 0.2), (16.9, floor), (15.2, floor)]
        ring = np.stack([polar(edge, r, z) for r, z in section])
        site["wood"].add(grid_part(ring))
        mid = angles + np.pi / bays
        length = 2 * 15.25 * np.sin(np.pi / bays)
        for z, size in ((floor + 1.15, 0.09), (floor + 0.42, 0.07)):
            site["wood"].add(boxes(polar(mid, 15.25, z), (size, length, size), mid, _tones(rng, bays, 0.7)))
        thin = np.linspace(0, 2 * np.pi, bays * 9, endpoint=False)
        keep = rng.random(len(thin)) > 0.04
        bars = polar(thin[keep], 15.25, floor + 0.78)
        site["wood"].add(boxes(bars, (0.045, 0.05, 0.72), thin[keep], _tones(rng, keep.sum(), 0.7)))
        brackets = polar(angles, 14.85, floor + 2.9)
        site["wood"].add(boxes(brackets, (1.2, 0.14, 0.16), angles, _tones(rng, bays, 0.4)))

    def rooms(s: np.ndarray, z: np.ndarray, d: float) -> np.ndarray:
        return polar(GATE + np.pi + s / 16.9, 16.9 + d, z)

    length, openings = 2 * np.pi * 16.9, []
    for level, floor in enumerate((0.0, 3.3, 6.5)):
        for bay in range(bays):
            s = bay * length / bays + 0.4
            if level == 0 and abs(bay - bays / 2 + 0.5) < 1:
                continue
            if rng.random() < 0.92:
                openings.append(Opening(left=s, bottom=floor + 0.2, width=0.8, height=2.0, depth=0.3))
            if rng.random() < 0.8:
                openings.append(Opening(left=s + 1.2, bottom=floor + 1.0, width=0.8, height=1.0, depth=0.2))
    openings.append(Opening(left=length / 2 - 1.2, bottom=0, width=2.4, height=2.8, depth=1.6))

    def boards(points: np.ndarray) -> np.ndarray:
        theta = np.arctan2(points[..., 1], points[..., 0])
        panel = hashed_panel(theta, points[..., 2], bays)
        return np.stack([panel, 0.2 * panel, 0 * panel, 1 + 0 * panel], -1)

    front, backs = wall(rooms, length, 9.4, 0.2, openings, boards)
    site["wood"].add(front)
    site["wood"].add(backs)
    for bay in rng.choice(bays, 15, replace=False):
        theta, floor = angles[bay] + np.pi / bays * rng.uniform(0.5, 1.4), rng.choice([3.3, 6.5])
        _hanging_cloth(site, polar(theta, 15.1, floor + 1.0), theta + np.pi / 2, rng)


def hashed_panel(theta: np.ndarray, z: np.ndarray, bays: int) -> np.ndarray:
    """A tone per board panel: one for each bay and storey."""
    cell = np.stack([np.floor(theta * bays / (2 * np.pi)), np.floor(z / 3.2), 0 * z], -1) * 3.0 + 1.5
    return np.clip(0.45 + 0.6 * noise(cell, 2.1, 51, 1), 0, 1)


def _tones(rng: np.random.Generator, count: int, middle: float) -> np.ndarray:
    paint = painted(count)
    paint[:, 0] = np.clip(rng.normal(middle, 0.2, count), 0, 1)
    return paint


CLOTH = np.array(
    [
        [0.45, 0.06, 0.05],
        [0.08, 0.14, 0.36],
        [0.55, 0.53, 0.48],
        [0.12, 0.25, 0.16],
        [0.5, 0.34, 0.08],
        [0.3, 0.16, 0.28],
        [0.36, 0.42, 0.5],
    ]
)


def _hanging_cloth(site: Site, top: np.ndarray, yaw: float, rng: np.random.Generator) -> None:
    """A piece of laundry hanging from `top` (its upper middle), along direction yaw."""
    width, drop = rng.uniform(0.6, 1.5), rng.uniform(0.6, 1.1)
    u, v = np.meshgrid(np.linspace(-0.5, 0.5, 14), np.linspace(0, 1, 8))
    wave = 0.06 * np.sin(9 * u + rng.uniform(0, 6)) * v
    points = (
        np.stack(
            [u * width * np.cos(yaw) - wave * np.sin(yaw), u * width * np.sin(yaw) + wave * np.cos(yaw), -v * drop], -1
        )
        + top
    )
    paint = np.ones((*u.shape, 4))
    paint[..., :3] = CLOTH[rng.integers(len(CLOTH))]
    paint[:, rng.integers(2, 12) :: 5, :3] = CLOTH[rng.integers(len(CLOTH))]
    site["goods"].add(grid_part(points, paint))


def _inner_ring(site: Site, rng: np.random.Generator) -> None:
    """The lower ring: whitewashed brick outside, boarded inside, open at the gate, fallen in at one place."""
    gap = 1.5 / 10.3
    for start, end, seed in ((GATE + gap, COLLAPSED[0], 61), (COLLAPSED[1], GATE + 2 * np.pi - gap, 63)):
        roof = RingRoof(
            start=start - 0.03,
            end=end + 0.03,
            ridge_radius=10.5,
            ridge_z=5.1,
            outer_radius=12.5,
            outer_z=3.75,
            inner_radius=8.5,
            inner_z=3.65,
            seed=seed,
            sag=0.09,
        )
        roof.add(site, [(0.3, 0, 0.42, 1)], [(0.7, 0.2, 0.8, 1), (0.1, 0, 0.16, 0.6)])
        for s in np.sort(rng.uniform(0.05, 0.95, 3)):
            roof.radial_ridge(site, float(s))
        for radius, sign, material, height in ((11.9, -1, "plaster", 3.8), (9.1, 1, "wood", 3.7)):
            length = (end - start) * radius
            openings = []
            for s in np.arange(0.5, length - 1.6, 2.1):
                if rng.random() < 0.65:
                    openings.append(Opening(left=s, bottom=0.2, width=0.8, height=2.0, depth=0.25))
                if rng.random() < 0.5:
                    openings.append(Opening(left=s + 1.0, bottom=1.2, width=0.6, height=0.8, depth=0.25))

            def surface(s: np.ndarray, z: np.ndarray, d: float, r=radius, k=sign, a=start) -> np.ndarray:
                plain = polar(a + s / r, r, z)
                return polar(a + s / r, r + k * d + 0.02 * noise(plain, 1.0, 65), z)

            front, backs = wall(surface, length, height, 0.2, openings, wall_paint)
            site[material].add(front)
            if backs:
                site["wood"].add(backs)
        for theta in (start, end):
            outline = [(9.1, 0), (9.1, 3.8), (10.5, 5.05), (11.9, 3.8), (11.9, 0)]
            side = np.stack([np.stack([polar(theta, r, z), polar(theta, r, 0.0)]) for r, z in outline], 1)
            site["plaster"].add(grid_part(side, wall_paint(side)))
    theta, v = np.meshgrid(np.linspace(*COLLAPSED, 90), np.linspace(0, 1, 9))
    for radius in (9.2, 11.9):
        base = polar(theta, radius, 0 * v)
        broken = np.clip(1.5 + 1.6 * noise(base, 2.2, 67, 3), 0.15, 3.4)
        for offset in (-0.2, 0.2):
            points = polar(theta, radius + offset, v * broken)
            site["plaster"].add(grid_part(points, wall_paint(points)))
        cap = np.stack([polar(theta[0], radius + o, broken[0]) for o in (-0.2, 0.2)])
        site["earth"].add(grid_part(cap))
    _rubble(site, rng)


def _rubble(site: Site, rng: np.random.Generator) -> None:
    """Fallen tiles, bricks and beams inside the collapsed bays."""
    theta, radius = np.meshgrid(np.linspace(*COLLAPSED, 120), np.linspace(8.6, 12.2, 50))
    flat = polar(theta, radius, 0 * theta)
    heap = 0.55 * np.clip(1 - ((radius - 10.5) / 1.6) ** 2, 0, 1) + 0.25 * noise(flat, 0.6, 71)
    points = polar(theta, radius, heap)
    tone = 0.5 + 0.4 * noise(flat, 0.5, 72)
    site["earth"].add(grid_part(points, np.stack([tone, 0 * tone, 0.3 * tone, 1 + 0 * tone], -1)))
    count = 420
    angle = rng.uniform(*COLLAPSED, count)
    where = polar(angle, rng.normal(10.5, 0.8, count), rng.uniform(0.25, 0.75, count))
    sizes = rng.uniform([0.12, 0.1, 0.05], [0.4, 0.25, 0.14], (count, 3))
    paint = _tones(rng, count, 0.5)
    paint[:, 1] = rng.random(count) < 0.3
    site["tile"].add(boxes(where, sizes, rng.uniform(0, 3, count), paint))
    for _ in range(9):
        theta, turn = rng.uniform(*COLLAPSED), rng.uniform(0, 2 * np.pi)
        foot = polar(theta, rng.uniform(9.4, 11.6), 0.4)
        tip = foot + np.array([np.cos(turn), np.sin(turn), rng.uniform(0.1, 0.7)]) * rng.uniform(1.5, 2.8)
        site["wood"].add(rod(np.array([foot, tip]), 0.09, WOOD))


def wall_paint(points: np.ndarray) -> np.ndarray:
    """Paint of an ordinary wall: tone, bare brick or repairs in patches, dirt at foot and top."""
    tone = np.clip(0.5 + 0.4 * noise(points, 3.0, 81), 0, 1)
    bare = np.clip(noise(points, 2.6, 82) - 0.15, 0, 1)
    dirt = np.clip(0.9 - points[..., 2] / 1.4, 0, 1) * 0.7 + 0.35 * np.clip(noise(points, 2.0, 83), 0, 1)
    return np.stack([tone, bare, np.clip(dirt, 0, 1), np.ones_like(tone)], -1)


def _courtyard(site: Site, rng: np.random.Generator) -> None:
    """Cobbles over the whole inside, paved lines to the hall, the well and everyday things."""
    axis = np.linspace(-17, 17, 487)
    x, y = np.meshgrid(axis, axis)
    height, tone = stones(x / 0.34, y / 0.3, 91)
    along = x * np.cos(GATE) + y * np.sin(GATE)
    across = -x * np.sin(GATE) + y * np.cos(GATE)
    slab = (np.abs(across) < 1.0) & (along > 2.5)
    slab_height, slab_tone = stones(along / 1.1, across / 0.7, 92)
    height, tone = np.where(slab, slab_height, height), np.where(slab, 0.4 + 0.6 * slab_tone, tone * 0.8)
    flat = np.stack([x, y, 0 * x], -1)
    z = 0.035 * height + 0.03 * noise(flat, 3.0, 93) - 0.04
    paint = np.stack([tone, 1 - height, 0.45 + 0.5 * noise(flat, 3.5, 94), np.ones_like(x)], -1)
    part = grid_part(np.stack([x, y, z], -1), paint)
    centre = part.vertices[part.faces].mean(1)
    part.faces = part.faces[np.hypot(centre[:, 0], centre[:, 1]) < 17]
    site["stone"].add(part)
    well = np.array([4.6, 5.2, 0.0])
    profile = [(1.3, -0.05), (1.3, 0.12), (0.75, 0.12), (0.72, 0.75), (0.5, 0.78), (0.48, -0.02), (0, -0.03)]
    site["stone"].add(lathe(np.array(profile), well, np.array([0.75, 0.05, 0.4, 1]), 28))
    for side in (-1, 1):
        site["wood"].add(rod(well + [[side * 0.9, 0, 0], [side * 0.9, 0, 1.9]], 0.07, WOOD))
    site["wood"].add(rod(well + [[-1.1, 0, 1.85], [1.1, 0, 1.85]], 0.08, WOOD))
    for _ in range(26):
        theta, radius = rng.uniform(0, 2 * np.pi), rng.choice([7.6, 13.4]) + rng.normal(0, 0.35)
        place = polar(theta, radius, 0.0)
        tall, wide = rng.uniform(0.35, 0.95), rng.uniform(0.25, 0.45)
        colour = rng.choice([[0.3, 0.12, 0.06], [0.33, 0.25, 0.13], [0.11, 0.10, 0.1], [0.08, 0.16, 0.32]])
        profile = [(0, tall * 0.8), (wide * 0.8, tall * 0.8), (wide * 0.85, tall), (wide, tall * 0.6), (wide * 0.7, 0)]
        site["goods"].add(lathe(np.array(profile), place, np.append(colour, 1.0), 14))
    for angle, radius in ((0.4, 7.4), (2.0, 7.2), (-2.2, 7.5)):
        a, b = polar(angle, radius, 2.1), polar(angle + 0.42, radius, 2.1)
        for end in (a, b):
            site["wood"].add(rod(np.array([end * [1, 1, 0], end]), 0.05, WOOD))
        site["wood"].add(rod(np.array([a, b]), 0.03, WOOD))
        for share in np.linspace(0.15, 0.85, 4):
            _hanging_cloth(site, a + (b - a) * share, float(np.arctan2(*(b - a)[1::-1])), rng)


def build_tulou(site: Site, rng: np.random.Generator) -> None:
    """Add the whole building (without the ancestral hall, which is a house: see tulou_surroundings.py)."""
    _outer_wall(site, rng)
    _gates(site)
    outer_roof(site)
    _galleries(site, rng)
    _inner_ring(site, rng)
    _courtyard(site, rng)
