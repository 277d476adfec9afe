# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The main job: photos to a coloured point cloud in the scene, and on to a textured mesh where that is wanted; and a
COLMAP model in place of our own cameras."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
from bpy.props import BoolProperty, StringProperty

from ..core.base.errors import SparseError
from ..core.base.language import Text
from ..core.base.options import RUN, arguments
from . import paths, running
from .import_workspace import bring_in
from .job_options import job_options
from .running import Work, WorkerOperator


class CURECON_OT_reconstruct(WorkerOperator, bpy.types.Operator):
    """Find the cameras, compute a depth map for every photo and fuse them into a coloured point cloud or a surface.

A cancelled or broken run goes on where it stopped"""

    bl_idname = "curecon.reconstruct"
    bl_label = "Reconstruct"
    bl_options = {"UNDO"}

    task = "Reconstructing"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return running.idle(cls) and paths.photos_chosen(cls, context)

    def workspace(self, context: bpy.types.Context) -> Path | None:
        return paths.workspace_folder(context, context.scene)

    def arguments(self, context: bpy.types.Context) -> list[str]:
        return arguments(job_options(context, until=context.scene.curecon.goal), RUN)

    def done(self, context: bpy.types.Context, scene: bpy.types.Scene, summary: dict[str, Any]) -> Work:
        return bring_in(context, scene, paths.workspace_folder(context, scene), photos=summary["photos"])


class CURECON_OT_import_model(WorkerOperator, bpy.types.Operator):
    """Take the cameras of a COLMAP model (text or binary) as they are, with the chosen photos"""

    bl_idname = "curecon.import_model"
    bl_label = "Import COLMAP Model"
    bl_options = {"UNDO"}

    directory: StringProperty(
        name="Model", description="The folder with cameras, images and points3D (.bin or .txt)", subtype="DIR_PATH",
        options={"SKIP_SAVE"},
    )
    photos: StringProperty(
        name="Photos", description="The folder with the model's photos", subtype="DIR_PATH", options={"SKIP_SAVE"},
    )
    filter_folder: BoolProperty(
        name="Folders", description="The file browser shows folders", default=True, options={"HIDDEN"},
    )

    task = "Importing cameras"

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.label(text="Photos of the model:")
        self.layout.prop(self, "photos", text="")

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self.photos = self.photos or context.scene.curecon.photos
        return self.browse(context)

    def workspace(self, context: bpy.types.Context) -> Path | None:
        return paths.workspace_folder(context, context.scene)

    def arguments(self, context: bpy.types.Context) -> list[str]:
        folder = Path(bpy.path.abspath(self.directory))
        if not any((folder / f"cameras{ending}").is_file() for ending in (".bin", ".txt")):
            raise SparseError(
                Text("{} holds no COLMAP model.", folder),
                remedy="Choose the folder that holds cameras, images and points3D as .bin or .txt.", path=folder,
            )
        properties = context.scene.curecon
        if self.photos:
            properties.photos = self.photos
        properties.model = str(folder)
        return arguments(job_options(context, until="views"), RUN)

    def done(self, context: bpy.types.Context, scene: bpy.types.Scene, summary: dict[str, Any]) -> Work:
        return bring_in(context, scene, paths.workspace_folder(context, scene), photos=summary["photos"])


class CURECON_OT_cancel(bpy.types.Operator):
    """Stop the running job. Finished work is kept, and the next run goes on from it"""

    bl_idname = "curecon.cancel"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not running.status.running or running.status.cancelling:
            cls.poll_message_set("It is being cancelled" if running.status.running else "No job is running")
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """By a key: asks first where much would have to be waited for again."""
        if running.status.seconds_running < running.LONG_SECONDS:
            return self.execute(context)
        return context.window_manager.invoke_confirm(
            self, event, title="Stop the Job?", confirm_text="Stop", icon="QUESTION",
            message="Finished work is kept, and the next run goes on from it.",
        )

    def execute(self, context: bpy.types.Context) -> set[str]:
        running.cancel()
        running.redraw_panels(context)
        return {"FINISHED"}


CLASSES = (CURECON_OT_reconstruct, CURECON_OT_import_model, CURECON_OT_cancel)
