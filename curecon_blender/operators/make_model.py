# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Everything with one press: photos to a textured mesh in the scene, framed, lit, and a picture of it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
from bpy.app.translations import pgettext_n as n_
from bpy.app.translations import pgettext_rpt as rpt_

from ..core.base.options import RUN, arguments
from ..languages import translated
from ..scene import flight, render_scene
from . import paths, running
from .import_workspace import bring_in
from .job_options import job_options
from .rendering import RenderSeries
from .running import Work, WorkerOperator

GOAL = "texture"  # the stage that it ends with
PICTURE_DELAY = 0.5  # seconds after the import: its undo step must not hold the scene that is rendered


class CURECON_OT_make_model(WorkerOperator, bpy.types.Operator):
    """All steps with one press: a textured mesh of the photos in the scene, framed and lit, and a picture of it.

A cancelled or broken run goes on where it stopped"""

    bl_idname = "curecon.make_model"
    bl_label = "Make the Model"
    bl_options = {"UNDO"}

    task = "Making the model"
    panel = "photos"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return running.idle(cls) and paths.photos_chosen(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        ended = WorkerOperator.execute(self, context)
        if ended == {"FINISHED"}:
            bpy.ops.curecon.render_still()
        return ended

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        ended = WorkerOperator.modal(self, context, event)
        if ended == {"FINISHED"}:
            bpy.app.timers.register(_take_picture_in(context.window), first_interval=PICTURE_DELAY)
        return ended

    def workspace(self, context: bpy.types.Context) -> Path | None:
        return paths.workspace_folder(context, context.scene)

    def arguments(self, context: bpy.types.Context) -> list[str]:
        return arguments(job_options(context, until=GOAL), RUN)

    def done(self, context: bpy.types.Context, scene: bpy.types.Scene, summary: dict[str, Any]) -> Work:
        uid = scene.session_uid
        said = yield from bring_in(context, scene, paths.workspace_folder(context, scene), photos=summary["photos"])
        scene = running.scene_with(uid)
        flight.still(scene)
        if missing := render_scene.apply_quality(scene):
            said = f"{said} {translated(missing)}"
        return said


class CURECON_OT_render_still(RenderSeries, bpy.types.Operator):
    """Render a picture of the whole site, from the side that the photos were taken from"""

    bl_idname = "curecon.render_still"
    bl_label = "Render Picture"

    def shots(self, context: bpy.types.Context, stage: bpy.types.Scene, folder: Path) -> list[render_scene.Shot]:
        scene = context.scene
        camera = render_scene.add_own(stage, flight.still(scene))
        size = render_scene.film_size(scene)
        return [render_scene.Shot(name=n_("Picture"), file=folder / "still.png", camera=camera, size=size)]

    def done(self, scene: bpy.types.Scene, folder: Path) -> str:
        self.sheet = folder / "still.png"
        return rpt_("The picture is {}.").format(self.sheet)


def _take_picture_in(window: bpy.types.Window) -> Callable[[], None]:
    def take() -> None:
        with bpy.context.temp_override(window=window):
            bpy.ops.curecon.render_still("INVOKE_DEFAULT")

    return take


CLASSES = (CURECON_OT_make_model, CURECON_OT_render_still)
