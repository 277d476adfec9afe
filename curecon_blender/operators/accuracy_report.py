# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The accuracy report of the workspace that the scene's cloud came from."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
from bpy.app.translations import pgettext_rpt as rpt_

from ..core.base.options import REPORT
from ..languages import current
from . import paths, running
from .running import WorkerOperator

FONT = "Noto Sans CJK Regular.woff2"  # of Blender's own: Latin, Greek, Cyrillic, Chinese, Japanese and Korean letters


def report_arguments(context: bpy.types.Context, workspace: Path | None, site: str, by: str, when: str) -> list[str]:
    """The worker's arguments; what is empty is as the scene and Blender's language have it."""
    scene = context.scene.curecon
    font = Path(bpy.utils.system_resource("DATAFILES", path="fonts")) / FONT
    told = {
        "--name": site or scene.present.title, "--by": by or scene.credit, "--when": when,
        "--language": current(), "--font": str(font) if font.is_file() else "",
    }
    return [REPORT, str(workspace), *(f"{flag}={value}" for flag, value in told.items() if value)]


class CURECON_OT_accuracy_report(WorkerOperator, bpy.types.Operator):
    """Write what the record rests on, how precise and how complete it is, and where it comes from, as PDF and as a web
page, and open the page"""

    bl_idname = "curecon.accuracy_report"
    bl_label = "Accuracy Report"

    task = "Writing the report"
    panel = "result"
    site: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Site", description="The site's name; empty: the title of its sheets, or else the photos' folder"
    )
    by: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Made By", description="Who made the record; empty: the credit of its exports"
    )
    when: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Date", description="When the record was made, if the report should say it"
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return running.idle(cls) and paths.cloud_finished(cls, context)

    def workspace(self, context: bpy.types.Context) -> Path | None:
        return paths.absolute(context.scene.curecon.result.workspace)

    def arguments(self, context: bpy.types.Context) -> list[str]:
        return report_arguments(context, self.workspace(context), self.site, self.by, self.when)

    def done(self, context: bpy.types.Context, scene: bpy.types.Scene, summary: dict[str, Any]) -> str:
        files: dict[str, str] = summary["report"]
        if not bpy.app.background:
            bpy.ops.wm.path_open(filepath=files["html"])
        return rpt_("The report is in {}.").format(Path(files["pdf"]).parent)


CLASSES = (CURECON_OT_accuracy_report,)
