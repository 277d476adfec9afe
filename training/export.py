# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Turn a training run's averaged weights into the file that ships, without refinement with calibrated confidence.

    python -m training.export --run DIR --scenes DIR [--mean-with WEIGHTS]
        [--out curecon_blender/weights/lcm_mvsnet.safetensors]

The scenes (`python -m training.generator --held-out`) must be none that training saw: it prints the errors there. For
a network without refinement, a logistic regression learns on them how the levels' confidences tell whether a depth is
within one interval; in the sky, none is.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from curecon_blender.core.network.model import LCMMVSNet, level_confidences, t_from_depth
from curecon_blender.core.network.weights import SHIPPED, load_network, save_network
from training.dataset import training_sample
from training.generator import load
from training.losses import INTERVALS
from training.train import batch_tensors, bf16_gains, start

SIZE = (384, 288)  # of the calibration's crops
PIXELS = 4000  # a sample


@torch.no_grad()
def observe(network: LCMMVSNet, scenes: list[Path], samples: int, sources: int) -> tuple[Tensor, Tensor]:
    """Logits of the confidences (P,3) by level 0, 1, 2, and the estimate's error in intervals (P,), infinite where
    there is no surface within the sweep, of random pixels of the scenes."""
    rng = np.random.default_rng(0)
    features: list[Tensor] = []
    errors: list[Tensor] = []
    while len(features) < samples:
        sample = training_sample(load(scenes[int(rng.integers(len(scenes)))]), rng, sources, SIZE)
        if sample is None:
            continue
        batch = batch_tensors([sample], torch.device("cpu"))
        with torch.autocast("cpu", torch.bfloat16, enabled=bf16_gains(torch.device("cpu"))):
            outputs = network(*(batch[k] for k in ("images", "K", "cam_from_world", "near", "far", "scores")))
            estimate, _ = network.estimate(batch["images"][:, 0], outputs, batch["points"])
        t = t_from_depth(batch["depth"].clamp_min(1e-3), batch["near"], batch["far"])
        surface = (batch["depth"] > 0) & (t >= 0) & (t < 1)
        chosen = torch.from_numpy(rng.integers(surface.numel(), size=PIXELS))
        features.append(torch.logit(level_confidences(outputs), eps=1e-4)[0].flatten(1).T[chosen])
        error = torch.where(surface, (estimate - t).abs() * INTERVALS, torch.inf)
        errors.append(error.flatten()[chosen])
    return torch.cat(features), torch.cat(errors)


def fit(features: Tensor, correct: Tensor) -> tuple[float, float, float, float]:
    """Weights of a logistic regression of (P,3) on (P,), its constant last."""
    parameters = torch.tensor([1.0, 1.0, 1.0, 0.0], requires_grad=True)
    optimiser = torch.optim.LBFGS([parameters], max_iter=100, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        optimiser.zero_grad()
        value = F.binary_cross_entropy_with_logits(features @ parameters[:3] + parameters[3], correct)
        value.backward()
        return value

    optimiser.step(loss)
    a, b, c, d = (round(p, 4) for p in parameters.tolist())
    return a, b, c, d


def main() -> None:
    parser = argparse.ArgumentParser(description="Export a run's EMA weights as safetensors with their record.")
    parser.add_argument("--run", type=Path, required=True)
    parser.add_argument("--scenes", type=Path, required=True, help="held-out scenes for the calibration")
    parser.add_argument("--samples", type=int, default=40, help="crops of the scenes to look at")
    parser.add_argument("--sources", type=int, default=4)
    parser.add_argument("--mean-with", type=Path, metavar="WEIGHTS",
                        help="ship the mean of the run's weights and these: what a short run began with, mostly")
    parser.add_argument("--out", type=Path, default=SHIPPED)
    options = parser.parse_args()
    if not (options.run / "state.pt").exists():
        parser.error(f"{options.run} holds no state.pt")
    scenes = sorted(options.scenes.glob("*.npz"))
    if not scenes:
        parser.error(f"{options.scenes} holds no scenes")
    state = start(options.run, torch.device("cpu"))
    network = state.ema.eval()
    if options.mean_with is not None:
        with torch.no_grad():
            for ours, theirs in zip(network.parameters(), load_network(options.mean_with).parameters(), strict=True):
                ours.lerp_(theirs, 0.5)
    features, errors = observe(network, scenes, options.samples, options.sources)
    if not network.config.refinement:  # which learns how sure it is
        network.config = replace(network.config, calibration=fit(features, (errors < 1).float()))
    errors = errors[errors.isfinite()]
    measured = {"epe": errors.mean().item(), "e1": (errors > 1).float().mean().item() * 100,
                "e3": (errors > 3).float().mean().item() * 100}
    measured = {name: round(value, 3) for name, value in measured.items()}
    facts = {"samples": state.earlier + state.samples, "steps": state.steps,
             "held_out": {**measured, "crops": options.samples, "size": list(SIZE), "sources": options.sources}}
    save_network(network, options.out, facts)
    print(f"{options.out}: {state.earlier + state.samples} samples seen; on held-out scenes {measured}")


if __name__ == "__main__":
    main()
