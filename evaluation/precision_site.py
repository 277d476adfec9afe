# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Told precision of a workspace's points against their true errors, where the site's surfaces are known.

    python -m evaluation.precision_site WORKSPACE SITE

An error is a point's distance along the normal from the true surface (SITE/truth/cloud.npz), where that is even. Errors
of the shape are those left after the shift, turn and scale that fit the points best.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from curecon_blender.core.adjust.precision_record import read_precision

NEAREST = 10  # true points that tell a surface
EVEN = 0.004  # metres: root mean square distance of these from their plane
FARTHEST = 1.0  # metres from the surface; what lies farther is another one's, or was matched wrongly


@dataclass(frozen=True, kw_only=True)
class Surface:
    """True points (T,3) with unit normals and whether the surface is even there."""

    points: np.ndarray
    normals: np.ndarray
    even: np.ndarray
    tree: cKDTree


def read_surface(path: Path) -> Surface:
    with np.load(path) as data:
        points = data["points"].T * float(data["unit"])
    tree = cKDTree(points)
    _, index = tree.query(points, NEAREST)
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", *[points[index] - points[index].mean(1)[:, None]] * 2))
    even = np.sqrt(np.maximum(values[:, 0], 0) / NEAREST) < EVEN
    return Surface(points=points, normals=vectors[:, :, 0], even=even & (values[:, 1] > 4 * values[:, 0]), tree=tree)


def off_surface(places: np.ndarray, surface: Surface) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which of places (P,3) lie at an even surface, and of these distances along the normal, and normals."""
    distance, index = surface.tree.query(places, distance_upper_bound=FARTHEST)
    near = np.flatnonzero(np.isfinite(distance))
    near = near[surface.even[index[near]]]
    normals = surface.normals[index[near]]
    return near, ((places[near] - surface.points[index[near]]) * normals).sum(axis=1), normals


def fitted(places: np.ndarray, surface: Surface) -> np.ndarray:
    """Places (P,3) after the small shift, turn and scale that lay them on the surface, outliers left aside."""
    for _ in range(12):
        near, off, normals = off_surface(places, surface)
        middle = places[near].mean(axis=0)
        about = places[near] - middle
        design = np.column_stack([normals, np.cross(about, normals), (about * normals).sum(axis=1)])
        weights = 1 / (1 + (off / (2 * max(1.4826 * float(np.median(np.abs(off))), 1e-3))) ** 2)
        fit = np.linalg.lstsq(design * weights[:, None], -off * weights, rcond=None)[0]
        shift, turn, scale = fit[:3], fit[3:6], fit[6]
        offsets = places - middle
        places = places + shift + np.cross(turn, offsets) + scale * offsets
    return places


def within(off: np.ndarray, normals: np.ndarray, covariances: np.ndarray) -> tuple[float, np.ndarray]:
    """The share of errors within one told sigma along the normal, and the told sigmas."""
    sigmas = np.sqrt(np.einsum("ni,nij,nj->n", normals, covariances, normals))
    return float((np.abs(off) < sigmas).mean()), sigmas


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("workspace", type=Path)
    parser.add_argument("site", type=Path)
    parser.add_argument("--component", type=int, default=0)
    arguments = parser.parse_args()
    told = read_precision(arguments.workspace / "sparse" / str(arguments.component))
    if told is None:
        parser.error("this workspace tells no precision: its cameras were not adjusted")
    report(told.places.astype(float), told.points, told.shapes, told.datum, read_surface(
        arguments.site / "truth" / "cloud.npz"))


def report(
    places: np.ndarray, points: np.ndarray, shapes: np.ndarray, datum: np.ndarray, surface: Surface
) -> None:
    shaped = fitted(places, surface)
    near, off, normals = off_surface(shaped, surface)
    share, sigmas = within(off, normals, shapes[near])
    print(f"shape: {len(near)} points, median |error| {np.median(np.abs(off)):.4f} m, told {np.median(sigmas):.4f} m, "
          f"within one sigma {share:.3f}, two {(np.abs(off) < 2 * sigmas).mean():.3f}")
    moved = (shaped - places)[near]
    shift = np.abs(moved.mean(axis=0))
    about = places[near] - places[near].mean(axis=0)
    scale = float((moved * about).sum() / (about**2).sum())
    sigmas = np.sqrt(np.diag(datum))
    print(f"as a whole: shift {shift.round(3)} m, told {sigmas[:3].round(3)} m; "
          f"scale {scale:+.5f}, told {sigmas[6]:.5f}")


if __name__ == "__main__":
    main()
