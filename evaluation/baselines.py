# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the network is compared with, given the same views, source views and depth ranges (views.json).

    python -m evaluation.baselines WORKSPACE [--method plane-sweep|patchmatch] [--out FOLDER] [--min-confidence 0.3]

FOLDER (default: WORKSPACE-METHOD) becomes a workspace of its own, with copies of views.json, undistorted/ and the
sparse models, its depth maps and, by the same fusion as the network's, its clouds. PatchMatch is that of the package
pyarchinit-photogrammetry-core; its confidence is one less its cost.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from curecon_blender.core.base import images
from curecon_blender.core.base.errors import CuReconError, WorkspaceError
from curecon_blender.core.base.files import disk_errors
from curecon_blender.core.base.messages import Message, Progress, Reporter, Warning
from curecon_blender.core.base.options import Options
from curecon_blender.core.base.records import View
from curecon_blender.core.cloud.fuse import NoPointsError, fuse
from curecon_blender.core.depth.maps import depth_path, write_depth
from curecon_blender.core.views import record as views_record

from .plane_sweep import sweep

Estimate = tuple[np.ndarray, np.ndarray]  # depth (H,W), 0 where none, and confidence (H,W)
Method = Callable[[View, list[View], Path], Estimate]  # of a view, from its sources, their pictures in the folder


def plane_sweep(view: View, sources: list[View], folder: Path) -> Estimate:
    return sweep(view, _grey(folder, view), [(source, _grey(folder, source)) for source in sources])


def patchmatch(view: View, sources: list[View], folder: Path) -> Estimate:
    import ppg_core

    def picture(v: View) -> np.ndarray:
        return np.ascontiguousarray(_grey(folder, v), np.float32) / 255

    def intrinsics(v: View) -> tuple[float, float, float, float]:  # its pixel centres lie at whole numbers
        return float(v.K[0, 0]), float(v.K[1, 1]), float(v.K[0, 2] - 0.5), float(v.K[1, 2] - 0.5)

    others = []
    for source in sources:
        rotation = source.cam_from_world[:, :3] @ view.cam_from_world[:, :3].T
        translation = source.cam_from_world[:, 3] - rotation @ view.cam_from_world[:, 3]
        others.append((picture(source), intrinsics(source), rotation, translation))
    depth, _, cost = ppg_core.patchmatch_depth(picture(view), intrinsics(view), others, (view.near, view.far))
    return depth, np.where(depth > 0, np.clip(1 - cost, 0, 1), 0)


METHODS: dict[str, Method] = {"plane-sweep": plane_sweep, "patchmatch": patchmatch}


def _grey(folder: Path, view: View) -> np.ndarray:
    return np.asarray(cv2.cvtColor(images.read_rgb(folder / view.image), cv2.COLOR_RGB2GRAY))


def run(workspace: Path, out: Path, method: Method, reporter: Reporter) -> float:
    """Depth maps of a workspace's views in another; returns the mean CPU seconds a photo. Finished photos are kept.

    Raises WorkspaceError when the workspace has no views or `out` is the same folder.
    """
    if out.resolve() == workspace.resolve():
        raise WorkspaceError(f"{out} holds the network's depth maps.", path=out, remedy="Give another --out folder.")
    found = views_record.read(workspace)
    views = [(component, view) for component in found for view in component.views]
    with disk_errors(out):
        out.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(workspace / views_record.FILE_NAME, out / views_record.FILE_NAME)
        shutil.copytree(workspace / "undistorted", out / "undistorted", dirs_exist_ok=True)
        for component in found:
            shutil.copytree(workspace / component.sparse, out / component.sparse, dirs_exist_ok=True)
    spent = []
    for done, (component, view) in enumerate(views):
        reporter.progress(done, len(views))
        if depth_path(out, view.name).exists():
            continue
        start = time.process_time()
        by_name = {v.name: v for v in component.views}
        depth, confidence = method(view, [by_name[name] for name, _ in view.sources], workspace)
        write_depth(out, view, depth, confidence)
        spent.append(time.process_time() - start)
    reporter.progress(len(views), len(views))
    return float(np.mean(spent)) if spent else 0.0


def _print(message: Message) -> None:
    if isinstance(message, Progress):
        print(f"{message.stage} {message.done}/{message.total}", file=sys.stderr)
    elif isinstance(message, Warning):
        print(message.text, file=sys.stderr)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m evaluation.baselines", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("workspace", type=Path)
    parser.add_argument("--method", choices=METHODS, default="plane-sweep")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--min-confidence", type=float, default=Options.min_confidence)
    parser.add_argument("--json", action="store_true", help="print JSON in place of a line of text")
    args = parser.parse_args(arguments)
    out = args.out or args.workspace.with_name(f"{args.workspace.name}-{args.method}")
    reporter = Reporter(_print)
    reporter.begin({"depth": 0.9, "fusion": 0.1})
    options = Options(photos=args.workspace, workspace=out, min_confidence=args.min_confidence)
    try:
        reporter.stage("depth")
        seconds = run(args.workspace, out, METHODS[args.method], reporter)
        reporter.stage("fusion")
        points = {}
        for component in views_record.read(out):
            try:
                points[component.cloud] = fuse(component, out, options, reporter)
            except NoPointsError as error:
                reporter.warning(f"{error.message} {error.remedy}")
        if not points:
            return NoPointsError.exit_code
    except CuReconError as error:
        print(f"{error.message}\n{error.remedy}", file=sys.stderr)
        return error.exit_code
    if args.json:
        print(json.dumps({"workspace": str(out), "seconds_per_photo": seconds, "points": points}))
    else:
        print(f"{out}: {seconds:.1f} CPU s a photo; " + ", ".join(f"{n} points in {c}" for c, n in points.items()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
