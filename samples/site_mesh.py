# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes made with numpy: noise, primitives, walls with openings, tiled roof slopes.

Lengths are metres; positions are (N, 3) in the site frame (x east, y north, z up) unless a function says
otherwise. Every vertex carries four numbers, its *paint*, which the materials read (see tulou_materials.py).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import bpy
import numpy as np

Surface = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(kw_only=True)
class Part:
    """A piece of mesh: vertices (N, 3), faces (M, 4) of vertex numbers, paint (N, 4) in [0, 1]."""

    vertices: np.ndarray
    faces: np.ndarray
    paint: np.ndarray


@dataclass
class MeshBuilder:
    """Gathers parts that share one material into one mesh."""

    parts: list[Part] = field(default_factory=list)

    def add(self, part: Part) -> None:
        self.parts.append(part)

    def mesh(self, name: str, material: bpy.types.Material) -> bpy.types.Mesh:
        """Make the Blender mesh of everything added so far, with the point attribute `paint`."""
        offsets = np.cumsum([0] + [len(part.vertices) for part in self.parts])
        vertices = np.concatenate([part.vertices for part in self.parts]).astype(np.float32)
        faces = np.concatenate(
            [part.faces + start for part, start in zip(self.parts, offsets[:-1], strict=True)]
        ).astype(np.int32)
        paint = np.concatenate([part.paint for part in self.parts]).astype(np.float32)
        mesh = bpy.data.meshes.new(name)
        mesh.vertices.add(len(vertices))
        mesh.vertices.foreach_set("co", vertices.ravel())
        mesh.loops.add(faces.size)
        mesh.loops.foreach_set("vertex_index", faces.ravel())
        mesh.polygons.add(len(faces))
        mesh.polygons.foreach_set("loop_start", np.arange(0, faces.size, 4, dtype=np.int32))
        attribute = mesh.attributes.new("paint", "FLOAT_COLOR", "POINT")
        attribute.data.foreach_set("color", paint.ravel())
        mesh.materials.append(material)
        mesh.update()
        mesh.validate()
        return mesh


def hashed(ix: np.ndarray, iy: np.ndarray, iz: np.ndarray, seed: int) -> np.ndarray:
    """Hash integer lattice points to uniform numbers in [0, 1)."""
    x, y, z = (np.asarray(i).astype(np.int64).astype(np.uint64) for i in (ix, iy, iz))
    h = x * np.uint64(374761393) + y * np.uint64(668265263) + z * np.uint64(2246822519)
    h = (h + np.uint64(seed * 3266489917 + 12345)) & np.uint64(0xFFFFFFFF)
    for shift, factor in ((15, 2246822519), (13, 3266489917)):
        h = ((h ^ (h >> np.uint64(shift))) * np.uint64(factor)) & np.uint64(0xFFFFFFFF)
    return (h ^ (h >> np.uint64(16))).astype(np.float64) / 2.0**32


def noise(points: np.ndarray, scale: float, seed: int, octaves: int = 3) -> np.ndarray:
    """Fractal value noise in about [-1, 1] at points (..., 3); `scale` is the coarsest wavelength in metres."""
    total = np.zeros(points.shape[:-1])
    amplitude, weight = 1.0, 0.0
    for octave in range(octaves):
        p = points * (2.0**octave / scale) + 17.3 * octave
        cell = np.floor(p).astype(np.int64)
        f = p - cell
        f = f * f * (3 - 2 * f)
        value = np.zeros_like(total)
        for corner in range(8):
            bits = np.array([corner & 1, corner >> 1 & 1, corner >> 2 & 1])
            share = np.prod(np.where(bits, f, 1 - f), axis=-1)
            lattice = cell + bits
            value += share * hashed(lattice[..., 0], lattice[..., 1], lattice[..., 2], seed + octave)
        total += amplitude * (2 * value - 1)
        weight += amplitude
        amplitude *= 0.5
    return total / weight * 1.5


def stones(u: np.ndarray, v: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Irregular stone pattern: (height in [0, 1], 0 in the joints; a random tone per stone). u, v in stones."""
    first = np.full(u.shape, 9.0)
    second = np.full(u.shape, 9.0)
    tone = np.zeros(u.shape)
    iu, iv = np.floor(u).astype(np.int64), np.floor(v).astype(np.int64)
    for du in (-1, 0, 1):
        for dv in (-1, 0, 1):
            cu, cv = iu + du, iv + dv
            zero = np.zeros_like(cu)
            pu = cu + 0.15 + 0.7 * hashed(cu, cv, zero, seed)
            pv = cv + 0.15 + 0.7 * hashed(cu, cv, zero + 1, seed)
            distance = np.hypot(u - pu, v - pv)
            closer = distance < first
            second = np.where(closer, first, np.minimum(second, distance))
            tone = np.where(closer, hashed(cu, cv, zero + 2, seed), tone)
            first = np.where(closer, distance, first)
    height = np.clip((second - first) / 0.35, 0, 1)
    return height * (2 - height), tone


def painted(count: int, r: float = 0.5, g: float = 0.0, b: float = 0.0, a: float = 1.0) -> np.ndarray:
    """The same paint for `count` vertices."""
    return np.tile(np.array([r, g, b, a], float), (count, 1))


def grid_faces(rows: int, columns: int) -> np.ndarray:
    """Faces of a grid of rows x columns vertices, row-major."""
    index = np.arange(rows * columns).reshape(rows, columns)
    corners = (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1])
    return np.stack([corner.ravel() for corner in corners], axis=1)


def grid_part(points: np.ndarray, paint: np.ndarray | None = None) -> Part:
    """A grid of points (rows, columns, 3) with paint (rows, columns, 4) as a Part."""
    rows, columns = points.shape[:2]
    colours = painted(rows * columns) if paint is None else np.array(paint, float).reshape(-1, 4)
    return Part(vertices=points.reshape(-1, 3), faces=grid_faces(rows, columns), paint=colours)


_CUBE = np.array([[x, y, z] for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)])
_CUBE_FACES = np.array([[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]])


def boxes(centres: np.ndarray, sizes: np.ndarray, yaws: np.ndarray | float, paint: np.ndarray) -> Part:
    """Boxes: centres (N, 3), sizes (N, 3) or (3,), yaws in radians about z, paint (N, 4) or (4,)."""
    centres = np.atleast_2d(np.asarray(centres, float))
    count = len(centres)
    sizes = np.broadcast_to(np.asarray(sizes, float), (count, 3))
    yaw = np.broadcast_to(np.asarray(yaws, float), (count,))[:, None]
    local = _CUBE[None] * sizes[:, None]
    x = local[..., 0] * np.cos(yaw) - local[..., 1] * np.sin(yaw)
    y = local[..., 0] * np.sin(yaw) + local[..., 1] * np.cos(yaw)
    vertices = np.stack([x, y, local[..., 2]], -1) + centres[:, None]
    faces = _CUBE_FACES[None] + 8 * np.arange(count)[:, None, None]
    colours = np.repeat(np.broadcast_to(np.asarray(paint, float), (count, 4)), 8, axis=0)
    return Part(vertices=vertices.reshape(-1, 3), faces=faces.reshape(-1, 4), paint=colours)


def rod(path: np.ndarray, radii: np.ndarray | float, paint: np.ndarray, sides: int = 7) -> Part:
    """A round rod along path (N, 3) with a radius at each of its points; its ends are closed."""
    path = np.asarray(path, float)
    path = np.concatenate([path[:1], path, path[-1:]])
    radius = np.broadcast_to(np.asarray(radii, float), (len(path) - 2,))
    radius = np.concatenate([[0.0], radius, [0.0]])
    forward = np.gradient(path[1:-1], axis=0)
    forward = np.concatenate([forward[:1], forward, forward[-1:]])
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    helper = np.where(np.abs(forward[:, 2:3]) > 0.9, np.array([[1.0, 0, 0]]), np.array([[0, 0, 1.0]]))
    side = np.cross(forward, helper)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(side, forward)
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    ring = np.cos(angle)[:, None] * side[:, None] + np.sin(angle)[:, None] * up[:, None]
    points = path[:, None] + radius[:, None, None] * ring
    return grid_part(points, np.broadcast_to(np.asarray(paint, float), (*points.shape[:2], 4)))


def lathe(profile: np.ndarray, centre: np.ndarray, paint: np.ndarray, sides: int = 20) -> Part:
    """Turn a profile (N, 2) of (radius, height) about the vertical through centre."""
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    profile = np.asarray(profile, float)
    x = profile[:, :1] * np.cos(angle)
    y = profile[:, :1] * np.sin(angle)
    z = np.broadcast_to(profile[:, 1:], x.shape)
    points = np.stack([x, y, z], -1) + np.asarray(centre, float)
    return grid_part(points, np.broadcast_to(np.asarray(paint, float), (*points.shape[:2], 4)))


def ridge(path: np.ndarray, width: float, height: float, seed: int) -> Part:
    """A roof ridge or coping: a rectangular bar along path (N, 3), its foot 0.15 m below the path."""
    forward = np.gradient(path, axis=0)
    side = np.stack([-forward[:, 1], forward[:, 0], np.zeros(len(path))], 1)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    rough = 1 + 0.12 * noise(path, 0.9, seed)
    section = np.array(
        [[0.5, -0.15], [0.5, height * 0.8], [0.25, height], [-0.25, height], [-0.5, height * 0.8], [-0.5, -0.15]]
    )
    points = path[:, None] + side[:, None] * (section[None, :, :1] * width * rough[:, None, None])
    points[..., 2] += section[None, :, 1] * rough[:, None]
    first, last = points[:1].mean(1, keepdims=True), points[-1:].mean(1, keepdims=True)
    points = np.concatenate([np.repeat(first, 6, 1), points, np.repeat(last, 6, 1)])
    tone = np.clip(0.5 + 0.4 * noise(points, 1.2, seed + 1), 0, 1)
    return grid_part(points, np.stack([tone, np.full_like(tone, 0.15), 0.5 * tone, np.ones_like(tone)], -1))


@dataclass(frozen=True, kw_only=True)
class Opening:
    """A rectangular recess in a wall: left and bottom edges, size and depth, in metres along the wall."""

    left: float
    bottom: float
    width: float
    height: float
    depth: float = 0.35


def wall(
    surface: Callable[[np.ndarray, np.ndarray, float], np.ndarray],
    length: float,
    height: float,
    cell: float,
    openings: list[Opening],
    paint: Callable[[np.ndarray], np.ndarray],
) -> tuple[Part, Part | None]:
    """A wall with recessed openings: (the wall with the openings' sides, the backs of the openings).

    `surface(s, z, d)` gives the point s metres along, z up and d into the wall; `paint(points)` its paint.
    Openings are rounded to whole cells.
    """
    columns, rows = round(length / cell), round(height / cell)
    s, z = np.meshgrid(np.linspace(0, length, columns + 1), np.linspace(0, height, rows + 1))
    front = surface(s, z, 0.0)
    keep = np.ones((rows, columns), bool)
    sides, backs = MeshBuilder(), MeshBuilder()
    for opening in openings:
        c0, r0 = round(opening.left / cell), round(opening.bottom / cell)
        c1 = min(c0 + max(1, round(opening.width / cell)), columns)
        r1 = min(r0 + max(1, round(opening.height / cell)), rows)
        keep[r0:r1, c0:c1] = False
        block = np.s_[r0 : r1 + 1, c0 : c1 + 1]
        deep = surface(s[block], z[block], opening.depth)
        near = front[block]
        loop = [np.concatenate([a[0], a[1:, -1], a[-1, -2::-1], a[-2::-1, 0]]) for a in (near, deep)]
        side = np.stack(loop)
        sides.add(grid_part(side, paint(side)))
        backs.add(grid_part(deep, painted(deep.size // 3, 0.3, 0.6).reshape((*deep.shape[:2], 4))))
    part = grid_part(front, paint(front))
    part.faces = part.faces[keep.ravel()]
    sides.parts.insert(0, part)
    return joined(sides.parts), joined(backs.parts) if backs.parts else None


def joined(parts: list[Part]) -> Part:
    """Join parts into one."""
    offsets = np.cumsum([0] + [len(part.vertices) for part in parts])
    return Part(
        vertices=np.concatenate([part.vertices for part in parts]),
        faces=np.concatenate([part.faces + start for part, start in zip(parts, offsets[:-1], strict=True)]),
        paint=np.concatenate([part.paint for part in parts]),
    )


def tiled_slope(
    surface: Surface,
    length: float,
    run: float,
    seed: int,
    *,
    repaired: list[tuple[float, float, float, float]] = (),
    moss: float = 0.4,
    gauge: float = 0.24,
    period: float = 0.25,
) -> tuple[Part, Part]:
    """A roof slope of pan and cover tiles: (tiles, boarded underside with its eave edge).

    `surface(s, t)` gives the point at s in [0, 1] along the eave and t in [0, 1] from eave to ridge; `length`
    and `run` are the slope's size in metres. Each course overlaps the one below by a real step. `repaired`
    holds rectangles (s0, t0, s1, t1) laid with newer tiles. Paint: r tone of a tile, g newness, b moss.
    """
    columns, courses, samples = max(4, round(length / period)), max(2, round(run / gauge)), 6
    column = np.arange(columns * samples + 1) / samples
    tile = np.floor(column + 0.5).astype(np.int64)
    wobble = 0.16 * (hashed(tile, tile * 0, tile * 0, seed) - 0.5)
    wave = np.cos(2 * np.pi * (column + wobble))
    profile = np.where(wave > 0, 0.06 * np.abs(wave) ** 0.7, 0.025 * wave)
    t = np.repeat(np.linspace(0, 1, courses + 1), 2)[1:-1]
    course = np.arange(len(t)) // 2
    step = np.where(np.arange(len(t)) % 2 == 0, 0.045, 0.0)
    tiles, rows = np.meshgrid(tile, course)
    lift = profile[None] + step[:, None] + 0.028 * (hashed(tiles, rows, tiles * 0, seed + 1) - 0.5)
    s_grid, t_grid = np.meshgrid(column / columns, t)
    ragged = np.where(t_grid == 0, (hashed(tiles, tiles * 0, tiles * 0, seed + 2) - 0.5) * 0.12 / run, 0)
    points = surface(s_grid, t_grid + ragged)
    points[..., 2] += lift
    new = np.zeros(lift.shape)
    for s0, t0, s1, t1 in repaired:
        fray = 0.5 * (hashed(rows, rows * 0, rows * 0, seed + 3) - 0.5) / max(length, 1)
        new = np.maximum(new, (s_grid > s0 + fray) & (s_grid < s1 + fray) & (t_grid >= t0) & (t_grid <= t1))
    single = hashed(tiles, rows, tiles * 0, seed + 4)
    new = np.maximum(new, np.where(single > 0.985, 0.8, 0.0))
    damp = np.clip(moss + 0.9 * noise(points, 4.0, seed + 5, 4) - 0.25 * profile[None] / 0.06, 0, 1)
    paint = np.stack([hashed(tiles, rows, tiles * 0, seed + 6), new, damp, np.ones_like(new)], -1)

    coarse_s, coarse_t = np.meshgrid(np.linspace(0, 1, max(2, columns // 4)), np.linspace(0, 1, 5))
    under = surface(coarse_s, coarse_t) - np.array([0, 0, 0.16])
    edge = np.stack([under[0], under[0] + np.array([0, 0, 0.15])])
    return grid_part(points, paint), joined([grid_part(under), grid_part(edge)])
