# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth maps made by the workers of a Dask cluster, and photos of a hundred megapixels."""

from __future__ import annotations

import os
import pickle
import shutil
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import distributed
import numpy as np
import pytest
import torch
from box_scene import make_view, write_scene

from curecon_blender.core.base.errors import Cancelled, DeviceError, PhotoError, WorkspaceError
from curecon_blender.core.base.messages import Message, Progress, Reporter
from curecon_blender.core.base.options import Options
from curecon_blender.core.base.records import Component
from curecon_blender.core.depth import cluster as depth_cluster
from curecon_blender.core.depth.estimate import estimate_depths
from curecon_blender.core.depth.maps import depth_path
from curecon_blender.core.network import weights
from curecon_blender.core.run import pipeline
from curecon_blender.core.run.command_line import options_of, parser

KEY = "key"
PHOTOS = 7


@pytest.fixture(scope="module")
def cluster() -> Iterator[distributed.LocalCluster]:
    """Two processes on this machine; a killed one is started again."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None, memory_limit="4GiB",
    ) as running:
        yield running


@pytest.fixture
def scene(tmp_path: Path) -> tuple[Component, Path]:
    """The box, and its workspace, where depth maps are to be made."""
    workspace = tmp_path / "workspace"
    component = write_scene(workspace, [make_view(i, PHOTOS) for i in range(PHOTOS)])
    shutil.rmtree(workspace / "depth")
    return component, workspace


def options(workspace: Path, address: str = "") -> Options:
    return Options(photos=None, workspace=workspace, device="cpu", precision="fp32", memory_gib=2.0, scheduler=address)


def depth_maps(workspace: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    found = {}
    for path in sorted((workspace / "depth").iterdir()):
        with np.load(path) as arrays:
            found[path.name] = arrays["depth"], arrays["confidence"]
    return found


def spread(scene: tuple[Component, Path], address: str, heard: Callable[[Progress], None] | None = None) -> None:
    def hear(message: Message) -> None:
        if isinstance(message, Progress) and heard:
            heard(message)

    component, workspace = scene
    depth_cluster.spread_depths([component], workspace, options(workspace, address), KEY, Reporter(hear))


def processes(cluster: distributed.LocalCluster) -> list[int]:
    return [nanny.process.pid for nanny in cluster.workers.values() if nanny.process and nanny.process.pid]


def test_a_killed_workers_photos_are_done_again_bit_for_bit(
    cluster: distributed.LocalCluster, scene: tuple[Component, Path]
) -> None:
    component, workspace = scene
    killed = []

    def kill_one(progress: Progress) -> None:
        if progress.done == 2:
            killed.append(processes(cluster)[0])
            os.kill(killed[0], signal.SIGKILL)

    spread(scene, cluster.scheduler_address, kill_one)
    assert len(killed) == 1
    made = depth_maps(workspace)
    shutil.rmtree(workspace / "depth")
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        network = weights.load_network()
        estimate_depths([component], network, workspace, options(workspace), KEY, Reporter())
    finally:
        torch.set_num_threads(before)
    alone = depth_maps(workspace)
    assert made.keys() == alone.keys() and len(alone) == PHOTOS
    for name in alone:
        assert (alone[name][0] > 0).mean() > 0.9
        assert np.array_equal(made[name][0], alone[name][0]) and np.array_equal(made[name][1], alone[name][1]), name


def finished(workspace: Path) -> dict[str, int]:
    """The depth maps that are there, and when each was written."""
    return {path.name: path.stat().st_mtime_ns for path in (workspace / "depth").glob("*.npz")}


def test_finished_photos_are_left_alone_and_cancelling_keeps_them(
    cluster: distributed.LocalCluster, scene: tuple[Component, Path]
) -> None:
    component, workspace = scene
    cancelled = []
    reporter = Reporter(lambda message: cancelled.append(1) if isinstance(message, Progress) and message.done == 2
                        else None, lambda: bool(cancelled))
    with pytest.raises(Cancelled):
        depth_cluster.spread_depths(
            [component], workspace, options(workspace, cluster.scheduler_address), KEY, reporter)
    kept, before = finished(workspace), None
    while kept != before:  # those at work are finished
        time.sleep(4)
        kept, before = finished(workspace), kept
    assert 2 <= len(kept) < PHOTOS
    told: list[Progress] = []
    spread(scene, cluster.scheduler_address, told.append)
    assert told[0].done == len(kept) and told[-1].done == PHOTOS
    now = finished(workspace)
    assert len(now) == PHOTOS and {name: now[name] for name in kept} == kept


def test_a_worker_that_sees_another_workspace_is_named(
    cluster: distributed.LocalCluster, scene: tuple[Component, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    # As on another machine: a path that leads elsewhere for the workers than it does here.
    monkeypatch.chdir(scene[1].parent)
    with pytest.raises(DeviceError, match=r"tcp://127.0.0.1:\d+ sees another workspace"):
        spread((scene[0], Path(scene[1].name)), cluster.scheduler_address)


def test_what_goes_wrong_in_a_worker_comes_back_with_its_remedy(
    cluster: distributed.LocalCluster, scene: tuple[Component, Path]
) -> None:
    component, workspace = scene
    (workspace / component.views[2].image).unlink()
    with pytest.raises(PhotoError, match=r"photo_02\.png does not exist") as raised:
        spread(scene, cluster.scheduler_address)
    assert "Put the photo back" in raised.value.remedy


def test_a_job_with_a_region_is_spread_too(cluster: distributed.LocalCluster, tmp_path: Path) -> None:
    workspace = tmp_path / "workspace"
    component = write_scene(workspace, [make_view(i, PHOTOS) for i in range(PHOTOS)])
    missing = depth_path(workspace, component.views[3].name)
    missing.unlink()
    given = parser().parse_args([
        "reconstruct", "photos", "--workspace", str(workspace), "--device", "cpu", "--memory", "2",
        "--scheduler", cluster.scheduler_address, "--region", "-1", "-1", "0", "1", "1", "2",
        "--region-turn", "1", "0", "0", "0",
    ])
    depth_cluster.spread_depths([component], workspace, options_of(given), "", Reporter())
    with np.load(missing) as arrays:
        assert (arrays["depth"] > 0).mean() > 0.9


def test_a_changed_file_in_any_room_makes_another_version(tmp_path: Path) -> None:
    copy = tmp_path / "core"
    shutil.copytree(depth_cluster.CORE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    ours = depth_cluster.code_digest()
    assert depth_cluster.code_digest(copy) == ours
    files = sorted(copy.rglob("*.py"))
    assert {"base", "sparse", "network", "depth", "texture", "run"} <= {file.parent.name for file in files}
    for file in files:
        content = file.read_bytes()
        file.write_bytes(content + b"# changed\n")
        assert depth_cluster.code_digest(copy) != ours, file
        file.write_bytes(content)
    (copy / "views" / "record.py").rename(copy / "views" / "records.py")
    assert depth_cluster.code_digest(copy) != ours


def test_errors_survive_the_way_between_processes() -> None:
    error = WorkspaceError("The disk is full.", remedy="Free some space.", path=Path("a"))
    back = pickle.loads(pickle.dumps(error))
    assert (type(back), back.message, back.remedy, back.path, str(back)) == (
        WorkspaceError, "The disk is full.", "Free some space.", "a", "The disk is full.")
    assert str(pickle.loads(pickle.dumps(Cancelled()))) == "Cancelled."


def test_a_scheduler_that_is_not_there_is_told_before_the_work(
    site_photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(depth_cluster, "CONNECT_SECONDS", 1)
    chosen = replace(options(tmp_path / "w", "tcp://127.0.0.1:9"), photos=site_photos)
    with pytest.raises(DeviceError, match="No Dask scheduler answers") as raised:
        pipeline.reconstruct(chosen, Reporter())
    assert "dask scheduler" in raised.value.remedy and not (tmp_path / "w").exists()
