# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs the targets in turn, each in a process of its own under limits of memory and time, and keeps what it finds."""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
import time
from pathlib import Path

from .runner import fuzz
from .targets import TARGETS

SLICE_SECONDS = 60.0  # for one target before the next has its turn
READERS = [f"curecon_blender.core.{name}" for name in
           ("site.adjustment", "sparse.models", "views.record", "run.cost", "depth.estimate", "cloud.fuse",
            "photos.check", "run.pipeline", "network.weights")]
STALLED_SECONDS = 150.0  # without a new case: native code that the alarm cannot reach


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--target", choices=TARGETS, action="append", help="these only; all by default")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--folder", type=Path, default=Path("scratch/fuzz"), help="for findings and counts")
    options = parser.parse_args()
    chosen = options.target or list(TARGETS)
    until = time.monotonic() + 60 * options.minutes
    slice_seconds = min(SLICE_SECONDS, 60 * options.minutes / len(chosen))
    totals = {name: {"cases": 0, "seconds": 0.0, "findings": 0} for name in chosen}
    turn = 0
    context = multiprocessing.get_context(
        "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn")
    context.set_forkserver_preload(["tests.fuzz.runner", *READERS])  # loading torch takes longer than a thousand cases
    while time.monotonic() < until:
        name = chosen[turn % len(chosen)]
        folder = options.folder / f"turn_{options.seed + turn}"
        folder.mkdir(parents=True, exist_ok=True)
        started = time.monotonic()
        process = context.Process(target=fuzz, args=(name, slice_seconds, 1000 * (options.seed + turn), folder))
        process.start()
        while process.is_alive():
            process.join(1)
            running = folder / "running"
            if running.exists() and time.time() - running.stat().st_mtime > STALLED_SECONDS:
                process.kill()
        if process.exitcode:
            place = folder / f"{name}_died"
            place.with_suffix(".txt").write_text(f"ended with {process.exitcode}")
            if (folder / "running").exists():
                (folder / "running").rename(place.with_suffix(".bin"))
        total = totals[name]
        total["cases"] += int((folder / "cases").read_text()) if (folder / "cases").exists() else 0
        total["seconds"] = round(total["seconds"] + time.monotonic() - started, 1)
        total["findings"] += len(list(folder.glob("*.txt")))
        (options.folder / f"totals_{options.seed}.json").write_text(json.dumps(totals, indent=1))
        turn += 1
    print(json.dumps(totals, indent=1))
    return int(any(total["findings"] for total in totals.values()))


if __name__ == "__main__":
    sys.exit(main())
