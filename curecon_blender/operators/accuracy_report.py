# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The accuracy report of the workspace that the scene's cloud came from."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
from bpy.app.translations import pgettext_rpt as rpt_

from ..core.base.options import REPORT
from . import paths, running
from .running import WorkerOperator


class CURECON_OT_accuracy_report(WorkerOperator, bpy.types.Operator):
    """Write what the record rests on, how precise and how complete it is, and where it comes from, as PDF and as a web
page, and open the page"""

    bl_idname = "curecon.accuracy_report"
    bl_label = "Accuracy Report"

    task = "Writing the report"
    panel = "result"
    by: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Made By", description="Who made the record, if the report should say it"
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not running.idle(cls):
            return False
        result = context.scene.curecon.result
        if not (result.workspace and result.points):
            cls.poll_message_set("Reconstruct photos or import a workspace with a cloud first")
            return False
        return True

    def workspace(self, context: bpy.types.Context) -> Path | None:
        return paths.absolute(context.scene.curecon.result.workspace)

    def arguments(self, context: bpy.types.Context) -> list[str]:
        return [REPORT, str(self.workspace(context)), *(["--by", self.by] if self.by else [])]

    def done(self, context: bpy.types.Context, scene: bpy.types.Scene, summary: dict[str, Any]) -> str:
        files: dict[str, str] = summary["report"]
        if not bpy.app.background:
            bpy.ops.wm.path_open(filepath=files["html"])
        return rpt_("The report is in {}.").format(Path(files["pdf"]).parent)


CLASSES = (CURECON_OT_accuracy_report,)
