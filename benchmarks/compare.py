# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""CPU seconds and peak memory of `compare` by step, of two drawn clouds of a ruin.

    python -m benchmarks.compare [--points 10000000] [--by coordinates] [--change] [--out FOLDER]

The steps are reading both, laying one on the other, and measuring them with the sheet and the cloud of distances. The
memory of a step is the most that the process held in it, libraries included.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.base.options import COMPARE_WAYS
from curecon_blender.core.base.ply import row_type, table, write_ply
from curecon_blender.core.compare.write import Wishes, compare
from curecon_blender.core.run.peak_memory import PeakMemory
from evaluation.registration_scenes import ruin

_ROW = row_type([("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("red", "u1"), ("green", "u1"), ("blue", "u1")])
_DENSITY = 40.0  # of `ruin` by default, points a square metre
_FAR = np.array([512_000.0, 2_734_000.0, 400.0])  # as surveyors have them


class Steps(Reporter):
    """Takes CPU time and the peak of memory at each stage."""

    def __init__(self, peak: PeakMemory) -> None:
        super().__init__()
        self._peak, self._name, self._began = peak, "", time.process_time()
        self.rows: list[tuple[str, float, float]] = []

    def stage(self, name: str) -> None:
        self.end()
        self._name = name
        super().stage(name)

    def end(self) -> None:
        now = time.process_time()
        if self._name:
            self.rows.append((self._name, now - self._began, self._peak.bytes / 2**30))
        self._began, self._peak.bytes = now, 0


def write_cloud(path: Path, points: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    few = len(ruin(np.random.default_rng(seed)))
    places = ruin(rng, _DENSITY * points / few)
    places += rng.normal(0, 0.01, places.shape)
    colours = np.clip(128 + 40 * np.sin(places * 3), 0, 255).astype(np.uint8)
    write_ply(path, {"vertex": table(_ROW, {"x y z": places + _FAR, "red green blue": colours})})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=10_000_000, help="of each cloud, about")
    parser.add_argument("--by", choices=[way for way in COMPARE_WAYS if way != "pairs"], default=COMPARE_WAYS[0])
    parser.add_argument("--change", action="store_true")
    parser.add_argument("--out", type=Path, help="keep sheet, figures and clouds there")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        files = [Path(scratch) / f"{name}.ply" for name in ("ours", "theirs")]
        for seed, file in enumerate(files):
            write_cloud(file, given.points, seed)
        with PeakMemory() as peak:
            steps = Steps(peak)
            wishes = Wishes(by=given.by, change=given.change)
            made = compare(files[0], files[1:], None, given.out or Path(scratch) / "out", wishes, steps)
            steps.end()
    counts = " and ".join(f"{one['points']:,}" for one in made["compare"]["results"])
    print(f"{counts} points")
    for name, seconds, gib in steps.rows:
        print(f"{name:8} {seconds:7.1f} CPU s {gib:6.2f} GiB")


if __name__ == "__main__":
    main()
