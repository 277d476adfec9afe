# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The part of the preferences that says whether the installation works."""

from __future__ import annotations

import bpy

from ..operators import running
from ..operators.self_check import STEP, described
from .layout import draw_progress, paragraph


def draw(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    row = layout.row()
    row.operator("curecon.self_check", icon="CHECKMARK")
    row.operator("curecon.copy_diagnostics", icon="COPYDOWN")
    status = running.status
    if running.step != STEP:
        return
    if status.running:
        draw_progress(layout, status)
        return
    box = layout.box()
    if status.failure is not None:
        paragraph(box, context, status.failure.message, icon="CANCEL", alert=True)
        paragraph(box, context, status.failure.remedy)
    elif status.result is not None:
        box.label(text="The installation works", icon="CHECKMARK")
        for line in described(status.result.summary):
            paragraph(box, context, line)
