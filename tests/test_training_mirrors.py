# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Training scenes with water and glass: pictures show there what lies elsewhere, depth is that of the surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import ROOT

from training.cameras import look_at
from training.generator import Generator, back_project
from training.scene import World, compose

SIZE = 192, 144
K = np.array([[150.0, 0, 96], [0, 150, 72], [0, 0, 1]])


@pytest.fixture(scope="module")
def made() -> Generator:
    return Generator(ROOT.parent / "shared" / "data" / "training")


def first_world(made: Generator, kind: str) -> World:
    """The first training world with a pond or with glass."""
    for seed in range(100):
        world = compose(made.assets, np.random.default_rng(seed), held_out=False, facade=kind == "glass")
        if any(mesh.material.mirror == kind for instance in world.instances for mesh in instance.meshes):
            return world
    raise AssertionError(f"no world of a hundred has {kind}")


def mirrored(made: Generator, world: World, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    made.renderer.upload(world)
    picture, depth = made.renderer.render(K, pose, SIZE)
    return picture[..., :3].astype(float), depth, picture[..., 3] == 0


def test_a_pond_shows_the_building_upside_down_and_is_as_deep_as_its_surface(made: Generator) -> None:
    world = first_world(made, "water")
    pond = next(i for i in world.instances if i.meshes[0].material.mirror == "water").transform[:3, 3]
    aside = pond[:2] - world.subject.centre[:2]
    eye = np.append(pond[:2] + aside, pond[2] + 0.4 * np.linalg.norm(aside))
    pose = look_at(eye, pond, 0.0)
    still = replace(world, water=replace(world.water, waves=(1.0, 0.0, 0.0)))
    picture, depth, mirror = mirrored(made, still, pose)
    assert mirror.mean() > 0.02
    rows, columns = np.nonzero(mirror)
    surface = back_project(K, pose, np.column_stack([columns, rows]) + 0.5, depth[mirror])
    np.testing.assert_allclose(surface[:, 2], world.water.level, atol=0.02)
    # Without the building the ground stays as it was where the sun still falls on it, and the water does not.
    kept = (pond[None] == [i.transform[:3, 3] for i in world.instances]).all(1)
    ground = np.array([i is world.instances[-1] for i in world.instances])
    alone = tuple(i for i, stays in zip(world.instances, kept | ground, strict=True) if stays)
    bare, _, again = mirrored(made, replace(still, instances=alone), pose)
    both = mirror & again
    assert both.any() and np.abs(bare - picture).mean(2)[both].max() > 10


def test_glass_shows_the_sky(made: Generator) -> None:
    world = first_world(made, "glass")
    facing = np.array([np.cos(world.subject.facing), np.sin(world.subject.facing), 0.0])
    middle = world.subject.centre + [0, 0, world.subject.height / 2]
    pose = look_at(middle + 12 * facing - [0, 0, 2], middle, 0.0)
    cloudy = replace(world.light, sky=made.assets.names("sky")[0])
    picture, depth, mirror = mirrored(made, replace(world, light=cloudy), pose)
    later = replace(cloudy, sky_turn=cloudy.sky_turn + 2)
    turned, same, _ = mirrored(made, replace(world, light=later), pose)
    np.testing.assert_array_equal(depth, same)
    surface = (depth > 0) & ~mirror
    assert mirror.any() and np.abs(turned - picture).mean(2)[mirror].max() > 5
    assert np.abs(turned - picture).mean(2)[surface].max() == 0


def test_scenes_for_evaluation_stay_without(made: Generator) -> None:
    for seed in range(30):
        world = compose(made.assets, np.random.default_rng(seed), held_out=True, facade=seed % 2 == 0)
        assert world.water is None
        assert not any(mesh.material.mirror for instance in world.instances for mesh in instance.meshes)
