# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A .blend that does not tell where the site is."""

from __future__ import annotations

import bpy

from ..core.base.errors import CuReconError
from ..scene import frame
from . import running


class CURECON_OT_forget_position(bpy.types.Operator):
    """Take latitude, longitude and altitude out of this .blend, so that it can be given away without them. The
    workspace keeps them: importing it again brings them back"""

    bl_idname = "curecon.forget_position"
    bl_label = "Forget GPS Position"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if frame.has_position():
            return True
        cls.poll_message_set("This .blend holds no GPS position")
        return False

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            frame.forget_position()
        except CuReconError as error:
            self.report({"ERROR"}, running.explain(error))
            return {"CANCELLED"}
        self.report({"INFO"}, "This .blend holds no GPS position any more; save it to keep it so.")
        return {"FINISHED"}


CLASSES = (CURECON_OT_forget_position,)
