# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Training: stopping and resuming loses nothing, a step learns, and a sample's crops agree with each other."""

from __future__ import annotations

import io
import json
import os
import signal
import struct
import subprocess
import sys
import time
import zipfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from box_scene import BOX, cast, make_view
from conftest import ROOT
from PIL import Image

from curecon_blender.core.network.refinement import Refined
from curecon_blender.core.network.weights import load_network
from training import build_assets, generator
from training.assets import Assets, Material, overcast_texture
from training.cameras import draw_rig
from training.dataset import Sample, training_sample
from training.facades import galleries
from training.generator import Scene
from training.losses import refinement_loss
from training.procedural import Recess, panel, straight
from training.scene import compose
from training.train import State, batch_tensors, bf16_gains, restart, save, start, step

# A network that takes a fifth of the time, where the network itself is not what a test looks at.
SMALL = {"channels": (2, 2, 2), "groups": (2, 2, 2), "regulariser_channels": 2, "context": 0, "refinement": 0}
ASSETS = ROOT.parent / "shared" / "data" / "training"


@pytest.fixture(scope="module")
def scene() -> Scene:
    """The ray-cast box as a training scene, its sparse points on the box and around it."""
    views = [make_view(i, 30) for i in range(5)]
    depth, images = zip(*(cast(view) for view in views), strict=True)
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-1, 1, (300, 2)), np.full(300, BOX[1, 2])])
    return Scene(
        np.stack(images), np.stack(depth), np.stack([v.K for v in views]), np.stack([v.cam_from_world for v in views]),
        points.astype(np.float32), np.ones((5, 300), bool),
    )


def samples(scene: Scene, count: int) -> list[Sample]:
    rng = np.random.default_rng(1)
    found = [training_sample(scene, rng, 2, (64, 64)) for _ in range(2 * count)]
    return [s for s in found if s is not None][:count]


def run(state: State, some: list[Sample]) -> list[float]:
    return [step(state, batch_tensors([s], torch.device("cpu")), 100, bf16=False)["loss"] for s in some]


def test_a_run_that_was_stopped_goes_on_as_if_it_had_not_been(scene: Scene, tmp_path: Path) -> None:
    some = samples(scene, 4)
    through = start(tmp_path / "nowhere", torch.device("cpu"))
    run(through, some)
    first = start(tmp_path / "nowhere", torch.device("cpu"))
    run(first, some[:2])
    save(first, tmp_path)
    second = start(tmp_path, torch.device("cpu"))
    assert second.samples == 2
    run(second, some[2:])
    assert second.samples == through.samples == 4
    for name in ("network", "ema"):
        ours, theirs = getattr(second, name).state_dict(), getattr(through, name).state_dict()
        for key in ours:
            torch.testing.assert_close(ours[key], theirs[key], atol=1e-5, rtol=1e-4)


def test_it_learns(scene: Scene, tmp_path: Path) -> None:
    state = start(tmp_path, torch.device("cpu"))
    batch = batch_tensors(samples(scene, 1), torch.device("cpu"))
    errors = [step(state, batch, 100, bf16=bf16_gains(torch.device("cpu")))["epe"] for _ in range(60)]
    assert np.mean(errors[-5:]) < 0.5 * np.mean(errors[:5])


def test_a_refinement_learns_on_a_cascade_that_stays_as_it_is(tmp_path: Path) -> None:
    views = [replace(view, K=np.diag([512 / view.width, 384 / view.height, 1]) @ view.K, width=512, height=384)
             for view in (make_view(i, 30) for i in range(3))]
    depth, images = zip(*(cast(view) for view in views), strict=True)
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-1, 1, (300, 2)), np.full(300, BOX[1, 2])]).astype(np.float32)
    (tmp_path / "scenes").mkdir()
    generator.save(Scene(
        np.stack(images), np.stack(depth), np.stack([v.K for v in views]), np.stack([v.cam_from_world for v in views]),
        points, np.ones((3, 300), bool)), tmp_path / "scenes" / "0.npz")

    def learn(minutes: float) -> dict[str, torch.Tensor]:
        subprocess.run(
            [sys.executable, "-m", "training.refine", "--scenes", tmp_path / "scenes", "--run", tmp_path / "run",
             "--maps", "2", "--minutes", str(minutes)], cwd=ROOT, check=True)
        weights: dict[str, torch.Tensor] = torch.load(tmp_path / "run" / "state.pt", weights_only=True)["network"]
        return weights

    before = load_network().state_dict()
    changed: set[str] = set()
    for minutes in (0.0, *[0.1] * 12):  # stopped before the first map is made, then gone on until it has learned
        after = learn(minutes)
        changed = {name for name, value in after.items() if not torch.equal(value, before[name])}
        if changed:
            break
    assert changed and all(name.startswith("refinement.") for name in changed)
    assert len(list((tmp_path / "run" / "maps").glob("*.npz"))) == 2


def test_a_restart_keeps_the_averaged_weights_and_the_count(scene: Scene, tmp_path: Path) -> None:
    state = start(tmp_path, torch.device("cpu"))
    run(state, samples(scene, 3))
    mean = {name: value.clone() for name, value in state.ema.state_dict().items()}
    restart(state)
    assert (state.earlier, state.samples) == (3, 0)
    for name, value in state.network.state_dict().items():
        torch.testing.assert_close(value, mean[name])


def test_crops_of_a_sample_show_the_same_place(scene: Scene) -> None:
    for sample in samples(scene, 5):
        height, width = sample.depth.shape
        v, u = np.nonzero(sample.depth)
        rays = np.linalg.inv(sample.K[0]) @ np.stack([u + 0.5, v + 0.5, np.ones(len(u))])
        pose = sample.cam_from_world[0]
        world = pose[:, :3].T @ (rays * sample.depth[v, u] - pose[:, 3:])
        x, y, w = sample.K[1] @ (sample.cam_from_world[1][:, :3] @ world + sample.cam_from_world[1][:, 3:])
        x, y = x / w, y / w
        inside = (x > 1) & (x < width - 1) & (y > 1) & (y < height - 1)
        assert inside.mean() > 0.4
        ours = sample.images[0][v, u][inside].astype(float)
        theirs = sample.images[1][y[inside].astype(int), x[inside].astype(int)].astype(float)
        assert np.median(np.abs(ours - theirs)) < 15
        assert sample.near < np.median(sample.depth[sample.depth > 0]) < sample.far


@pytest.mark.skipif(not ASSETS.exists(), reason="the asset folder for training is not beside the repository")
def test_rendered_scenes_are_geometrically_exact() -> None:
    from training.generator import Generator

    scene = Generator(ASSETS).generate(7, (192, 144), views=5, pose_noise=False)
    checked = 0
    for other in range(1, 5):
        v, u = np.nonzero(scene.depth[0])
        pose, target = scene.cam_from_world[0], scene.cam_from_world[other]
        rays = np.linalg.inv(scene.K[0]) @ np.stack([u + 0.5, v + 0.5, np.ones(len(u))])
        world = pose[:, :3].T @ (rays * scene.depth[0][v, u] - pose[:, 3:])
        camera = target[:, :3] @ world + target[:, 3:]
        x, y, _ = scene.K[other] @ camera / camera[2]
        inside = (x > 0) & (x < 192) & (y > 0) & (y < 144) & (camera[2] > 0)
        there = scene.depth[other][y[inside].astype(int), x[inside].astype(int)]
        relative = np.abs(there - camera[2][inside]) / camera[2][inside]
        if (relative < 0.05).sum() > 500:  # enough of the same surface in both
            assert np.median(relative[relative < 0.05]) < 0.01
            checked += 1
    assert checked


def test_plain_walls_lose_their_pattern_and_keep_their_shape() -> None:
    from training.generator import Generator

    made = Generator(ASSETS)
    rng = np.random.default_rng(3)
    world = compose(made.assets, rng, held_out=True)
    rig = draw_rig(rng, "orbit", world, 1, (192, 144))
    plain = replace(world, instances=tuple(replace(i, contrast=0.0) for i in world.instances))
    pictures, depths = [], []
    for each in (world, plain):
        made.renderer.upload(each)
        picture, depth = made.renderer.render(rig.K[0], rig.cam_from_world[0], (192, 144))
        pictures.append(picture.astype(float))
        depths.append(depth)
    np.testing.assert_array_equal(*depths)
    surface = depths[0][:, 1:] * depths[0][:, :-1] > 0
    steps = [np.abs(np.diff(picture, axis=1)).mean(2)[surface] for picture in pictures]
    assert np.median(steps[1]) < 0.5 * np.median(steps[0])


def test_training_has_overcast_skies_and_plain_walls_and_held_out_scenes_have_not() -> None:
    assets = Assets(ASSETS)
    skies: dict[bool, list[bool]] = {True: [], False: []}
    contrasts: dict[bool, list[float]] = {True: [], False: []}
    for seed in range(12):
        for held_out in (True, False):
            world = compose(assets, np.random.default_rng(seed), held_out)
            skies[held_out].append(world.light.sky.startswith("overcast"))
            contrasts[held_out].append(min(i.contrast for i in world.instances))
    assert 1 < sum(skies[False]) < 11 and not any(skies[True])
    assert min(contrasts[False]) < 0.5 and max(contrasts[False]) == 1 and min(contrasts[True]) == 1
    sky = overcast_texture(3)
    assert sky.std() < 20 and sky.mean() > 150  # bright, and nothing in it


def test_two_processes_train_one_network_and_stop_together(scene: Scene, tmp_path: Path) -> None:
    (tmp_path / "scenes").mkdir()
    generator.save(scene, tmp_path / "scenes" / "1.npz")
    command = [sys.executable, "-m", "training.train", "--assets", str(ASSETS), "--run", str(tmp_path),
               "--processes", "2", "--renderers", "0", "--sources", "2", "--width", "64", "--height", "64",
               "--minutes", "5", "--config", json.dumps(SMALL)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True) as together:
        log = tmp_path / "log.jsonl"
        deadline = time.monotonic() + 240
        while not (log.exists() and log.read_text()) and together.poll() is None and time.monotonic() < deadline:
            time.sleep(0.5)
        together.send_signal(signal.SIGINT)
        said = together.communicate(timeout=120)[0]
    assert together.returncode == 0, said
    logged = json.loads(log.read_text().splitlines()[0])
    assert logged["samples"] == 100  # fifty steps of two samples
    state = start(tmp_path, torch.device("cpu"))
    assert state.samples == 2 * state.steps >= 100 and f"{state.samples} samples seen" in said


def pmd(vertices: np.ndarray, uv: np.ndarray, props: dict[str, tuple[float, float, float]]) -> bytes:
    """A mesh of 0 A.D. (version 4): one triangle, a UV set, and places for props."""
    body = struct.pack("<2I", len(vertices), 1)
    for position, place in zip(vertices, uv, strict=True):
        body += struct.pack("<8f4B4f", *position, 0, 1, 0, *place, 255, 255, 255, 255, 0, 0, 0, 0)
    body += struct.pack("<I3H", 1, 0, 1, 2) + struct.pack("<2I", 0, len(props))
    for name, place in props.items():
        body += struct.pack("<I", len(name)) + name.encode() + struct.pack("<7fB", *place, 0, 0, 0, 1, 255)
    return b"PSMD" + struct.pack("<2I", 4, len(body)) + body


def test_an_asset_folder_is_built_from_the_games_archive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(build_assets.FEWEST_FACES, "building", 1)
    picture = io.BytesIO()
    colours = np.zeros((256, 256, 4), np.uint8)
    colours[:128], colours[128:] = (200, 40, 40, 255), (40, 40, 200, 255)
    colours[::2, ::2, :3] += 30
    Image.fromarray(colours).save(picture, "DDS")
    actor = """<?xml version="1.0"?><actor version="1"><group><variant frequency="1"><mesh>structural/{mesh}.dae</mesh>
        <textures><texture file="wall.png" name="baseTex"/></textures>{props}</variant></group></actor>"""
    corners, uv = np.array([[0, 0, 0], [4, 0, 0], [0, 3, 2.0]]), np.array([[0, 0], [1, 0], [0, 0.75]])
    with zipfile.ZipFile(tmp_path / "public.zip", "w") as archive:
        archive.writestr("art/meshes/structural/house.dae.cached.pmd", pmd(corners, uv, {"door": (10, 0, 1)}))
        archive.writestr("art/meshes/structural/door.dae.cached.pmd", pmd(corners / 10, uv, {}))
        archive.writestr("art/textures/skins/wall.png.cached.dds", picture.getvalue())
        archive.writestr("art/textures/terrain/types/soil.png.cached.dds", picture.getvalue())
        for side in ("front", "back", "left", "right", "top"):
            archive.writestr(f"art/textures/skies/calm/{side}.dds.cached.dds", picture.getvalue())
        prop = '<props><prop actor="props/door.xml" attachpoint="door"/></props>'
        archive.writestr("art/actors/structures/land/house.xml", actor.format(mesh="house", props=prop))
        archive.writestr("art/actors/props/door.xml", actor.format(mesh="door", props=""))
    counts = build_assets.build(tmp_path / "public.zip", tmp_path / "assets", None)
    assert counts == {"building": 1, "rock": 0, "tree": 0, "prop": 0, "texture": 1, "sky": 1}

    assets = Assets(tmp_path / "assets")
    [name] = assets.buildings(held_out=False) + assets.buildings(held_out=True)
    house, door = assets.model(name)
    np.testing.assert_allclose(house.positions, corners[:, [0, 2, 1]], atol=1e-6)  # Z up, not mirrored
    np.testing.assert_allclose(door.positions, corners[:, [0, 2, 1]] / 10 + [10, 1, 0], atol=1e-6)
    np.testing.assert_allclose(house.uv, uv * [1, -1] + [0, 1], atol=1e-6)
    texture = assets.texture(house.material.texture)
    assert texture[60].mean(0) @ [1, 0, -1] > 100 > -100 > texture[200].mean(0) @ [1, 0, -1]
    assert assets.lighting(assets.names("sky")[0]).shape == (9, 3) and "Wildfire" in (
        tmp_path / "assets" / "SOURCES.md").read_text()


def test_one_sees_through_an_opening_and_not_through_the_wall() -> None:
    wall = panel(8.0, 4.0, straight(np.zeros(3), *np.eye(3)[[0, 2]], np.array([0, -1.0, 0])),
                 [Recess(1, 3, 1, 3, -0.5, open=True), Recess(5, 6, 0, 4, -0.5)], lambda points: 0 * points[:, 0], 0.5,
                 Material("plaster:0"))
    drawn = np.zeros((400, 800), np.uint8)
    for corners in wall.positions[wall.faces][..., [0, 2]]:
        cv2.fillConvexPoly(drawn, np.round(corners * 100).astype(np.int32), 1)
    assert not drawn[110:290, 110:290].any()
    assert drawn[:, 310:].mean() > 0.99 and drawn[:90].mean() > 0.99


def test_one_sees_into_a_gallery_above_its_railing_and_between_the_bars() -> None:
    front = galleries(np.random.default_rng(2), 6.0, 7.0, Material("plaster:0"))[0]
    drawn = np.zeros((700, 1200), np.uint8)
    for corners in front.positions[front.faces][..., [0, 2]]:
        cv2.fillConvexPoly(drawn, np.round(corners * 100 + [600, 0]).astype(np.int32), 1)
    open_rows = 1 - drawn.mean(axis=1)
    assert open_rows[100] > 0.7 and open_rows.min() == 0  # a ground floor between posts, and beams
    bars = [row for row in drawn[250:450] if np.count_nonzero(np.diff(row)) > 60]
    assert len(bars) > 40 and 0.2 < 1 - np.mean(bars) < 0.95


def test_what_the_sky_does_not_reach_is_darker_and_keeps_its_shape() -> None:
    from training.generator import Generator

    made = Generator(ASSETS)
    rng = np.random.default_rng(3)
    world = compose(made.assets, rng, held_out=True)
    rig = draw_rig(rng, "orbit", world, 1, (192, 144))
    world = replace(world, light=replace(world.light, sun_colour=np.zeros(3), haze=0.0))
    dark = replace(world, instances=tuple(
        replace(i, meshes=tuple(replace(m, material=replace(m.material, sheltered=0.1)) for m in i.meshes), key=None,
                override=None if i.override is None else replace(i.override, sheltered=0.1))
        for i in world.instances))
    pictures, depths = [], []
    for each in (world, dark):
        made.renderer.upload(each)
        picture, depth = made.renderer.render(rig.K[0], rig.cam_from_world[0], (192, 144))
        pictures.append(picture[depth > 0][:, :3].astype(float))
        depths.append(depth)
    np.testing.assert_array_equal(*depths)
    assert pictures[1].mean() < 0.6 * pictures[0].mean()


def test_a_guess_too_deep_costs_more_than_one_as_many_intervals_too_near() -> None:
    truth = torch.full((1, 1, 4, 4), 0.7)

    def loss(t: float) -> float:
        candidates = torch.cat([truth, truth + t, truth, truth], 1)
        probability = torch.tensor([0.5, 0.5, 0, 0]).view(1, 4, 1, 1).expand(1, 4, 4, 4)
        refined = Refined(truth, torch.zeros_like(truth), candidates, probability)
        everywhere = torch.ones_like(truth) > 0
        return float(refinement_loss(refined, truth, everywhere, everywhere, 0.002, torch.tensor([0.1])))

    assert loss(0.0) < loss(-0.2) < loss(0.2)


def test_confidence_learns_of_no_surface_but_nothing_where_the_truth_has_gaps() -> None:
    t, logit = torch.full((1, 1, 1, 3), 0.7), torch.zeros(1, 1, 1, 3, requires_grad=True)
    refined = Refined(t, logit, t.expand(1, 4, 1, 3), torch.full((1, 4, 1, 3), 0.25))
    surface, whole = torch.tensor([[[[True, False, True]]]]), torch.tensor([[[[True, True, False]]]])
    refinement_loss(refined, t, surface, whole, 0.002, torch.tensor([0.1])).backward()
    assert logit.grad is not None
    right, nothing, gaps = (float(value) for value in logit.grad[0, 0, 0])
    assert right < 0 < nothing and gaps == 0
