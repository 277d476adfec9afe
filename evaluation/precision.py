# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Predicted precision against the spread of many adjustments of one small site, each with its own noise.

    python -m evaluation.precision [--runs 200] [--photos 16] [--points 300] [--datum gps|control|both|free]

The datum is that of positions, of control points, of control points beside positions that are all off alike, or none.

James, Robson and Smith (2017) make precision maps this way; here it is the oracle of core/adjust/precision.py.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from curecon_blender.core.adjust.bundle import Bundle, adjust
from curecon_blender.core.adjust.bundle_cpu import residuals
from curecon_blender.core.adjust.precision import precision, similarity_of

LENS = np.array([[850.0, 1.0, 606.0, 446.0, 0.066, -0.043, -0.0046, 0.0026, 0.0]])
SIZE = np.array([1200, 900])
PIXELS, ATTITUDE = 0.5, np.radians(0.5)
POSITION, CONTROL = np.array([0.5, 0.5, 0.8]), np.array([0.02, 0.02, 0.03])
LENS_SIGMAS = np.array([[17.0, 1e-9, 6.0, 6.0, 0.05, 0.05, 0.005, 0.005, 1e-9]])
MARKED = 6  # points of known place
DATUMS = ("gps", "control", "both", "free")


@dataclass(frozen=True, kw_only=True)
class Trials:
    """Errors of each run, metres: of points (R,P,3) in the frame and after the best similarity, of cameras (R,N,3), of
    that similarity (R,7), of the lens (R,9); and what the runs predicted, averaged: covariances (P,3,3) of both,
    (N,3,3), and sigmas (7,), (9,)."""

    errors: np.ndarray
    shape_errors: np.ndarray
    camera_errors: np.ndarray
    datum_errors: np.ndarray
    lens_errors: np.ndarray
    covariances: np.ndarray
    shape_covariances: np.ndarray
    camera_covariances: np.ndarray
    datum_sigmas: np.ndarray
    lens_sigmas: np.ndarray


def site(photos: int, points: int, datum: str) -> Bundle:
    """A true bundle without noise: photos down on a hilly site in a grid, half of them tilted; its observations."""
    rng = np.random.default_rng(3)
    side = int(np.ceil(np.sqrt(photos)))
    grid = np.stack(np.meshgrid(np.arange(side), np.arange(side)), -1).reshape(-1, 2)[:photos] - (side - 1) / 2
    centres = np.column_stack([grid * 10 + rng.normal(0, 0.5, grid.shape), np.full(photos, 50.0)])
    tilts = np.radians(np.where(np.arange(photos) % 2 == 0, 15, 0))
    turns = Rotation.from_euler("zx", np.column_stack([rng.uniform(0, 2 * np.pi, photos), tilts])).as_matrix()
    rotations = turns @ np.diag([1.0, -1.0, -1.0])
    xy = rng.uniform(-25, 25, (points, 2))
    world = np.column_stack([xy, 4 * np.sin(xy[:, 0] / 7) * np.cos(xy[:, 1] / 9)])
    photo, point = np.tile(np.arange(photos), points), np.repeat(np.arange(points), photos)
    none = np.zeros((len(photo), 2))
    pixels = residuals(rotations, centres, LENS, np.zeros(photos, int), world, photo, point, none)
    seen = ((pixels > 0) & (pixels < SIZE)).all(axis=1)
    marked = np.arange(MARKED) if datum in ("control", "both") else np.zeros(0, int)
    return Bundle(
        rotations=rotations, centres=centres, lens_of=np.zeros(photos, int), lenses=LENS, points=world,
        photo=photo[seen], point=point[seen], pixels=pixels[seen], positions=centres,
        position_sigmas=np.tile(POSITION if datum in ("gps", "both") else np.full(3, np.inf), (photos, 1)),
        attitudes=rotations, attitude_sigmas=np.full(photos, np.inf if datum == "free" else ATTITUDE),
        known_lenses=LENS, lens_sigmas=LENS_SIGMAS, control=marked, control_positions=world[marked],
        control_sigmas=np.tile(CONTROL, (len(marked), 1)), apart=datum == "both",
        together=1.0,  # the errors here have nothing in common
    )


def noisy(truth: Bundle, rng: np.random.Generator) -> Bundle:
    """What a survey of the site would know: every input with an error of its sigma, positions with one in common."""
    shift = rng.normal(size=3)
    positions = truth.positions + POSITION * (rng.normal(size=truth.positions.shape) + shift)
    turned = Rotation.from_rotvec(rng.normal(0, ATTITUDE, truth.centres.shape)).as_matrix() @ truth.attitudes
    told, free = np.isfinite(truth.position_sigmas), np.isfinite(truth.attitude_sigmas)
    return replace(
        truth, pixels=truth.pixels + rng.normal(0, PIXELS, truth.pixels.shape),
        positions=np.where(told, positions, truth.positions),
        attitudes=np.where(free[:, None, None], turned, truth.attitudes),
        known_lenses=truth.known_lenses + rng.normal(size=LENS.shape) * truth.lens_sigmas,
        control_positions=truth.control_positions + rng.normal(size=truth.control_positions.shape) * CONTROL,
    )


def split(found: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Errors of points as the small shift, turn and scale (7,) that fits them best, and what is left (P,3)."""
    design, errors = similarity_of(truth - truth.mean(axis=0)), found - truth
    fit = np.linalg.lstsq(design.reshape(-1, 7), errors.ravel(), rcond=None)[0]
    return fit, np.asarray(errors - design @ fit)


def run(runs: int, photos: int, points: int, datum: str) -> Trials:
    """Adjust the site `runs` times."""
    truth, rng = site(photos, points, datum), np.random.default_rng(8)
    adjusted = [adjust(noisy(truth, rng)) for _ in range(runs)]
    told = [precision(bundle) for bundle in adjusted]
    whole, shapes = zip(*(split(bundle.points, truth.points) for bundle in adjusted), strict=True)
    cameras = np.array([bundle.centres - truth.centres for bundle in adjusted])
    if datum == "free":  # of the shape, as the points'
        moves = similarity_of(truth.centres - truth.points.mean(axis=0))
        cameras -= np.einsum("nij,rj->rni", moves, np.array(whole))
    return Trials(
        errors=np.array([bundle.points - truth.points for bundle in adjusted]), shape_errors=np.array(shapes),
        camera_errors=cameras, datum_errors=np.array(whole),
        lens_errors=np.array([bundle.lenses[0] - LENS[0] for bundle in adjusted]),
        covariances=np.mean([p.points for p in told], axis=0),
        shape_covariances=np.mean([p.shapes for p in told], axis=0),
        camera_covariances=np.mean([p.centres for p in told], axis=0),
        datum_sigmas=np.sqrt(np.mean([p.datum_sigmas**2 for p in told], axis=0)),
        lens_sigmas=np.sqrt(np.mean([p.lenses[0] ** 2 for p in told], axis=0)),
    )


def ratios(errors: np.ndarray, covariances: np.ndarray) -> np.ndarray:
    """(3,) root mean square errors of all points and runs over the predicted sigmas, along x, y and z."""
    predicted = np.diagonal(covariances, axis1=1, axis2=2)
    return np.asarray(np.sqrt((errors**2).mean(axis=(0, 1)) / predicted.mean(axis=0)))


def within(errors: np.ndarray, covariances: np.ndarray) -> float:
    """The share of errors within one predicted sigma: 0.683 where the prediction is right."""
    return float((np.abs(errors) < np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))).mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--photos", type=int, default=16)
    parser.add_argument("--points", type=int, default=300)
    parser.add_argument("--datum", choices=DATUMS, nargs="+", default=DATUMS)
    arguments = parser.parse_args()
    for datum in arguments.datum:
        trials = run(arguments.runs, arguments.photos, arguments.points, datum)
        print(f"{datum}: error over prediction, x y z, and the share within one sigma")
        for name, errors, covariances in (
            ("points in the frame", trials.errors, trials.covariances),
            ("points, shape", trials.shape_errors, trials.shape_covariances),
            ("cameras", trials.camera_errors, trials.camera_covariances),
        ):
            if datum != "free" or name != "points in the frame":
                print(f"  {name}: {ratios(errors, covariances).round(3)} {within(errors, covariances):.3f}")
        for name, errors, sigmas in (("shift, turn, scale", trials.datum_errors, trials.datum_sigmas),
                                     ("lens", trials.lens_errors, trials.lens_sigmas)):
            free = sigmas > 1e-8
            if free.any():
                print(f"  {name}: {(np.sqrt((errors**2).mean(axis=0))[free] / sigmas[free]).round(3)}", flush=True)


if __name__ == "__main__":
    main()
