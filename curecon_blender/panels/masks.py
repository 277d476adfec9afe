# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""After a first result: what to leave out of the photos."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..operators import mask_photos, running
from ..scene import solids
from .layout import Panel, counted, draw_outcome, draw_progress, paragraph


class CURECON_PT_masks(Panel, bpy.types.Panel):
    bl_idname = "CURECON_PT_masks"
    bl_parent_id = "CURECON_PT_result"
    bl_label = "Masks"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return bool(context.scene.curecon.result.workspace)

    def draw(self, context: bpy.types.Context) -> None:
        layout, ours = self.layout, running.panel == "masks"
        if running.status.running and ours:
            draw_progress(layout, running.status)
            return
        around = ", ".join(item.name for item in solids.chosen(context)[:3])
        paragraph(layout, context, iface_("Leaves out what stands inside: {}").format(around) if around else
                  "Put a cube around what is to be left out of all photos, and select it.")
        layout.operator("curecon.mask_photos", icon="MOD_MASK")
        if ours:
            draw_outcome(layout, context, running.status)
        if masked := mask_photos.masked(context):
            row = layout.row(align=True)
            row.label(text=counted(masked, "{:,} photo has a mask", "{:,} photos have masks"), translate=False)
            row.operator("curecon.clear_masks", text="", icon="X")


CLASSES = (CURECON_PT_masks,)
