# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Control points: import, export, delete."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import CollectionProperty, EnumProperty, StringProperty
from bpy_extras.io_utils import ExportHelper

from ..core.adjust.control import read_control
from ..core.adjust.control_files import import_files, write_odm
from ..core.base.errors import CuReconError
from ..core.base.options import CONTROL, DICTIONARIES
from ..core.photos import record as photos_record
from ..scene import control, viewport
from . import paths, running
from .running import WorkerOperator


class CURECON_OT_import_control(bpy.types.Operator):
    """Read control points and marks: ODM's gcp_list.txt and geo.txt, CSV of Pix4D and Metashape, and plain tables of
name, x, y, z in local metres, latitude and longitude, or UTM"""

    bl_idname = "curecon.import_control"
    bl_label = "Import Control Points"
    bl_options = {"REGISTER", "UNDO"}

    directory: StringProperty(subtype="DIR_PATH", options={"SKIP_SAVE", "HIDDEN"})
    files: CollectionProperty(
        type=bpy.types.OperatorFileListElement, name="Files",
        description="One file, or points and marks in two files", options={"SKIP_SAVE", "HIDDEN"},
    )
    filter_glob: StringProperty(default="*.txt;*.csv;*.tsv", options={"HIDDEN"})
    system: StringProperty(
        name="System", description="What the coordinates are in where the file does not say so: WGS84, UTM 50N, "
                                   "EPSG:2180 or local. Empty: find it out by the photos' GPS", options={"SKIP_SAVE"},
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return running.idle(cls) and (bool(context.scene.curecon.control.folder) or paths.photos_chosen(cls, context))

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        chosen = [paths.absolute(self.directory) / file.name for file in self.files if file.name]
        try:
            folder = _workspace(context)
            recorded = (folder / photos_record.FILE_NAME).is_file()
            photos = photos_record.read_photos(folder).photos if recorded else ()
            found, said = import_files(chosen, control.of(context.scene), photos, self.system)
            control.put(context.scene, found, folder)
        except CuReconError as error:
            self.report({"ERROR"}, running.explain(error))
            return {"CANCELLED"}
        for sentence in said:
            self.report({"WARNING"}, sentence)
        self.report({"INFO"}, rpt_("{} points with {} marks.").format(len(found.points), len(found.marks)))
        viewport.redraw()
        return {"FINISHED"}


def _workspace(context: bpy.types.Context) -> Path:
    """Where the points are kept: with the site that has some, else in the scene's own workspace. Raises PhotoError."""
    kept = context.scene.curecon.control.folder
    return Path(kept) if kept else paths.workspace_folder(context, context.scene)


class CURECON_OT_export_control(bpy.types.Operator, ExportHelper):
    """Write the points with their marks as ODM's gcp_list.txt, which WebODM and others read too"""

    bl_idname = "curecon.export_control"
    bl_label = "Export Control Points"

    filename_ext = ".txt"
    filter_glob: StringProperty(default="*.txt", options={"HIDDEN"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if control.of(context.scene).marks:
            return True
        cls.poll_message_set("No point has been marked yet")
        return False

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self.filepath = str(Path(context.scene.curecon.control.folder) / "gcp_list.txt")
        return ExportHelper.invoke(self, context, event)

    def execute(self, context: bpy.types.Context) -> set[str]:
        path = Path(bpy.path.abspath(self.filepath))
        try:
            said = write_odm(path, control.of(context.scene))
        except CuReconError as error:
            self.report({"ERROR"}, running.explain(error))
            return {"CANCELLED"}
        for sentence in said:
            self.report({"WARNING"}, sentence)
        self.report({"INFO"}, rpt_("{} is written.").format(path))
        return {"FINISHED"}


class CURECON_OT_delete_control_point(bpy.types.Operator):
    """Take the chosen point and its marks off the list"""

    bl_idname = "curecon.delete_control_point"
    bl_label = "Delete Control Point"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not running.idle(cls):
            return False
        if not control.active(context.scene):
            cls.poll_message_set("There is no control point on the list")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            control.remove_point(context.scene, control.active(context.scene))
        except CuReconError as error:
            self.report({"ERROR"}, running.explain(error))
            return {"CANCELLED"}
        viewport.redraw()
        return {"FINISHED"}


class CURECON_OT_find_targets(WorkerOperator, bpy.types.Operator):
    """Find coded targets in the photos, and mark with them the points whose names end in their numbers"""

    bl_idname = "curecon.find_targets"
    bl_label = "Find Targets"
    bl_options = {"UNDO"}

    dictionary: EnumProperty(
        name="Targets", description="Which coded targets were laid out, as OpenCV calls them",
        items=[(name, name, "Targets of this kind") for name in DICTIONARIES],
    )

    task = "Finding targets"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not running.idle(cls):
            return False
        if not control.of(context.scene).points:
            cls.poll_message_set("There are no control points: import them first")
            return False
        return True

    def workspace(self, context: bpy.types.Context) -> Path | None:
        return _workspace(context)

    def arguments(self, context: bpy.types.Context) -> list[str]:
        return [CONTROL, str(_workspace(context)), "--find-targets", "--dictionary", self.dictionary]

    def done(self, context: bpy.types.Context, scene: bpy.types.Scene, summary: dict[str, Any]) -> str:
        before, found = len(control.of(scene).marks), read_control(_workspace(context))
        control.put(scene, found)
        return rpt_("{} marks are new.").format(len(found.marks) - before)


CLASSES = (
    CURECON_OT_find_targets, CURECON_OT_import_control, CURECON_OT_export_control, CURECON_OT_delete_control_point,
)
