# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How far a depth map is from the truth, by BlendedMVS's measures.

BlendedMVS measures in "depth-wise pixels": the depth error over the depth interval of that view, which its cam.txt
gives and which is (depth_max - depth_min) / 128 there. EPE is the mean of it, e1 and e3 the percentages of pixels
with more than 1 and 3. Pixels count where the truth lies in the depth range, as in Vis-MVSNet's code and others, and
the figures of a set are the means over its maps.

    python -m evaluation.depth_metrics PREDICTED TRUTH [--cameras FOLDER | --range NEAR FAR] [--json]

PREDICTED and TRUTH are files, or folders whose files belong together by name: .npz (key `depth`, and `confidence` if
there), .npy or .pfm. The range of a map comes from `--range`, from `--cameras` (NAME_cam.txt as in BlendedMVS), or
else from the 1st and 99th percentile of its true depth.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import zipfile
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

from curecon_blender.core.base.errors import CuReconError, WorkspaceError

INTERVALS = 128
SUFFIXES = (".npz", ".npy", ".pfm")
PHOTO_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff")


@dataclass(frozen=True, kw_only=True)
class DepthRange:
    """Of one view, in units of its depth: pixels outside [near, far] do not count; `interval` is the unit of error."""

    near: float
    far: float
    interval: float

    @classmethod
    def of(cls, near: float, far: float) -> DepthRange:
        return cls(near=near, far=far, interval=(far - near) / INTERVALS)


@dataclass(frozen=True, kw_only=True)
class DepthErrors:
    """`epe` in depth intervals; `e1`, `e3`, `abs_rel` and `coverage` in percent; `mean` and `median` absolute error
    in units of depth. `coverage` is the share of the true pixels that have a prediction; the errors are over those."""

    epe: float
    e1: float
    e3: float
    abs_rel: float
    mean: float
    median: float
    coverage: float


def true_range(truth: np.ndarray) -> DepthRange:
    """The 1st to 99th percentile of the true depth (0 = none)."""
    near, far = np.percentile(truth[truth > 0], (1, 99))
    return DepthRange.of(float(near), float(far))


def depth_errors(predicted: np.ndarray, truth: np.ndarray, depth_range: DepthRange) -> DepthErrors:
    """Errors of `predicted` (H,W) against `truth` (H,W): z-depth, 0 or not finite = none.

    A map without any prediction has coverage 0 and errors NaN. Raises WorkspaceError when the shapes differ or no
    true depth lies in the range.
    """
    if predicted.shape != truth.shape:
        raise WorkspaceError(f"Predicted depth has shape {predicted.shape}, true depth {truth.shape}.",
                             remedy="Bring one of them to the size of the other, with its camera.")
    valid = np.isfinite(truth) & (truth > 0) & (truth >= depth_range.near) & (truth <= depth_range.far)
    if not valid.any():
        raise WorkspaceError(f"No true depth lies between {depth_range.near:g} and {depth_range.far:g}.",
                             remedy="Check the depth range and the units of the true depth.")
    both = valid & np.isfinite(predicted) & (predicted > 0)
    coverage = 100 * both.sum() / valid.sum()
    if not both.any():
        nan = float("nan")
        return DepthErrors(epe=nan, e1=nan, e3=nan, abs_rel=nan, mean=nan, median=nan, coverage=0.0)
    true = truth[both].astype(np.float64)
    error = np.abs(predicted[both] - true)
    scaled = error / depth_range.interval
    return DepthErrors(
        epe=float(scaled.mean()), e1=float(100 * (scaled > 1).mean()), e3=float(100 * (scaled > 3).mean()),
        abs_rel=float(100 * (error / true).mean()), mean=float(error.mean()), median=float(np.median(error)),
        coverage=float(coverage),
    )


def mean_errors(errors: list[DepthErrors]) -> DepthErrors:
    """Mean over maps; a map without any prediction counts in the coverage alone."""
    measured = [e for e in errors if e.coverage > 0] or errors
    means = {f.name: float(np.mean([getattr(e, f.name) for e in measured])) for f in fields(DepthErrors)}
    return DepthErrors(**{**means, "coverage": float(np.mean([e.coverage for e in errors]))})


def read_depth(path: Path, min_confidence: float = 0.0) -> np.ndarray:
    """A depth map (H,W) float32 from .npz, .npy or .pfm; pixels below `min_confidence` become 0 (.npz alone has it).

    Raises WorkspaceError for a file that is missing or not a depth map.
    """
    try:
        if path.suffix == ".pfm":
            depth, confidence = read_pfm(path), None
        elif path.suffix == ".npy":
            depth, confidence = np.load(path), None
        else:
            with np.load(path) as file:
                depth = file["depth"]
                confidence = file.get("confidence", None)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise WorkspaceError(
            f"{path} is not a depth map that can be read: {error}", path=path,
            remedy="Give .npz with the key `depth`, .npy, or .pfm with one channel.",
        ) from error
    depth = np.squeeze(depth).astype(np.float32)
    if depth.ndim != 2:
        raise WorkspaceError(f"{path} has shape {depth.shape}, not (H, W).", path=path,
                             remedy="Give depth maps of one channel.")
    if min_confidence > 0:
        if confidence is None:
            raise WorkspaceError(f"{path} has no confidence.", path=path, remedy="Leave out --min-confidence.")
        depth[np.squeeze(confidence) < min_confidence] = 0
    return depth


def read_pfm(path: Path) -> np.ndarray:
    """The picture (H,W) or (H,W,3) float32 in a .pfm, top row first."""
    with open(path, "rb") as file:
        kind = file.readline().strip()
        size = re.fullmatch(rb"(\d+)\s+(\d+)", file.readline().strip())
        if kind not in (b"Pf", b"PF") or size is None:
            raise ValueError("not a PFM header")
        width, height = int(size[1]), int(size[2])
        order = "<" if float(file.readline()) < 0 else ">"
        shape = (height, width) if kind == b"Pf" else (height, width, 3)
        values = np.fromfile(file, f"{order}f4")
    return values.reshape(shape)[::-1].astype(np.float32)


def read_camera_range(path: Path) -> DepthRange:
    """From the last line of a cam.txt: depth_min, interval, and in BlendedMVS also the number of planes, depth_max."""
    try:
        numbers = [float(word) for word in path.read_text().strip().splitlines()[-1].split()]
        if len(numbers) == 4:
            return DepthRange(near=numbers[0], far=numbers[3], interval=numbers[1])
        near, interval = numbers
        return DepthRange(near=near, far=near + (INTERVALS - 1) * interval, interval=interval)
    except (OSError, ValueError, IndexError) as error:
        raise WorkspaceError(
            f"{path} gives no depth range.", path=path,
            remedy="Its last line has to be: depth_min interval [planes depth_max].",
        ) from error


def pairs(predicted: Path, truth: Path) -> list[tuple[Path, Path]]:
    """Predicted and true files that belong together: NAME.npz, NAME.JPG.npz and NAME.pfm are all of NAME.

    Raises WorkspaceError when no two do; a truth without prediction is an error too, or coverage would flatter.
    """
    if predicted.is_file() and truth.is_file():
        return [(predicted, truth)]
    for folder in (predicted, truth):
        if not folder.is_dir():
            raise WorkspaceError(f"{folder} does not exist, or is a file beside a folder.", path=folder,
                                 remedy="Give two files or two folders.")
    ours, true = _by_name(predicted), _by_name(truth)
    if not true or not ours:
        empty = truth if not true else predicted
        raise WorkspaceError(f"{empty} holds no depth maps.", path=empty, remedy=f"It needs {', '.join(SUFFIXES)}.")
    missing = sorted(set(true) - set(ours))
    if missing:
        raise WorkspaceError(
            f"{predicted} has no depth map for {len(missing)} of {len(true)} true ones, such as {missing[0]}.",
            remedy="Take those out of the folder of true depth maps, or compute them.", path=predicted,
        )
    return [(ours[name], path) for name, path in sorted(true.items())]


def _by_name(folder: Path) -> dict[str, Path]:
    return {photo_name(path): path for path in sorted(folder.iterdir()) if path.suffix in SUFFIXES}


def photo_name(path: Path) -> str:
    """The photo that a depth map belongs to, without extensions: that of the map, and the photo's own before it."""
    stem = Path(path.stem)
    return stem.stem if stem.suffix.lower() in PHOTO_SUFFIXES else stem.name


def to_json(errors: DepthErrors | None) -> dict[str, float | None] | None:
    """Its fields, null for what could not be measured: JSON knows no NaN."""
    if errors is None:
        return None
    return {key: None if np.isnan(value) else value for key, value in asdict(errors).items()}


def table(rows: dict[str, DepthErrors]) -> str:
    lines = [f"{'':24}{'EPE':>9}{'e1 %':>9}{'e3 %':>9}{'abs-rel %':>11}{'median':>10}{'coverage %':>12}"]
    lines += [
        f"{name:24.24}{e.epe:9.3f}{e.e1:9.2f}{e.e3:9.2f}{e.abs_rel:11.3f}{e.median:10.4f}{e.coverage:12.1f}"
        for name, e in rows.items()
    ]
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m evaluation.depth_metrics", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("predicted", type=Path)
    parser.add_argument("truth", type=Path)
    source = parser.add_mutually_exclusive_group()
    source.add_argument("--range", type=float, nargs=2, metavar=("NEAR", "FAR"))
    source.add_argument("--cameras", type=Path, help="folder with NAME_cam.txt, or one such file")
    parser.add_argument("--min-confidence", type=float, default=0.0, help="leave out pixels less sure than this")
    parser.add_argument("--json", action="store_true", help="print JSON instead of the table")
    args = parser.parse_args(arguments)
    try:
        rows = {}
        for predicted, truth in pairs(args.predicted, args.truth):
            true = read_depth(truth)
            name = photo_name(truth)
            if args.range:
                depth_range = DepthRange.of(*args.range)
            elif args.cameras:
                folder = args.cameras
                depth_range = read_camera_range(folder if folder.is_file() else folder / f"{name}_cam.txt")
            else:
                depth_range = true_range(true)
            rows[name] = depth_errors(read_depth(predicted, args.min_confidence), true, depth_range)
    except CuReconError as error:
        print(f"{error.message}\n{error.remedy}", file=sys.stderr)
        return error.exit_code
    mean = mean_errors(list(rows.values()))
    if args.json:
        print(json.dumps({"mean": to_json(mean), "maps": {name: to_json(e) for name, e in rows.items()}}))
    else:
        print(table({**rows, "mean": mean}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
