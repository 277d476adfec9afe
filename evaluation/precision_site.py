# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A workspace's cameras, heights and told precision against a site's exact truth.

    python -m evaluation.precision_site WORKSPACE [WORKSPACE ...] FLIGHT

FLIGHT, such as samples/tulou or samples/tulou_nadir, holds truth/cameras.txt, images.txt and origin.json; the true
surfaces are samples/tulou/truth/cloud.npz. A sparse point's true place is what its observations show of them (see
true_points.py); points on uneven surfaces and wrong matches do not count. Metres.

* As placed: errors of cameras and points in the frame that the workspace has.
* Bend: the quadratic term of the points' height errors, from the middle of the flight to its edge.
* As a whole: the shift of the points' middle, the turn (degrees) and the scale that bring them to the truth, each
  beside what was told of it.
* Shape: what is left then. A point's error is counted along the surface's normal, since along the surface its features
  tell its true place, too.
* Within one sigma: the share of errors below their told sigma; 0.683 where it is right.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from curecon_blender.core.adjust.precision import similarity_of
from curecon_blender.core.adjust.precision_record import Precision, read_precision
from curecon_blender.core.adjust.record import read_accuracy, rms
from curecon_blender.core.base.geodesy import enu_to_geodetic, geodetic_to_enu
from curecon_blender.core.sparse.models import read_model
from curecon_blender.core.sparse.record import read_frame

from .alignment import align
from .true_points import TrueSite

CLOUD = Path(__file__).resolve().parents[1] / "samples" / "tulou" / "truth" / "cloud.npz"
OUTLIER = 2.0  # robust sigmas from where on a point counts less


def similarity_errors(off: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """(7,) the small shift, turn and relative scale of points at `offsets` (P,3) from their middle that explain what
    they are off (P,3), outliers left aside."""
    design, fit = similarity_of(offsets), np.zeros(7)
    for _ in range(10):
        left = np.linalg.norm(off - design @ fit, axis=1)
        weights = 1 / (1 + (left / (OUTLIER * max(float(np.median(left)), 1e-6))) ** 2)
        normal = np.einsum("pij,p,pik->jk", design, weights, design)
        fit = np.linalg.solve(normal, np.einsum("pij,p,pi->j", design, weights, off))
    return fit


def bend(heights: np.ndarray, plan: np.ndarray, cameras: np.ndarray) -> float:
    """The quadratic term of height errors (P,) of points at plan (P,2), over the cameras' (N,2) greatest distance from
    their middle."""
    middle = np.median(cameras, axis=0)
    reach = np.linalg.norm(cameras - middle, axis=1).max()
    x, y = ((plan - middle) / reach).T
    design = np.column_stack([np.ones_like(x), x, y, x**2 + y**2])
    weights = np.ones_like(x)
    for _ in range(10):
        fit = np.linalg.lstsq(design * weights[:, None], heights * weights, rcond=None)[0]
        left = np.abs(heights - design @ fit)
        weights = 1 / np.sqrt(1 + (left / (OUTLIER * max(1.4826 * float(np.median(left)), 1e-6))) ** 2)
    return float(fit[3])


def report(workspace: Path, site: TrueSite, component: int = 0) -> str:
    """The figures of one workspace, for people. Raises WorkspaceError."""
    folder = workspace / "sparse" / str(component)
    model, frame = read_model(folder), read_frame(folder)
    told, accuracy = read_precision(folder), read_accuracy(folder)
    images = sorted((model.image(i) for i in model.reg_image_ids()), key=lambda image: str(image.name))
    centres = np.array([image.projection_center() for image in images])
    places = np.array([model.point3D(i).xyz for i in sorted(model.point3D_ids())])
    true_centres = site.centres([str(image.name) for image in images])
    true = site.points(model, align(centres, true_centres))
    for _ in range(2):  # cameras that bend lie better where their points do
        true = site.points(model, align(places[true.index], true.places))

    def in_frame(truth: np.ndarray) -> np.ndarray:
        if frame.origin is None:
            return truth
        return geodetic_to_enu(enu_to_geodetic(truth, site.origin), frame.origin)

    off = places[true.index] - in_frame(true.places)
    cameras_off = centres - in_frame(true_centres)
    middle = places.mean(axis=0) if told is None else told.middle
    whole = similarity_errors(off, places[true.index] - middle)
    left = off - similarity_of(places[true.index] - middle) @ whole
    cameras_left = cameras_off - similarity_of(centres - middle) @ whole
    plan = places[true.index, :2]
    lines = [
        f"{workspace}: {len(images)} cameras, {len(true.index)} points ({true.mismatched} wrong matches aside)",
        f"  cameras as placed: RMS {_rms(cameras_off):.4f}; after the best fit of the points {_rms(cameras_left):.4f}",
        f"  heights of points: RMS {_rms(off[:, 2:]):.4f} as placed, {_rms(left[:, 2:]):.4f} after the best fit; "
        f"bend {bend(off[:, 2], plan, centres[:, :2]):+.4f}",
    ]
    if accuracy is not None and accuracy.check:
        lines.append("  check points: RMS {:.4f} in plan, {:.4f} in height".format(*rms(accuracy.check)))
    lines += _precision(told, true.index, true.normals, off, left, cameras_off, cameras_left, whole) if told else [
        "  as a whole: shift " + " ".join(f"{value:+.3f}" for value in whole[:3])]
    return "\n".join(lines)


def _precision(
    told: Precision, index: np.ndarray, normals: np.ndarray, off: np.ndarray, left: np.ndarray, cameras_off: np.ndarray,
    cameras_left: np.ndarray, whole: np.ndarray,
) -> list[str]:
    units = np.array([1, 1, 1, *np.degrees([1, 1, 1]), 1])
    names = ("east", "north", "up", "turn x", "y", "z", "scale")
    lines = ["  as a whole: " + ", ".join(
        f"{name} {value:+.4f} (told {sigma:.4f})"
        for name, value, sigma in zip(names, whole * units, told.datum_sigmas * units, strict=True))]
    for name, errors, covariances in (("points as placed", off, told.points), ("points, shape", left, told.shapes)):
        along = (errors * normals).sum(axis=1)
        sigmas = np.sqrt(np.einsum("pi,pij,pj->p", normals, covariances[index], normals))
        lines.append(_shares(name, along, sigmas))
    sigmas = np.sqrt(np.diagonal(told.centres, axis1=1, axis2=2))
    lines.append(_shares("cameras as placed", cameras_off, sigmas))
    return lines


def _shares(name: str, errors: np.ndarray, sigmas: np.ndarray) -> str:
    errors = np.abs(errors)
    return (f"  {name}: median |error| {np.median(errors):.4f}, told {0.6745 * np.median(sigmas):.4f}; "
            f"within one sigma {(errors < sigmas).mean():.3f}, two {(errors < 2 * sigmas).mean():.3f}")


def _rms(off: np.ndarray) -> float:
    return float(np.sqrt((off**2).sum(axis=1).mean()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("workspaces", type=Path, nargs="+")
    parser.add_argument("flight", type=Path)
    parser.add_argument("--cloud", type=Path, default=CLOUD, help="the true surfaces, in the frame of the truth")
    parser.add_argument("--component", type=int, default=0)
    arguments = parser.parse_args()
    site = TrueSite(arguments.flight / "truth", arguments.cloud)
    for workspace in arguments.workspaces:
        print(report(workspace, site, arguments.component), flush=True)


if __name__ == "__main__":
    main()
