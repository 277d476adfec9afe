# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether the photos that `gaps` asks for close the gaps of the true surface, beside as many random ones.

    python -m evaluation.gaps WORKSPACE SITE [--photos 8] [--draws 5]

WORKSPACE is a reconstruction of some of the sample site's photos, SITE the sample's folder. A place of SITE's
truth/cloud.npz within 24.5 m of its middle counts as well seen where three photos see it within 60 degrees of its
normal, 5 degrees apart and with nothing true before it. Random photos are drawn from the same candidates, of those that
show 5 % of the patches or more.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from curecon_blender.core.base.errors import CuReconError
from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.plan.candidates import candidates, seeing
from curecon_blender.core.plan.coverage import Eyes, Parts, sightings
from curecon_blender.core.plan.gaps import advise
from curecon_blender.core.plan.patches import MEASURED, Patches, judge
from curecon_blender.core.plan.solid import Solid
from curecon_blender.core.plan.wishes import MOST_PHOTOS, Wishes
from curecon_blender.core.run.gaps import look
from curecon_blender.core.run.plan import moved

from .alignment import align_cameras, read_centres
from .cloud_metrics import read_points

RADIUS, EVERY, CUBE = 24.5, 45, 0.25  # metres; each so manieth true point; metres
_NEIGHBOURS = 20


def true_surface(site: Path, centres: np.ndarray) -> tuple[Patches, Solid]:
    """Some true points with their normals, which face the cameras (M,3) that see them, and all points as what hides."""
    points = read_points(site / "truth" / "cloud.npz").astype(float)
    solid = Solid(points, CUBE)
    some = points[np.hypot(points[:, 0], points[:, 1]) < RADIUS][::EVERY]
    near = points[cKDTree(points).query(some, k=_NEIGHBOURS)[1]]
    normals = np.linalg.svd(near - near.mean(axis=1, keepdims=True), full_matrices=False)[2][:, 2]
    towards = np.zeros_like(some)
    for centre in centres:
        ray = centre - some
        free = ~solid.hidden(np.broadcast_to(centre, some.shape), some)
        towards += ray / np.linalg.norm(ray, axis=1, keepdims=True) * free[:, None]
    normals *= np.where((normals * towards).sum(axis=1) < 0, -1, 1)[:, None]
    return Patches(Parts(some, normals), np.ones(len(some)), np.full(len(some), MEASURED, np.uint8)), solid


def shares(workspace: Path, site: Path, photos: int, draws: int) -> dict[str, float]:
    """The share of the true places that is well seen: by the photos there are, and with further ones."""
    found = look(workspace, Reporter())
    centres = read_centres(site / "truth")
    patches, solid = true_surface(site, np.array(list(centres.values())))
    to_truth = align_cameras(read_centres(workspace), centres)
    origin = to_truth.apply(np.zeros((1, 3)))[0]
    axes = (to_truth.apply(np.eye(3)) - origin) / to_truth.scale
    back = np.linalg.inv(found.ground.matrix)
    turn = axes.T @ back[:3, :3] / np.cbrt(np.linalg.det(back[:3, :3]))

    def in_truth(eyes: Eyes) -> Eyes:
        return replace(eyes, centres=to_truth.apply(moved(eyes.centres + found.level, back)), turns=eyes.turns @ turn.T)

    def share(*parts: Eyes) -> float:
        eyes = Eyes(*(np.concatenate(column) for column in zip(*(vars(part).values() for part in parts), strict=True)))
        return 1 - judge(patches, in_truth(eyes), solid).share

    leg = candidates(found.building, found.drone, Wishes(), found.distance)
    offered = seeing(leg, found.drone)
    chosen = advise(judge(found.patches, found.taken, found.solid), found.taken, offered, found.solid, photos)
    n, m, _ = sightings(found.patches.parts, offered, found.solid)
    useful = np.flatnonzero(np.bincount(m, found.patches.areas[n], len(offered)) > 0.05 * found.patches.areas.sum())
    rng = np.random.default_rng(0)
    random = [share(found.taken, offered.take(rng.choice(useful, len(chosen), replace=False))) for _ in range(draws)]
    return {"photos": len(chosen), "before": share(found.taken), "asked for": share(found.taken, offered.take(chosen)),
            "random": float(np.mean(random)), "random, best": float(np.max(random))}


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m evaluation.gaps", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("workspace", type=Path)
    parser.add_argument("site", type=Path)
    parser.add_argument("--photos", type=int, default=MOST_PHOTOS)
    parser.add_argument("--draws", type=int, default=5)
    args = parser.parse_args(arguments)
    try:
        found = shares(args.workspace, args.site, args.photos, args.draws)
    except CuReconError as error:
        print(f"{error.message}\n{error.remedy}", file=sys.stderr)
        return error.exit_code
    for name, value in found.items():
        print(f"{name:14} {value:.0f}" if name == "photos" else f"{name:14} {value:.1%}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
