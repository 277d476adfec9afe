# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Train LCM-MVSNet on scenes rendered as it goes; stop and resume at any moment.

    python -m training.train --assets DIR --run DIR [--minutes 9] [--horizon 20000] [--device auto]

A run folder holds state.pt (weights, EMA, optimiser, counters), log.jsonl (curves) and scenes/ (a pool of rendered
scenes that renderer processes keep fresh). The same command goes on from where the last one stopped.

On a CPU, `--processes 2` uses two cores better than two threads do: each process takes its own samples, and all step
together with the mean of their gradients.
"""

from __future__ import annotations

import argparse
import json
import math
import queue
import signal
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
import torch.distributed as dist
from torch import Tensor

from curecon_blender.core.base.allocator import use_large_pages
from curecon_blender.core.depth.estimate import choose_precision
from curecon_blender.core.network.config import NetworkConfig
from curecon_blender.core.network.model import LCMMVSNet, t_from_depth
from curecon_blender.core.network.refinement import plain_refined_depth, rasterise_points
from curecon_blender.core.network.weights import describe, load_network
from training.dataset import Sample, training_sample
from training.generator import load
from training.losses import INTERVALS, refinement_loss, total_loss
from training.pool import ScenePool

LEARNING_RATE = 1e-3
WARM_UP = 200  # samples
EMA_DECAY = 0.998
GRADIENT_NORM = 5.0
SAVE_EVERY = 120.0  # seconds


@dataclass
class State:
    """Everything a run goes on from."""

    network: LCMMVSNet
    ema: LCMMVSNet
    optimiser: torch.optim.Optimizer
    samples: int = 0  # since the schedule began
    steps: int = 0
    earlier: int = 0  # samples seen before the schedule began anew (--restart)


def bf16_gains(device: torch.device) -> bool:
    """Whether a device is made for bf16; others emulate it, many times slower than fp32."""
    return choose_precision("auto", device) == torch.bfloat16


def batch_tensors(samples: list[Sample], device: torch.device) -> dict[str, Tensor]:
    """Samples of one size as the network's arguments (and the true depth), on the device."""
    def stack(name: str) -> Tensor:
        return torch.from_numpy(np.stack([getattr(s, name) for s in samples])).to(device)

    return {
        "images": stack("images").permute(0, 1, 4, 2, 3).float() / 255,
        "K": stack("K"), "cam_from_world": stack("cam_from_world"), "scores": stack("scores"),
        "near": torch.tensor([s.near for s in samples], dtype=torch.float32, device=device),
        "far": torch.tensor([s.far for s in samples], dtype=torch.float32, device=device),
        "depth": stack("depth").unsqueeze(1),
        "points": torch.from_numpy(np.stack([
            rasterise_points(s.points, s.near, s.far, (s.depth.shape[1], s.depth.shape[0])) for s in samples
        ])).to(device),
    }


def start(
    run: Path, device: torch.device, weights: Path | None = None, config: NetworkConfig | None = None
) -> State:
    """The run's state from state.pt, or a new one: from a weights file, or from nothing, with a config."""
    torch.manual_seed(0)
    saved = None
    if (run / "state.pt").exists():
        saved = torch.load(run / "state.pt", map_location=device, weights_only=True)
        config = NetworkConfig(**saved["config"])
    elif weights is not None:
        config = load_network(weights).config
    network, ema = LCMMVSNet(config).to(device), LCMMVSNet(config).to(device)
    ema.load_state_dict(network.state_dict())
    network, ema = network.channels_last(), ema.channels_last()
    state = State(network, ema, torch.optim.Adam(network.parameters(), lr=LEARNING_RATE))
    if saved is not None:
        network.load_state_dict(saved["network"])
        ema.load_state_dict(saved["ema"])
        state.optimiser.load_state_dict(saved["optimiser"])
        state.samples, state.steps, state.earlier = saved["samples"], saved["steps"], saved["earlier"]
    elif weights is not None:
        network.load_state_dict(load_network(weights).state_dict())
        ema.load_state_dict(network.state_dict())
        state.earlier = describe(weights)["samples"]
    return state


def restart(state: State) -> None:
    """Begin the schedule anew from the averaged weights, with a fresh optimiser."""
    state.network.load_state_dict(state.ema.state_dict())
    state.optimiser = torch.optim.Adam(state.network.parameters(), lr=LEARNING_RATE)
    state.earlier, state.samples = state.earlier + state.samples, 0


def save(state: State, run: Path) -> None:
    partial = run / "state.pt.partial"
    torch.save(
        {"network": state.network.state_dict(), "ema": state.ema.state_dict(),
         "optimiser": state.optimiser.state_dict(), "samples": state.samples, "steps": state.steps,
         "earlier": state.earlier, "config": asdict(state.network.config)}, partial,
    )
    partial.replace(run / "state.pt")


def learning_rate(samples: int, horizon: int) -> float:
    """Linear warm-up, then a cosine down to 2 % at the horizon."""
    warm = min(1.0, (samples + 1) / WARM_UP)
    along = min(1.0, samples / horizon)
    return LEARNING_RATE * warm * (0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * along)))


@torch.no_grad()
def update_ema(state: State) -> None:
    # Early on the average must not remember the random start.
    decay = min(EMA_DECAY, (1 + state.steps) / (10 + state.steps))
    for mean, value in zip(state.ema.state_dict().values(), state.network.state_dict().values(), strict=True):
        if mean.dtype.is_floating_point:
            mean.lerp_(value, 1 - decay)
        else:
            mean.copy_(value)


def feed(pool: ScenePool, out: queue.Queue[list[Sample]], stop: threading.Event, options: argparse.Namespace,
         seed: int) -> None:
    """Fill the queue with batches; each scene that is read gives several samples."""
    rng = np.random.default_rng(seed)
    # The same in all processes that train together, or one would wait for another's larger sample.
    common = np.random.default_rng(seed // options.processes)
    size = (options.width, options.height)
    batch: list[Sample] = []
    sources = options.sources
    while not stop.is_set():
        scene = load(pool.pick(rng))
        for _ in range(options.samples_per_scene):
            sample = training_sample(scene, rng, sources, size)
            if sample is None:
                continue
            batch.append(sample)
            if len(batch) == options.batch:
                while not stop.is_set():
                    try:
                        out.put(batch, timeout=1.0)
                        break
                    except queue.Full:
                        continue
                batch = []
                sources = int(common.integers(options.fewest_sources, options.sources + 1))


def average_gradients(network: LCMMVSNet) -> None:
    """Replace every gradient by its mean over the processes that train together."""
    gradients = [p.grad for p in network.parameters() if p.grad is not None]
    together = torch.cat([g.flatten() for g in gradients])
    dist.all_reduce(together)
    together /= dist.get_world_size()
    for gradient, mean in zip(gradients, together.split([g.numel() for g in gradients]), strict=True):
        gradient.copy_(mean.view_as(gradient))


def step(
    state: State, batch: dict[str, Tensor], horizon: int, bf16: bool, loss: Callable[..., Tensor] = total_loss,
    fixed_statistics: bool = False,
) -> dict[str, float]:
    """One optimiser step, with the other processes if there are any; returns the figures for the log.

    `fixed_statistics`: batch normalisation keeps its running statistics, as it will in use.
    """
    for group in state.optimiser.param_groups:
        group["lr"] = learning_rate(state.samples, horizon)
    state.network.train(not fixed_statistics)
    depth, near, far = batch["depth"], batch["near"], batch["far"]
    t = t_from_depth(depth.clamp_min(1e-3), near, far)
    valid = (depth > 0) & (t >= 0) & (t < 1)
    with torch.autocast(depth.device.type, torch.bfloat16, enabled=bf16):
        outputs = state.network(*(batch[k] for k in ("images", "K", "cam_from_world", "near", "far", "scores")))
        proposal = (state.network.refine(batch["images"][:, 0], outputs, batch["points"])
                    if state.network.config.refinement else None)
    value = loss(outputs, t, valid, state.network.config.representation)
    estimate = outputs[-1].t
    if proposal is not None:
        refined = plain_refined_depth(estimate.detach(), proposal, outputs[-1].interval)
        everywhere, ratio = torch.ones_like(valid), batch["near"] / batch["far"]
        value = value + refinement_loss(refined, t, valid, everywhere, outputs[-1].interval, ratio)
        estimate = refined.t
    state.optimiser.zero_grad(set_to_none=True)
    value.backward()
    if dist.is_initialized():
        average_gradients(state.network)
    # The refinement apart: while it is new, its gradients would take the cascade's share.
    parts = [[p for n, p in state.network.named_parameters() if n.startswith("refinement.") == late]
             for late in (False, True)]
    norms = [torch.nn.utils.clip_grad_norm_(part, GRADIENT_NORM) for part in parts if part]
    if all(norm.isfinite() for norm in norms):  # a bad sample costs its step, not the run
        state.optimiser.step()
    state.steps += 1
    state.samples += len(depth) * (dist.get_world_size() if dist.is_initialized() else 1)
    update_ema(state)
    error = ((estimate - t).abs() * INTERVALS)[valid]
    pixels = max(len(error), 1)
    return {"loss": value.item(), "epe": error.clamp_max(64).sum().item() / pixels,
            "e1": (error > 1).sum().item() / pixels * 100, "e3": (error > 3).sum().item() / pixels * 100}


def stop_together(stop: bool) -> bool:
    """Whether any of the processes that train together wants to stop: all leave at the same step."""
    if dist.is_initialized():
        wish = torch.tensor(float(stop))
        dist.all_reduce(wish)
        return bool(wish > 0)
    return stop


def train(rank: int, options: argparse.Namespace, rendezvous: str) -> None:
    """The loop of one process; the first also keeps the pool of scenes, the log and the state."""
    device = torch.device("cuda" if options.device == "auto" and torch.cuda.is_available() else
                          "cpu" if options.device == "auto" else options.device)
    if options.processes > 1:
        torch.set_num_threads(1)
        dist.init_process_group("gloo", init_method=rendezvous, rank=rank, world_size=options.processes)
    state = start(options.run, device, options.weights, NetworkConfig(**options.config))
    if options.restart:
        restart(state)
    bf16 = bf16_gains(device)
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    began = saved = time.monotonic()
    batches: queue.Queue[list[Sample]] = queue.Queue(8)
    sums: dict[str, float] = {}
    count = 0
    renderers = options.renderers if rank == 0 else 0
    with ScenePool(options.run / "scenes", options.assets, options.pool, renderers) as pool, \
            open(options.run / "log.jsonl", "a") as log:
        seed = state.steps * options.processes + rank
        feeder = threading.Thread(target=feed, args=(pool, batches, stop, options, seed), daemon=True)
        feeder.start()
        while not stop_together(stop.is_set() or time.monotonic() - began > options.minutes * 60):
            samples = None
            while samples is None:
                try:
                    samples = batches.get(timeout=5.0)
                except queue.Empty:
                    if not feeder.is_alive():
                        raise RuntimeError("the thread that reads scenes has ended; its error is above") from None
            batch = batch_tensors(samples, device)
            for name, value in step(state, batch, options.horizon, bf16,
                                    fixed_statistics=options.fixed_statistics).items():
                sums[name] = sums.get(name, 0.0) + value
            count += 1
            if rank == 0 and count == 50:
                line = {"samples": state.samples, **{k: round(v / count, 4) for k, v in sums.items()},
                        "alpha": [round(a, 3) for a in state.network.alpha.tolist()],
                        "seconds": round(time.monotonic() - began, 1)}
                print(json.dumps(line), file=log, flush=True)
                print(json.dumps(line), flush=True)
                sums, count = {}, 0
            if rank == 0 and time.monotonic() - saved > SAVE_EVERY:
                save(state, options.run)
                saved = time.monotonic()
        stop.set()
        feeder.join()  # a thread that still works when its process ends can abort it
        if rank == 0:
            save(state, options.run)
            print(f"{state.earlier + state.samples} samples seen; state in {options.run / 'state.pt'}")
    if dist.is_initialized():
        dist.destroy_process_group()


def main() -> None:
    parser = argparse.ArgumentParser(description="Train LCM-MVSNet; run it again to go on.")
    parser.add_argument("--assets", type=Path, required=True, help="folder of models, textures and skies")
    parser.add_argument("--run", type=Path, required=True, help="folder of this run's state, log and scene pool")
    parser.add_argument("--minutes", type=float, default=9.0)
    parser.add_argument("--horizon", type=int, default=20000, help="samples at which the learning rate has come down")
    parser.add_argument("--batch", type=int, default=1)
    parser.add_argument("--fewest-sources", type=int, default=2)
    parser.add_argument("--sources", type=int, default=5, help="of a batch, at most; drawn anew for each")
    parser.add_argument("--width", type=int, default=256)
    parser.add_argument("--height", type=int, default=192)
    parser.add_argument("--samples-per-scene", type=int, default=3)
    parser.add_argument("--pool", type=int, default=400, help="scenes kept on disk")
    parser.add_argument("--renderers", type=int, default=1, help="processes that render new scenes")
    parser.add_argument("--weights", type=Path, help="begin a new run with these weights (.safetensors)")
    parser.add_argument("--config", type=json.loads, default={}, metavar="JSON",
                        help="fields of NetworkConfig for a new run, to compare with")
    parser.add_argument("--restart", action="store_true", help="begin the schedule anew from the averaged weights")
    parser.add_argument("--fixed-statistics", action="store_true",
                        help="keep batch normalisation's statistics: for going on from good weights")
    parser.add_argument("--processes", type=int, default=1, help="how many train together, on a CPU's cores")
    parser.add_argument("--device", default="auto")
    options = parser.parse_args()
    options.run.mkdir(parents=True, exist_ok=True)
    if options.processes == 1:
        train(0, options, "")
        return
    with tempfile.TemporaryDirectory() as folder:
        rendezvous = (Path(folder) / "rendezvous").as_uri()
        together = torch.multiprocessing.spawn(train, (options, rendezvous), nprocs=options.processes, join=False)
        for number in (signal.SIGINT, signal.SIGTERM):  # the processes save and leave; this one waits for them
            signal.signal(number, lambda *_: [process.terminate() for process in together.processes])
        while not together.join():
            pass


if __name__ == "__main__":
    use_large_pages()
    main()
