# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The one job that may run at a time, and what operators have in common that wait for a worker or take long inside
Blender itself."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import bpy
from bpy.app.translations import pgettext_iface as iface_
from bpy.app.translations import pgettext_n as n_

from ..core.base.errors import Cancelled, CuReconError
from ..core.base.messages import Failure, Log, StageStarted, failure
from ..job import Job, Status, duration
from ..languages import translated
from ..preferences import settings
from ..scene import sidebar

POLL_SECONDS = 0.05
SLICE_SECONDS = 0.002  # a timer tick begins slices for so long: a long one is alone, since 0.1 seems to hang
REDRAW_SECONDS = 1.0
LONG_SECONDS = 60.0  # from then on a job is not ended by a slip of the hand, and its end may be heard
# Work in slices of a few milliseconds: each says what is being done, or is None where there is nothing to do but wait.
# Returns the report for the user.
Work = Generator[str | None, None, str]
STAGE_NAMES = {
    "photos": "Photos", "sparse": "Cameras", "adjust": "Adjustment", "views": "Undistorted photos",
    "depth": "Depth maps", "fusion": "Point cloud", "mesh": "Mesh", "texture": "Texture",
    "detail_20k": "Level of detail", "detail_150k": "Level of detail", "detail_1m": "Level of detail",
    "download": "Download", "unpack": "Unpacking",
    "laz": "LAZ Cloud", "copc": "COPC Cloud", "e57": "E57 Cloud", "orthomosaic": "Orthomosaic", "dsm": "Surface Model",
    "facades": "Façades", "contours": "Contours", "sections": "Sections",
    "levels": "Levels of Detail", "tiles": "Tiles", "cloud": "Point cloud", "pages": "Web Pages",
    "gaps": "Gaps", "mask": "Masks", "upload": "Upload", "read": "Reading", "lay": "Laying On", "measure": "Distances",
}

OFFLINE = n_("Allow Online Access is off in Blender's preferences, under System")
QUESTION_WIDTH = 460  # pixels at scale 1

status = Status()
PREFERENCES = "preferences"
# The panel that the job was started from, which shows its progress: "photos", "reconstruct" ..., or PREFERENCES.
panel = ""
_job: Job | None = None


def start(
    context: bpy.types.Context, task: str, arguments: list[str], workspace: Path | None,
    environment: dict[str, str] | None = None,
) -> None:
    """Start a worker. Raises WorkerError when it cannot be started."""
    global _job, status
    chosen = settings(context)
    status = Status(task=task, running=True)
    _job = Job(arguments, python=chosen.worker_python, import_paths=chosen.import_paths, workspace=workspace,
               environment=environment)


def idle(operator: type[bpy.types.Operator]) -> bool:
    """For an operator's poll: whether no job runs; where one does, the button says so."""
    if status.running:
        operator.poll_message_set("Another job of CU-Recon is running")
    return not status.running


def online(operator: type[bpy.types.Operator]) -> bool:
    """For an operator's poll: whether the user lets Blender use the network; where not, the button says so."""
    if not bpy.app.online_access:
        operator.poll_message_set(OFFLINE)
    return bpy.app.online_access


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
        _job = None
    return finished


def cancel() -> None:
    status.cancelling = status.running
    if _job is not None:
        _job.cancel()


def close() -> None:
    """End a running worker at once: Blender quits, loads another file, or the add-on is switched off."""
    global _job
    if _job is not None:
        _job.close()
    _job, status.running = None, False
    for window in bpy.context.window_manager.windows:  # Blender drops a switched-off add-on's operators without a word
        if window.workspace is not None:
            with bpy.context.temp_override(window=window):  # without a window, as at times when it quits, it crashes
                window.workspace.status_text_set(None)


def line() -> str:
    """The job's state in one line, for the status bar."""
    if status.cancelling:
        return iface_("CU-Recon: cancelling...")
    if not status.stages:
        return iface_("CU-Recon: {}...    Esc: cancel").format(iface_(status.task))
    stage, done, left = status.stages[-1], f"{status.overall:.0%}", status.seconds_left
    name = iface_(STAGE_NAMES.get(stage.stage, stage.stage))
    if stage.total > 1:
        name = f"{name} {stage.fraction:.0%}"
    if left is not None:
        done = iface_("{}, {} left").format(done, translated(duration(left)))
    return iface_("CU-Recon: {} ({})    Esc: cancel").format(name, done)


def _draw_status(header: bpy.types.Header, context: bpy.types.Context) -> None:
    """The job in Blender's status bar."""
    row = header.layout.row()
    row.progress(factor=status.overall, text="")
    row.label(text=line(), translate=False)


def _chime() -> None:
    import aud

    aud.Device().play(aud.Sound.sine(660).limit(0, 0.6).fadeout(0.1, 0.5).volume(0.3))


def explain(error: CuReconError | Failure) -> str:
    return f"{translated(error.message)} {translated(error.remedy)}"


class ModalOperator:
    """Works in slices: as many as fit into a moment at each timer tick in a window, and to the end at once in
    background Blender and when a script calls it.

    A subclass gives `work`. What it raises of CuReconError is reported with its remedy, and shown in the panel `panel`.
    Its `invoke` may `browse` first: Blender calls `execute` once the user has chosen.
    """

    task = ""
    panel = "reconstruct"
    work: Callable[[bpy.types.Context], Work]
    # Blender's, of the operator that this is mixed into:
    report: Callable[[set[str], str], None]
    poll_message_set: Callable[..., None]
    _timer: bpy.types.Timer | None = None
    _in_window = False
    _browsing = False
    _slices: Work

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return idle(cls)

    def browse(self, context: bpy.types.Context) -> set[str]:
        """Let the user choose a file or folder."""
        self._browsing = True
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        if self._browsing and not bpy.app.background:  # back from the file browser
            self._browsing = False
            return ModalOperator.invoke(self, context, None)
        self._begin(context)
        while (ended := self._go_on(math.inf)) is None:
            time.sleep(POLL_SECONDS)
        return ended

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event | None) -> set[str]:
        if bpy.app.background or context.window is None:
            return self.execute(context)
        self._in_window = True
        self._begin(context)
        if (ended := self._go_on(SLICE_SECONDS)) is not None:
            return ended
        self._timer = context.window_manager.event_timer_add(POLL_SECONDS, window=context.window)
        context.window_manager.modal_handler_add(self)
        self._redrawn = 0.0
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type == "ESC" and event.value == "PRESS":
            bpy.ops.curecon.cancel("INVOKE_DEFAULT")
            return {"RUNNING_MODAL"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        ended = self._go_on(SLICE_SECONDS)
        if ended is not None or time.monotonic() - self._redrawn > REDRAW_SECONDS:
            self._redrawn = time.monotonic()
            redraw_panels(context)
            context.workspace.status_text_set(None if ended is not None else _draw_status)
        if ended is None:
            return {"PASS_THROUGH"}
        context.window_manager.event_timer_remove(self._timer)
        return ended

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender ends the operator itself when another file is loaded or it quits, and when its question or its file
        browser is closed, before there is any work."""
        if self._timer is None:
            return
        close()
        self._slices.close()
        context.window_manager.event_timer_remove(self._timer)

    def _begin(self, context: bpy.types.Context) -> None:
        global status, panel
        self._scene_uid, panel = context.scene.session_uid, self.panel
        status = Status(task=self.task, running=True)
        self._slices = self.work(context)

    def _go_on(self, seconds: float) -> set[str] | None:
        """Begin slices for so long; returns what the operator ends with, None while there is more to do."""
        deadline, said = time.monotonic() + seconds, ""
        try:
            while time.monotonic() < deadline:
                if status.cancelling and _job is None:  # a worker would tell of its end itself
                    self._slices.close()
                    raise Cancelled
                if (doing := next(self._slices)) is None:
                    return None
                status.task = doing
            return None
        except StopIteration as end:
            said = end.value
        except CuReconError as error:
            status.failure = failure(error)
        except BaseException:
            close()
            raise
        status.running = False
        if status.failure is not None:
            # In a window the panel tells of it; a popup beside it would stay until it is clicked away.
            level = "WARNING" if status.failure.kind == "cancelled" or self._in_window else "ERROR"
            self.report({level}, explain(status.failure))
            if self._in_window and self.panel != PREFERENCES and status.failure.kind != "cancelled":
                sidebar.show_tab(bpy.context)
            return {"CANCELLED"}
        self.report({"INFO"}, said)
        status.said = said
        if status.seconds_running > LONG_SECONDS and settings(bpy.context).sound and not bpy.app.background:
            _chime()
        return {"FINISHED"}


class WorkerOperator(ModalOperator):
    """Runs a worker and takes in what it found.

    A subclass gives `task`, `arguments` and `done`; the latter two may raise CuReconError. `done` takes in the worker's
    result and returns the report for the user, or the work that leads to it.
    """

    arguments: Callable[[bpy.types.Context], list[str]]
    done: Callable[[bpy.types.Context, bpy.types.Scene, dict[str, Any]], str | Work]

    def workspace(self, context: bpy.types.Context) -> Path | None:
        """The job's workspace folder, if it has one."""
        return None

    def environment(self, context: bpy.types.Context) -> dict[str, str]:
        """What the worker is told by variables, as its arguments can be seen by other programs."""
        return {}

    def work(self, context: bpy.types.Context) -> Work:
        start(context, self.task, self.arguments(context), self.workspace(context), self.environment(context))
        while not poll():
            yield None
        if status.failure is not None:
            return ""
        assert status.result is not None, "a job ends with a Result or a Failure"
        status.stages.clear()  # what is done inside Blender is none of the worker's stages
        outcome = self.done(context, scene_with(self._scene_uid), status.result.summary)
        return outcome if isinstance(outcome, str) else (yield from outcome)


def scene_with(session_uid: int) -> bpy.types.Scene:
    """The scene that a job was started from. Raises CuReconError when it is gone."""
    found = next((scene for scene in bpy.data.scenes if scene.session_uid == session_uid), None)
    if found is None:
        raise CuReconError("The scene that it was started from is gone.", remedy="Import its workspace instead.")
    return found


def redraw_panels(context: bpy.types.Context) -> None:
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                for region in area.regions:
                    if region.type == "UI":
                        region.tag_redraw()
            elif area.type == "PREFERENCES":
                area.tag_redraw()
