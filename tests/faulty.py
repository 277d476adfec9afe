# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the tests of faults share: a job as the add-on has it, from just before a stage to its end."""

from __future__ import annotations

import shutil
import sys
import time
from pathlib import Path

from conftest import ROOT, SITE_PHOTOS, SMALL, Run, curecon

from curecon_blender.core.base.messages import Failure, Message, Progress
from curecon_blender.core.base.options import STAGES
from curecon_blender.job import Job

# What each stage makes; the feature database goes with the cameras.
MADE = {
    "photos": ["photos.json"], "sparse": ["sparse"], "adjust": ["sparse/0"], "views": ["views.json", "undistorted"],
    "depth": ["depth"], "fusion": ["cloud.ply"], "mesh": ["mesh.ply"], "texture": ["textured"],
}


def before(stage: str, textured: tuple[Path, Run], workspace: Path) -> None:
    """Copy the finished workspace as it stood just before a stage."""
    shutil.copytree(textured[0], workspace)
    for later in STAGES[STAGES.index(stage):]:
        (workspace / "stages" / f"{later}.json").unlink()
        for name in MADE[later]:
            path = workspace / name
            shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)


def arguments(photos: Path, workspace: Path, until: str) -> list[str]:
    return ["reconstruct", str(photos), "--workspace", str(workspace), *SMALL, "--until", until]


def start(photos: Path, workspace: Path, until: str, grace: float = 20.0) -> Job:
    """A worker as the add-on has it."""
    return Job(arguments(photos, workspace, until), python=sys.executable, import_paths=[ROOT], workspace=workspace,
               grace=grace)


def at_work(job: Job, stage: str) -> None:
    """Wait for the first progress of a stage."""
    while True:
        for message in job.poll():
            assert not isinstance(message, Failure), message
            if isinstance(message, Progress) and message.stage == stage:
                return
        assert not job.finished, f"the worker never got to {stage}"
        time.sleep(0.002)


def ended(job: Job) -> Message:
    """The last message."""
    assert job.wait(300)
    return job.poll()[-1]


def failed(job: Job, *words: str) -> Failure:
    """The job failed with these words, and says what to do."""
    failure = ended(job)
    assert isinstance(failure, Failure), failure
    assert failure.kind != "fault" and failure.remedy, failure
    for word in words:
        assert word in failure.message, failure
    return failure


def finished_again(photos: Path, workspace: Path, stage: str, textured: tuple[Path, Run]) -> Run:
    """Run to the end of the stage: it comes out as it did undisturbed, and nothing unfinished lies about."""
    run = curecon(*arguments(photos, workspace, stage))
    assert run.code == 0, run.said
    assert run.said.count("already done") == STAGES.index(stage), run.said
    for name in MADE[stage]:
        assert (workspace / name).exists()
    if stage in ("depth", "fusion"):
        for file in ("cloud.ply",) if stage == "fusion" else [f"depth/{name}.npz" for name in SITE_PHOTOS]:
            assert (workspace / file).read_bytes() == (textured[0] / file).read_bytes()
    assert not [*workspace.rglob(".*.partial")]
    return run
