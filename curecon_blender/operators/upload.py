# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A published site to an atlas on the network, after a question."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
from bpy.app.translations import pgettext_iface as iface_
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import BoolProperty, EnumProperty, IntProperty, StringProperty

from ..core.base.errors import CuReconError
from ..core.base.options import TOKEN_VARIABLE, UPLOAD
from ..languages import current
from ..preferences import settings
from . import paths, running
from .running import WorkerOperator

_items: list[tuple[str, str, str]] = []  # Blender keeps no copy of an enumeration's texts


def _sites(operator: bpy.types.Operator, context: bpy.types.Context | None) -> list[tuple[str, str, str]]:
    """The published sites, the one that was published last at the top."""
    if context is not None:
        records = [*(paths.absolute(context.scene.curecon.result.published) / "sites").glob("*/site.json")]
        names = [path.parent.name for path in sorted(records, key=lambda path: path.stat().st_mtime, reverse=True)]
        _items[:] = [(name, name, "") for name in names]
    return _items


class CURECON_OT_upload(WorkerOperator, bpy.types.Operator):
    """Upload a published site to the atlas that the preferences name. Others see it when a moderator has accepted it.

What has come there stays when it is cancelled, and the next press goes on from there"""

    bl_idname = "curecon.upload"
    bl_label = "Upload to Atlas"

    task = "Uploading"
    panel = "result"

    site: EnumProperty(name="Site", description="Which published site is uploaded", items=_sites)
    tags: StringProperty(name="Tags", description="Words that the site is found by, with commas between")
    register: StringProperty(name="Register Number", description="The site's number in a heritage register")
    dated: BoolProperty(name="Period Known", description="Say when the site was built and used")
    period_from: IntProperty(name="From Year", description="Before our era below zero", min=-10_000, max=2200)
    period_to: IntProperty(name="To Year", description="Before our era below zero", min=-10_000, max=2200)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not running.idle(cls):
            return False
        if not context.scene.curecon.result.published:
            cls.poll_message_set("Publish the site first")
            return False
        return running.online(cls)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return context.window_manager.invoke_props_dialog(
            self, width=running.QUESTION_WIDTH, title="Upload to Atlas?", confirm_text="Upload")

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        for name in ("site", "tags", "register", "dated"):
            layout.prop(self, name)
        if self.dated:
            column = layout.column(align=True)
            column.prop(self, "period_from")
            column.prop(self, "period_to")
        address = settings(context).atlas
        if not address:
            layout.label(text="The preferences name no atlas yet.", icon="ERROR")
            return
        layout.label(text=iface_("The site's pages go to {}.").format(address), translate=False)
        layout.label(text="They tell of its place what you chose when you published it.")
        layout.label(text="Others see them when a moderator there has accepted them.")

    def execute(self, context: bpy.types.Context) -> set[str]:
        if not bpy.app.online_access:
            self.report({"ERROR"}, running.OFFLINE)
            return {"CANCELLED"}
        return WorkerOperator.execute(self, context)

    def arguments(self, context: bpy.types.Context) -> list[str]:
        chosen = settings(context)
        if not chosen.atlas:
            raise CuReconError("The preferences name no atlas yet.",
                               remedy="Put its address and a token from your page there into the add-on's preferences.")
        folder: Path = paths.absolute(context.scene.curecon.result.published)
        given = [UPLOAD, str(folder), f"--to={chosen.atlas}", f"--site={self.site}", f"--tags={self.tags}",
                 f"--register={self.register}", f"--language={current()}"]
        return [*given, "--period", str(self.period_from), str(self.period_to)] if self.dated else given

    def environment(self, context: bpy.types.Context) -> dict[str, str]:
        return {TOKEN_VARIABLE: settings(context).atlas_token}

    def done(self, context: bpy.types.Context, scene: bpy.types.Scene, summary: dict[str, Any]) -> str:
        return rpt_("The site is at {}: a moderator there decides on it.").format(summary["uploaded"])


CLASSES = (CURECON_OT_upload,)
