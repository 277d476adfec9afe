# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Handing the cloud to other programs."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import StringProperty
from bpy_extras.io_utils import ExportHelper

from ..core.base.errors import CuReconError
from ..scene.exchange import Choices, export_cloud
from ..scene.workspace import clouds_of
from . import owner, paths, running
from .export_surface import position_property


class CURECON_OT_export_cloud(bpy.types.Operator, ExportHelper):
    """Write the cloud as PLY, in metres and without the points that were taken out, with licence and credit"""

    bl_idname = "curecon.export_cloud"
    bl_label = "Export Point Cloud"

    filename_ext = ".ply"
    position: position_property()
    filter_glob: StringProperty(default="*.ply", options={"HIDDEN"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if clouds_of(context.scene):
            return True
        cls.poll_message_set("There is no cloud in the scene")
        return False

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        owner.recall(context)
        self.filepath = str(paths.export_file(context.scene, " cloud.ply"))
        return ExportHelper.invoke(self, context, event)

    def draw(self, context: bpy.types.Context) -> None:
        layout, properties = self.layout, context.scene.curecon
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(self, "position")
        layout.prop(properties, "licence")
        layout.prop(properties, "credit")

    def execute(self, context: bpy.types.Context) -> set[str]:
        properties, found = context.scene.curecon, clouds_of(context.scene)
        item = next((cloud for cloud in found if cloud.select_get()), found[0])
        path = Path(bpy.path.ensure_ext(self.filepath, self.filename_ext))
        choices = Choices(form="PLY", position=self.position, licence=properties.licence, credit=properties.credit)
        try:
            exported = export_cloud(item, path, choices)
        except CuReconError as error:
            self.report({"ERROR"}, running.explain(error))
            return {"CANCELLED"}
        owner.remember(context)
        said = rpt_("{} is written; it carries the site's GPS position.") if exported.has_position else rpt_(
            "{} is written; it carries no GPS position.")
        self.report({"INFO"}, said.format(path.name))
        return {"FINISHED"}


CLASSES = (CURECON_OT_export_cloud,)
