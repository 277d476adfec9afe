# SPDX-License-Identifier: GPL-3.0-or-later
"""Plants and rocks of the site: vegetables, grass, trees, bamboo, bushes and boulders, all of real geometry.

Site frame: metres, x east, y north, z up.
"""

from __future__ import annotations

import bpy
import numpy as np
from site_mesh import MeshBuilder, Part, grid_part, joined, noise, painted, rod
from tulou_plan import Site
from tulou_surroundings import (
    HOUSES,
    PATHS,
    PLOTS,
    POND_CENTRE,
    POND_RADIUS,
    on_ground,
    place,
    plot_frame,
    segment_distance,
    smooth,
)


def quads(centres: np.ndarray, u: np.ndarray, v: np.ndarray, paint: np.ndarray) -> Part:
    """Free quads: centres (N, 3) with half-axes u and v (N, 3)."""
    corners = np.stack([centres - u - v, centres + u - v, centres + u + v, centres - u + v], 1)
    faces = np.arange(4 * len(centres)).reshape(-1, 4)
    return Part(vertices=corners.reshape(-1, 3), faces=faces, paint=np.repeat(paint, 4, axis=0))


def _directions(rng: np.random.Generator, count: int) -> np.ndarray:
    d = rng.normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def _leaves(rng: np.random.Generator, centres: np.ndarray, size: float) -> Part:
    """One leaf quad at each centre, turned at random but mostly facing up."""
    count = len(centres)
    normal = _directions(rng, count) + [0, 0, 0.7]
    u = np.cross(normal, _directions(rng, count))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(normal, u)
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    scale = size * rng.uniform(0.6, 1.3, (count, 1))
    paint = painted(count)
    paint[:, 0], paint[:, 1] = rng.beta(2, 3, count), rng.random(count) ** 3
    return quads(centres, u * scale, v * scale * 0.55, paint)


def _tree(rng: np.random.Generator, height: float, spread: float, clusters: int, size: float) -> tuple[Part, Part]:
    """Wood and leaves of a tree at the origin, `height` tall with a crown `spread` wide, in metres."""
    crown = np.array([0, 0, height * 0.66])
    trunk = np.array([[0, 0, -0.4], [0.1, 0.05, height * 0.3], [rng.normal(0, 0.3), rng.normal(0, 0.3), height * 0.75]])
    branches = [rod(trunk, np.array([0.032, 0.024, 0.01]) * height, painted(1)[0] * [0.2, 1, 1, 1])]
    radius = np.array([spread / 2, spread / 2, height * 0.34])
    heads = crown + _directions(rng, clusters) * radius * rng.uniform(0.45, 1.0, (clusters, 1))
    for head in heads[:14]:
        start = trunk[1] + (trunk[2] - trunk[1]) * rng.uniform(0.1, 0.9)
        middle = (start + head) / 2 + [0, 0, -0.05 * height]
        branches.append(
            rod(
                np.array([start, middle, head]),
                np.array([0.012, 0.008, 0.003]) * height,
                painted(1)[0] * [0.2, 1, 1, 1],
                5,
            )
        )
    around = np.repeat(heads, 75, axis=0)
    offset = rng.normal(size=around.shape) * spread * np.array([0.085, 0.085, 0.055])
    return joined(branches), _leaves(rng, around + offset, size)


def _bamboo(rng: np.random.Generator) -> tuple[Part, Part]:
    """A clump of bamboo, about 9 m tall, bowing outwards."""
    stems, tips = [], []
    for _ in range(38):
        angle, lean, tall = rng.uniform(0, 2 * np.pi), rng.uniform(0.3, 2.4), rng.uniform(6, 10)
        out = np.array([np.cos(angle), np.sin(angle), 0])
        h = np.linspace(0, 1, 6)[:, None]
        path = out * (rng.uniform(0.1, 0.9) + lean * h**2.2) + np.array([0, 0, tall]) * (h - 0.12 * h**3)
        stems.append(rod(path, 0.045, np.array([0.35, 0.3, 0, 1]), 5))
        share = rng.uniform(0.35, 1.0, 110) ** 0.8
        along = np.stack([np.interp(share, h[:, 0], path[:, i]) for i in range(3)], 1)
        tips.append(along + rng.normal(size=along.shape) * [0.45, 0.45, 0.35])
    return joined(stems), _leaves(rng, np.concatenate(tips), 0.16)


def add_crops(site: Site, rng: np.random.Generator) -> None:
    """Rows of vegetables on the plots and on the terraces, and tufts of grass everywhere else."""
    centres, sizes, tint = [], [], []
    for number, plot in enumerate(PLOTS):
        centre, turn = plot_frame(plot)
        along, across = np.meshgrid(
            np.arange(-plot[2] / 2 + 0.4, plot[2] / 2 - 0.2, 0.5),
            np.arange(-np.floor(plot[3] / 1.8) * 0.9, plot[3] / 2 - 0.2, 0.9),
        )
        local = np.stack([along.ravel(), across.ravel()], 1) + rng.normal(0, 0.07, (along.size, 2))
        local = local[rng.random(len(local)) > 0.13]
        crop = rng.uniform(0.12, 0.3) * np.where(local[:, 0] < plot[2] * rng.uniform(-0.3, 0.3), 1.0, 0.6)
        centres.append(on_ground(local @ turn.T + centre) + [0, 0, 0.14])
        sizes.append(crop * rng.uniform(0.7, 1.3, len(local)))
        tint.append(np.full(len(local), (number * 0.37) % 0.8))
    plants, size, tone = np.concatenate(centres), np.concatenate(sizes), np.concatenate(tint)
    whorl = np.repeat(plants, 9, axis=0)
    spread = np.repeat(size, 9)[:, None]
    leaves = _leaves(rng, whorl + rng.normal(size=whorl.shape) * spread * [0.6, 0.6, 0.35], 0.14)
    leaves.paint[:, 0] = np.clip(np.repeat(np.repeat(tone, 9), 4) + 0.5 * leaves.paint[:, 0] - 0.1, 0, 1)
    site["leaf"].add(leaves)

    xy = rng.uniform(-75, 75, (60000, 2))
    flat = np.concatenate([xy, np.zeros((len(xy), 1))], 1)
    radius = np.hypot(*xy.T)
    keep = (radius > 24) & (noise(flat, 5.0, 131, 3) + 0.6 * smooth(radius, 24, 34) > 0.5)
    for path in PATHS:
        keep &= segment_distance(xy, path) > 1.7
    keep &= np.hypot(*(xy - POND_CENTRE).T) > POND_RADIUS + 0.3
    keep &= np.linalg.norm(xy - place(158, 34), axis=1) > 9
    tufts = on_ground(xy[keep])
    blades = np.repeat(tufts, 4, axis=0)
    count = len(blades)
    tall = rng.uniform(0.08, 0.3, (count, 1)) * np.repeat(rng.uniform(0.5, 1.5, len(tufts)), 4)[:, None]
    lean = rng.normal(size=(count, 3)) * [0.5, 0.5, 0] + [0, 0, 1]
    turn = rng.uniform(0, np.pi, count)
    u = np.stack([np.cos(turn), np.sin(turn), 0 * turn], 1) * 0.05
    paint = painted(count)
    paint[:, 0] = np.repeat(rng.beta(2, 2, len(tufts)), 4)
    site["leaf"].add(quads(blades + lean * tall * 0.5 + u, u, lean * tall * 0.6, paint))


def _rock(rng: np.random.Generator) -> Part:
    """A boulder about 1 m across, at the origin."""
    theta, phi = np.meshgrid(np.linspace(0, 2 * np.pi, 33), np.linspace(0, np.pi, 17))
    ball = np.stack([np.cos(theta) * np.sin(phi), np.sin(theta) * np.sin(phi), np.cos(phi)], -1)
    seed = int(rng.integers(1000))
    points = ball * (0.5 + 0.16 * noise(ball + seed, 1.1, seed, 4))[..., None] * [1.0, 0.8, 0.65]
    tone = 0.45 + 0.4 * noise(ball, 0.8, seed + 1)
    return grid_part(points, np.stack([tone, 0 * tone, 0.5 + 0.3 * ball[..., 2], 1 + 0 * tone], -1))


def add_trees(materials: dict[str, bpy.types.Material], rng: np.random.Generator) -> None:
    """Trees, bamboo, bushes and rocks: a few meshes, many objects."""

    def prototype(name: str, parts: dict[str, Part]) -> list[bpy.types.Mesh]:
        meshes = []
        for material, part in parts.items():
            builder = MeshBuilder([part])
            meshes.append(builder.mesh(f"{name}_{material}", materials[material]))
        return meshes

    kinds = {}
    for i, (height, spread, clusters, size) in enumerate(
        ((8.5, 6.5, 62, 0.17), (11.0, 7.5, 85, 0.18), (6.0, 5.0, 45, 0.15), (4.2, 3.6, 36, 0.13)),
    ):
        bark, leaf = _tree(rng, height, spread, clusters, size)
        kinds[f"tree{i}"] = prototype(f"tree{i}", {"bark": bark, "leaf": leaf})
    stems, tips = _bamboo(rng)
    kinds["bamboo"] = prototype("bamboo", {"bark": stems, "leaf": tips})
    heads = _directions(rng, 1600) * rng.uniform(0.5, 1, (1600, 1)) * [0.9, 0.8, 0.6] + [0, 0, 0.55]
    kinds["bush"] = prototype("bush", {"leaf": _leaves(rng, heads, 0.09)})
    kinds["rock"] = prototype("rock", {"stone": _rock(rng)})

    def put(kind: str, xy: np.ndarray, scale: float) -> None:
        where = on_ground(xy)[0]
        turn = rng.uniform(0, 2 * np.pi)
        for mesh in kinds[kind]:
            thing = bpy.data.objects.new(mesh.name, mesh)
            thing.location = where
            thing.rotation_euler = (0, 0, turn)
            thing.scale = (scale, scale * rng.uniform(0.95, 1.05), scale * rng.uniform(0.95, 1.1))
            bpy.context.scene.collection.objects.link(thing)

    houses = np.array([[h.x, h.y] for h in HOUSES])
    clear = np.concatenate([np.array([plot_frame(p)[0] for p in PLOTS]), houses])

    def free(xy: np.ndarray, gap: float) -> bool:
        path = min(float(segment_distance(xy, line)) for line in PATHS)
        near = float(np.min(np.hypot(*(clear - xy).T)))
        return path > 2.6 and near > gap and np.hypot(*(xy - POND_CENTRE)) > POND_RADIUS + 1

    for azimuth, radius, kind, scale in (
        (187, 36, "tree1", 1.0),
        (212, 47, "tree0", 1.0),
        (300, 37, "bamboo", 1.0),
        (56, 30, "tree2", 1.0),
        (105, 28.5, "tree3", 1.1),
        (283, 33, "tree2", 0.9),
        (345, 33, "tree3", 1.2),
        (175, 44, "bamboo", 0.9),
        (66, 44, "tree0", 0.9),
    ):
        put(kind, place(azimuth, radius), scale)
    for count, low, high, names, gap in (
        (34, 46, 85, ("tree0", "tree1", "tree2", "bamboo"), 9.5),
        (650, 80, 300, ("tree0", "tree1", "bamboo", "tree1"), 8),
        (70, 25.5, 70, ("bush", "bush", "rock", "rock"), 6),
    ):
        while count:
            xy = place(rng.uniform(0, 360), np.sqrt(rng.uniform(low**2, high**2)))
            if free(xy, gap):
                name = str(rng.choice(names))
                put(name, xy, rng.uniform(0.4, 1.3) if name in ("bush", "rock") else rng.uniform(0.75, 1.25))
                count -= 1
