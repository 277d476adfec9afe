# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth on rendered scenes that training never saw: the network beside a plane sweep and a PatchMatch.

    python -m training.generator --assets DIR --out SCENES --count 20 --start-seed 900000 --size 768x576 --held-out
    python -m evaluation.validation SCENES [--methods network plane-sweep patchmatch] [--references 2] [--json]

Every method gets the same references, the same four sources by Algorithm 1, and the same depth range: from the sparse
points, as in use, or with `--range true` the true one, as BlendedMVS hands it to a network. The network is told of the
sparse points that lie in the picture, as in use, or with `--without-points` of none. The depth interval is
that of BlendedMVS, 1/128 of the reference's true range (1st to 99th percentile). PatchMatch is that of the package
pyarchinit-photogrammetry-core; it fills only where it is sure enough, so its errors are over fewer pixels: read them
with its coverage. A second table counts only the pixels that at least two of the sources really see: the others can be
guessed but not measured. A third says where the error lies (error_classes.py).
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np

from curecon_blender.core.base.allocator import use_large_pages
from curecon_blender.core.base.options import Options
from curecon_blender.core.base.records import View
from curecon_blender.core.depth.estimate import DepthEstimator
from curecon_blender.core.network.weights import load_network
from curecon_blender.core.views import sparse_points
from training.dataset import source_scores, sparse_depth_range
from training.generator import Scene, back_project, load, project

from . import depth_metrics, error_classes
from .baselines import METHODS, Estimate, Method
from .depth_metrics import DepthErrors
from .error_classes import Shares

SURE = 0.9
OBSERVERS = 2
OCCLUSION = 0.01  # relative depth by which a source may see something nearer and still see the pixel


@dataclass(frozen=True, kw_only=True)
class Result:
    """One method over all references. `observed`: over the pixels that at least OBSERVERS sources see. `sure`: percent
    of the pixels with confidence above SURE, and of those within one interval. `shares`: where the error lies.
    `seconds`: CPU time a reference."""

    errors: DepthErrors
    observed: DepthErrors
    sure: float
    sure_within_one: float
    shares: Shares
    seconds: float


def views_of(
    scene: Scene, folder: Path, references: int, sources: int, sweep: str = "sparse",
    points: bool = True,
) -> list[tuple[View, int, list[View]]]:
    """References of a scene (evenly taken, with their number) and the sources of each; pictures go to the folder.
    `sweep`: the depth range is from the "sparse" points or the "true" one. `points`: the views are told of the sparse
    points that lie in them."""
    height, width = scene.depth.shape[1:]
    for i, picture in enumerate(scene.images):
        cv2.imwrite(str(folder / f"{i}.png"), picture[..., ::-1])
    chosen = []
    for reference in range(len(scene.images)):
        scored = source_scores(scene, reference)[:sources]
        if len(scored) == sources:
            near, far = sparse_depth_range(scene, reference)
            if sweep == "true":
                true_range = depth_metrics.true_range(scene.depth[reference])
                near, far = true_range.near, true_range.far
            chosen.append((reference, near, far, scored))
    step = max(1, len(chosen) // references)

    def view(i: int, near: float, far: float, scored: list[tuple[int, float]], points: int = 0) -> View:
        return View(name=str(i), image=f"{i}.png", width=width, height=height, K=scene.K[i],
                    cam_from_world=scene.cam_from_world[i], near=near, far=far,
                    sources=tuple((str(n), s) for n, s in scored), points=points)

    def told(i: int) -> int:
        """Write what the view i is told of the sparse points, and how many those are."""
        found = sparse_points.points_in(scene.points, scene.visible[i], scene.K[i], scene.cam_from_world[i],
                                        (width, height))
        sparse_points.write(folder, str(i), found)
        return len(found)

    return [
        (view(reference, near, far, scored, told(reference) if points else 0), reference,
         [view(n, near, far, []) for n, _ in scored])
        for reference, near, far, scored in chosen[step // 2 :: step][:references]
    ]


def observers(scene: Scene, reference: int, sources: list[int]) -> np.ndarray:
    """(H,W) int: how many of the sources see the surface that each pixel of the reference shows."""
    height, width = scene.depth.shape[1:]
    truth = scene.depth[reference].reshape(-1)
    rows, columns = np.mgrid[:height, :width] + 0.5
    world = back_project(scene.K[reference], scene.cam_from_world[reference],
                         np.column_stack([columns.ravel(), rows.ravel()]), truth)
    count = np.zeros(height * width, int)
    for source in sources:
        pixels, depth = project(scene.K[source], scene.cam_from_world[source], world)
        inside = (depth > 0) & (pixels > 0).all(1) & (pixels[:, 0] < width) & (pixels[:, 1] < height)
        column, row = np.where(inside[:, None], pixels, 0).astype(int).T
        count += inside & (np.abs(scene.depth[source][row, column] - depth) < OCCLUSION * depth)
    return np.where(truth > 0, count, 0).reshape(height, width)


def network_method(weights: Path | None, precision: str = "auto") -> Method:
    """LCM-MVSNet as in use, with one set of weights (None: those that ship); `precision` as in Options."""
    network = load_network(weights)

    def estimate(view: View, sources: list[View], folder: Path) -> Estimate:
        estimator = DepthEstimator(network, folder, Options(photos=folder, workspace=folder, precision=precision))
        return estimator.estimate(view, list(zip(sources, [s for _, s in view.sources], strict=True)))

    return estimate


def measure(
    method: Method, scenes: list[Path], references: int, sources: int, sweep: str, points: bool = True
) -> Result:
    """Mean errors of a method over the references of all scenes."""
    errors, observed, shares, seconds = [], [], [], []
    sure = within = pixels = 0
    for path in scenes:
        scene = load(path)
        with tempfile.TemporaryDirectory() as folder:
            for view, reference, others in views_of(scene, Path(folder), references, sources, sweep,
                                                     points):
                began = time.process_time()
                depth, confidence = method(view, others, Path(folder))
                seconds.append(time.process_time() - began)
                truth = scene.depth[reference]
                true_range = depth_metrics.true_range(truth)
                errors.append(depth_metrics.depth_errors(depth, truth, true_range))
                seen = observers(scene, reference, [int(v.name) for v in others])
                observed.append(depth_metrics.depth_errors(depth, np.where(seen >= OBSERVERS, truth, 0), true_range))
                of = error_classes.classes(truth, seen, view.near, view.far)
                shares.append(error_classes.shares(depth, confidence, truth, true_range, of))
                counted = (truth >= true_range.near) & (truth <= true_range.far)
                confident = counted & (confidence > SURE)
                sure, pixels = sure + int(confident.sum()), pixels + int(counted.sum())
                within += int((np.abs(depth - truth)[confident] < true_range.interval).sum())
    return Result(errors=depth_metrics.mean_errors(errors), observed=depth_metrics.mean_errors(observed),
                  sure=100 * sure / max(pixels, 1),
                  sure_within_one=100 * within / max(sure, 1), shares=error_classes.mean_shares(shares),
                  seconds=float(np.mean(seconds)))


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m evaluation.validation", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path)
    parser.add_argument("--methods", nargs="+", choices=("network", *METHODS),
                        default=["network", "plane-sweep"])
    parser.add_argument("--weights", type=Path, help="of the network (default: those that ship)")
    parser.add_argument("--references", type=int, default=2, help="a scene")
    parser.add_argument("--sources", type=int, default=4)
    parser.add_argument("--range", choices=("sparse", "true"), default="sparse", help="that is swept")
    parser.add_argument("--without-points", action="store_true", help="the network is told of no sparse points")
    parser.add_argument("--precision", choices=("auto", "fp32", "bf16"), default="auto", help="of the network")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(arguments)
    scenes = sorted(args.scenes.glob("*.npz"))
    if not scenes:
        print(f"{args.scenes} holds no scenes; make some with training.generator.", file=sys.stderr)
        return 2
    results = {name: measure(METHODS.get(name) or network_method(args.weights, args.precision), scenes, args.references,
                             args.sources, args.range, not args.without_points) for name in args.methods}
    if args.json:
        print(json.dumps({name: asdict(result) for name, result in results.items()}, default=np.ndarray.tolist))
        return 0
    print("All pixels")
    print(depth_metrics.table({name: r.errors for name, r in results.items()}))
    print(f"Pixels that at least {OBSERVERS} sources see")
    print(depth_metrics.table({name: r.observed for name, r in results.items()}))
    for name, r in results.items():
        print(f"{name:24}{r.sure:5.1f} % with confidence above {SURE}, {r.sure_within_one:5.1f} % of them within one "
              f"interval; {r.seconds:.1f} CPU s a reference")
        print(error_classes.table(r.shares))
    return 0


if __name__ == "__main__":
    use_large_pages()
    sys.exit(main())
