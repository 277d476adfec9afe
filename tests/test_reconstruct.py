# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The main job as a user runs it: end to end, again, with other options, killed, cancelled, with a given model."""

from __future__ import annotations

import os
import platform
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from conftest import QUICK, ROOT, SITE, SITE_PHOTOS, Run, command, curecon

from curecon_blender.core.base import messages
from curecon_blender.core.cloud.ply import read_cloud
from curecon_blender.core.views.record import read


def times(folder: Path) -> dict[str, int]:
    return {p.name: p.stat().st_mtime_ns for p in folder.iterdir() if not p.name.startswith(".")}


def truth_poses() -> dict[str, np.ndarray]:
    """cam_from_world (3,4) by photo, from the sample site's exact COLMAP text model."""
    poses = {}
    for line in (SITE / "truth" / "images.txt").read_text().splitlines():
        words = line.split()
        if not line.startswith("#") and len(words) == 10:
            w, x, y, z = map(float, words[1:5])
            rotation = np.array([
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ])
            poses[words[9]] = np.column_stack([rotation, np.array(words[5:8], float)])
    return poses


def test_photos_become_a_coloured_cloud_in_metres(finished: tuple[Path, Run]) -> None:
    workspace, run = finished
    assert run.code == 0, run.said
    assert run.summary["photos"] == run.summary["registered"] == len(SITE_PHOTOS)
    assert run.summary["components"][0]["scale"] == "metres"
    assert set(run.summary["seconds"]) == {"photos", "sparse", "adjust", "views", "depth", "fusion"}
    cloud = read_cloud(workspace / "cloud.ply")
    assert len(cloud) == run.summary["points"] > 10_000
    assert cloud.colours.std(axis=0).min() > 5  # a picture, not one colour
    assert cloud.views.min() >= 2 and cloud.confidence.min() >= 0.3
    assert (cloud.confidence > 0).all() and (cloud.confidence <= 1).all() and np.median(cloud.confidence) > 0.3
    np.testing.assert_allclose(np.linalg.norm(cloud.normals, axis=1), 1, atol=1e-3)


def test_depth_files_say_all_that_is_needed_to_use_them(finished: tuple[Path, Run]) -> None:
    workspace, _ = finished
    for view in read(workspace)[0].views:
        with np.load(workspace / "depth" / f"{view.name}.npz") as arrays:
            assert arrays["depth"].shape == arrays["confidence"].shape == (view.height, view.width)
            assert max(view.width, view.height) == 320
            np.testing.assert_array_equal(arrays["K"], view.K)
            np.testing.assert_array_equal(arrays["cam_from_world"], view.cam_from_world)


def test_depth_maps_agree_with_the_sparse_points_that_they_are_told_of(finished: tuple[Path, Run]) -> None:
    from curecon_blender.core.views import sparse_points

    workspace, _ = finished
    for view in read(workspace)[0].views:
        points = sparse_points.read(workspace, view)
        matched = points[points[:, 3] > 0]
        assert len(points) == view.points > len(matched) > 20
        with np.load(workspace / "depth" / f"{view.name}.npz") as arrays:
            depth = arrays["depth"][matched[:, 1].astype(int), matched[:, 0].astype(int)]
        assert np.median(np.abs(depth / matched[:, 2] - 1)) < 0.01


def test_a_second_run_does_nothing(finished: tuple[Path, Run], site_photos: Path) -> None:
    workspace, first = finished
    before = times(workspace / "depth"), times(workspace), times(workspace / "sparse")
    again = curecon("reconstruct", site_photos, "--workspace", workspace, *QUICK)
    assert again.code == 0
    assert again.said.count("already done") == 6
    assert (times(workspace / "depth"), times(workspace), times(workspace / "sparse")) == before
    assert again.summary["points"] == first.summary["points"]


def test_a_fusion_option_runs_fusion_alone(finished: tuple[Path, Run], site_photos: Path, tmp_path: Path) -> None:
    workspace = tmp_path / "workspace"
    shutil.copytree(finished[0], workspace)
    before = times(workspace / "depth"), times(workspace / "undistorted")
    stricter = curecon("reconstruct", site_photos, "--workspace", workspace, *QUICK, "--min-views", 4)
    assert stricter.said.count("already done") == 5
    assert (times(workspace / "depth"), times(workspace / "undistorted")) == before
    assert 0 < stricter.summary["points"] < finished[1].summary["points"]
    assert read_cloud(workspace / "cloud.ply").views.min() >= 4


def test_killed_in_the_midst_it_goes_on_from_the_last_photo(
    finished: tuple[Path, Run], site_photos: Path, tmp_path: Path
) -> None:
    workspace = tmp_path / "workspace"
    shutil.copytree(finished[0], workspace)
    shutil.rmtree(workspace / "depth")
    (workspace / "stages" / "depth.json").unlink()
    arguments = ["reconstruct", site_photos, "--workspace", workspace, *QUICK]
    process = subprocess.Popen(command(*arguments), cwd=ROOT, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 300
    while not list((workspace / "depth").glob("[!.]*.npz")) if (workspace / "depth").exists() else True:
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.01)
    process.kill()
    process.wait()
    survivors = times(workspace / "depth")
    assert 0 < len(survivors) < len(SITE_PHOTOS)
    run = curecon(*arguments)
    assert run.code == 0, run.said
    assert times(workspace / "depth").items() >= survivors.items()
    assert run.summary["points"] == finished[1].summary["points"]


def test_killed_in_the_sparse_stage_it_still_finishes(site_photos: Path, tmp_path: Path) -> None:
    arguments = ["reconstruct", site_photos, "--workspace", tmp_path / "w", *QUICK, "--until", "views"]
    process = subprocess.Popen(command(*arguments), cwd=ROOT, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 300
    while not (tmp_path / "w" / "sparse" / "features.db").exists():
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.01)
    time.sleep(0.3)
    process.kill()
    process.wait()
    run = curecon(*arguments)
    assert run.code == 0, run.said
    assert run.summary["registered"] == len(SITE_PHOTOS)


def test_a_given_model_keeps_its_cameras_exactly(site_photos: Path, tmp_path: Path) -> None:
    run = curecon("reconstruct", site_photos, "--workspace", tmp_path / "w", "--model", SITE / "truth", *QUICK,
                  "--until", "views")
    assert run.code == 0, run.said
    truth = truth_poses()
    views = read(tmp_path / "w")[0].views
    assert {view.name for view in views} == set(SITE_PHOTOS)
    for view in views:
        np.testing.assert_allclose(view.cam_from_world, truth[view.name], atol=1e-9)


def test_a_small_memory_budget_changes_the_tiles_and_not_the_depth(
    finished: tuple[Path, Run], site_photos: Path, tmp_path: Path
) -> None:
    from curecon_blender.core.base.options import Options
    from curecon_blender.core.depth.estimate import DepthEstimator
    from curecon_blender.core.depth.tiles import BASE_BYTES, plan_tiles
    from curecon_blender.core.network.weights import load_network

    workspace = finished[0]
    views = {view.name: view for view in read(workspace)[0].views}
    view = next(iter(views.values()))
    budgets = [8.0, (BASE_BYTES + 75e6) / 2**30]
    sources = [views[name] for name, _ in view.sources]
    assert [len(plan_tiles(view, sources, 48, int(b * 2**30))) > 1 for b in budgets] == [False, True]
    whole, tiled = (
        DepthEstimator(load_network(), workspace, Options(
            photos=site_photos, workspace=workspace, memory_gib=budget, device="cpu", precision="fp32",
        )).estimate(view, [(views[n], s) for n, s in view.sources])
        for budget in budgets
    )
    sure = (whole[1] > 0.5) & (tiled[1] > 0.5)
    assert sure.mean() > 0.2
    difference = np.abs(whole[0] - tiled[0])[sure] / whole[0][sure]
    assert np.median(difference) < 0.002


def test_cancelling_keeps_finished_work_and_says_so(site_photos: Path, tmp_path: Path) -> None:
    arguments = ["--messages", "reconstruct", site_photos, "--workspace", tmp_path / "w", *QUICK]
    process = subprocess.Popen(command(*arguments), cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                               stderr=subprocess.DEVNULL, text=True)
    assert process.stdin and process.stdout
    seen = []
    for line in process.stdout:
        seen.append(messages.decode(line))
        if isinstance(seen[-1], messages.StageStarted) and seen[-1].stage == "sparse":
            process.stdin.write("cancel\n")
            process.stdin.flush()
    assert process.wait(timeout=120) == 130
    assert isinstance(seen[-1], messages.Failure) and seen[-1].kind == "cancelled"
    assert "goes on" in seen[-1].remedy
    assert (tmp_path / "w" / "stages" / "photos.json").exists()


def test_the_worker_ends_when_its_parent_is_gone(site_photos: Path, tmp_path: Path) -> None:
    arguments = ["--messages", "reconstruct", site_photos, "--workspace", tmp_path / "w", *QUICK]
    process = subprocess.Popen(command(*arguments), cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL,
                               stderr=subprocess.DEVNULL)
    assert process.stdin
    time.sleep(1.0)
    process.stdin.close()
    assert process.wait(timeout=60) == 130


def test_an_interrupt_from_the_keyboard_is_a_cancel(site_photos: Path, tmp_path: Path) -> None:
    process = subprocess.Popen(
        command("reconstruct", site_photos, "--workspace", tmp_path / "w", *QUICK), cwd=ROOT,
        stderr=subprocess.PIPE, text=True,
    )
    assert process.stderr
    for line in process.stderr:
        if "sparse" in line:
            process.send_signal(signal.SIGINT)
            break
    said = process.stderr.read()
    assert process.wait(timeout=120) == 130
    assert "Cancelled" in said


@pytest.mark.parametrize("word", ["--quality ultra9", "--until nowhere", "--memory -1"])
def test_wrong_arguments_are_refused_with_the_usage(site_photos: Path, tmp_path: Path, word: str) -> None:
    run = curecon("reconstruct", site_photos, "--workspace", tmp_path / "w", *word.split())
    assert run.code == 2
    assert "usage" in run.said


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="the allocator's settings are glibc's")
def test_a_worker_starts_itself_again_with_large_pages_and_the_same_arguments() -> None:
    script = ("from curecon_blender.core.base.allocator import use_large_pages; use_large_pages(); "
              "import os, sys; print(os.environ['MALLOC_MMAP_MAX_'], sys.argv[1:])")
    plain = {k: v for k, v in os.environ.items() if not k.startswith(("MALLOC_", "GLIBC_"))}
    done = subprocess.run([sys.executable, "-c", script, "a b", "--c"], cwd=ROOT, env=plain, capture_output=True,
                          text=True, check=True)
    assert done.stdout.split(maxsplit=1) == ["0", "['a b', '--c']\n"]
