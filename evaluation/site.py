# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The sample site's report: cameras, depth maps and cloud of one or more workspaces against the exact truth.

    python -m evaluation.site WORKSPACE [WORKSPACE ...] SITE [--depth FOLDER] [--radius 32] [--json] [--truth-ply FILE]

SITE is the sample's folder, such as samples/tulou, with truth/cameras.txt, images.txt, origin.json and cloud.npz.
FOLDER holds its exact depth maps (`python samples/make_site.py depth --out FOLDER`); without it depth is not measured.

* Cameras: distances of the estimated centres from the true ones, as they are (through the geodetic origins of both
  frames: it shows what GPS is worth) and after the similarity that brings them nearest to the truth.
* Depth: an undistorted view's pixel is followed through the estimated camera to its place on the photo, where the true
  depth is read; estimated depth is multiplied by the similarity's scale. So errors of the pose do not count as errors
  of depth. The depth interval is that of the photo's true range. Once for every pixel, and once for those that fusion
  may use.
* Cloud: after the same similarity, thinned to a voxel of 5 cm, both clouds cropped to an upright cylinder about the
  origin. The largest component alone is measured. `--radius 24.5` leaves the building alone, without its surroundings.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from curecon_blender.core.base.errors import CuReconError, WorkspaceError
from curecon_blender.core.base.options import Options
from curecon_blender.core.base.ply import row_type, table, write_ply
from curecon_blender.core.base.records import Component, GeoPosition, View
from curecon_blender.core.compare.geometry import Similarity
from curecon_blender.core.depth.maps import read_depth
from curecon_blender.core.views import record as views_record

from . import cloud_metrics, depth_metrics
from .alignment import align_cameras, read_centres
from .cloud_metrics import CloudErrors
from .depth_metrics import DepthErrors

THRESHOLDS = [0.1, 0.2]  # metres
MAX_DISTANCE = 1.0  # metres; accuracy and completeness are over the points nearer than this
VOXEL = 0.05  # metres


@dataclass(frozen=True, kw_only=True)
class CameraErrors:
    """Distances in metres of the estimated camera centres from the true ones, aligned by a similarity, and as placed
    by GPS (None: the workspace's frame is not tied to the globe). `scale` is true over estimated length."""

    registered: int
    photos: int
    components: int
    rmse: float
    median: float
    largest: float
    scale: float
    placed_rmse: float | None
    placed_median: float | None


@dataclass(frozen=True, kw_only=True)
class SiteReport:
    """One workspace's figures; depth is None where no true depth was given."""

    workspace: str
    cameras: CameraErrors
    depth: DepthErrors | None
    depth_confident: DepthErrors | None
    cloud: CloudErrors


def report(workspace: Path, site: Path, depth_folder: Path | None = None, radius: float | None = None) -> SiteReport:
    """Measure a finished workspace against the truth of a site. Raises WorkspaceError where a file is missing."""
    found = views_record.read(workspace)
    truth = read_centres(site / "truth")
    to_truth = align_cameras(read_centres(workspace), truth)
    depth = confident = None
    if depth_folder is not None:
        depth = depth_against(found[0], workspace, depth_folder, to_truth.scale)
        confident = depth_against(found[0], workspace, depth_folder, to_truth.scale, Options.min_confidence)
    return SiteReport(
        workspace=str(workspace), cameras=_camera_errors(found, truth, to_truth, site), depth=depth,
        depth_confident=confident, cloud=_cloud_errors(workspace / found[0].cloud, to_truth, site, radius),
    )


def _camera_errors(
    found: list[Component], truth: dict[str, np.ndarray], to_truth: Similarity, site: Path
) -> CameraErrors:
    views = [view for view in found[0].views if Path(view.name).stem in truth]
    true = np.array([truth[Path(view.name).stem] for view in views])
    estimated = np.array([view.centre for view in views])
    aligned = np.linalg.norm(to_truth.apply(estimated) - true, axis=1)
    placed = None
    if found[0].frame.origin is not None:
        placed = np.linalg.norm(_on_the_globe(estimated, found[0].frame.origin, site) - true, axis=1)
    return CameraErrors(
        registered=sum(len(component.views) for component in found), photos=len(truth), components=len(found),
        rmse=_rms(aligned), median=float(np.median(aligned)), largest=float(aligned.max()), scale=to_truth.scale,
        placed_rmse=None if placed is None else _rms(placed),
        placed_median=None if placed is None else float(np.median(placed)),
    )


def _on_the_globe(points: np.ndarray, origin: GeoPosition, site: Path) -> np.ndarray:
    """Points (n,3) of a frame with this origin, in the frame of the truth."""
    from curecon_blender.core.base.geodesy import enu_to_geodetic, geodetic_to_enu

    true_origin = GeoPosition(**json.loads((site / "truth" / "origin.json").read_text()))
    return geodetic_to_enu(enu_to_geodetic(points, origin), true_origin)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean()))


def depth_against(
    component: Component, workspace: Path, depth_folder: Path, scale: float, min_confidence: float = 0.0
) -> DepthErrors:
    """Mean errors (metres) of a component's depth maps against true ones of the photos, NAME.npz by photo name.

    `scale` is true over estimated length. Raises WorkspaceError when a photo has no true depth map.
    """
    import pycolmap

    model = pycolmap.Reconstruction(workspace / component.sparse)
    cameras = {image.name: image.camera for image in model.images.values()}
    true_maps = {depth_metrics.photo_name(path): path for path in depth_folder.glob("*.npz")}
    errors = []
    for view in component.views:
        path = true_maps.get(Path(view.name).stem)
        if path is None:
            raise WorkspaceError(f"{depth_folder} has no true depth map of {view.name}.", path=depth_folder,
                                 remedy="Make them all: python samples/make_site.py depth --out FOLDER")
        true = depth_metrics.read_depth(path)
        depth, confidence = read_depth(workspace, view)
        predicted = np.where(confidence >= min_confidence, depth, 0)
        errors.append(depth_metrics.depth_errors(
            predicted * np.float32(scale), _at_photo(true, view, cameras[view.name]), depth_metrics.true_range(true)
        ))
    return depth_metrics.mean_errors(errors)


def _at_photo(true: np.ndarray, view: View, camera: Any) -> np.ndarray:
    """True depth (H',W') of a photo, read at the place of each pixel of its undistorted view (H,W); 0 outside."""
    y, x = np.mgrid[: view.height, : view.width] + 0.5
    rays = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3) @ np.linalg.inv(view.K).T
    pixels = camera.img_from_cam(rays) * (true.shape[1] / camera.width, true.shape[0] / camera.height)
    column, row = np.floor(pixels).astype(int).T
    inside = (column >= 0) & (column < true.shape[1]) & (row >= 0) & (row < true.shape[0])
    found = np.zeros(view.height * view.width, np.float32)
    found[inside] = true[row[inside], column[inside]]
    return found.reshape(view.height, view.width)


def _cloud_errors(cloud: Path, to_truth: Similarity, site: Path, radius: float | None) -> CloudErrors:
    path = site / "truth" / "cloud.npz"
    truth = cloud_metrics.read_points(path)
    if radius is None:
        with np.load(path) as file:
            radius = float(file["radius"])
    points = to_truth.apply(cloud_metrics.read_points(cloud))
    points, truth = (c[np.hypot(c[:, 0], c[:, 1]) < radius] for c in (points, truth))
    return cloud_metrics.cloud_errors(cloud_metrics.thin(points, VOXEL), truth, THRESHOLDS, MAX_DISTANCE)


def write_truth(workspace: Path, site: Path, path: Path) -> None:
    """The true cloud in a workspace's frame, as PLY: for `compare --truth`. Raises WorkspaceError."""
    from_truth = align_cameras(read_centres(workspace), read_centres(site / "truth")).inverse()
    places = from_truth.apply(cloud_metrics.read_points(site / "truth" / "cloud.npz"))
    write_ply(path, {"vertex": table(row_type([("x", "<f4"), ("y", "<f4"), ("z", "<f4")]), {"x y z": places})})


def text(reports: list[SiteReport]) -> str:
    """The reports side by side, for people."""
    names = {report.workspace: Path(report.workspace).name for report in reports}
    lines = ["Cameras"]
    for r in reports:
        c = r.cameras
        placed = "not tied to the globe" if c.placed_rmse is None else (
            f"as placed by GPS RMSE {c.placed_rmse:.3f} m, median {c.placed_median:.3f} m")
        lines.append(
            f"{names[r.workspace]:24.24} {c.registered} of {c.photos} photos in {c.components} component(s); aligned "
            f"RMSE {c.rmse:.3f} m, median {c.median:.3f} m, largest {c.largest:.3f} m, scale {c.scale:.5f}; {placed}"
        )
    confidence = f"Depth, metres: confidence {Options.min_confidence:g} or more"
    for title, rows in (
        ("Depth, metres: all pixels", {names[r.workspace]: r.depth for r in reports}),
        (confidence, {names[r.workspace]: r.depth_confident for r in reports}),
    ):
        measured = {name: errors for name, errors in rows.items() if errors is not None}
        if measured:
            lines += ["", title, depth_metrics.table(measured)]
    if any(r.depth is None for r in reports):
        lines += ["", "Depth: not measured (give --depth)"]
    lines += ["", "Cloud, metres", cloud_metrics.table({names[r.workspace]: r.cloud for r in reports})]
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m evaluation.site", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("workspaces", type=Path, nargs="+", metavar="WORKSPACE")
    parser.add_argument("site", type=Path, metavar="SITE")
    parser.add_argument("--depth", type=Path, help="folder with the exact depth maps")
    parser.add_argument("--radius", type=float, help="metres about the origin (default: that of the true cloud)")
    parser.add_argument("--truth-ply", type=Path, metavar="FILE",
                        help="also write the true cloud in the first workspace's frame, for compare --truth")
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")
    args = parser.parse_args(arguments)
    try:
        if args.truth_ply is not None:
            write_truth(args.workspaces[0], args.site, args.truth_ply)
        reports = [report(workspace, args.site, args.depth, args.radius) for workspace in args.workspaces]
    except CuReconError as error:
        print(f"{error.message}\n{error.remedy}", file=sys.stderr)
        return error.exit_code
    if args.json:
        print(json.dumps([{**asdict(r), "depth": depth_metrics.to_json(r.depth),
                           "depth_confident": depth_metrics.to_json(r.depth_confident)} for r in reports]))
    else:
        print(text(reports))
    return 0


if __name__ == "__main__":
    sys.exit(main())
