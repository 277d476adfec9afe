# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The worker's libraries with one press, for zips that do not bring them; and away again."""

# mypy: disable-error-code="valid-type"
# Blender reads an operator's properties from annotations that are calls.

from __future__ import annotations

import shutil
from typing import Any

import bpy
from bpy.app.translations import pgettext_iface as iface_
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import BoolProperty

from ..core.base.files import disk_errors
from ..core.base.options import LIBRARIES
from ..core.run.nvidia import FIRST_DRIVER, find_card
from ..preferences import LOCKS, settings
from . import running
from .running import WorkerOperator


class CURECON_OT_get_libraries(WorkerOperator, bpy.types.Operator):
    """Fetch what CU-Recon computes with, once, from the package index, each file checked: about 400 MB, or 3 GB for
an NVIDIA card.

What has come stays when it is cancelled, and the next press goes on from there"""

    bl_idname = "curecon.get_libraries"
    bl_label = "Get Libraries"

    task = "Getting libraries"
    panel = running.PREFERENCES

    use_card: BoolProperty(
        name="For the NVIDIA Card", description="Several times faster than the processor, and a larger download",
        default=True, options={"SKIP_SAVE"},
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not running.idle(cls):
            return False
        if not LOCKS.is_dir():
            cls.poll_message_set("This CU-Recon brings its libraries itself")
            return False
        return running.online(cls)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if bpy.app.background:
            return self.execute(context)
        self._asked, self._card = True, find_card()
        return context.window_manager.invoke_props_dialog(
            self, width=running.QUESTION_WIDTH, title="Get Libraries?", confirm_text="Get Libraries")

    def draw(self, context: bpy.types.Context) -> None:
        layout, card = self.layout, self._card
        if card is not None and card.usable:
            layout.prop(self, "use_card", text=iface_("For the {}").format(card.name), translate=False)
            if self.use_card:
                layout.label(text="About 3 GB come from pypi.org, and take 6 GB on the disk (9 GB meanwhile).")
                layout.label(text="NVIDIA's libraries among them come under NVIDIA's own terms.")
                return
        layout.label(text="About 400 MB come from pypi.org and pytorch.org, and take 1.4 GB on the disk.")
        if card is not None and card.too_old:
            layout.label(text=iface_("The {} is too old to help: the processor does the work.").format(card.name),
                         translate=False)
        elif card is not None and not card.usable:
            layout.label(text=iface_("The {} could help with driver {} or newer; it has {}.").format(
                card.name, FIRST_DRIVER, card.driver), translate=False)

    def execute(self, context: bpy.types.Context) -> set[str]:
        if getattr(self, "_asked", False):  # back from the question
            self._asked = False
            if context.area is not None and context.area.type == "VIEW_3D" and running.panel:
                self.panel = running.panel  # where its progress is looked for
            return WorkerOperator.invoke(self, context, None)
        return WorkerOperator.execute(self, context)

    def arguments(self, context: bpy.types.Context) -> list[str]:
        chosen = settings(context)
        named = ["--index", *chosen.indexes] if chosen.indexes else []
        processor = [] if self.use_card else ["--processor"]
        return [LIBRARIES, str(chosen.libraries), "--locks", str(LOCKS), *named, *processor]

    def done(self, context: bpy.types.Context, scene: bpy.types.Scene, summary: dict[str, Any]) -> str:
        return rpt_("The libraries are in place. Check Installation tries them.")


class CURECON_OT_remove_libraries(bpy.types.Operator):
    """Delete the libraries that Get Libraries fetched"""

    bl_idname = "curecon.remove_libraries"
    bl_label = "Remove Libraries"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not running.idle(cls):
            return False
        if not settings(context).libraries.is_dir():
            cls.poll_message_set("Get Libraries has not fetched any")
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return context.window_manager.invoke_confirm(self, event)

    def execute(self, context: bpy.types.Context) -> set[str]:
        folder = settings(context).libraries
        with disk_errors(folder):
            shutil.rmtree(folder)
        self.report({"INFO"}, "The libraries are removed.")
        return {"FINISHED"}


CLASSES = (CURECON_OT_get_libraries, CURECON_OT_remove_libraries)
