# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Stills, a film and a contact sheet with one button, and the folder that they are in."""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.app.translations import pgettext_rpt as rpt_

from ..core.base.errors import WorkspaceError
from ..core.base.language import Text
from ..scene import render_scene, showreel
from . import rendering, running
from .rendering import RenderSeries


class CURECON_OT_render_showreel(RenderSeries, bpy.types.Operator):
    """Render five stills, a film and a contact sheet.

The film shows the camera move that the scene looks through, or else a turntable"""

    bl_idname = "curecon.render_showreel"
    bl_label = "Render Stills and Film"

    def shots(self, context: bpy.types.Context, stage: bpy.types.Scene, folder: Path) -> list[render_scene.Shot]:
        self._shots = showreel.shots(context.scene, stage, folder)
        return self._shots

    def done(self, scene: bpy.types.Scene, folder: Path) -> str:
        stills = [shot for shot in self._shots if shot.frames == 1]
        showreel.write_contact_sheet(stills, folder, rendering.title_of(scene), rendering.today())
        self.sheet = folder / "contact_sheet.png"
        if len(stills) == len(self._shots):
            self.report({"WARNING"}, "This Blender was built without FFmpeg and makes no films.")
            return rpt_("{} stills and a contact sheet are in {}.").format(len(stills), folder)
        return rpt_("{} stills, a film and a contact sheet are in {}.").format(len(stills), folder)


class CURECON_OT_open_presentation(bpy.types.Operator):
    """Show the presentation's files in the computer's own file browser"""

    bl_idname = "curecon.open_presentation"
    bl_label = "Open Folder"

    def execute(self, context: bpy.types.Context) -> set[str]:
        folder = rendering.folder_of(context.scene)
        if not folder.is_dir():
            error = WorkspaceError(Text("{} is not there yet.", folder), remedy="Render something first.", path=folder)
            self.report({"ERROR"}, running.explain(error))
            return {"CANCELLED"}
        bpy.ops.wm.path_open(filepath=str(folder))
        return {"FINISHED"}


CLASSES = (CURECON_OT_render_showreel, CURECON_OT_open_presentation)
