# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The flow: photos, sparse model, views, depth maps, fused cloud, mesh, texture. A stage that is already done is
skipped."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..base.allocator import release
from ..base.errors import DeviceError, WorkspaceError, ran_out_of_memory
from ..base.language import Text
from ..base.messages import Reporter
from ..base.options import STAGES as NAMES
from ..base.options import SURFACE_STAGES, Options
from ..depth.cluster import connect
from ..photos.check import check_photos, describe, write_thumbnails
from ..photos.record import read_photos
from ..views import record as views_record
from . import cost
from .control import import_into
from .peak_memory import PeakMemory
from .settings import keep_settings
from .stages import DETAIL_STAGES, STAGES, Job, Stage
from .summary import summarise
from .workspace import StageRecord, Workspace, require_workspace


def reconstruct(options: Options, reporter: Reporter) -> dict[str, Any]:
    """Run the job to `options.until` and return its JSON summary; without photos, from the finished cloud on.

    The stages read and write the workspace only, so a second run finds them done and a killed one goes on. Raises
    the CuReconError of whichever stage cannot go on; what was finished before it stays.
    """
    stages = [STAGES[name] for name in NAMES[: NAMES.index(options.until) + 1]]
    if options.until == SURFACE_STAGES[-1]:
        stages += [DETAIL_STAGES[level] for level in options.detail]
    if options.photos is None:
        stages = [stage for stage in stages if stage.name in SURFACE_STAGES or stage.last]
        require_workspace(options.workspace)
    reporter.begin({stage.name: stage.weight for stage in stages})
    if options.scheduler and STAGES["depth"] in stages:  # a wrong address is told now, not when the cameras are found
        with connect(options.scheduler):
            pass
    with Workspace(options.workspace) as workspace:
        job = Job(options, workspace, reporter)
        if options.photos is None:
            _begin_from_cloud(job)
        else:
            keep_settings(options)
        for stage in stages:
            reporter.stage(stage.name)
            _bring_about(stage, job)
            reporter.progress(1, 1, fresh=False)
            if stage.name == "photos":  # how many there are, and how large, says what the rest will take
                photos = job.photo_set.photos
                seconds = cost.reference_seconds(photos, cost.count_pairs(photos), options)
                seconds |= {stage.name: seconds["texture"] / 3 for stage in stages if stage.last}
                reporter.begin({stage.name: seconds[stage.name] for stage in stages})
                if options.control:
                    import_into(workspace, options.control, options.control_system, reporter)
        return summarise(job, [stage.name for stage in stages])


def check(options: Options, thumbnails: Path | None, reporter: Reporter) -> dict[str, Any]:
    """The photo check alone: what was found, and what each quality would cost here. Only the folder `thumbnails` is
    written, with small pictures of doubtful photos."""
    assert options.photos is not None
    reporter.begin({"photos": 1.0})
    reporter.stage("photos")
    photo_set = check_photos(options.photos, reporter, surplus=options.surplus)
    summary = describe(photo_set)
    if thumbnails is not None:
        files = write_thumbnails(photo_set, thumbnails)
        for doubtful in summary["doubtful"]:
            doubtful["thumbnail"] = str(files.get(doubtful["name"], ""))
    try:
        slowness = cost.slowness_here(options.device, options.speeds)
    except DeviceError as error:
        reporter.warning(Text("{} {}", error.message, error.remedy))
        slowness = cost.slowness_here("cpu", options.speeds)
    return {
        **summary, **cost.free(options.workspace), "presets": cost.predict_all(photo_set.photos, options, slowness),
    }


def _begin_from_cloud(job: Job) -> None:
    """Begin after fusion, from what the workspace holds. Raises WorkspaceError when its cloud is not finished."""
    record = job.workspace.record("fusion")
    if record is None:
        raise WorkspaceError(
            Text("The cloud of {} is not finished.", job.root),
            remedy="Run Reconstruct to the end first.", path=job.root,
        )
    job.photo_set = read_photos(job.root)
    job.components, job.key = views_record.read(job.root), record.key
    if any(not view.original for component in job.components for view in component.views):
        job.reporter.warning(
            "This workspace names photos on a network drive, which are left alone: a stranger could have written "
            "that, to make your computer log in to his. Texture comes from the smaller pictures in the workspace. "
            "If the photos are yours, run Reconstruct with them up to the texture."
        )


def _bring_about(stage: Stage, job: Job) -> None:
    """Run a stage unless it is done for the same key; mark it done with what it took and made; take up its result."""
    workspace, key = job.workspace, stage.key(job)
    if workspace.is_done(stage.name, key):
        job.reporter.log(f"{stage.name}: already done")
    else:
        workspace.reopen(stage.name)
        release()
        started = time.monotonic()
        with PeakMemory() as peak:
            _run(stage, job)
        seconds = time.monotonic() - started
        files = tuple(sorted({file.relative_to(job.root).as_posix() for pattern in stage.files
                              for file in job.root.glob(pattern)}))
        workspace.mark_done(
            stage.name, StageRecord(key=key, seconds=seconds, peak_gib=peak.bytes / 2**30, files=files)
        )
        _learn(stage, seconds, job)
    if not stage.last:
        job.key = key
    if stage.load:
        stage.load(job)


def _run(stage: Stage, job: Job) -> None:
    """Run a stage; one that keeps to the memory budget is tried again with half of it when memory runs out."""
    try:
        stage.run(job)
        return
    except Exception as error:
        if not stage.in_budget or job.options.half_memory or not ran_out_of_memory(error):
            raise
    # Outside of the except block, or the traceback would hold on to what filled the memory.
    release()
    job.reporter.warning(Text("Memory ran out: {} goes on with half the memory budget.", stage.name))
    job.options = replace(job.options, half_memory=True)
    stage.run(job)


def _learn(stage: Stage, seconds: float, job: Job) -> None:
    """Keep this computer's speed, unless the stage was not run from its start, on the whole site, or here."""
    options = job.options
    if stage.name == "photos" or stage.last or options.photos is None or (stage.name == "depth" and options.scheduler):
        return
    if job.reporter.resumed or options.model or options.region:
        return
    try:
        cost.learn(stage.name, seconds, job.photo_set.photos, options)
    except (OSError, WorkspaceError) as error:  # a convenience: the job is worth more
        job.reporter.log(f"This computer's speed was not kept: {error}")
