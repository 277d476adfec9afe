# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The one job that may run at a time, and what every operator that waits for a worker has in common."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy

from ..core.errors import CuReconError
from ..core.messages import Failure, Log, StageStarted, failure
from ..job import Job, Status, duration, log_path
from ..preferences import settings

POLL_SECONDS = 0.1
STAGE_NAMES = {
    "photos": "Photos", "sparse": "Cameras", "views": "Undistorted photos", "depth": "Depth maps",
    "fusion": "Point cloud", "mesh": "Mesh", "texture": "Texture",
}

status = Status()
# The panel that the job was started from, which shows its progress: "photos", "reconstruct", "surface", "preferences".
step = ""
_job: Job | None = None


def start(context: bpy.types.Context, task: str, arguments: list[str], workspace: Path | None) -> None:
    """Start a worker. Raises WorkerError when it cannot be started."""
    global _job, status
    chosen = settings(context)
    status = Status(task=task)
    _job = Job(
        arguments, python=chosen.worker_python, import_paths=chosen.import_paths, log=log_path(workspace),
    )
    status.running = True


def idle(operator: type[bpy.types.Operator]) -> bool:
    """For an operator's poll: whether no job runs; where one does, the button says so."""
    if status.running:
        operator.poll_message_set("Another job of CU-Recon is running")
    return not status.running


def poll() -> bool:
    """Take in what the worker has said; True once it has ended."""
    global _job
    if _job is None:
        return True
    finished = _job.finished
    for message in _job.poll():
        status.apply(message)
        if bpy.app.background and isinstance(message, StageStarted):
            print(f"CU-Recon: {STAGE_NAMES.get(message.stage, message.stage)}", flush=True)
        elif isinstance(message, Log):
            print(f"CU-Recon: {message.text}", flush=True)
    if finished:
        _job, status.running = None, False
    return finished


def wait() -> None:
    """Block until the worker has ended."""
    while not poll():
        if _job is not None:
            _job.wait(POLL_SECONDS)


def cancel() -> None:
    if _job is not None:
        status.cancelling = True
        _job.cancel()


def close() -> None:
    """End a running worker at once: Blender quits, loads another file, or the add-on is switched off."""
    global _job
    if _job is not None:
        _job.close()
        _job, status.running = None, False


def line() -> str:
    """The job's state in one line, for the status bar."""
    if status.cancelling:
        return "CU-Recon: cancelling..."
    if not status.stages:
        return f"CU-Recon: {status.task}...    Esc: cancel"
    stage = status.stages[-1]
    left = status.seconds_left
    time_left = f", {duration(left)} left" if left is not None else ""
    name = STAGE_NAMES.get(stage.stage, stage.stage)
    count = f" {stage.done}/{stage.total}" if stage.total else ""
    return f"CU-Recon: {name}{count} ({status.overall:.0%}{time_left})    Esc: cancel"


def explain(error: CuReconError | Failure) -> str:
    return f"{error.message} {error.remedy}"


class WorkerOperator:
    """Runs a worker: modal in a window, blocking in background Blender and when a script calls it.

    A subclass gives `task`, `arguments` and `done`; both may raise CuReconError, which is reported with its remedy.
    `done` takes in the worker's result and returns the report for the user.
    """

    task = ""
    step = "reconstruct"
    arguments: Callable[[bpy.types.Context], list[str]]
    done: Callable[[bpy.types.Context, bpy.types.Scene, dict[str, Any]], str]
    # Blender's, of the operator that this is mixed into:
    report: Callable[[set[str], str], None]
    poll_message_set: Callable[..., None]
    _timer: bpy.types.Timer | None = None

    def workspace(self, context: bpy.types.Context) -> Path | None:
        """The job's workspace folder, if it has one."""
        return None

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return idle(cls)

    def execute(self, context: bpy.types.Context) -> set[str]:
        if not self._start(context):
            return {"CANCELLED"}
        wait()
        return self._finish(context)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if bpy.app.background or context.window is None:
            return self.execute(context)
        if not self._start(context):
            return {"CANCELLED"}
        self._timer = context.window_manager.event_timer_add(POLL_SECONDS, window=context.window)
        context.window_manager.modal_handler_add(self)
        self._redrawn = 0.0
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type == "ESC" and event.value == "PRESS":
            cancel()
            return {"RUNNING_MODAL"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        finished = poll()
        if finished or time.monotonic() - self._redrawn > 0.5:
            self._redrawn = time.monotonic()
            redraw_panels(context)
            context.workspace.status_text_set(None if finished else line())
        if not finished:
            return {"PASS_THROUGH"}
        context.window_manager.event_timer_remove(self._timer)
        return self._finish(context)

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender ends the operator itself when another file is loaded or it quits."""
        close()
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
        if context.workspace is not None:
            context.workspace.status_text_set(None)

    def _start(self, context: bpy.types.Context) -> bool:
        global step
        self._scene_uid, step = context.scene.session_uid, self.step
        try:
            start(context, self.task, self.arguments(context), self.workspace(context))
        except CuReconError as error:
            self._fail(error)
            return False
        return True

    def _finish(self, context: bpy.types.Context) -> set[str]:
        scene = next((s for s in bpy.data.scenes if s.session_uid == self._scene_uid), None)
        if status.failure is not None:
            level = "WARNING" if status.failure.kind == "cancelled" else "ERROR"
            self.report({level}, explain(status.failure))
            return {"CANCELLED"}
        if scene is None:
            self.report({"WARNING"}, "The scene that it was started from is gone; import its workspace instead.")
            return {"CANCELLED"}
        assert status.result is not None, "a job ends with a Result or a Failure"
        try:
            self.report({"INFO"}, self.done(context, scene, status.result.summary))
        except CuReconError as error:
            self._fail(error)
            return {"CANCELLED"}
        return {"FINISHED"}

    def _fail(self, error: CuReconError) -> None:
        """Show the error in the panel too, where it stays."""
        status.failure = failure(error)
        self.report({"ERROR"}, explain(error))


def redraw_panels(context: bpy.types.Context) -> None:
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                for region in area.regions:
                    if region.type == "UI":
                        region.tag_redraw()
            elif area.type == "PREFERENCES":
                area.tag_redraw()
