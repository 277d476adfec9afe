# SPDX-License-Identifier: GPL-3.0-or-later
"""Random scenes: what stands where, how it is coloured and lit.  Pure numpy; frame Z up, metres, origin at the site."""

import zlib
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from training.assets import Assets, Material, Mesh, subdivide, vertex_normals
from training.facades import facade as open_facade
from training.facades import galleries, panes
from training.procedural import Noise, Terrain, house
from training.tulou import tulou

FLOATING_ABOVE = 1.5  # a model whose lowest point is higher than this (metres) is a part without its base
GROUND_TILE = (3.0, 9.0)  # metres covered by one repeat of a photo texture on the ground
DRONE_TILE = (50.0, 110.0)  # the same for textures that are drone photos
WALL_TILE = (1.5, 5.0)


@dataclass(frozen=True)
class Instance:
    """Meshes placed in the world.  `key` names meshes that stay the same between scenes (kept on the GPU)."""

    meshes: tuple[Mesh, ...]
    transform: np.ndarray  # (4,4) world from model
    key: str | None = None
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)
    gloss: float = 0.0
    override: Material | None = None  # replaces the colour of every mesh that is not alpha-cut
    contrast: float = 1.0  # of its colours about their mean: plain plaster has little


@dataclass(frozen=True)
class Subject:
    """What a flight is about: a cylinder on the ground; centre (3,) at ground level. `facing`: the direction that a
    facade looks to, in radians about Z from x."""

    centre: np.ndarray
    radius: float
    height: float
    facing: float | None = None


@dataclass(frozen=True)
class Light:
    """Sun direction (3,) towards the sun, linear sun colour (3,), ambient SH (9,3) scaled, sky panorama and turn."""

    sun: np.ndarray
    sun_colour: np.ndarray
    ambient: np.ndarray
    sky: str
    sky_turn: float  # radians about Z
    haze: float  # extinction per metre
    exposure: float


@dataclass(frozen=True)
class Detail:
    """A fine texture multiplied onto everything, box-mapped, because game textures are coarse seen from near."""

    texture: str
    tile: float
    strength: float


@dataclass(frozen=True)
class Water:
    """A pond's level in metres, and its waves: their length in metres, their slope, and how far, in shares of the
    picture, a slope of 1 moves what is mirrored."""

    level: float
    waves: tuple[float, float, float]


@dataclass(frozen=True)
class World:
    instances: tuple[Instance, ...]
    terrain: Terrain
    subject: Subject  # the main building
    site: Subject  # all buildings
    light: Light
    detail: Detail
    solids: tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...]  # (4,4) world from box, lowest and highest corner
    water: Water | None = None

    def inside(self, points: np.ndarray) -> bool:
        """Whether any of the points (N,3) lies in the box of a closed building."""
        homogeneous = np.column_stack([points, np.ones(len(points))])
        for world_from_box, low, high in self.solids:
            local = homogeneous @ np.linalg.inv(world_from_box).T[:, :3]
            if ((local > low) & (local < high)).all(axis=1).any():
                return True
        return False


def ground_texture(assets: Assets, rng: np.random.Generator) -> tuple[str, float]:
    """A photo texture and the metres that one repeat of it covers."""
    name = str(rng.choice(assets.names("texture")))
    low, high = DRONE_TILE if "uav_" in name else GROUND_TILE
    return name, float(rng.uniform(low, high))


def wall_material(assets: Assets, rng: np.random.Generator) -> Material:
    """Plaster, earth or any photo texture at a size that suits a wall."""
    if rng.random() < 0.4:
        return Material(f"plaster:{rng.integers(24)}", tiles=(float(rng.uniform(3, 6)),) * 3)
    name = str(rng.choice([n for n in assets.names("texture") if "uav_" not in n]))
    return Material(name, tiles=(float(rng.uniform(*WALL_TILE)),) * 3)


def roof_material(assets: Assets, rng: np.random.Generator) -> Material:
    if rng.random() < 0.7:
        return Material(f"roof:{rng.integers(16)}", tiles=(float(rng.uniform(2.5, 5)),) * 3)
    return wall_material(assets, rng)


@lru_cache(maxsize=512)
def _rough_model(assets: Assets, name: str, variant: int) -> tuple[Mesh, ...]:
    """The model with long edges split and every vertex moved by noise (variant 0: as it is).

    Walls of game models are single planes; a network trained on them would learn to prefer planes.
    """
    meshes = assets.model(name)
    if variant == 0:
        return meshes
    rng = np.random.default_rng(variant * 7919 + zlib.crc32(name.encode()))
    noise = Noise(rng)
    amplitude = rng.uniform(0.02, 0.12)
    wavelength = rng.uniform(0.8, 3.0)
    out = []
    for mesh in meshes:
        if not mesh.material.alpha_cut:
            mesh = subdivide(mesh, 0.45 * wavelength + 0.3, min(4 * len(mesh.faces), 14000))
        p = mesh.positions
        # The shift depends on the position only, so vertices that coincide stay together.
        shift = np.stack([noise(p + o, wavelength, 2) for o in (0.0, 13.7, 29.1)], axis=1) * amplitude
        moved = (p + shift).astype(np.float32)
        out.append(replace(mesh, positions=moved, normals=vertex_normals(moved, mesh.faces)))
    return tuple(out)


def _bounds(meshes: tuple[Mesh, ...]) -> tuple[np.ndarray, np.ndarray]:
    points = np.concatenate([m.positions for m in meshes])
    return points.min(axis=0), points.max(axis=0)


def _placement(position: np.ndarray, turn: float, scale: np.ndarray) -> np.ndarray:
    """(4,4) scale (3,), then turn about Z (radians), then move."""
    matrix = np.eye(4)
    cos, sin = np.cos(turn), np.sin(turn)
    matrix[:3, :3] = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]) * scale
    matrix[:3, 3] = position
    return matrix


class _Layout:
    """Where discs already stand."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.discs: list[tuple[np.ndarray, float]] = []

    def find(self, radius: float, spread: float, gap: float, tries: int = 30) -> np.ndarray | None:
        """A free centre (2,) for a disc, as near the origin as the others allow."""
        for trial in range(tries):
            reach = spread * (0.2 + 0.8 * trial / tries)
            centre = self.rng.normal(0, reach, 2) if self.discs else self.rng.normal(0, 2, 2)
            if all(np.linalg.norm(centre - c) > gap * (radius + r) for c, r in self.discs):
                self.discs.append((centre, radius))
                return centre
        return None


@dataclass(frozen=True)
class _Building:
    meshes: tuple[Mesh, ...]
    key: str | None
    scale: np.ndarray
    radius: float
    height: float
    override: Material | None
    box: tuple[np.ndarray, np.ndarray] | None  # None where one can stand inside, as in a courtyard


def _wood(rng: np.random.Generator) -> Material:
    name = str(rng.choice(["ground/ph_beam_wall_01.jpg", "ground/ufo_s_wood003.jpg", "ground/ufo_floor_wood01.jpg"]))
    return Material(name, tiles=(float(rng.uniform(1.5, 3)),) * 3)


def _building(
    assets: Assets, rng: np.random.Generator, held_out: bool, carpenter: np.random.Generator | None
) -> _Building:
    """A model (60 %), a Tulou or a procedural house; with a `carpenter` more are Tulou, with open galleries."""
    draw = rng.random()
    if draw < 0.14 or (carpenter is not None and carpenter.random() < 0.15):
        wood = _wood(rng)
        meshes, radius, height = tulou(rng, wall_material(assets, rng), roof_material(assets, rng), wood, Noise(rng),
                                       carpenter)
        return _Building(tuple(meshes), None, np.ones(3), radius, height, None, None)
    if draw < 0.38:
        meshes = house(rng, wall_material(assets, rng), roof_material(assets, rng), Noise(rng))
        low, high = _bounds(tuple(meshes))
        return _Building(tuple(meshes), None, np.ones(3), float(np.hypot(*high[:2])), float(high[2]), None, (low, high))
    name = str(rng.choice(assets.buildings(held_out)))
    variant = int(rng.integers(0, 4))
    model = _rough_model(assets, name, variant)
    low, high = _bounds(model)
    scale = rng.uniform(0.7, 1.4) * rng.uniform(0.9, 1.1, 3)
    if "misc_" in name:  # statues modelled at the size of houses
        scale = scale * rng.uniform(0.3, 1.0)
    override = replace(wall_material(assets, rng), box_mapped=True) if rng.random() < 0.15 else None
    radius = float(np.abs(np.stack([low, high])[:, :2] * scale[:2]).max()) * 1.1
    return _Building(model, f"{name}#{variant}", scale, radius, float(high[2] * scale[2]), override, (low, high))


def _facade(
    assets: Assets, rng: np.random.Generator, glazier: np.random.Generator | None,
    carpenter: np.random.Generator | None,
) -> _Building:
    """A wall with openings that one sees through; with a `glazier` a third have glass in them, with a `carpenter` half
    have galleries before them."""
    meshes, half, height, holes = open_facade(rng, wall_material(assets, rng), wall_material(assets, rng), Noise(rng))
    if carpenter is not None and carpenter.random() < 0.5:
        front = replace(meshes[0].material, sheltered=float(carpenter.uniform(0.1, 0.6)))
        meshes = [replace(meshes[0], material=front), *meshes[1:],
                  *galleries(carpenter, half, height, _wood(carpenter))]
    if glazier is not None and glazier.random() < 0.35:
        meshes += panes(glazier, half, holes, Material("plaster:0", tiles=(5.0,) * 3, mirror="glass"))
    return _Building(tuple(meshes), None, np.ones(3), half, height, None, None)


def _thin_trees(
    assets: Assets, rng: np.random.Generator, terrain: Terrain, subject: Subject, facing: np.ndarray
) -> list[Instance]:
    """A few trees between a facade and who looks at it; `facing` (2,) is where it looks to."""
    usable = [n for n in assets.names("tree") if _bounds(assets.model(n))[0][2] < FLOATING_ABOVE]
    found = []
    for _ in range(int(rng.integers(0, 5))):
        name = str(rng.choice(usable))
        meshes = assets.model(name)
        low, high = _bounds(meshes)
        size = rng.uniform(2, 7) / max(float(high[2] - low[2]), 0.5)
        along = np.array([-facing[1], facing[0]]) * subject.radius * rng.uniform(-1, 1)
        centre = subject.centre[:2] + along + facing * rng.uniform(3, 6)
        z = float(terrain.height(centre[None])[0]) - 0.05 - max(low[2], 0.0) * size
        scale = size * np.array([0.6, 0.6, 1.0]) * rng.uniform(0.8, 1.1, 3)
        place = _placement(np.append(centre, z), rng.uniform(0, 2 * np.pi), scale)
        found.append(Instance(meshes, place, f"{name}#{id(meshes)}", _tint(rng)))
    return found


def _pond(
    assets: Assets, rng: np.random.Generator, terrain: Terrain, beside: Subject, discs: list[tuple[np.ndarray, float]]
) -> tuple[Instance, Water] | None:
    """A pond beside a building; it joins the `discs` that others stand on, or is None where those leave no room."""
    radius = float(rng.uniform(4, 12))
    turn, away = rng.uniform(0, 2 * np.pi), beside.radius + 1.3 * radius
    centre = beside.centre[:2] + away * np.array([np.cos(turn), np.sin(turn)])
    if any(np.linalg.norm(centre - c) < r + radius for c, r in discs):
        return None
    discs.append((centre, radius))
    level, outside = terrain.dig(centre, radius, float(rng.uniform(0.3, 1.0)))
    turns = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    rim = outside * np.column_stack([np.cos(turns), np.sin(turns), 0 * turns])
    positions = np.vstack([[0, 0, 0], rim]).astype(np.float32)
    number = np.arange(48)
    faces = np.column_stack([0 * number, 1 + number, 1 + (number + 1) % 48]).astype(np.int32)
    name, tile = ground_texture(assets, rng)
    upward, plan = np.tile(np.array([0, 0, 1], np.float32), (49, 1)), positions[:, :2]
    surface = Mesh(positions, upward, plan, plan, faces, Material(name, tiles=(tile,) * 3, mirror="water"))
    red, green, blue = rng.uniform(0.02, 0.2) * rng.uniform([0.7, 0.9, 0.5], [1.0, 1.0, 0.9])
    place = _placement(np.append(centre, level), 0.0, np.ones(3))
    waves = float(rng.uniform(0.3, 3)), float(rng.choice([0.0, 0.01, 0.03, 0.08])), float(rng.uniform(0.1, 0.3))
    return Instance((surface,), place, None, (float(red), float(green), float(blue)), 0.0, None,
                    float(rng.uniform(0.0, 0.6))), Water(level, waves)


def _tint(rng: np.random.Generator) -> tuple[float, float, float]:
    grey = rng.uniform(0.75, 1.15)
    red, green, blue = grey * rng.uniform(0.92, 1.08, 3)
    return float(red), float(green), float(blue)


def _scatter(
    assets: Assets, rng: np.random.Generator, terrain: Terrain, layout: _Layout, kind: str, count: int, spread: float
) -> list[Instance]:
    """Rocks, trees or props on free ground; a few kinds a scene, many copies of each."""
    usable = [n for n in assets.names(kind) if _bounds(assets.model(n))[0][2] < FLOATING_ABOVE]
    kinds = rng.choice(usable, size=min(len(usable), int(rng.integers(1, 5))), replace=False)
    found = []
    for _ in range(count):
        name = str(rng.choice(kinds))
        meshes = _rough_model(assets, name, int(rng.integers(1, 3))) if kind == "rock" else assets.model(name)
        low, high = _bounds(meshes)
        largest = float((high - low)[:2].max())
        size = {"tree": rng.uniform(0.35, 0.9), "rock": rng.uniform(0.15, 0.9), "prop": rng.uniform(0.5, 1.1)}[kind]
        size *= min(1.0, 14.0 / largest)
        centre = rng.normal(0, spread, 2)
        if any(np.linalg.norm(centre - c) < r * 0.85 + 0.25 * largest * size for c, r in layout.discs):
            continue
        z = float(terrain.height(centre[None])[0]) - 0.05 - max(low[2], 0.0) * size
        key = f"{name}#{id(meshes)}"
        override = None
        if kind == "rock" and rng.random() < 0.3:
            override = Material(ground_texture(assets, rng)[0], tiles=(3.0,) * 3, box_mapped=True)
        scale = size * rng.uniform(0.85, 1.15, 3)
        place = _placement(np.append(centre, z), rng.uniform(0, 2 * np.pi), scale)
        found.append(Instance(meshes, place, key, _tint(rng), 0.0, override))
    return found


def _light(assets: Assets, rng: np.random.Generator) -> Light:
    elevation, azimuth = np.radians(rng.uniform(18, 75)), rng.uniform(0, 2 * np.pi)
    sun = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    overcast = rng.random() < 0.25
    power = rng.uniform(0.0, 0.35) if overcast else rng.uniform(0.9, 2.6)
    warmth = rng.uniform(0, 1) * (1 - np.sin(elevation))
    sky = str(rng.choice(assets.names("sky")))
    ambient = assets.lighting(sky).copy()
    ambient *= (1.0 if overcast else rng.uniform(0.35, 0.8)) / max(float(ambient[0].mean()) * 0.282, 1e-3)
    ambient[1:] *= 0.6  # the panorama holds its own sun; ours casts the shadows
    grey = ambient[0].mean()
    ambient[0] = grey + 0.4 * (ambient[0] - grey)
    level = grey * 0.282 + power * np.sin(elevation)
    return Light(
        sun=sun,
        sun_colour=power * np.array([1.0, 1 - 0.18 * warmth, 1 - 0.4 * warmth]),
        ambient=ambient,
        sky=sky,
        sky_turn=float(rng.uniform(0, 2 * np.pi)),
        haze=float(rng.choice([0.0, 0.0, 2e-4, 1e-3]) * rng.uniform(0.3, 1)),
        exposure=float(rng.uniform(1.0, 2.2) / level),
    )


def compose(assets: Assets, rng: np.random.Generator, held_out: bool, facade: bool = False) -> World:
    """A scene from a random generator; its subject is a building, or a `facade` with openings."""
    # For what held-out scenes do not have: they stay those that earlier figures were measured on.
    painter, digger, glazier, carpenter = rng.spawn(4)
    horizon = rng.random() < 0.35
    radius = float(rng.uniform(55, 85))
    terrain = Terrain(rng, radius, float(rng.uniform(400, 2500)) if horizon else 2.5 * radius)
    layout = _Layout(rng)
    instances: list[Instance] = []
    placed: list[Subject] = []
    solids = []
    gap = rng.uniform(0.65, 1.1)
    for _ in range(int(rng.choice([1, 1, 2, 3, 4, 5, 6, 8]))):
        open_wall = facade and not placed
        building = (_facade(assets, rng, *((None, None) if held_out else (glazier, carpenter))) if open_wall
                    else _building(assets, rng, held_out, None if held_out else carpenter))
        centre = layout.find(building.radius, 22.0, gap)
        if centre is None:
            continue
        z = terrain.level(centre, building.radius)
        turn = rng.uniform(0, 2 * np.pi)
        place = _placement(np.append(centre, z), turn, building.scale)
        gloss = float(rng.choice([0, 0, 0.15]) * rng.random())
        instances.append(Instance(building.meshes, place, building.key, _tint(rng), gloss, building.override))
        if building.box is not None:
            solids.append((place, *building.box))
        placed.append(Subject(np.append(centre, z), building.radius, building.height,
                              turn - np.pi / 2 if open_wall else None))
    centre = np.mean([s.centre for s in placed], axis=0)
    reach = max(float(np.linalg.norm(s.centre[:2] - centre[:2])) + s.radius for s in placed)
    site = Subject(centre, reach, max(s.height for s in placed))
    spread = site.radius + 8
    pond = None
    if not held_out and digger.random() < 0.3:
        pond = _pond(assets, digger, terrain, placed[0], layout.discs)
    for kind, most in (("rock", 14), ("tree", 26), ("prop", 10)):
        count = int(rng.integers(0, most + 1) * (rng.random() < 0.75))
        instances += _scatter(assets, rng, terrain, layout, kind, count, spread)
    if placed[0].facing is not None:
        facing = np.array([np.cos(placed[0].facing), np.sin(placed[0].facing)])
        instances += _thin_trees(assets, rng, terrain, placed[0], facing)
    textures = [ground_texture(assets, rng) for _ in range(3)]
    material = Material(
        textures[0][0], blend=(textures[1][0], textures[2][0]), tiles=(textures[0][1], textures[1][1], textures[2][1])
    )
    instances += [] if pond is None else [pond[0]]
    instances.append(Instance((terrain.mesh(material),), np.eye(4), None, _tint(rng)))
    fine = [n for n in assets.names("texture") if "uav_" not in n]
    detail = Detail(str(rng.choice(fine)), float(rng.uniform(1.2, 4)), float(rng.choice([0, 0.3, 0.6, 0.9])))
    world = World(tuple(instances), terrain, placed[0], site, _light(assets, rng), detail, tuple(solids),
                  None if pond is None else pond[1])
    return world if held_out else _plainer(world, len(placed), painter)


def _plainer(world: World, buildings: int, rng: np.random.Generator) -> World:
    """Some worlds with pale plain walls, calm ground or an overcast sky, as photos have them and game art does not:
    there the network must know what it cannot match, and tell a wall from the sky. The buildings come first among the
    world's instances, the ground last."""
    instances = list(world.instances)
    if rng.random() < 0.35:
        for i in range(buildings):
            if rng.random() < 0.75:
                paler = rng.uniform(1.0, 1.7)
                red, green, blue = (c * paler for c in instances[i].tint)
                instances[i] = replace(instances[i], contrast=float(rng.uniform(0.03, 0.4)), tint=(red, green, blue))
    if rng.random() < 0.25:
        instances[-1] = replace(instances[-1], contrast=float(rng.uniform(0.1, 0.5)))
    light = world.light
    if rng.random() < 0.4:
        light = replace(light, sky=f"overcast:{rng.integers(16)}")
    return replace(world, instances=tuple(instances), light=light)
