# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How well, and how honestly, `compare` lays one cloud on another: trials with known motions.

    python -m evaluation.registration [--scenes tulou ring facade ruin] [--overlaps 0.9 0.5 0.1] [--scale no yes]
                                      [--trials 20] [--first-seed 100] [--ways found pairs] [--json]

Each trial samples a scene twice, with noise of 2 cm, leaves each cloud the stated share of what the other has, and
moves one by any rotation and shift, and scale where that is open. `found` starts from nothing; `pairs` from four
places in what both share, marked with errors of 5 cm. A result is right when its points come to lie within 10 cm (RMS)
of where they belong. What is *said* of it is "sure", "doubted", or refused by an error.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from scipy.spatial import cKDTree

from curecon_blender.core.compare import align
from curecon_blender.core.compare.geometry import Similarity
from curecon_blender.core.compare.result import CompareError, Result, result_of

from .registration_scenes import SCENES, pair

RIGHT, MARKED, MARKS = 0.1, 0.05, 4  # metres; the error of a mark; how many
WAYS = ("found", "pairs")


@dataclass(frozen=True, kw_only=True)
class Trial:
    """`error` is the RMS distance of the other's points from where they belong, in its metres; None where refused, for
    the reason in `said`."""

    scene: str
    way: str
    scaled: bool
    overlap: float
    seed: int
    error: float | None
    sure: bool
    said: str
    seconds: float

    @property
    def right(self) -> bool:
        return self.error is not None and self.error < RIGHT


def trial(scene: str, way: str, overlap: float, seed: int, *, scaled: bool) -> Trial:
    """Lay one drawn cloud on another."""
    source, target, motion = pair(scene, seed, overlap, scaled=scaled)
    ours, other = result_of("ours", target), result_of("other", source)
    began = time.process_time()
    error, sure = None, False
    try:
        if way == "pairs":
            laid = align.by_pairs(ours, other, _marks(source, target, motion, seed), scaled=scaled)
        else:
            laid = align.find(ours, other, scaled=scaled)
        error, sure, said = _error(laid.motion, ours, other, source, motion), laid.sure, " ".join(laid.remarks)
    except CompareError as refused:
        said = str(refused.message)
    return Trial(scene=scene, way=way, scaled=scaled, overlap=overlap, seed=seed, error=error, sure=sure, said=said,
                 seconds=time.process_time() - began)


def _error(found: Similarity, ours: Result, other: Result, source: np.ndarray, true: Similarity) -> float:
    off = found.apply(source - other.offset) + ours.offset - true.apply(source)
    return float(np.sqrt((off**2).sum(axis=1).mean())) / true.scale


def _marks(source: np.ndarray, target: np.ndarray, motion: Similarity, seed: int) -> np.ndarray:
    """Pairs (MARKS,6) in what both share, as far apart as it allows."""
    rng = np.random.default_rng(seed)
    moved = motion.apply(source)
    shared = source[cKDTree(target).query(moved)[0] < 0.3 * motion.scale]
    chosen = [int(rng.integers(len(shared)))]
    for _ in range(MARKS - 1):
        chosen.append(int(cKDTree(shared[chosen]).query(shared)[0].argmax()))
    theirs = shared[chosen]
    mine = motion.apply(theirs + rng.normal(0, MARKED / np.sqrt(3), theirs.shape))
    return np.hstack([theirs, mine])


def table(trials: Sequence[Trial]) -> str:
    """Of all trials of a kind: how many were right and wrong, by what was said of them."""
    lines = ["| scene | way | scale | overlap | right, sure | right, doubted | refused | wrong, doubted | "
             "**wrong, sure** | median error of right ones, mm | CPU s |", "|" + "---|" * 11]
    kinds = list(dict.fromkeys((one.scene, one.way, one.scaled, one.overlap) for one in trials))
    for kind in kinds:
        of = [one for one in trials if (one.scene, one.way, one.scaled, one.overlap) == kind]
        errors = [one.error for one in of if one.right and one.error is not None]
        lied = [one for one in of if one.error is not None and not one.right]
        refused = [one for one in of if one.error is None]
        counts = (sum(one.right and one.sure for one in of), sum(one.right and not one.sure for one in of),
                  len(refused), sum(not one.sure for one in lied), sum(one.sure for one in lied))
        error = f"{1000 * np.median(errors):.1f}" if errors else "–"
        lines.append(f"| {kind[0]} | {kind[1]} | {'open' if kind[2] else 'known'} | {kind[3]:.0%} | "
                     + " | ".join(map(str, counts)) + f" | {error} | {np.mean([one.seconds for one in of]):.1f} |")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m evaluation.registration", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", choices=list(SCENES), default=list(SCENES))
    parser.add_argument("--overlaps", nargs="+", type=float, default=[0.9, 0.5, 0.1])
    parser.add_argument("--scale", nargs="+", choices=("no", "yes"), default=["no", "yes"], help="whether it is open")
    parser.add_argument("--ways", nargs="+", choices=WAYS, default=list(WAYS))
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=100)
    parser.add_argument("--json", action="store_true", help="print each trial as a line of JSON instead of the table")
    given = parser.parse_args(arguments)
    kinds = [(scene, way, scale == "yes", overlap) for scene in given.scenes for way in given.ways
             for scale in given.scale for overlap in given.overlaps]
    trials = []
    for seed in range(given.first_seed, given.first_seed + given.trials):
        for scene, way, scaled, overlap in kinds:
            trials.append(trial(scene, way, overlap, seed, scaled=scaled))
            if given.json:
                print(json.dumps(asdict(trials[-1])), flush=True)
    if not given.json:
        print(table(trials))
    return 0


if __name__ == "__main__":
    sys.exit(main())
