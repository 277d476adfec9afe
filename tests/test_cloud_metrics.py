# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The measures of clouds on inputs whose answers are known by hand, and the sample site's report."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
from box_scene import cast, make_view, write_depth, write_model, write_scene
from evaluated import answer, command, write_ply
from scipy.spatial.transform import Rotation

from curecon_blender.core.base.errors import CuReconError, WorkspaceError
from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.base.options import Options
from curecon_blender.core.base.records import Frame, GeoPosition, View
from curecon_blender.core.cloud.fuse import fuse
from curecon_blender.core.cloud.ply import read_cloud
from curecon_blender.core.views import record as components
from evaluation import cloud_metrics, site
from evaluation.alignment import align


def plate(step: float = 0.1, side: int = 21) -> np.ndarray:
    """A level square of side x side points at z = 0."""
    x, y = np.meshgrid(np.arange(side) * step, np.arange(side) * step)
    return np.stack([x.ravel(), y.ravel(), np.zeros(side * side)], axis=1)


def test_a_cloud_shifted_by_three_centimetres() -> None:
    errors = cloud_metrics.cloud_errors(plate() + [0, 0, 0.03], plate(), [0.02, 0.05])
    assert errors.accuracy == errors.completeness == pytest.approx(0.03)
    assert errors.overall == pytest.approx(0.03) and errors.accuracy_median == pytest.approx(0.03)
    assert [s.fscore for s in errors.scores] == [0, 100]


def test_half_a_cloud_and_outliers() -> None:
    """The left half of the plate (231 of 441 points) is there; every eleventh of 462 points is 5 m above it."""
    truth = plate()
    half = truth[truth[:, 0] < 1.05]
    points = np.concatenate([half, half[:42] + [0, 0, 5]])
    errors = cloud_metrics.cloud_errors(points, truth, [0.05], max_distance=1.0)
    assert errors.scores[0].precision == pytest.approx(100 * 231 / 273)
    assert errors.scores[0].recall == pytest.approx(100 * 231 / 441)
    assert errors.scores[0].fscore == pytest.approx(200 * 231 / (273 + 441))
    assert errors.accuracy == pytest.approx(0)  # the outliers are beyond the maximum distance
    assert errors.completeness == pytest.approx(np.mean([0] * 231 + [0.1 * i for i in range(1, 10) for _ in range(21)]))
    assert cloud_metrics.cloud_errors(points, truth, [0.05]).accuracy == pytest.approx(5 * 42 / 273, rel=0.01)


def test_thinning_keeps_one_point_a_voxel_and_moves_none() -> None:
    points = plate(step=0.01, side=100) + 1e-4
    thinned = cloud_metrics.thin(points, 0.1)
    assert len(thinned) == 100
    assert {tuple(p) for p in thinned} <= {tuple(p) for p in points}


def test_crop_volume_of_tanks_and_temples(tmp_path: Path) -> None:
    """An L-shaped prism along Y: x-z corners (0,0) (2,0) (2,1) (1,1) (1,2) (0,2), 0 <= y <= 1."""
    corners = [[0, 0, 0], [2, 0, 0], [2, 0, 1], [1, 0, 1], [1, 0, 2], [0, 0, 2]]
    (tmp_path / "crop.json").write_text(json.dumps({
        "class_name": "SelectionPolygonVolume", "orthogonal_axis": "Y", "axis_min": 0.0, "axis_max": 1.0,
        "bounding_polygon": corners, "version_major": 1, "version_minor": 0,
    }))
    points = np.array([[0.5, 0.5, 1.5], [1.5, 0.5, 0.5], [1.5, 0.5, 1.5], [0.5, 1.5, 0.5], [-0.1, 0.5, 0.5]])
    inside = cloud_metrics.in_prism(points, *cloud_metrics.read_crop(tmp_path / "crop.json"))
    assert inside.tolist() == [True, True, False, False, False]


def test_alignment_undoes_a_similarity() -> None:
    rng = np.random.default_rng(1)
    source = rng.normal(size=(10, 3))
    rotation = Rotation.from_euler("xyz", [20, -50, 130], degrees=True).as_matrix()
    target = 2.5 * source @ rotation.T + [10, -20, 3]
    found = align(source, target)
    assert found.scale == pytest.approx(2.5)
    np.testing.assert_allclose(found.apply(source), target, atol=1e-9)
    flat = source * [1, 1, 0]  # a level flight has no reflection
    np.testing.assert_allclose(align(flat, 2.5 * flat @ rotation.T).apply(source), 2.5 * source @ rotation.T, atol=1e-9)
    with pytest.raises(CuReconError, match="three"):
        align(source[:2], target[:2])


def test_cloud_command_with_cameras_and_crop(tmp_path: Path) -> None:
    """A cloud in a frame of its own, brought over by its cameras: a COLMAP model against a trajectory .log."""
    rotation = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    truth = np.concatenate([plate(), plate() + [9, 0, 0]])
    mine = (truth - [1, 2, 3]) @ rotation / 2  # its inverse: x -> 2 R x + t
    views = [replace(view, name=f"{i + 1:06d}.jpg") for i, view in enumerate(make_view(i, 5) for i in range(5))]
    own = [replace(view, cam_from_world=own_pose(view, rotation)) for view in views]
    write_model(tmp_path / "model", own)
    lines = []
    for i, view in enumerate(views):
        pose = np.linalg.inv(np.vstack([view.cam_from_world, [0, 0, 0, 1]]))
        lines += [f"{i} {i} 0", *(" ".join(map(str, row)) for row in pose)]
    (tmp_path / "truth.log").write_text("\n".join(lines) + "\n")
    write_ply(tmp_path / "mine.ply", mine)
    np.savez(tmp_path / "truth.npz", points=np.round(truth * 1000).astype(np.int16), unit=0.001)
    files = tmp_path / "mine.ply", tmp_path / "truth.npz", "--thresholds", 0.01
    cameras = "--cameras", tmp_path / "model", tmp_path / "truth.log"
    assert answer("cloud_metrics", *files)["scores"][0]["fscore"] < 50
    aligned = answer("cloud_metrics", *files, *cameras)
    assert aligned["scores"][0]["fscore"] == 100 and aligned["points"] == 882
    assert answer("cloud_metrics", *files, *cameras, "--box", -1, -1, -1, 3, 3, 1)["points"] == 441
    assert answer("cloud_metrics", *files, *cameras, "--radius", 0, 0, 4)["true_points"] == 441
    np.savetxt(tmp_path / "matrix.txt", np.vstack([np.column_stack([2 * rotation, [1, 2, 3]]), [0, 0, 0, 1]]))
    assert answer("cloud_metrics", *files, "--transform", tmp_path / "matrix.txt")["accuracy"] < 1e-3


def own_pose(view: View, rotation: np.ndarray) -> np.ndarray:
    """cam_from_world in the frame x, where the view's world is 2 R x + (1, 2, 3); lengths are halved."""
    turned = view.cam_from_world[:, :3] @ rotation
    return np.column_stack([turned, (view.cam_from_world[:, :3] @ [1, 2, 3] + view.cam_from_world[:, 3]) / 2])


def test_cloud_command_explains_bad_input(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", plate())
    (tmp_path / "text.ply").write_text("hello")
    cases = (("none.ply", "a.ply"), ("text.ply", "a.ply"), ("a.ply", "a.ply", "--radius", "90", "90", "1"),
             ("a.ply", "a.ply", "--cameras", ".", "."), ("a.ply", "a.ply", "--crop", "text.ply"))
    for cloud, truth, *extra in cases:
        extra = [str(tmp_path / word) if word in (".", "text.ply") else word for word in extra]
        done = command("cloud_metrics", tmp_path / cloud, tmp_path / truth, "--thresholds", 1, *extra)
        assert done.returncode in (4, 5) and done.stderr.count("\n") == 2 and "Traceback" not in done.stderr


def test_cameras_of_blendedmvs_become_a_colmap_model(tmp_path: Path) -> None:
    views = [make_view(i, 4) for i in range(3)]
    (tmp_path / "cams").mkdir()
    (tmp_path / "photos").mkdir()
    for i, view in enumerate(views):
        rows = [*view.cam_from_world, [0, 0, 0, 1]]
        numbers = ["\n".join(" ".join(map(str, row)) for row in matrix) for matrix in (rows, view.K)]
        (tmp_path / "cams" / f"{i:08d}_cam.txt").write_text(
            f"extrinsic\n{numbers[0]}\n\nintrinsic\n{numbers[1]}\n\n1.0 0.01 128 2.28\n"
        )
        cv2.imwrite(str(tmp_path / "photos" / f"{i:08d}.jpg"), np.zeros((view.height, view.width, 3), np.uint8))
        cv2.imwrite(str(tmp_path / "photos" / f"{i:08d}_masked.jpg"), np.zeros((view.height, view.width, 3), np.uint8))
    done = command("mvsnet_cameras", tmp_path / "cams", tmp_path / "photos", tmp_path / "model")
    assert done.returncode == 0 and "3 cameras" in done.stdout
    model = pycolmap.Reconstruction(tmp_path / "model")
    for image in model.images.values():
        view = views[int(image.name[:8])]
        np.testing.assert_allclose(image.cam_from_world().matrix(), view.cam_from_world, atol=1e-9)
        np.testing.assert_allclose(image.camera.calibration_matrix(), view.K)
    swapped = command("mvsnet_cameras", tmp_path / "photos", tmp_path / "cams", tmp_path / "model")
    assert swapped.returncode == WorkspaceError.exit_code and "cam.txt" in swapped.stderr


def test_site_report(tmp_path: Path) -> None:
    """A perfect reconstruction in a frame 1 % too small and 5 m off, whose GPS origin lies 3 m east of the truth's."""
    views = [make_view(i, 8) for i in range(8)]
    site_folder, depth_folder, workspace = tmp_path / "site", tmp_path / "true depth", tmp_path / "mine"
    write_model(site_folder / "truth", views)
    origin = {"latitude": 25.0, "longitude": 117.0, "altitude": 600.0}
    (site_folder / "truth" / "origin.json").write_text(json.dumps(origin))
    depth_folder.mkdir()
    for view in views:
        np.savez(depth_folder / f"{Path(view.name).stem}.npz", depth=cast(view)[0])
    # The exact scene and its cloud are written first, then brought into the frame x' = 0.99 (x + (5, 0, 0)).
    component = write_scene(tmp_path / "exact", views)
    fuse(component, tmp_path / "exact", Options(photos=tmp_path, workspace=tmp_path), Reporter())
    points = read_cloud(tmp_path / "exact" / "cloud.ply").points.astype(float)
    np.savez(site_folder / "truth" / "cloud.npz", points=np.round(points * 1000).astype(np.int16), unit=0.001,
             radius=4.0)
    moved = [replace(view, cam_from_world=np.column_stack([
        view.cam_from_world[:, :3], 0.99 * (view.cam_from_world[:, 3] - view.cam_from_world[:, :3] @ [5, 0, 0])
    ])) for view in component.views]
    write_model(workspace / "sparse" / "0", moved)
    (workspace / "depth").mkdir()
    for view in moved:
        depth = 0.99 * cast(views[[v.name for v in views].index(view.name)])[0]
        depth[:30] = 0
        write_depth(workspace, view, depth, np.where(np.arange(depth.shape[1]) < 80, 0.9, 0.1) + 0 * depth)
    write_ply(workspace / "cloud.ply", 0.99 * (points + [5, 0, 0]))
    east = 3 / (111_320 * np.cos(np.radians(25.0)))
    frame = Frame(scale="metres", up="gps", north=True, origin=GeoPosition(latitude=25.0, longitude=117.0 + east,
                                                                           altitude=600.0))
    components.write(workspace, [replace(component, frame=frame, views=tuple(moved))])

    found = site.report(workspace, site_folder, depth_folder)
    assert (found.cameras.registered, found.cameras.photos, found.cameras.components) == (8, 8, 1)
    assert found.cameras.rmse < 1e-6 and found.cameras.scale == pytest.approx(1 / 0.99)
    offset = [np.linalg.norm(0.99 * (v.centre + [5, 0, 0]) + [3, 0, 0] - v.centre) for v in views]
    assert found.cameras.placed_median == pytest.approx(np.median(offset), abs=0.02)
    assert found.depth is not None and found.depth_confident is not None
    assert found.depth.epe < 1e-3 and 60 < found.depth.coverage < 90
    assert found.depth_confident.coverage == pytest.approx(found.depth.coverage / 2, abs=5)
    assert found.cloud.scores[0].fscore > 99 and found.cloud.accuracy < 0.001

    both = command("site", workspace, workspace, site_folder, "--depth", depth_folder)
    assert both.returncode == 0, both.stderr
    assert both.stdout.count("8 of 8 photos") == 2 and "F at 0.1" in both.stdout
    without = answer("site", workspace, site_folder)
    assert without[0]["depth"] is None and without[0]["cloud"]["scores"][1]["threshold"] == 0.2
    next(depth_folder.iterdir()).unlink()
    missing = command("site", workspace, site_folder, "--depth", depth_folder)
    assert missing.returncode == WorkspaceError.exit_code and "make_site.py depth" in missing.stderr
