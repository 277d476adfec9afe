# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A series of renders: Blender's own render jobs one after another in a window, blocking in background Blender."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import date
from pathlib import Path

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..core.base.errors import CuReconError, WorkspaceError
from ..core.base.files import PRESENTATION, disk_errors
from ..core.base.language import Text
from ..scene import pictures, render_scene, site
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
    return scene.curecon.present.title or paths.site_name(scene).replace("_", " ")


def today() -> str:
    """The date in words that no country misreads."""
    now = date.today()
    return iface_("{0.day} {0:%B %Y}").format(now)


def _sentence(error: RuntimeError) -> str:
    """What Blender says of its own operator's failure, without the lines of where."""
    lines = [line for line in str(error).strip().splitlines() if not line.startswith("Location:")]
    return lines[-1].removeprefix("Error: ") if lines else "Blender could not render."


class RenderSeries:
    """Mixed into an operator. A subclass gives `shots`, which puts cameras on the stage, and `done`, which takes in the
    files and returns the report; both may raise CuReconError. Whatever is raised, the stage goes."""

    shots: Callable[[bpy.types.Context, bpy.types.Scene, Path], list[render_scene.Shot]]
    done: Callable[[bpy.types.Scene, Path], str]
    # Blender's, of the operator that this is mixed into:
    report: Callable[[set[str], str], None]
    poll_message_set: Callable[..., None]
    sheet: Path | None = None  # set by `done`: the finished page, to be seen in place of the last render
    _timer: bpy.types.Timer | None = None
    _queue: Sequence[render_scene.Shot] = ()

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not paths.site_stands(cls, context):
            return False
        if progress.running or bpy.app.is_job_running("RENDER"):
            cls.poll_message_set("Blender is rendering")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        return self._guarded(context, self._draw_all)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if bpy.app.background or context.window is None:
            return self.execute(context)
        return self._guarded(context, self._begin)

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type != "TIMER" or bpy.app.is_job_running("RENDER"):
            return {"PASS_THROUGH"}
        if self._cancelled or render_scene.find() is None:
            self._give_up(context)
            self.report({"WARNING"}, "Cancelled; what is finished lies in the folder.")
            return {"CANCELLED"}
        return self._guarded(context, self._go_on)

    def _guarded(self, context: bpy.types.Context, step: Callable[[bpy.types.Context], set[str]]) -> set[str]:
        """A step of the series: an error ends it and is reported in a sentence, and any exception takes the stage
        away."""
        try:
            ended = step(context)
        except (CuReconError, RuntimeError) as error:  # Blender's own: no graphics card for EEVEE, no encoder
            self._give_up(context)
            self.report({"ERROR"}, running.explain(error) if isinstance(error, CuReconError) else _sentence(error))
            return {"CANCELLED"}
        except BaseException:
            self._give_up(context)
            raise
        return ended

    def _draw_all(self, context: bpy.types.Context) -> set[str]:
        self._start(context)
        for shot in self._queue:
            render_scene.set_up(self._stage, shot)
            print(f"CU-Recon: {shot.name}", flush=True)
            bpy.ops.render.render(scene=self._stage.name, write_still=True, animation=shot.frames > 1)
            render_scene.check(self._stage, shot)
        return self._finish(context)

    def _begin(self, context: bpy.types.Context) -> set[str]:
        self._start(context)
        self._cancelled = False
        render_scene.spare_the_window(self._stage)
        # A window that draws a render at work waits for it, for many seconds at a time.
        self._display = context.preferences.view.render_display_type
        self._show_renders(context, "NONE")
        bpy.app.handlers.render_cancel.append(self._on_cancel)
        self._timer = context.window_manager.event_timer_add(POLL_SECONDS, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def _go_on(self, context: bpy.types.Context) -> set[str]:
        """Start the next render in a window, or take in the files of all."""
        if (stage := render_scene.find()) is None:  # Python holds no scene over an undo
            raise CuReconError("The scene that the sheets are rendered in was deleted.", remedy="Start it again.")
        if progress.done > self._checked:
            render_scene.check(stage, self._queue[self._checked])
            self._checked += 1
        if progress.done == len(self._queue):
            ended = self._finish(context)
            if self.sheet is not None:
                pictures.show_finished(context, self.sheet)
            return ended
        shot = self._queue[progress.done]
        render_scene.set_up(stage, shot)
        # A render that another one holds up is asked for again at the next tick.
        started = bpy.ops.render.render(
            "INVOKE_DEFAULT", scene=stage.name, write_still=True, animation=shot.frames > 1
        )
        if "CANCELLED" not in started:
            progress.name, progress.done = shot.name, progress.done + 1
        running.redraw_panels(context)
        return {"PASS_THROUGH"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender ends the operator itself when another file is loaded or it quits."""
        self._give_up(context)

    def _start(self, context: bpy.types.Context) -> None:
        scene = context.scene
        folder = folder_of(scene)
        with disk_errors(folder):
            try:
                folder.mkdir(parents=True, exist_ok=True)
            except (FileExistsError, NotADirectoryError) as error:
                raise WorkspaceError(
                    Text("{} cannot be a folder: a file is in the way.", folder),
                    remedy="Choose another folder.", path=folder,
                ) from error
        self._scene_name, self._folder, self._checked = scene.name, folder, 0
        self._stage = render_scene.create(scene)
        self._queue = self.shots(context, self._stage, folder)
        progress.running, progress.done, progress.total, progress.name = True, 0, len(self._queue), ""

    def _finish(self, context: bpy.types.Context) -> set[str]:
        self._close(context)
        self.report({"INFO"}, self.done(bpy.data.scenes[self._scene_name], self._folder))
        return {"FINISHED"}

    def _give_up(self, context: bpy.types.Context) -> None:
        """End without the finished files: what was rendered to be read alone, for them, goes."""
        self._close(context)
        for shot in self._queue:
            if shot.facts:
                with suppress(OSError):  # of a folder that is gone, or that nobody may write to any more
                    shot.file.unlink(missing_ok=True)

    def _close(self, context: bpy.types.Context) -> None:
        progress.running = False
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None
            bpy.app.handlers.render_cancel.remove(self._on_cancel)
            self._show_renders(context, self._display)
            running.redraw_panels(context)
        if (stage := render_scene.find()) is not None:
            render_scene.remove(stage)

    def _show_renders(self, context: bpy.types.Context, where: str) -> None:
        preferences = context.preferences
        changed = preferences.is_dirty  # by the user
        preferences.view.render_display_type, preferences.is_dirty = where, changed

    def _on_cancel(self, *_: object) -> None:
        self._cancelled = True
