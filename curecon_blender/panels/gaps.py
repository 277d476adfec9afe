# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""After a first result: where to fly again."""

from __future__ import annotations

import bpy

from ..operators import running
from ..scene import gaps
from .layout import Panel, draw_outcome, draw_progress, paragraph


class CURECON_PT_gaps(Panel, bpy.types.Panel):
    bl_idname = "CURECON_PT_gaps"
    bl_parent_id = "CURECON_PT_result"
    bl_label = "Gaps"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return bool(context.scene.curecon.result.workspace)

    def draw(self, context: bpy.types.Context) -> None:
        layout, ours = self.layout, running.panel == "gaps"
        if running.status.running and ours:
            draw_progress(layout, running.status)
            return
        layout.operator("curecon.find_gaps", icon="VIEWZOOM")
        if ours:
            draw_outcome(layout, context, running.status)
        if gaps.drawn(context.scene):
            paragraph(layout, context, "Green: enough photos. Yellow, orange, red: one, two, three are lacking, or it "
                      "was filled. Violet: nothing was found.")
            said = gaps.says(context.active_object)
            paragraph(layout, context, said or "Select a camera of these photos to read where to fly.")


CLASSES = (CURECON_PT_gaps,)
