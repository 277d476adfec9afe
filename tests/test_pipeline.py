# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A finished workspace, run again: what is made anew, and what may never end a job."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from conftest import Run

from curecon_blender.core.base.messages import Log, Reporter
from curecon_blender.core.base.options import STAGES as NAMES
from curecon_blender.core.base.options import Options
from curecon_blender.core.run import cost, pipeline, stages


@pytest.fixture
def workspace(finished: tuple[Path, Run], tmp_path: Path) -> Path:
    return Path(shutil.copytree(finished[0], tmp_path / "workspace"))


@pytest.fixture
def options(site_photos: Path, workspace: Path) -> Options:
    """Those of the run that made the workspace."""
    return Options(photos=site_photos, workspace=workspace, quality="preview", max_image_size=320)


def run(options: Options) -> list[str]:
    """Run a job; the stages that were already done."""
    said: list[str] = []
    pipeline.reconstruct(options, Reporter(lambda message: said.append(message.text) if isinstance(message, Log)
                                           else None))
    return [text.removesuffix(": already done") for text in said if text.endswith(": already done")]


def test_every_stage_is_declared_once_in_the_order_of_the_flow() -> None:
    assert tuple(stages.STAGES) == NAMES


def test_a_new_version_of_a_stage_makes_it_and_what_follows_anew(
    options: Options, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert run(options) == ["photos", "sparse", "adjust", "views", "depth", "fusion"]
    depth = next((options.workspace / "depth").glob("*.npz"))
    made = depth.stat().st_mtime_ns
    fusion = stages.STAGES["fusion"]
    monkeypatch.setitem(stages.STAGES, "fusion", replace(fusion, version=fusion.version + 1))
    assert run(options) == ["photos", "sparse", "adjust", "views", "depth"]
    assert depth.stat().st_mtime_ns == made
    assert run(options) == ["photos", "sparse", "adjust", "views", "depth", "fusion"]


def test_a_speed_that_cannot_be_kept_ends_no_job(options: Options, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cost, "SHORTEST_LEARNED", 0.0)
    blocked = options.workspace / "workspace.json" / "speeds.json"  # below a file
    assert "fusion" not in run(replace(options, speeds=blocked, min_confidence=0.35))
    assert (options.workspace / "cloud.ply").exists()
    assert "fusion" in run(replace(options, min_confidence=0.35))


def test_a_dangling_link_in_the_workspace_ends_no_job(options: Options) -> None:
    (options.workspace / "notes.txt").symlink_to("gone.txt")
    assert "fusion" in run(options)
