# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The plane sweep on a ray-cast scene, and every method of the validation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from box_scene import cast, make_view, surface_distance, write_scene
from evaluated import answer, command

from curecon_blender.core.base.errors import WorkspaceError
from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.cloud.ply import read_cloud
from curecon_blender.core.views import record as components
from evaluation import baselines, depth_metrics, error_classes, plane_sweep
from evaluation.alignment import read_centres
from evaluation.depth_metrics import DepthRange, depth_errors
from training.generator import Scene, save


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
