# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Bringing a workspace into the scene, and turning the view to what came."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import bpy
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import BoolProperty, StringProperty

from ..scene import cameras, control, history, marks, points, presentation, sidebar, surface, view, workspace
from ..scene.surface import surfaces_of
from ..scene.workspace import Imported, clouds_of
from . import paths, running
from .running import ModalOperator, Work

EASY_POINTS = 10_000_000  # what a viewport shows without trouble


def bring_in(
    context: bpy.types.Context, scene: bpy.types.Scene, folder: Path, *, photos: int = 0, show: bool = True
) -> Work:
    """Import the workspace, fill the Result panel and, with `show`, turn the viewports to what came; returns a report.

    `photos` is how many were given to the job, 0 when unknown. Nothing is in the scene until the last slice, so that
    one undo takes all of it back. Raises WorkspaceError.
    """
    session_uid, pack, detail = scene.session_uid, scene.curecon.pack_textures, scene.curecon.shown_detail
    yield "Reading the workspace"
    pool = ThreadPoolExecutor(1, thread_name_prefix="curecon-read")
    reading = pool.submit(workspace.read, folder, detail)
    pool.shutdown(wait=False)
    while not reading.done():
        yield None
    content = reading.result()
    while True:
        turns = history.turns
        with closing(workspace.build(content, lambda: running.scene_with(session_uid), pack=pack)) as building:
            try:
                while turns == history.turns:  # an undo takes away what has been built
                    yield next(building)
            except StopIteration as end:
                control.take_up(running.scene_with(session_uid), content.control, content.folder)
                return _show(
                    context, running.scene_with(session_uid), folder, end.value, photos=photos, show=show)


def _show(
    context: bpy.types.Context, scene: bpy.types.Scene, folder: Path, imported: Imported, *, photos: int, show: bool
) -> str:
    """Tell of an import in the Result panel, and let the scene show it; returns the report."""
    properties, result = scene.curecon, scene.curecon.result
    result.workspace, result.points, result.photos = str(folder), imported.points, photos
    result.cameras, result.parts = len(imported.cameras), imported.parts
    result.faces, result.textured = imported.faces, imported.textured
    result.filled, result.weak, result.unseen = 100 * imported.filled, 100 * imported.weak, 100 * imported.unseen
    properties.display_fraction = min(100.0, 100.0 * EASY_POINTS / max(imported.points, 1))
    cameras.show(scene, properties.show_cameras)
    properties.show_cloud, properties.show_surface = not imported.surfaces, True
    marks.show(surfaces_of(scene), properties.shown_marks())
    surface.light(scene, properties.surface_light == "SCENE")
    if imported.surfaces:
        view.show_texture(context, textured=imported.textured)
        view.light(context, properties.surface_light == "SCENE")
    known = {workspace.WORKSPACE_KEY, presentation.ROLE_KEY}
    ours = all(known & {*child.keys()} for child in scene.collection.children)
    if ours and not bpy.app.background:  # nothing of the user's is folded with it
        sidebar.fold_outliner_once_drawn()
    if show and imported.bounds is not None:
        view.turn_to(context, imported.bounds)
    if imported.surfaces:
        said = rpt_("{:,} points, {:,} faces and {:,} cameras are in the scene.").format(
            imported.points, imported.faces, len(imported.cameras))
    else:
        said = rpt_("{:,} points and {:,} cameras are in the scene.").format(imported.points, len(imported.cameras))
    sentences = [said]
    if imported.cleared:
        sentences.append(rpt_("The new file's cube, camera and light made room."))
    if imported.missing_pictures:
        sentences.append(rpt_("{:,} pictures are missing in {}.").format(imported.missing_pictures, folder))
    if imported.stray:
        sentences.append(rpt_("Too far from the first part to stand where it belongs: {}.").format(
            ", ".join(imported.stray)))
    if imported.stale_edits:
        sentences.append(
            rpt_("The cloud is new: points that were taken out of the earlier one are taken out no more."))
    return " ".join(sentences)


class CURECON_OT_import_workspace(ModalOperator, bpy.types.Operator):
    """Bring the cameras, the point cloud and the surface of an existing workspace folder into the scene"""

    bl_idname = "curecon.import_workspace"
    bl_label = "Import Workspace"
    bl_options = {"UNDO"}

    directory: StringProperty(
        name="Workspace", description="The folder that Reconstruct made", subtype="DIR_PATH", options={"SKIP_SAVE"},
    )
    filter_folder: BoolProperty(
        name="Folders", description="The file browser shows folders", default=True, options={"HIDDEN"},
    )

    task = "Importing"

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if self.directory:  # a caller's own
            return ModalOperator.invoke(self, context, event)
        self.directory = context.scene.curecon.workspace
        return self.browse(context)

    def work(self, context: bpy.types.Context) -> Work:
        return bring_in(context, context.scene, paths.absolute(self.directory))


class CURECON_OT_frame_cloud(bpy.types.Operator):
    """Turn the 3D viewports to the whole surface or cloud"""

    bl_idname = "curecon.frame_cloud"
    bl_label = "Frame All"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return paths.site_stands(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        item = [*surfaces_of(context.scene), *clouds_of(context.scene)][0]
        if (bounds := points.bounds(points.subject(item))) is not None:
            view.turn_to(context, bounds)
        return {"FINISHED"}


CLASSES = (CURECON_OT_import_workspace, CURECON_OT_frame_cloud)
