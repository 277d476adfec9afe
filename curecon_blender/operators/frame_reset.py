# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Back to the frame as it was reconstructed."""

from __future__ import annotations

import bpy
import numpy as np

from ..core.site.adjustment import Adjustment
from ..scene import frame
from .picking import PickingOperator


class CURECON_OT_frame_reset(PickingOperator, bpy.types.Operator):
    """Take back scale, level and north that were set here: the site stands as it was reconstructed"""

    bl_idname = "curecon.frame_reset"
    bl_label = "Reset Frame"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not super().poll(context):
            return False
        if not frame.part_of(context).adjustment.measured:
            cls.poll_message_set("The site stands as it was reconstructed")
            return False
        return True

    def apply(self, context: bpy.types.Context, places: list[np.ndarray]) -> str:
        frame.adjust(context.scene, frame.part_of(context), Adjustment())
        return "The site stands as it was reconstructed."


CLASSES = (CURECON_OT_frame_reset,)
