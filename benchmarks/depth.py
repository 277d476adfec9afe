# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Seconds and peak memory of one depth map, by size: what the memory budget's model in core/depth.py rests on.

    python -m benchmarks.depth [--sizes 800x600 1600x1200] [--sources 4] [--device cpu] [--precision auto]

Each size runs in a process of its own. Random photos serve: neither time nor memory depends on what is seen.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from curecon_blender.core.allocator import use_large_pages


def measure(width: int, height: int, sources: int, device: str, precision: str, memory_gib: float | None) -> None:
    """Print one row: seconds of wall and CPU time, and peak memory above what was there before."""
    from curecon_blender.core import images
    from curecon_blender.core.depth import DepthEstimator, plan_tiles
    from curecon_blender.core.options import Options
    from curecon_blender.core.pipeline import PeakMemory
    from curecon_blender.core.types import View
    from curecon_blender.core.weights import load_network

    with tempfile.TemporaryDirectory() as folder:
        views = []
        for i in range(sources + 1):
            pixels = np.random.default_rng(i).integers(0, 255, (height, width, 3), np.uint8)
            images.write_jpeg(Path(folder) / f"{i}.jpg", pixels)
            # As far apart as an orbit's neighbours: it decides how many hypotheses the sweep needs.
            pose = np.column_stack([np.eye(3), [1.2 * i, 0.0, 0.0]])
            K = np.array([[0.8 * width, 0, width / 2], [0, 0.8 * width, height / 2], [0, 0, 1]])
            views.append(View(name=str(i), image=f"{i}.jpg", width=width, height=height, K=K, cam_from_world=pose,
                              near=5.0, far=25.0, sources=()))
        options = Options(photos=Path(folder), workspace=Path(folder), device=device, precision=precision,
                          memory_gib=memory_gib)
        estimator = DepthEstimator(load_network(), Path(folder), options)
        with PeakMemory() as before:
            pass
        with PeakMemory() as peak:
            wall, cpu = time.perf_counter(), time.process_time()
            estimator.estimate(views[0], [(view, 1.0) for view in views[1:]])
            wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        hypotheses = estimator.coarse_hypotheses(views[0], views[1:])
        tiles = len(plan_tiles(width, height, sources, hypotheses, estimator.budget))
        print(f"{width}x{height}  N={sources}  {str(estimator.dtype)[6:]:8}  {tiles:3} tiles  {wall:6.1f} s  "
              f"{cpu:6.1f} CPU s  {(peak.bytes - before.bytes) / 2**30:5.2f} GiB", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description="Seconds and memory of one depth map, by size.")
    parser.add_argument("--sizes", nargs="+", default=["800x600", "1600x1200"], metavar="WIDTHxHEIGHT")
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
