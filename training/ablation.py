# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Train small rivals of the network side by side: the same samples in the same order, one thing changed.

    python -m training.ablation --scenes TRAINING --held-out SCENES --out ablation.jsonl [--only NAME ...]

Every rival starts from nothing, sees the same `--samples` crops of 192x128 with three sources, and is then measured on
the same held-out crops, over the pixels that at least two sources see, all of them without refinement. Rivals whose
line is in the file are left alone.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from curecon_blender.core.base.allocator import use_large_pages
from curecon_blender.core.network import model as network_module
from curecon_blender.core.network.config import PAPER, NetworkConfig
from curecon_blender.core.network.cost_volume_cpu import CostVolumeInput
from curecon_blender.core.network.model import LCMMVSNet, LevelOutput
from training import train
from training.dataset import Sample, training_sample
from training.generator import load
from training.losses import LEVEL_WEIGHT, at_level, total_loss

SIZE, HELD_OUT_SIZE = (192, 128), (256, 192)
SOURCES = 3
CPU = torch.device("cpu")


@dataclass(frozen=True, kw_only=True)
class Rival:
    """One change: of the config, of functions of the network's module, of the loss, or of the samples' scores."""

    config: dict[str, Any] = field(default_factory=dict)
    functions: dict[str, Callable[..., Any]] = field(default_factory=dict)
    loss: Callable[..., Tensor] = total_loss
    equal_scores: bool = False


def variance(self: LCMMVSNet, level: int, inputs: CostVolumeInput, out: Tensor | None = None) -> Tensor:
    """MVSNet's cost in place of Eq. 2: the variance over the views, in the mean of a group's channels."""
    b, c = inputs.reference.shape[:2]
    k = self.config.groups[level]
    first = inputs.reference.unsqueeze(2).expand(-1, -1, inputs.inverse_depth.shape[1], -1, -1)
    total, squares = first, first.square()
    for i, (source, (rotated, shifted)) in enumerate(zip(inputs.sources, inputs.terms, strict=True)):
        warped, _ = network_module.warp(inputs.compared(source), rotated, shifted, inputs.inverse_depth,
                                      inputs.extents[:, i])
        total, squares = total + warped, squares + warped.square()
    count = len(inputs.sources) + 1
    spread = squares / count - (total / count).square()
    cost = spread.reshape(b, k, c // k, *spread.shape[2:]).mean(2)
    return cost if out is None else out.copy_(cost)


def uniform_depth(t: Tensor, near: Tensor, far: Tensor) -> Tensor:
    """depth_from_t with t uniform in depth (Eq. 1)."""
    near, far = near.view(-1, 1, 1, 1), far.view(-1, 1, 1, 1)
    return near + t * (far - near)


def uniform_t(depth: Tensor, near: Tensor, far: Tensor) -> Tensor:
    """Inverse of uniform_depth."""
    near, far = near.view(-1, 1, 1, 1), far.view(-1, 1, 1, 1)
    return (depth - near) / (far - near)


def expectation(logits: Tensor, first: Tensor, interval: float) -> tuple[Tensor, Tensor]:
    """Soft argmax over all hypotheses, as the L1 loss needs it."""
    probability = torch.softmax(logits, 1)
    places = torch.arange(logits.shape[1], dtype=logits.dtype).view(1, -1, 1, 1) + 0.5
    return first + interval * (probability * places).sum(1, keepdim=True), probability.max(1, keepdim=True).values


def l1_loss(outputs: list[LevelOutput], t: Tensor, valid: Tensor, representation: str) -> Tensor:
    """CasMVSNet's: smooth L1 of the depth, here in intervals of each level."""
    loss = t.new_zeros(())
    for level, output in zip((2, 1, 0), outputs, strict=True):
        error = F.smooth_l1_loss(output.t / output.interval, at_level(t, level) / output.interval, reduction="none")
        counted = at_level(valid, level)
        loss = loss + LEVEL_WEIGHT[level] * (error.clamp_max(64) * counted).sum() / counted.sum().clamp_min(1)
    return loss


RIVALS = {
    "shipped": Rival(),
    "equal weights for all sources": Rival(config={"visibility": False}, equal_scores=True),
    "matching scores alone (Eq. 2)": Rival(config={"visibility": False}),
    "variance": Rival(config={"visibility": False}, functions={"LCMMVSNet.cost_volume": variance}),
    "no bottom-up path": Rival(config={"bottom_up": False}),
    "no context": Rival(config={"context": 0}),
    "no unit features": Rival(config={"cosine": False}),
    "unified, focal loss (Eq. 3)": Rival(config={"representation": "unified"}),
    "L1": Rival(functions={"decode_linear": expectation}, loss=l1_loss),
    "uniform in depth (Eq. 1)": Rival(functions={"depth_from_t": uniform_depth, "t_from_depth": uniform_t}),
    "4 groups": Rival(config={"groups": (4, 4, 4)}),
    "as many groups as channels": Rival(config={"groups": (8, 16, 32)}),
    "hypotheses two pixels apart": Rival(config={"hypothesis_step": 2.0}),
    "finer levels 4 and 8 hypotheses": Rival(config={"hypotheses": (8, 8, 48)}),
    "finer levels 16 and 32 hypotheses": Rival(config={"hypotheses": (16, 32, 48)}),
    "the paper's": Rival(config={k: v for k, v in vars(PAPER).items() if v != vars(NetworkConfig())[k]}),
}


def samples_of(scenes: list[Path], seed: int, size: tuple[int, int]) -> Iterator[Sample]:
    """An endless, repeatable row of samples."""
    rng = np.random.default_rng(seed)
    while True:
        scene = load(scenes[int(rng.integers(len(scenes)))])
        for _ in range(3):
            sample = training_sample(scene, rng, SOURCES, size)
            if sample is not None:
                yield sample


def seen_by_two(sample: Sample) -> np.ndarray:
    """(H,W) bool: pixels with depth whose surface lies inside at least two of the sources' pictures."""
    height, width = sample.depth.shape
    rows, columns = np.mgrid[:height, :width] + 0.5
    rays = np.linalg.inv(sample.K[0].astype(np.float64)) @ np.stack([columns, rows, np.ones_like(rows)]).reshape(3, -1)
    pose = sample.cam_from_world[0].astype(np.float64)
    world = pose[:, :3].T @ (rays * sample.depth.reshape(-1) - pose[:, 3:])
    count = np.zeros(height * width, int)
    for K, other in zip(sample.K[1:], sample.cam_from_world[1:], strict=True):
        u, v, z = K @ (other[:, :3] @ world + other[:, 3:])
        z = np.where(z > 1e-3, z, np.inf)
        count += (u > 0) & (u < width * z) & (v > 0) & (v < height * z) & np.isfinite(z)
    return (count.reshape(height, width) >= 2) & (sample.depth > 0)


@contextmanager
def changed(rival: Rival) -> Iterator[None]:
    """The network's module with the rival's functions in place."""
    with ExitStack() as stack:
        for name, function in rival.functions.items():
            if name == "t_from_depth":
                stack.enter_context(patch.object(train, name, function))
            elif "." in name:
                stack.enter_context(patch.object(LCMMVSNet, name.split(".")[1], function))
            else:
                stack.enter_context(patch.object(network_module, name, function))
        yield


def tensors(sample: Sample, rival: Rival) -> dict[str, Tensor]:
    batch = train.batch_tensors([sample], CPU)
    if rival.equal_scores:
        batch["scores"] = torch.ones_like(batch["scores"])
    return batch


def run(rival: Rival, scenes: list[Path], held_out: list[Path], samples: int, crops: int) -> dict[str, float]:
    """Train one rival and measure it; errors in 1/128 of the sweep's inverse depth, whatever the rival sweeps in."""
    torch.manual_seed(0)
    network = LCMMVSNet(NetworkConfig(**{"refinement": 0, **rival.config})).channels_last()
    state = train.State(network, network, torch.optim.Adam(network.parameters(), lr=train.LEARNING_RATE))
    began = time.process_time()
    with changed(rival):
        for sample, _ in zip(samples_of(scenes, 1, SIZE), range(samples), strict=False):
            train.step(state, tensors(sample, rival), samples, bf16=train.bf16_gains(CPU), loss=rival.loss)
        seconds = time.process_time() - began
        errors = []
        network.eval()
        for sample, _ in zip(samples_of(held_out, 2, HELD_OUT_SIZE), range(crops), strict=False):
            batch = tensors(sample, rival)
            with torch.no_grad(), torch.autocast("cpu", torch.bfloat16, enabled=train.bf16_gains(CPU)):
                outputs = network(*(batch[k] for k in ("images", "K", "cam_from_world", "near", "far", "scores")))
            depth = network_module.depth_from_t(outputs[-1].t, batch["near"], batch["far"])[0, 0].numpy()
            seen = seen_by_two(sample) & (sample.depth > sample.near) & (sample.depth < sample.far)
            span = 1 / sample.near - 1 / sample.far
            errors.append(np.abs(1 / np.maximum(depth, 1e-3) - 1 / np.maximum(sample.depth, 1e-3))[seen] / span * 128)
    together = np.concatenate(errors)
    return {"epe": float(together.mean()), "e1": float((together > 1).mean() * 100),
            "e3": float((together > 3).mean() * 100), "seconds_a_step": seconds / samples}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=Path, required=True)
    parser.add_argument("--held-out", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--samples", type=int, default=500)
    parser.add_argument("--crops", type=int, default=24)
    parser.add_argument("--only", nargs="+", choices=RIVALS, default=list(RIVALS))
    options = parser.parse_args()
    done = {json.loads(line)["rival"] for line in options.out.read_text().splitlines()} if options.out.exists() else ()
    scenes, held_out = (sorted(folder.glob("*.npz")) for folder in (options.scenes, options.held_out))
    for name in options.only:
        if name not in done:
            result = run(RIVALS[name], scenes, held_out, options.samples, options.crops)
            figures = {k: round(v, 3) for k, v in result.items()}
            line = json.dumps({"rival": name, "samples": options.samples, **figures})
            print(line, flush=True)
            with options.out.open("a") as out:
                print(line, file=out)


if __name__ == "__main__":
    use_large_pages()
    main()
