# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The measures on inputs whose answers are known by hand, the plane sweep on a ray-cast scene, and the commands."""

from __future__ import annotations

import importlib
import io
import json
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap
import pytest
from box_scene import cast, make_view, surface_distance, write_depth, write_model, write_scene
from scipy.spatial.transform import Rotation

from curecon_blender.core.base.errors import CuReconError, WorkspaceError
from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.base.options import Options
from curecon_blender.core.base.records import Frame, GeoPosition, View
from curecon_blender.core.cloud.fuse import fuse
from curecon_blender.core.cloud.ply import Cloud, CloudWriter, read_cloud
from curecon_blender.core.views import record as components
from evaluation import baselines, cloud_metrics, depth_metrics, error_classes, plane_sweep, site
from evaluation.alignment import align, read_centres
from evaluation.depth_metrics import DepthRange, depth_errors
from training.generator import Scene, save

ROOT = Path(__file__).resolve().parents[1]


@dataclass
class Done:
    returncode: int
    stdout: str
    stderr: str


def command(module: str, *arguments: object) -> Done:
    """Run a command in this process: a test below starts each as `python -m` too."""
    with redirect_stdout(io.StringIO()) as out, redirect_stderr(io.StringIO()) as err:
        code = importlib.import_module(f"evaluation.{module}").main([str(a) for a in arguments])
    return Done(code, out.getvalue(), err.getvalue())


def answer(module: str, *arguments: object) -> Any:
    done = command(module, *arguments, "--json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("module", ["depth_metrics", "cloud_metrics", "baselines", "site", "validation"])
def test_each_starts_as_a_command_and_explains_itself(module: str) -> None:
    done = subprocess.run([sys.executable, "-m", f"evaluation.{module}", "--help"], cwd=ROOT, capture_output=True,
                          text=True, timeout=120, check=True)
    assert f"python -m evaluation.{module}" in done.stdout and "--json" in done.stdout


def write_pfm(path: Path, depth: np.ndarray) -> None:
    header = f"Pf\n{depth.shape[1]} {depth.shape[0]}\n-1.0\n"
    path.write_bytes(header.encode() + depth[::-1].astype("<f4").tobytes())


def write_ply(path: Path, points: np.ndarray) -> None:
    count = len(points)
    with CloudWriter(path) as writer:
        writer.write(Cloud(points, np.zeros((count, 3), np.uint8), np.zeros((count, 3)), np.ones(count),
                           np.full(count, 3, np.uint8)))


# ---- depth

def test_depth_off_by_two_intervals() -> None:
    """Range 10 to 138 m: 128 intervals of 1 m. A quarter of the pixels is 2 m off, a quarter 4 m, one has no truth."""
    truth = np.full((4, 4), 20.0)
    predicted = truth.copy()
    predicted[0] += 2
    predicted[1] -= 4
    truth[3, 3] = 0
    errors = depth_errors(predicted, truth, DepthRange.of(10, 138))
    assert errors.epe == pytest.approx((4 * 2 + 4 * 4) / 15)
    assert errors.e1 == pytest.approx(100 * 8 / 15)
    assert errors.e3 == pytest.approx(100 * 4 / 15)
    assert errors.abs_rel == pytest.approx(100 * (4 * 2 + 4 * 4) / 20 / 15)
    assert errors.coverage == 100
    assert errors.median == 2


def test_depth_counts_only_true_pixels_in_range_and_says_what_is_missing() -> None:
    truth = np.array([[20.0, 20.0, 5.0, np.nan]])
    errors = depth_errors(np.array([[21.0, 0.0, 50.0, 9.0]]), truth, DepthRange.of(10, 138))
    assert (errors.epe, errors.coverage) == (1.0, 50.0)
    nothing = depth_errors(np.zeros((1, 4)), truth, DepthRange.of(10, 138))
    assert nothing.coverage == 0 and np.isnan(nothing.epe)
    with pytest.raises(WorkspaceError, match="shape"):
        depth_errors(np.ones((2, 2)), truth, DepthRange.of(10, 138))


def test_depth_command_on_blendedmvs_files(tmp_path: Path) -> None:
    """PFM and cam.txt as that set has them; its own interval is the unit, and its range the limit."""
    for folder in ("rendered_depth_maps", "cams", "mine"):
        (tmp_path / folder).mkdir()
    truth = np.linspace(1.0, 2.0, 12, dtype=np.float32).reshape(3, 4)
    (tmp_path / "cams" / "00000000_cam.txt").write_text(
        "extrinsic\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n\nintrinsic\n9 0 2\n0 9 1.5\n0 0 1\n\n"
        "1.21079 0.00412819 128.0 1.7392 \n"
    )
    write_pfm(tmp_path / "rendered_depth_maps" / "00000000.pfm", truth)
    predicted = truth.copy()
    predicted[truth <= 1.7392] += 2 * 0.00412819
    predicted[truth > 1.7392] = 9
    np.savez(tmp_path / "mine" / "00000000.jpg.npz", depth=predicted, confidence=np.ones_like(truth))
    mean = answer("depth_metrics", tmp_path / "mine", tmp_path / "rendered_depth_maps",
                  "--cameras", tmp_path / "cams")["mean"]
    assert mean["epe"] == pytest.approx(2, abs=1e-3)
    assert (mean["e1"], mean["e3"], mean["coverage"]) == (100, 0, 100)


def test_depth_command_over_single_files_with_confidence(tmp_path: Path) -> None:
    truth = np.full((2, 2), 50.0, np.float32)
    np.save(tmp_path / "truth.npy", truth)
    np.savez(tmp_path / "mine.npz", depth=truth + [[0, 0], [3, 3]], confidence=[[0.9, 0.9], [0.1, 0.1]])
    files = tmp_path / "mine.npz", tmp_path / "truth.npy"
    assert answer("depth_metrics", *files, "--range", 0, 128)["mean"]["epe"] == 1.5
    sure = answer("depth_metrics", *files, "--range", 0, 128, "--min-confidence", 0.5)["mean"]
    assert (sure["epe"], sure["coverage"]) == (0, 50)
    shown = command("depth_metrics", *files, "--range", 0, 128)
    assert "EPE" in shown.stdout and "1.500" in shown.stdout


@pytest.mark.parametrize("case", ["no folder", "empty folder", "missing map", "not a map", "no confidence", "no range"])
def test_depth_command_explains_bad_input(tmp_path: Path, case: str) -> None:
    mine, truth = tmp_path / "mine", tmp_path / "truth"
    truth.mkdir()
    np.save(truth / "a.npy", np.ones((2, 2)))
    extra: tuple[object, ...] = ("--range", 0.5, 2)
    if case != "no folder":
        mine.mkdir()
    if case == "missing map":
        np.save(mine / "b.npy", np.ones((2, 2)))
    elif case == "not a map":
        (mine / "a.npy").write_text("hello")
    elif case == "no confidence":
        np.save(mine / "a.npy", np.ones((2, 2)))
        extra += ("--min-confidence", 0.3)
    elif case == "no range":
        np.save(mine / "a.npy", np.ones((2, 2)))
        (tmp_path / "a_cam.txt").write_text("nothing\n")
        extra = ("--cameras", tmp_path)
    done = command("depth_metrics", mine, truth, *extra)
    assert done.returncode == WorkspaceError.exit_code
    assert str(tmp_path) in done.stderr and "Traceback" not in done.stderr


# ---- clouds

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


# ---- plane sweep

@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, dict]:
    """A workspace of four photos on an arc, and what the plane sweep's command made of it."""
    workspace = tmp_path_factory.mktemp("sweep") / "site one"
    write_scene(workspace, [make_view(i, 4, arc=32.0) for i in range(4)])
    summary = answer("baselines", workspace)
    return workspace, workspace.with_name("site one-plane-sweep"), summary


def test_plane_sweep_recovers_the_scene(swept: tuple[Path, Path, dict]) -> None:
    workspace, out, _ = swept
    view = components.read(workspace)[0].views[1]
    truth, _ = cast(view)
    depth_range = DepthRange.of(view.near, view.far)
    errors = depth_errors(depth_metrics.read_depth(out / "depth" / f"{view.name}.npz"), truth, depth_range)
    assert errors.coverage > 95
    assert errors.e1 < 25 and errors.median < 0.5 * depth_range.interval  # the rest: occlusion, and too few photos
    sure = depth_errors(depth_metrics.read_depth(out / "depth" / f"{view.name}.npz", 0.8), truth, depth_range)
    assert sure.e1 < errors.e1 and sure.coverage > 50


def test_plane_sweep_fuses_into_a_workspace_of_its_own(swept: tuple[Path, Path, dict]) -> None:
    workspace, out, summary = swept
    cloud = read_cloud(out / "cloud.ply")
    assert summary["workspace"] == str(out) and summary["points"] == {"cloud.ply": len(cloud)}
    assert len(cloud) > 5000 and np.median(surface_distance(cloud.points)) < 0.02
    assert components.read(out)[0].views[0].name == components.read(workspace)[0].views[0].name
    assert len(read_centres(out / "sparse" / "0")) == 4
    assert not (workspace / "cloud.ply").exists()  # the network's workspace is left alone


def test_plane_sweep_does_not_write_over_the_networks_depth(swept: tuple[Path, Path, dict]) -> None:
    workspace = swept[0]
    done = command("baselines", workspace, "--out", workspace)
    assert done.returncode == WorkspaceError.exit_code and "--out" in done.stderr


def test_plane_sweep_goes_on_from_the_last_finished_photo(swept: tuple[Path, Path, dict]) -> None:
    workspace, out, _ = swept
    done, missing, *_ = sorted((out / "depth").iterdir())
    before, depth = done.stat().st_mtime_ns, depth_metrics.read_depth(missing)
    missing.unlink()
    baselines.run(workspace, out, baselines.plane_sweep, Reporter())
    assert done.stat().st_mtime_ns == before
    np.testing.assert_array_equal(depth_metrics.read_depth(missing), depth)


def test_plane_sweep_of_a_level_plane_is_exact_below_an_interval() -> None:
    """Straight down on the ground, beyond the box: depth is one number, between two planes."""
    looking_down = make_view(0, 12, radius=6.0, elevation=89.0)
    views = [replace(looking_down, cam_from_world=np.column_stack([
        looking_down.cam_from_world[:, :3],
        -looking_down.cam_from_world[:, :3] @ (looking_down.centre + [20 + 0.4 * i, 0, 0])])) for i in range(3)]
    greys = [cast(view)[1].mean(axis=-1).astype(np.uint8) for view in views]
    depth, confidence = plane_sweep.sweep(views[1], greys[1], [(views[0], greys[0]), (views[2], greys[2])])
    truth, _ = cast(views[1])
    errors = depth_errors(depth, truth, DepthRange.of(views[1].near, views[1].far))
    assert errors.e1 < 2 and errors.median < 0.1 * (views[1].far - views[1].near) / 128
    assert np.median(confidence) > 0.9


# ---- the sample site's report

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


# The network may be 2 % of the distance off, as in test_network.py: its training will change it.
@pytest.mark.parametrize(("method", "metres"), [("network", 0.12), ("plane-sweep", 0.05), ("patchmatch", 0.05)])
def test_every_method_of_the_validation_finds_the_box(method: str, metres: float, tmp_path: Path) -> None:
    views = [make_view(i, 30) for i in range(5)]
    depth, pictures = zip(*(cast(view) for view in views), strict=True)
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-2.5, 2.5, (300, 2)), np.zeros(300)])
    scene = Scene(np.stack(pictures), np.stack(depth), np.stack([v.K for v in views]),
                  np.stack([v.cam_from_world for v in views]), points.astype(np.float32), np.ones((5, 300), bool))
    save(scene, tmp_path / "1.npz")
    found = answer("validation", tmp_path, "--methods", method, "--references", 1)[method]
    assert found["errors"]["median"] < metres and found["errors"]["coverage"] > 50
    assert found["observed"]["e3"] <= found["errors"]["e3"]  # what sources see is measured better than what is guessed
    assert sum(found["shares"]["epe"]) == pytest.approx(found["errors"]["epe"])
    if method == "network":
        untold = answer("validation", tmp_path, "--methods", method, "--references", 1, "--without-points")[method]
        assert untold["errors"]["median"] < metres and untold["errors"] != found["errors"]


def test_each_pixel_belongs_to_the_first_class_that_takes_it() -> None:
    truth = np.full((120, 160), 20.0, np.float32)
    truth[:30] = 0  # sky
    truth[70:, 90:] = 14.0  # a wall before another
    truth[100:, 20:60] = 5.0  # nearer than the sweep begins
    seen = np.full(truth.shape, 2)
    seen[50:60], seen[60:65] = 0, 1
    of = error_classes.classes(truth, seen, 10.0, 30.0)
    at = {(55, 4): 0, (62, 50): 1, (34, 80): 2, (80, 2): 2, (90, 88): 3, (105, 30): 4, (45, 80): 5, (85, 130): 5}
    assert {place: int(of[place]) for place in at} == at

    depth, confidence = truth + 1, np.where(truth > 0, 0.9, 0.2)
    depth[50:60] += 5
    found = error_classes.shares(depth, confidence, truth, DepthRange.of(10.0, 20.0), of)
    assert found.epe.sum() == pytest.approx(depth_errors(depth, truth, DepthRange.of(10.0, 20.0)).epe)
    assert found.far_off[0] == found.epe[0] > found.epe[1] and found.sky == pytest.approx(0.2)
