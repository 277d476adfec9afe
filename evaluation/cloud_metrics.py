# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How far a cloud is from the true one: DTU's accuracy and completeness, and the F-score of Tanks and Temples.

Accuracy is the distance of each point of the cloud to the nearest true one, completeness that of each true point to
the cloud: mean and median, without those of `max_distance` or more (DTU: 20 mm); overall is the mean of both means.
Precision and recall are the percentages of these distances below a threshold, all of them counted; the F-score is
their harmonic mean.

    python -m evaluation.cloud_metrics CLOUD TRUTH --thresholds 0.1 0.2 [--max-distance 1] [--voxel 0.05]
        [--cameras ESTIMATED TRUE] [--transform FILE] [--crop FILE | --box x y z x y z | --radius x y r] [--json]

CLOUD and TRUTH are binary PLY or .npz (key `points`, times `unit` if there). The order of work: `--cameras` aligns
CLOUD by the similarity between two sets of camera centres (see alignment.read_centres), `--transform` applies a 4x4
matrix in a text file, both clouds are cropped in the truth's frame, then thinned to one point a voxel.
"""

from __future__ import annotations

import argparse
import json
import sys
import zipfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from curecon_blender.core.base.errors import CuReconError, WorkspaceError
from curecon_blender.core.cloud.ply import read_cloud

from .alignment import align_cameras, read_centres


@dataclass(frozen=True, kw_only=True)
class Score:
    """`precision`, `recall` and `fscore` in percent at `threshold`, in units of the truth."""

    threshold: float
    precision: float
    recall: float
    fscore: float


@dataclass(frozen=True, kw_only=True)
class CloudErrors:
    """Distances in units of the truth; `points` and `true_points` are the numbers compared."""

    accuracy: float
    accuracy_median: float
    completeness: float
    completeness_median: float
    overall: float
    scores: tuple[Score, ...]
    points: int
    true_points: int


def cloud_errors(
    points: np.ndarray, truth: np.ndarray, thresholds: list[float], max_distance: float = np.inf
) -> CloudErrors:
    """Errors of `points` (n,3) against `truth` (m,3), in one frame. Raises WorkspaceError when either is empty."""
    for cloud, name in ((points, "cloud"), (truth, "truth")):
        if not len(cloud):
            raise WorkspaceError(f"No points are left of the {name} to compare.",
                                 remedy="Check the crop and the alignment: both clouds must be in the truth's frame.")
    to_truth = cKDTree(truth).query(points, workers=-1)[0]
    to_cloud = cKDTree(points).query(truth, workers=-1)[0]
    accuracy, completeness = to_truth[to_truth < max_distance], to_cloud[to_cloud < max_distance]
    if not len(accuracy) or not len(completeness):
        raise WorkspaceError(f"No point is nearer than {max_distance:g} to the other cloud.",
                             remedy="Check the alignment, or give a larger maximum distance.")
    return CloudErrors(
        accuracy=float(accuracy.mean()), accuracy_median=float(np.median(accuracy)),
        completeness=float(completeness.mean()), completeness_median=float(np.median(completeness)),
        overall=float(accuracy.mean() + completeness.mean()) / 2,
        scores=tuple(_score(to_truth, to_cloud, threshold) for threshold in thresholds),
        points=len(points), true_points=len(truth),
    )


def _score(to_truth: np.ndarray, to_cloud: np.ndarray, threshold: float) -> Score:
    precision, recall = 100 * float((to_truth < threshold).mean()), 100 * float((to_cloud < threshold).mean())
    fscore = 2 * precision * recall / (precision + recall) if precision + recall else 0.0
    return Score(threshold=threshold, precision=precision, recall=recall, fscore=fscore)


def thin(points: np.ndarray, voxel: float) -> np.ndarray:
    """One of the points (n,3) in each cube of side `voxel`: the first, and never a mean, which would hide noise."""
    cells = np.floor((points - points.min(axis=0)) / voxel).astype(np.int64) if len(points) else np.empty((0, 3))
    first = np.unique(cells, axis=0, return_index=True)[1]
    thinned: np.ndarray = points[np.sort(first)]
    return thinned


def in_box(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(n,) bool, whether points (n,3) lie in the box."""
    inside: np.ndarray = ((points >= low) & (points <= high)).all(axis=1)
    return inside


def in_prism(points: np.ndarray, polygon: np.ndarray, axis: int, low: float, high: float) -> np.ndarray:
    """(n,) bool, whether points (n,3) lie between `low` and `high` on `axis` and, seen along it, in `polygon` (k,3)."""
    across = [a for a in range(3) if a != axis]
    x, y = points[:, across].T
    odd = np.zeros(len(points), bool)  # crossings of a ray in +x, even-odd rule
    corners = polygon[:, across]
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if y0 != y1:
            odd ^= ((y0 > y) != (y1 > y)) & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
    return odd & (points[:, axis] >= low) & (points[:, axis] <= high)


def read_points(path: Path) -> np.ndarray:
    """Points (n,3) float64 of a PLY, or of an .npz with `points` (n,3) or (3,n), times `unit`, where it has one."""
    if path.suffix != ".npz":
        return read_cloud(path).points.astype(np.float64)
    try:
        with np.load(path) as file:
            points: np.ndarray = file["points"] * float(file.get("unit", 1.0))
            if points.shape[1] != 3:  # (3,N), as the sample site keeps it: coordinates by axis compress better
                points = points.T
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise WorkspaceError(f"{path} is not a cloud that can be read: {error}", path=path,
                             remedy="Give a binary PLY, or .npz with the key `points`.") from error
    return points


def read_crop(path: Path) -> tuple[np.ndarray, int, float, float]:
    """Polygon (k,3), axis and its limits from a crop file of Tanks and Temples (SelectionPolygonVolume)."""
    try:
        volume = json.loads(path.read_text())
        axis = "XYZ".index(volume["orthogonal_axis"].upper())
        polygon = np.array(volume["bounding_polygon"], dtype=float).reshape(-1, 3)
        return polygon, axis, float(volume["axis_min"]), float(volume["axis_max"])
    except (OSError, ValueError, KeyError, AttributeError) as error:
        raise WorkspaceError(f"{path} is not a crop volume.", path=path,
                             remedy="It needs bounding_polygon, orthogonal_axis, axis_min and axis_max.") from error


def _read_transform(path: Path) -> np.ndarray:
    try:
        return np.loadtxt(path).reshape(4, 4)
    except (OSError, ValueError) as error:
        raise WorkspaceError(f"{path} is not a 4x4 matrix.", path=path,
                             remedy="It needs four lines of four numbers.") from error


def _crop(args: argparse.Namespace) -> Callable[[np.ndarray], np.ndarray]:
    """What tells the points (n,3) inside the crop that was asked for, as (n,) bool."""
    if args.crop:
        volume = read_crop(args.crop)
        return lambda points: in_prism(points, *volume)
    if args.box:
        return lambda points: in_box(points, np.array(args.box[:3]), np.array(args.box[3:]))
    if args.radius:
        x, y, radius = args.radius
        return lambda points: np.hypot(points[:, 0] - x, points[:, 1] - y) < radius
    return lambda points: np.ones(len(points), bool)


def table(rows: dict[str, CloudErrors]) -> str:
    """Distances and scores of one or more clouds against the same truth, one a row."""
    thresholds = [score.threshold for score in next(iter(rows.values())).scores]
    lines = [f"{'':24}{'points':>10}{'acc.':>9}{'median':>9}{'comp.':>9}{'median':>9}{'overall':>9}"
             + "".join(f"{f'P/R/F at {t:g}':>24}" for t in thresholds)]
    for name, e in rows.items():
        scores = "".join(f"{f'{s.precision:.1f} / {s.recall:.1f} / {s.fscore:.1f}':>24}" for s in e.scores)
        lines.append(f"{name:24.24}{e.points:10d}{e.accuracy:9.4f}{e.accuracy_median:9.4f}{e.completeness:9.4f}"
                     f"{e.completeness_median:9.4f}{e.overall:9.4f}{scores}")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m evaluation.cloud_metrics", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cloud", type=Path)
    parser.add_argument("truth", type=Path)
    parser.add_argument("--thresholds", type=float, nargs="+", required=True, help="in units of the truth")
    parser.add_argument("--max-distance", type=float, default=np.inf, help="for accuracy and completeness alone")
    parser.add_argument("--voxel", type=float, help="thin both clouds to one point a voxel of this side")
    parser.add_argument("--cameras", type=Path, nargs=2, metavar=("ESTIMATED", "TRUE"),
                        help="workspace, COLMAP model or .log: align the cloud by the camera centres")
    parser.add_argument("--transform", type=Path, help="4x4 matrix in a text file, applied to the cloud after that")
    crop = parser.add_mutually_exclusive_group()
    crop.add_argument("--crop", type=Path, help="crop volume of Tanks and Temples (.json)")
    crop.add_argument("--box", type=float, nargs=6, metavar=("X0", "Y0", "Z0", "X1", "Y1", "Z1"))
    crop.add_argument("--radius", type=float, nargs=3, metavar=("X", "Y", "R"), help="upright cylinder")
    parser.add_argument("--json", action="store_true", help="print JSON instead of the table")
    args = parser.parse_args(arguments)
    try:
        points, truth = read_points(args.cloud), read_points(args.truth)
        if args.cameras:
            points = align_cameras(*map(read_centres, args.cameras)).apply(points)
        if args.transform:
            matrix = _read_transform(args.transform)
            points = points @ matrix[:3, :3].T + matrix[:3, 3]
        inside = _crop(args)
        points, truth = points[inside(points)], truth[inside(truth)]
        if args.voxel:
            points, truth = thin(points, args.voxel), thin(truth, args.voxel)
        errors = cloud_errors(points, truth, args.thresholds, args.max_distance)
    except CuReconError as error:
        print(f"{error.message}\n{error.remedy}", file=sys.stderr)
        return error.exit_code
    print(json.dumps(asdict(errors)) if args.json else table({args.cloud.name: errors}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
