# SPDX-License-Identifier: GPL-3.0-or-later
"""Procedural geometry: noise, heightfield ground, walls with relief, galleries and houses.  Z up, metres."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from training.assets import Material, Mesh, vertex_normals

# A panel is a sheet over (u, v) in metres; the placement turns (u, v, offset outwards) into a point.
Placement = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
EDGE = 0.012  # half width of the step at the rim of a window or niche


class Noise:
    """Smooth value noise over a repeating random lattice; zero mean, values within about [-1, 1]."""

    SIZE = 32

    def __init__(self, rng: np.random.Generator) -> None:
        self._lattice = rng.uniform(-1, 1, (self.SIZE,) * 3).astype(np.float32)

    def __call__(self, points: np.ndarray, wavelength: float, octaves: int = 1) -> np.ndarray:
        """(N,) float32 noise at points (N,2 or 3); each octave halves wavelength and amplitude."""
        total = np.zeros(len(points), np.float32)
        for octave in range(octaves):
            total += self._single(points * (2.0**octave / wavelength) + 7.3 * octave) * 0.5**octave
        return total

    def _single(self, points: np.ndarray) -> np.ndarray:
        floor = np.floor(points)
        fraction = (points - floor).astype(np.float32)
        fraction = fraction * fraction * (3 - 2 * fraction)
        low = floor.astype(np.int64) % self.SIZE
        high = (low + 1) % self.SIZE
        x = ((low[:, 0], 1 - fraction[:, 0]), (high[:, 0], fraction[:, 0]))
        y = ((low[:, 1], 1 - fraction[:, 1]), (high[:, 1], fraction[:, 1]))
        if points.shape[1] == 2:
            return sum(wx * wy * self._lattice[ix, iy, 0] for ix, wx in x for iy, wy in y)
        z = ((low[:, 2], 1 - fraction[:, 2]), (high[:, 2], fraction[:, 2]))
        return sum(wx * wy * wz * self._lattice[ix, iy, iz] for ix, wx in x for iy, wy in y for iz, wz in z)


def grid_faces(rows: int, columns: int) -> np.ndarray:
    """(2(rows-1)(columns-1),3) int32 triangles of a row-major vertex grid."""
    index = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1].ravel(), index[:-1, 1:].ravel(), index[1:, :-1].ravel(), index[1:, 1:].ravel()
    return np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)])


@dataclass(frozen=True)
class Recess:
    """A rectangle of a panel moved outwards by `offset` metres (inwards when negative), or cut out where it is `open`:
    only its sides are left."""

    u0: float
    u1: float
    v0: float
    v1: float
    offset: float
    open: bool = False


def panel(
    width: float,
    height: float,
    place: Placement,
    recesses: list[Recess],
    roughness: Callable[[np.ndarray], np.ndarray],
    cell: float,
    material: Material,
) -> Mesh:
    """A sheet with relief: a grid of about `cell` metres with extra lines at the rims of the recesses."""

    def lines(length: float, rims: list[float]) -> np.ndarray:
        even = np.linspace(0, length, max(2, round(length / cell) + 1))
        near = np.array([2 * EDGE, length - 2 * EDGE, *(r + s for r in rims for s in (-EDGE, EDGE))])
        near = near[(near > EDGE) & (near < length - EDGE)]
        return np.unique(np.concatenate([even, near]).round(4))

    us = lines(width, [r for recess in recesses for r in (recess.u0, recess.u1)])
    vs = lines(height, [r for recess in recesses for r in (recess.v0, recess.v1)])
    v, u = (a.ravel() for a in np.meshgrid(vs, us, indexing="ij"))
    offset, hollow = np.zeros_like(u), np.zeros(len(u), bool)
    for recess in recesses:
        inside = (u > recess.u0) & (u < recess.u1) & (v > recess.v0) & (v < recess.v1)
        offset[inside], hollow[inside] = recess.offset, recess.open
    flat = place(u, v, offset)
    # Relief ends at the rim of the sheet, so that neighbouring walls meet without a gap.
    rim = np.minimum(np.minimum(u, width - u), np.minimum(v, height - v))
    offset = np.where(rim < EDGE, 0, offset + roughness(flat) * np.clip(rim / 0.5, 0, 1))
    positions = place(u, v, offset).astype(np.float32)
    faces = grid_faces(len(vs), len(us))
    faces = faces[~hollow[faces].all(1)]
    uv = np.stack([u, v], axis=1).astype(np.float32)
    return Mesh(positions, vertex_normals(positions, faces), uv, uv, faces, material)


def straight(origin: np.ndarray, along: np.ndarray, up: np.ndarray, outward: np.ndarray) -> Placement:
    """Placement on a plane: all arguments (3,), directions of unit length."""
    return lambda u, v, d: origin + u[:, None] * along + v[:, None] * up + d[:, None] * outward


def lofted(
    lower: tuple[np.ndarray, np.ndarray], upper: tuple[np.ndarray, np.ndarray], size: tuple[float, float], sag: float
) -> Placement:
    """Placement between two segments (start, end), for roofs; `sag` (metres) hollows the slope as on a curved roof."""
    width, height = size

    def place(u: np.ndarray, v: np.ndarray, d: np.ndarray) -> np.ndarray:
        s, t = (u / width)[:, None], (v / height)[:, None]
        low = lower[0] + s * (lower[1] - lower[0])
        high = upper[0] + s * (upper[1] - upper[0])
        point = low + t * (high - low)
        point[:, 2] += d - sag * 4 * t[:, 0] * (1 - t[:, 0])
        return point

    return place


def around(radius: Callable[[np.ndarray], np.ndarray], perimeter: float, power: float, up: float) -> Placement:
    """Placement on a closed wall: u runs round it, `radius(v)` gives the radius at v, up=1 a wall, 0 < up < 1 a slope.

    `power` 2 is a circle, 8 nearly a square with round corners.
    """

    def place(u: np.ndarray, v: np.ndarray, d: np.ndarray) -> np.ndarray:
        angle = u / perimeter * 2 * np.pi
        cos, sin = np.cos(angle), np.sin(angle)
        shape = (np.abs(cos) ** power + np.abs(sin) ** power) ** (-1 / power)
        r = radius(v) * shape + d
        return np.stack([r * cos, r * sin, v * up], axis=1)

    return place


def gallery_openings(rng: np.random.Generator, width: float, levels: np.ndarray, height: float) -> list[Recess]:
    """What one looks through in the front of galleries this wide and high, whose floors are at `levels`: between posts,
    above a parapet or a railing, and between its bars."""
    bays = max(3, int(width / rng.uniform(1.8, 4.0)))
    bay, post, beam = width / bays, rng.uniform(0.1, 0.3), rng.uniform(0.15, 0.4)
    rail, bar, gap = rng.uniform(0.8, 1.1), rng.uniform(0.03, 0.08), rng.uniform(0.08, 0.3)
    barred = rng.random() < 0.7
    found = []
    for level, top in zip(levels, [*levels[1:], height], strict=True):
        sill = level + (rail if level > 0 else 0.0)
        for left in np.arange(bays) * bay + post / 2:
            found.append(Recess(left, left + bay - post, sill, top - beam, -post, open=True))
            if barred and level > 0:
                bars = max(1, int((bay - post) / (bar + gap)))
                step = (bay - post) / bars
                found += [Recess(at + bar / 2, at + step - bar / 2, level + 0.1, sill - 0.06, -bar, open=True)
                          for at in left + step * np.arange(bars)]
    return found


def gallery_levels(rng: np.random.Generator, height: float) -> np.ndarray:
    """The floors of galleries this high, the ground first."""
    return np.arange(0, max(height - 1.8, 0.1), rng.uniform(2.3, 3.2))


def wall_recesses(rng: np.random.Generator, width: float, height: float) -> list[Recess]:
    """Cornices, pilasters, windows and a door of one facade."""
    found: list[Recess] = []
    storey = rng.uniform(2.6, 4.5)
    storeys = max(1, int(height / storey))
    bay = rng.uniform(1.8, 4.5)
    bays = max(1, int(width / bay))
    if rng.random() < 0.4:
        half = rng.uniform(0.1, 0.35)
        depth = rng.uniform(0.05, 0.3)
        found += [Recess(width * i / bays - half, width * i / bays + half, 0, height, depth) for i in range(bays + 1)]
    if rng.random() < 0.6:
        depth, tall = rng.uniform(0.05, 0.35), rng.uniform(0.1, 0.4)
        found += [Recess(-1, width + 1, s * storey - tall, s * storey, depth) for s in range(1, storeys + 1)]
    window_width, window_height = rng.uniform(0.25, 0.65) * bay, rng.uniform(0.3, 0.65) * storey
    sill = rng.uniform(0.2, 0.9) * (storey - window_height)
    depth = -rng.uniform(0.06, 0.6)
    frame = rng.uniform(0.08, 0.25) if rng.random() < 0.5 else 0.0
    for level in range(storeys):
        for column in range(bays):
            if rng.random() < 0.15:
                continue
            u, v = (column + 0.5) * width / bays, level * storey + sill
            low, high = (0.0, window_height + sill) if level == 0 and rng.random() < 0.2 else (v, v + window_height)
            u0, u1 = u - window_width / 2, u + window_width / 2
            if frame:
                found.append(Recess(u0 - frame, u1 + frame, low - frame, high + frame, 0.08))
            found.append(Recess(u0, u1, low, high, depth))
            if rng.random() < 0.4:
                found.append(Recess(u - 0.04, u + 0.04, low, high, depth + 0.06))
    return found


def house(rng: np.random.Generator, walls: Material, roof: Material, noise: Noise) -> list[Mesh]:
    """A rectangular house centred on the origin: four walls with relief and a flat, gabled or hipped roof."""
    half = np.array([rng.uniform(3.5, 14), rng.uniform(3, 8)])
    height = rng.uniform(3, 16)
    amplitude = rng.choice([0.01, 0.03, 0.08]) * rng.uniform(0.5, 1.5)
    wavelength = rng.uniform(0.6, 2.5)

    def rough(points: np.ndarray) -> np.ndarray:
        return amplitude * noise(points, wavelength, 2)

    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    meshes = []
    up = np.array([0.0, 0.0, 1.0])
    below = 1.0  # walls go below ground, so that slopes leave no gap
    for index in range(4):
        start, end = np.append(corners[index], -below), np.append(corners[(index + 1) % 4], -below)
        width = float(np.linalg.norm(end - start))
        along = (end - start) / width
        outward = np.cross(along, up)
        recesses = wall_recesses(rng, width, height)
        recesses = [Recess(r.u0, r.u1, r.v0 + below, r.v1 + below, r.offset) for r in recesses]
        place = straight(start, along, up, outward)
        meshes.append(panel(width, height + below, place, recesses, rough, 0.45, walls))
    kind = rng.choice(["flat", "gable", "hip", "hip"])
    if kind == "flat":
        level = height - rng.uniform(0.1, 1.0)
        place = straight(np.array([-half[0], -half[1], level]), np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), up)
        return [*meshes, panel(2 * half[0], 2 * half[1], place, [], rough, 0.7, walls)]
    return meshes + _pitched_roof(rng, half, height, kind == "hip", roof, walls, rough)


def _pitched_roof(
    rng: np.random.Generator,
    half: np.ndarray,
    height: float,
    hipped: bool,
    roof: Material,
    walls: Material,
    rough: Callable[[np.ndarray], np.ndarray],
) -> list[Mesh]:
    overhang = rng.uniform(0.2, 1.8)
    rise = half[1] * rng.uniform(0.35, 1.0)
    sag = rng.choice([0.0, 0.08]) * rise
    eaves = half + overhang
    ridge = max(half[0] - (half[1] * rng.uniform(0.6, 1.1) if hipped else -overhang), 0.2)
    low = height - 0.1 - overhang * rise / half[1] * 0.6
    c = [np.append(s * eaves, low) for s in np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])]
    left, right = np.array([-ridge, 0, height + rise]), np.array([ridge, 0, height + rise])
    slope = float(np.hypot(eaves[1], rise))
    sides = [((c[0], c[1]), (left, right)), ((c[2], c[3]), (right, left))]
    if hipped:
        sides += [((c[1], c[2]), (right, right)), ((c[3], c[0]), (left, left))]
    meshes = []
    for lower, upper in sides:
        width = float(np.linalg.norm(lower[1] - lower[0]))
        place = lofted(lower, upper, (width, slope), sag)
        meshes.append(panel(width, slope, place, [], rough, 0.5, roof))
    if not hipped:
        for side in (-1.0, 1.0):
            base = (np.array([side * half[0], -half[1], height]), np.array([side * half[0], half[1], height]))
            top = np.array([side * half[0], 0, height + rise - 0.1])
            place = lofted(base, (top, top), (2 * half[1], rise), 0.0)
            meshes.append(panel(2 * half[1], float(rise), place, [], rough, 0.6, walls))
    return meshes


class Terrain:
    """Heightfield with gentle relief near the site, hills far away, and levelled discs under buildings."""

    def __init__(self, rng: np.random.Generator, radius: float, far: float) -> None:
        self.noise = Noise(rng)
        self.radius = radius
        self.far = far
        self._relief = rng.choice([0.3, 1.5, 5.0]) * rng.uniform(0.4, 1)
        self._wavelength = rng.uniform(25, 70)
        self._hills = rng.choice([0.0, 30.0, 120.0]) * rng.uniform(0.3, 1)
        self._discs: list[tuple[np.ndarray, float, float]] = []

    def level(self, centre: np.ndarray, radius: float) -> float:
        """Flatten a disc round centre (2,) and return its height."""
        height = float(self.height(centre[None])[0])
        self._discs.append((centre, radius, height))
        return height

    def dig(self, centre: np.ndarray, radius: float, depth: float) -> tuple[float, float]:
        """Sink a basin at centre (2,); returns the level that water in it has, and a radius that holds all of it."""
        outside = 1.4 * radius + 1  # where the basin's slope ends (height)
        turns = np.linspace(0, 2 * np.pi, 64)
        rim = self.height(centre + outside * np.column_stack([np.cos(turns), np.sin(turns)]))
        level = float(rim.min()) - 0.1
        self._discs.append((centre, radius, level - depth))
        return level, outside

    def height(self, points: np.ndarray) -> np.ndarray:
        """(N,) ground height at points (N,2)."""
        z = self._relief * self.noise(points, self._wavelength, 3)
        distance = np.linalg.norm(points, axis=1)
        z = z + self._hills * np.clip(distance / (4 * self.radius) - 0.5, 0, 1) * (0.6 + self.noise(points, 350.0, 2))
        for centre, radius, level in self._discs:
            away = np.linalg.norm(points - centre, axis=1)
            weight = np.clip((away - radius) / (0.4 * radius + 1), 0, 1)
            weight = weight * weight * (3 - 2 * weight)
            z = level + weight * (z - level)
        return z

    def mesh(self, material: Material) -> Mesh:
        """One grid: even cells near the site, growing to the horizon.  uv2 are the weights of two more textures."""
        even = np.linspace(-self.radius, self.radius, 91)
        steps = np.geomspace(self.radius * 1.04, self.far, 16) if self.far > self.radius else np.zeros(0)
        line = np.concatenate([-steps[::-1], even, steps])
        y, x = (a.ravel() for a in np.meshgrid(line, line, indexing="ij"))
        xy = np.stack([x, y], axis=1)
        z = self.height(xy) + 0.03 * self.noise(xy, 1.9)
        positions = np.stack([x, y, z], axis=1).astype(np.float32)
        faces = grid_faces(len(line), len(line))
        weights = [np.clip(0.5 + s * self.noise(xy + o, w, 4), 0, 1) for s, o, w in ((2.5, 11, 31.0), (2.0, 57, 17.0))]
        uv2 = np.stack(weights, axis=1).astype(np.float32)
        return Mesh(positions, vertex_normals(positions, faces), xy.astype(np.float32), uv2, faces, material)
