# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A series of renders: Blender's own render jobs one after another in a window, blocking in background Blender."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import date
from pathlib import Path

import bpy

from ..core.base.errors import CuReconError, WorkspaceError
from ..core.base.files import PRESENTATION, disk_errors
from ..scene import render_scene, site
from . import paths, running

POLL_SECONDS = 0.2


@dataclass
class Progress:
    """How the series is going, for the panel."""

    running: bool = False
    done: int = 0
    total: int = 0
    name: str = ""


progress = Progress()


def folder_of(scene: bpy.types.Scene) -> Path:
    """Where the presentation's files go: the chosen folder, else one in the workspace."""
    chosen = scene.curecon.present.folder
    return paths.absolute(chosen) if chosen else paths.absolute(site.workspace(scene)) / PRESENTATION


def title_of(scene: bpy.types.Scene) -> str:
    """What the sheets are headed with: the chosen title, else the workspace's name."""
    name = paths.absolute(site.workspace(scene)).name.removesuffix("_curecon")
    return scene.curecon.present.title or name.replace("_", " ")


def today() -> str:
    """The date in words that no country misreads."""
    now = date.today()
    return f"{now.day} {now:%B %Y}"


class RenderSeries:
    """Mixed into an operator. A subclass gives `shots`, which puts cameras in the copy, and `done`, which takes in the
    files and returns the report; both may raise CuReconError."""

    shots: Callable[[bpy.types.Context, bpy.types.Scene, Path], list[render_scene.Shot]]
    done: Callable[[bpy.types.Scene, Path], str]
    # Blender's, of the operator that this is mixed into:
    report: Callable[[set[str], str], None]
    poll_message_set: Callable[..., None]
    _timer: bpy.types.Timer | None = None

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not paths.site_stands(cls, context):
            return False
        if progress.running or bpy.app.is_job_running("RENDER"):
            cls.poll_message_set("Blender is rendering")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            self._start(context)
            for shot in self._queue:
                render_scene.set_up(self._copy, shot)
                print(f"CU-Recon: {shot.name}", flush=True)
                bpy.ops.render.render(scene=self._copy.name, write_still=True, animation=shot.frames > 1)
        except (CuReconError, RuntimeError) as error:  # Blender's own: no graphics card for EEVEE, no such folder
            return self._fail(error)
        return self._finish(context)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if bpy.app.background or context.window is None:
            return self.execute(context)
        try:
            self._start(context)
        except CuReconError as error:
            return self._fail(error)
        self._cancelled = False
        bpy.app.handlers.render_cancel.append(self._on_cancel)
        self._timer = context.window_manager.event_timer_add(POLL_SECONDS, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type != "TIMER" or bpy.app.is_job_running("RENDER"):
            return {"PASS_THROUGH"}
        if self._cancelled or render_scene.find() is None:
            self._close(context)
            self.report({"WARNING"}, "Cancelled; what is finished lies in the folder.")
            return {"CANCELLED"}
        if progress.done == len(self._queue):
            return self._finish(context)
        shot = self._queue[progress.done]
        render_scene.set_up(self._copy, shot)
        # A render that another one holds up is asked for again at the next tick.
        started = bpy.ops.render.render(
            "INVOKE_DEFAULT", scene=self._copy.name, write_still=True, animation=shot.frames > 1
        )
        if "CANCELLED" not in started:
            progress.name, progress.done = shot.name, progress.done + 1
        running.redraw_panels(context)
        return {"PASS_THROUGH"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender ends the operator itself when another file is loaded or it quits."""
        self._close(context)

    def _start(self, context: bpy.types.Context) -> None:
        scene = context.scene
        folder = folder_of(scene)
        with disk_errors(folder):
            try:
                folder.mkdir(parents=True, exist_ok=True)
            except (FileExistsError, NotADirectoryError) as error:
                raise WorkspaceError(
                    f"{folder} cannot be a folder: a file is in the way.", remedy="Choose another folder.", path=folder,
                ) from error
        self._scene_name, self._folder = scene.name, folder
        self._copy = render_scene.create(scene)
        self._queue = self.shots(context, self._copy, folder)
        progress.running, progress.done, progress.total, progress.name = True, 0, len(self._queue), ""

    def _finish(self, context: bpy.types.Context) -> set[str]:
        self._close(context)
        missing = [shot.file for shot in self._queue if not shot.file.is_file()]
        try:
            if missing:
                raise WorkspaceError(
                    f"Blender could not write {missing[0]}.", path=missing[0],
                    remedy="Check the free space of the disk and the folder's permissions.",
                )
            said = self.done(bpy.data.scenes[self._scene_name], self._folder)
        except CuReconError as error:
            return self._fail(error)
        self.report({"INFO"}, said)
        return {"FINISHED"}

    def _fail(self, error: CuReconError | RuntimeError) -> set[str]:
        self._close(bpy.context)
        self.report({"ERROR"}, running.explain(error) if isinstance(error, CuReconError) else str(error).strip())
        return {"CANCELLED"}

    def _close(self, context: bpy.types.Context) -> None:
        progress.running = False
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None
            bpy.app.handlers.render_cancel.remove(self._on_cancel)
            running.redraw_panels(context)
        if (copy := render_scene.find()) is not None:
            render_scene.remove(copy)

    def _on_cancel(self, *_: object) -> None:
        self._cancelled = True
