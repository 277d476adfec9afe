# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a finished site lacks photos, and where to fly again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
from bpy.app.translations import pgettext_rpt as rpt_

from ..core.base.options import GAPS
from ..scene import gaps, view
from . import paths, running
from .running import WorkerOperator


class CURECON_OT_find_gaps(WorkerOperator, bpy.types.Operator):
    """Show what too few photos saw, and the few further photos that would close these gaps, as cameras and as a mission
for the drone"""

    bl_idname = "curecon.find_gaps"
    bl_label = "Find Gaps"

    task = "Finding gaps"
    panel = "gaps"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return running.idle(cls) and paths.cloud_finished(cls, context)

    def workspace(self, context: bpy.types.Context) -> Path | None:
        return paths.absolute(context.scene.curecon.result.workspace)

    def arguments(self, context: bpy.types.Context) -> list[str]:
        plan = context.scene.curecon.plan
        return [GAPS, str(self.workspace(context)), f"--clearance={plan.clearance}", f"--ceiling={plan.ceiling}"]

    def done(self, context: bpy.types.Context, scene: bpy.types.Scene, summary: dict[str, Any]) -> str:
        found = summary["gaps"]
        gaps.draw(scene, Path(found["folder"]), found["photos"])
        view.show_texture(context, textured=False)
        if not found["photos"]:
            return rpt_("{:.0%} of the surface lacks photos, and no further photo helps much.").format(found["lacking"])
        return rpt_("{:.0%} of the surface lacks photos; {} more would leave {:.0%}. Missions are in {}.").format(
            found["lacking"], len(found["photos"]), found["lacking_after"], found["folder"])


CLASSES = (CURECON_OT_find_gaps,)
