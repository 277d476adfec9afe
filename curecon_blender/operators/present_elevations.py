# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""True-scale sheets of the façades and the roof."""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.app.translations import pgettext_rpt as rpt_

from ..core.base.errors import WorkspaceError
from ..core.photos import capture
from ..languages import translated
from ..scene import elevations, render_scene, site
from . import owner, paths, rendering
from .rendering import RenderSeries


class CURECON_OT_render_elevations(RenderSeries, bpy.types.Operator):
    """Draw four façades and the roof plan to scale, a sheet each: PNG, and one PDF at true size"""

    bl_idname = "curecon.render_elevations"
    bl_label = "Draw Elevations"

    def shots(self, context: bpy.types.Context, stage: bpy.types.Scene, folder: Path) -> list[render_scene.Shot]:
        owner.recall(context)
        self._plan = elevations.plan(context.scene, stage, folder)
        return self._plan.shots

    def done(self, scene: bpy.types.Scene, folder: Path) -> str:
        try:
            times = capture.read_times(paths.absolute(site.workspace(scene)))
        except WorkspaceError as error:
            times = {}
            text = rpt_("{} The sheets do not say when the photos were taken.")
            self.report({"WARNING"}, text.format(translated(error.message)))
        said_of_all = elevations.notes(scene, times)
        drawn = rpt_("Drawn {}").format(rendering.today())
        bare = elevations.write_sheets(self._plan, folder, rendering.title_of(scene), drawn, said_of_all)
        self.sheet = self._plan.elevations[0].shot.file
        if bare:
            names = ", ".join(map(translated, bare))
            self.report({"WARNING"}, rpt_("Next to nothing was measured on: {}.").format(names))
        said = [rpt_("{} sheets and elevations.pdf are in {}.").format(len(self._plan.elevations), folder)]
        if self._plan.round:
            said.append(rpt_("The walls face all ways alike, so the sides are those of the scene's axes."))
        return " ".join(said)


CLASSES = (CURECON_OT_render_elevations,)
