# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Choosing the photo folder, in the file browser or by dropping photos on the 3D viewport."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import BoolProperty, CollectionProperty, EnumProperty, StringProperty

from ..core.base.errors import CuReconError
from ..scene import sidebar
from . import running


def _use(operator: bpy.types.Operator, context: bpy.types.Context, directory: str) -> set[str]:
    """Make a folder the scene's photos, open the tab where what follows is told, and check them."""
    folder = Path(bpy.path.abspath(directory))
    if not folder.is_dir():
        said = rpt_("{} is not a folder. Choose the folder with the drone's photos.")
        operator.report({"ERROR"}, said.format(folder))
        return {"CANCELLED"}
    properties = context.scene.curecon
    properties.photos, properties.workspace, properties.model = str(folder), "", ""
    properties.check.folder = ""
    if not bpy.app.background:
        sidebar.show_tab(context)
        try:
            bpy.ops.curecon.check_photos("INVOKE_DEFAULT")
        except (RuntimeError, CuReconError) as error:  # the check's own report, which the panel shows
            operator.report({"WARNING"}, str(error).strip())
    return {"FINISHED"}


class CURECON_OT_choose_photos(bpy.types.Operator):
    """Choose the folder with the drone's photos, then check them"""

    bl_idname = "curecon.choose_photos"
    bl_label = "Use This Folder"  # what the file browser's button says
    bl_options = {"UNDO"}

    directory: StringProperty(
        name="Folder", description="The folder with the drone's photos", subtype="DIR_PATH",
        options={"SKIP_SAVE", "HIDDEN"},
    )
    files: CollectionProperty(
        type=bpy.types.OperatorFileListElement, name="Photos", description="Chosen photos: their folder is meant",
        options={"SKIP_SAVE", "HIDDEN"},
    )
    display_type: EnumProperty(
        name="Display", description="The file browser shows thumbnails", default="THUMBNAIL", options={"HIDDEN"},
        items=(("THUMBNAIL", "Thumbnails", "Small pictures of the photos", 3),),  # as Blender counts them
    )
    filter_folder: BoolProperty(
        name="Folders", description="The file browser shows folders", default=True, options={"HIDDEN"},
    )
    filter_image: BoolProperty(
        name="Photos", description="The file browser shows photos", default=True, options={"HIDDEN"},
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return running.idle(cls)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self.directory = context.scene.curecon.photos
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        return _use(self, context, self.directory)


class CURECON_OT_drop_photos(bpy.types.Operator):
    """Take the folder of dropped photos, then check them"""

    bl_idname = "curecon.drop_photos"
    bl_label = "Drone Photos (CU-Recon)"  # what the menu of a drop says, beside what Blender can do with pictures
    bl_options = {"UNDO", "INTERNAL"}

    directory: StringProperty(
        name="Folder", description="The folder of the dropped photos", subtype="DIR_PATH",
        options={"SKIP_SAVE", "HIDDEN"},
    )
    files: CollectionProperty(
        type=bpy.types.OperatorFileListElement, name="Photos", description="Dropped photos: their folder is meant",
        options={"SKIP_SAVE", "HIDDEN"},
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return running.idle(cls)

    def execute(self, context: bpy.types.Context) -> set[str]:
        return _use(self, context, self.directory)


class CURECON_OT_show_tab(bpy.types.Operator):
    """Open the sidebar on the tab CU-Recon"""

    bl_idname = "curecon.show_tab"
    bl_label = "Photogrammetry with CU-Recon"

    def execute(self, context: bpy.types.Context) -> set[str]:
        sidebar.show_tab(context)
        return {"FINISHED"}


class CURECON_OT_open_workspace(bpy.types.Operator):
    """Turn to a workspace of its own: a large 3D viewport and the tab CU-Recon, made of the workspace that is open"""

    bl_idname = "curecon.open_workspace"
    bl_label = "Photogrammetry Workspace"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if bpy.app.background or context.window is None:
            cls.poll_message_set("Blender runs without a window")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        sidebar.open_workspace(context.window)
        return {"FINISHED"}


class CURECON_FH_photos(bpy.types.FileHandler):
    """Photos dropped on a 3D viewport. Blender offers file handlers by extension only, so a folder cannot be dropped
    there; dropped photos stand for their whole folder."""

    bl_idname = "CURECON_FH_photos"
    bl_label = "CU-Recon: Reconstruct These Photos' Folder"
    bl_import_operator = "curecon.drop_photos"
    bl_file_extensions = ".jpg;.jpeg;.png;.tif;.tiff;.heic;.heif;.hif;.dng;.cr2;.cr3;.nef;.arw;.raf;.orf;.rw2;.pef;.srw"

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        return context.area is not None and context.area.type == "VIEW_3D"


CLASSES = (CURECON_OT_choose_photos, CURECON_OT_drop_photos, CURECON_OT_show_tab,
           CURECON_OT_open_workspace, CURECON_FH_photos)
