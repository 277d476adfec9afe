# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""CPU seconds and peak memory of one photo's depth map, by size and step: what depth/tiles.py's memory model rests on.

    python -m benchmarks.depth [--sizes 800x600 1600x1200 3200x2400] [--sources 4] [--device cpu] [--precision auto]

Each size runs in a process of its own, after a small depth map that has all code compiled. Random photos serve: neither
time nor memory depends on what is seen. A photo's features are computed once and serve it as reference and as source
where the whole photo fits the memory budget, so a photo costs its features once and three levels; `all` is the time
with the features of all its sources, as for a job's first photo.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from curecon_blender.core.base.allocator import use_large_pages


def measure(width: int, height: int, sources: int, device: str, precision: str, memory_gib: float | None) -> None:
    """Print one row: CPU seconds by step, wall seconds, and peak memory above what was there before."""
    from curecon_blender.core.base import images
    from curecon_blender.core.base.options import Options
    from curecon_blender.core.base.records import View
    from curecon_blender.core.depth.estimate import DepthEstimator
    from curecon_blender.core.depth.tiles import plan_tiles
    from curecon_blender.core.network.weights import load_network
    from curecon_blender.core.run.peak_memory import PeakMemory

    def views_of(w: int, h: int, folder: Path) -> list[View]:
        views = []
        for i in range(sources + 1):
            name = f"{w}_{i}"
            pixels = np.random.default_rng(i).integers(0, 255, (h, w, 3), np.uint8)
            images.write_jpeg(folder / f"{name}.jpg", pixels)
            # As far apart as an orbit's neighbours: it decides how many hypotheses the sweep needs.
            pose = np.column_stack([np.eye(3), [1.2 * i, 0.0, 0.0]])
            K = np.array([[0.8 * w, 0, w / 2], [0, 0.8 * w, h / 2], [0, 0, 1]])
            views.append(View(name=name, image=f"{name}.jpg", width=w, height=h, K=K, cam_from_world=pose,
                              near=5.0, far=25.0, sources=()))
        return views

    with tempfile.TemporaryDirectory() as folder:
        network = load_network()
        options = Options(photos=Path(folder), workspace=Path(folder), device=device, precision=precision,
                          memory_gib=memory_gib)
        estimator = DepthEstimator(network, Path(folder), options)
        small, views = views_of(96, 64, Path(folder)), views_of(width, height, Path(folder))
        estimator.estimate(small[0], [(view, 1.0) for view in small[1:]])
        spent: dict[str, list[float]] = {}

        def timed(name: Callable[..., str], work: Callable[..., Any]) -> Callable[..., Any]:
            def run(*arguments: Any) -> Any:
                began = time.process_time()
                result = work(*arguments)
                spent.setdefault(name(*arguments), []).append(time.process_time() - began)
                return result
            return run

        estimator._features_of = timed(lambda *_: "features", estimator._features_of)  # type: ignore[method-assign]
        network.regulariser_input = timed(  # type: ignore[method-assign]
            lambda level, *_: f"level {level}", network.regulariser_input)
        for level, regulariser in enumerate(network.regularisers):
            for part in (regulariser.enter, regulariser):
                part.forward = timed(lambda *_, level=level: f"level {level}", part.forward)
        network.estimate = timed(lambda *_: "refinement", network.estimate)  # type: ignore[method-assign]
        with PeakMemory() as before:
            pass
        with PeakMemory() as peak:
            wall, cpu = time.perf_counter(), time.process_time()
            estimator.estimate(views[0], [(view, 1.0) for view in views[1:]])
            wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        hypotheses = estimator.coarse_hypotheses(views[0], views[1:])
        tiles = len(plan_tiles(views[0], views[1:], hypotheses, estimator.budget))
        features = sum(spent["features"])
        # A cut-up photo's features are computed for each tile anew, a whole one's once for all its uses.
        a_photo = cpu if tiles > 1 else cpu - features * sources / (sources + 1)
        steps = "  ".join(f"{name} {sum(spent[name]):5.2f}"
                          for name in ("features", "level 2", "level 1", "level 0", "refinement"))
        memory = (peak.bytes - before.bytes) / 2**30
        print(f"{width}x{height}  N={sources}  {str(estimator.dtype)[6:]:8}  {tiles:3} tiles  {steps}  all {cpu:6.2f}  "
              f"a photo {a_photo:6.2f} CPU s  {wall:6.1f} s  {memory:5.2f} GiB", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description="Seconds and memory of one depth map, by size.")
    parser.add_argument("--sizes", nargs="+", default=["800x600", "1600x1200", "3200x2400"], metavar="WIDTHxHEIGHT")
    parser.add_argument("--sources", type=int, default=4)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--precision", default="auto")
    parser.add_argument("--memory", type=float, default=None, metavar="GIB")
    options = parser.parse_args()
    if len(options.sizes) == 1:
        width, height = map(int, options.sizes[0].split("x"))
        measure(width, height, options.sources, options.device, options.precision, options.memory)
        return
    for size in options.sizes:
        command = [sys.executable, "-m", "benchmarks.depth", "--sizes", size, "--sources", str(options.sources),
                   "--device", options.device, "--precision", options.precision]
        subprocess.run([*command, *(["--memory", str(options.memory)] if options.memory else [])], check=True)


if __name__ == "__main__":
    use_large_pages()
    main()
