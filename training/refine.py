# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Train the refinement alone, on what a finished cascade says of rendered scenes; stop and resume at any moment.

    python -m training.refine --scenes DIR --run DIR [--maps 1000] [--minutes 9] [--horizon 10000]

The cascade stays as it is, so it is run once a map: RUN/maps fills with its outputs first, and each step of training
takes one of those: half the time of a step of training.train, on four times the pixels. state.pt and log.jsonl are as
there, and training.export turns the one into weights.
"""

from __future__ import annotations

import argparse
import json
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import cast

import numpy as np
import torch
from torch import Tensor

from curecon_blender.core.base.allocator import use_large_pages
from curecon_blender.core.network.model import MULTIPLE, LCMMVSNet, level_confidences, t_from_depth
from curecon_blender.core.network.refinement import Refinement, rasterise_points, sampled_refined_depth
from curecon_blender.core.network.weights import SHIPPED
from training.dataset import Sample, training_sample
from training.generator import load
from training.losses import INTERVALS, refinement_loss
from training.train import (
    GRADIENT_NORM,
    SAVE_EVERY,
    State,
    batch_tensors,
    bf16_gains,
    learning_rate,
    save,
    start,
    update_ema,
)

SIZES = (768, 576), (512, 384)  # of a map
CROPS = (768, 576), (512, 384), (512, 384)  # of a step, if the map is as large: windows of the refinement must fit
VIEWS_A_MAP = 10  # of a scene for each of its maps, one in any case
SOURCES = 2, 3, 4, 4, 4, 5
WITHOUT_POINTS = 0.15  # of the steps have no sparse points
FEWEST_POINTS = 0.3  # of a map's, as the root of their share
WRONG_POINTS = 0.0, 0.0, 0.02, 0.05  # share of the points whose depth is made another
BF16 = bf16_gains(torch.device("cpu"))
_COLOURS, _UNIT = 255, 65535  # steps of a stored colour, of a stored sweep coordinate or share


@torch.no_grad()
def cascade_map(network: LCMMVSNet, sample: Sample) -> dict[str, np.ndarray]:
    """What the refinement sees of a sample, and the truth: `image` (H,W,3) uint8; `t`, `truth` (H,W) and `shares`
    (3,H,W) uint16 in steps of 1/65535; `valid` (H,W) where the truth lies within the sweep; `whole` (H,W) where
    confidence learns; the finest `interval`; `points` (P,4), `near` and `far` of the sample."""
    batch = batch_tensors([sample], torch.device("cpu"))
    with torch.autocast("cpu", torch.bfloat16, enabled=BF16):
        outputs = network(*(batch[k] for k in ("images", "K", "cam_from_world", "near", "far", "scores")))
    truth = t_from_depth(batch["depth"].clamp_min(1e-3), batch["near"], batch["far"])

    def stored(values: Tensor) -> np.ndarray:
        return np.round(values.float().clamp(0, 1).numpy() * _UNIT).astype(np.uint16)

    valid = ((batch["depth"] > 0) & (truth >= 0) & (truth < 1))[0, 0].numpy()
    return {
        "image": sample.images[0], "t": stored(outputs[-1].t[0, 0]), "shares": stored(level_confidences(outputs)[0]),
        "truth": stored(truth[0, 0]), "valid": valid, "whole": np.full_like(valid, sample.complete),
        "interval": np.float32(outputs[-1].interval), "points": sample.points, "near": sample.near, "far": sample.far,
    }


def fill(folder: Path, count: int, scenes: list[Path], network: LCMMVSNet, stopped: Callable[[], bool]) -> None:
    """Write maps to the folder until it holds `count` of them, each from a random view of a random scene."""
    folder.mkdir(exist_ok=True)
    network.eval().fold_batch_norm()
    made = len(list(folder.glob("*.npz")))
    rng = np.random.default_rng(made)
    while made < count:
        scene = load(scenes[int(rng.integers(len(scenes)))])
        height, width = scene.depth.shape[1:]
        sizes = [size for size in SIZES if size[0] <= width and size[1] <= height]
        for _ in range(1 + len(scene.images) // VIEWS_A_MAP if sizes else 0):
            sample = training_sample(scene, rng, int(rng.choice(SOURCES)), sizes[int(rng.integers(len(sizes)))])
            if stopped():
                return
            if sample is not None:
                partial = folder / "map.partial"
                with open(partial, "wb") as out:
                    np.savez(out, **cascade_map(network, sample))
                partial.rename(folder / f"{made:05d}.npz")
                made += 1


def crop_of(path: Path, rng: np.random.Generator) -> dict[str, Tensor]:
    """A random crop of a map, mirrored or not, as the refinement's arguments: (1,C,H,W) each."""
    with np.load(path) as data:
        height, width = data["t"].shape
        crop = np.minimum(CROPS[int(rng.integers(len(CROPS)))], (width, height))
        x, y = (int(rng.integers(spare // MULTIPLE + 1)) * MULTIPLE for spare in (width, height) - crop)
        cut = np.s_[..., y : y + crop[1], x : x + crop[0]]
        scale = {"image": _COLOURS, "t": _UNIT, "shares": _UNIT, "truth": _UNIT, "valid": 1, "whole": 1}
        parts = {name: np.moveaxis(data[name], -1, 0) if name == "image" else data[name] for name in scale}
        found = {name: torch.from_numpy(np.atleast_3d(parts[name][cut].astype(np.float32)) / scale[name])
                 for name in scale}
        interval = torch.tensor(float(data["interval"]))
        points = spoiled(data["points"] - np.array((x, y, 0, 0), np.float32), rng)
        near, far = float(data["near"]), float(data["far"])
        grid = rasterise_points(points, near, far, (int(crop[0]), int(crop[1])))
    found = {name: (value if len(value) == 3 else value.permute(2, 0, 1))[None] for name, value in found.items()}
    found["points"] = torch.from_numpy(grid)[None]
    for axis in (2, 3):
        if rng.random() < 0.5:
            found = {name: value.flip(axis) for name, value in found.items()}
    return {**found, "interval": interval, "ratio": torch.tensor([near / far])}


def spoiled(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Some of a map's sparse points (P,4), and some of those wrong: models are thinner and worse than rendered ones,
    and some users of the network have none."""
    if rng.random() < WITHOUT_POINTS:
        return points[:0]
    kept = points[rng.random(len(points)) < rng.uniform(FEWEST_POINTS, 1) ** 2]
    wrong = rng.random(len(kept)) < rng.choice(WRONG_POINTS)
    kept[wrong, 2] *= np.exp(rng.normal(0, 0.2, wrong.sum()))
    return kept


def step(state: State, crop: dict[str, Tensor], horizon: int, rate: float) -> dict[str, float]:
    """One optimiser step of the refinement; returns the figures for the log, those of the cascade among them."""
    for group in state.optimiser.param_groups:
        group["lr"] = rate * learning_rate(state.steps, horizon)
    interval = float(crop["interval"])
    with torch.autocast("cpu", torch.bfloat16, enabled=BF16):
        refinement = cast(Refinement, state.network.refinement)
        proposal = refinement(crop["image"], crop["t"], crop["shares"], interval, crop["points"])
    first = state.steps % 2, state.steps // 2 % 2
    refined = sampled_refined_depth(crop["t"], proposal, interval, first)
    t, truth, valid, whole = (crop[name][..., first[1] :: 2, first[0] :: 2]
                              for name in ("t", "truth", "valid", "whole"))
    valid, whole = valid > 0, whole > 0
    value = refinement_loss(refined, truth, valid, whole, interval, crop["ratio"])
    state.optimiser.zero_grad(set_to_none=True)
    value.backward()
    if torch.nn.utils.clip_grad_norm_(refinement.parameters(), GRADIENT_NORM).isfinite():
        state.optimiser.step()
    state.steps += 1
    update_ema(state)
    figures = {"loss": value.item()}
    for name, found in (("", refined.t), ("cascade_", t)):
        error = ((found - truth).abs() * INTERVALS)[valid]
        pixels = max(len(error), 1)
        figures[f"{name}epe"] = error.clamp_max(64).sum().item() / pixels
        figures[f"{name}e1"] = (error > 1).sum().item() / pixels * 100
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description="Train the refinement on a finished cascade; run it again to go on.")
    parser.add_argument("--scenes", type=Path, required=True, help="rendered scenes (training.generator)")
    parser.add_argument("--run", type=Path, required=True, help="folder of this run's maps, state and log")
    parser.add_argument("--weights", type=Path, default=SHIPPED, help="begin a new run with these (.safetensors)")
    parser.add_argument("--maps", type=int, default=1000, help="of the cascade, made before training begins")
    parser.add_argument("--minutes", type=float, default=9.0)
    parser.add_argument("--horizon", type=int, default=10000, help="steps at which the learning rate has come down")
    parser.add_argument("--rate", type=float, default=1.0, help="of learning, times training.train's")
    options = parser.parse_args()
    scenes = sorted(options.scenes.glob("*.npz"))
    if not scenes:
        parser.error(f"{options.scenes} holds no scenes")
    options.run.mkdir(parents=True, exist_ok=True)
    state = start(options.run, torch.device("cpu"), options.weights)
    if not state.network.config.refinement:
        parser.error(f"the network of {options.weights} has no refinement; train one with training.train")
    state.network.eval()
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    began = saved = time.monotonic()

    def stopped() -> bool:
        return stop.is_set() or time.monotonic() - began > options.minutes * 60

    fill(options.run / "maps", options.maps, scenes, start(options.run, torch.device("cpu"), options.weights).ema,
         stopped)
    maps = sorted((options.run / "maps").glob("*.npz"))
    rng = np.random.default_rng(state.steps)
    sums: list[dict[str, float]] = []
    with open(options.run / "log.jsonl", "a") as log:
        while not stopped():
            sums.append(step(state, crop_of(maps[int(rng.integers(len(maps)))], rng), options.horizon, options.rate))
            if len(sums) == 200:
                line = {"steps": state.steps, "seconds": round(time.monotonic() - began, 1),
                        **{name: round(float(np.mean([s[name] for s in sums])), 4) for name in sums[0]}}
                print(json.dumps(line), file=log, flush=True)
                print(json.dumps(line), flush=True)
                sums = []
            if time.monotonic() - saved > SAVE_EVERY:
                save(state, options.run)
                saved = time.monotonic()
    save(state, options.run)
    print(f"{len(maps)} maps, {state.steps} steps; state in {options.run / 'state.pt'}")


if __name__ == "__main__":
    use_large_pages()
    main()
