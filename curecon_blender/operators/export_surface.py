# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Handing the surface to other programs."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import BoolProperty, EnumProperty, StringProperty
from bpy_extras.io_utils import ExportHelper

from ..core.base.errors import CuReconError
from ..languages import translated
from ..scene.exchange import Choices, export_surfaces
from ..scene.surface import surfaces_of
from . import owner, paths, running

FORMS = (
    ("GLB", "GLB", "One file with the texture inside, for the web, presentations and game engines (glTF 2.0)"),
    ("OBJ", "OBJ", "With .mtl and pictures beside it, for CAD and modelling programs"),
    ("PLY", "PLY", "With distance and views at each vertex, for CloudCompare and MeshLab"),
)
TEXTURES = (
    ("AUTO", "As It Is", "The pictures as they are, PNG or JPEG"),
    ("JPEG", "JPEG", "Small files that every viewer reads"),
    ("WEBP", "WebP", "Smaller still; older viewers cannot read it"),
)
COMPRESSIONS = (
    ("NONE", "None", "Every viewer reads it"),
    ("DRACO", "Draco", "About a quarter of the size, exact to half a millimetre, for viewers with Draco"),
    ("MESHOPT", "Meshopt", "Smaller and exact, quick to open, for viewers with meshopt; Blender 5.2 and later"),
)


def position_property() -> object:
    """Whether the file may tell where the site is; off, since a file is soon given away."""
    return BoolProperty(
        name="GPS Position", default=False,
        description="Write latitude, longitude (degrees) and altitude (metres) of the frame's origin into the file. "
                    "Off: nobody can read from it where the site is",
    )


class CURECON_OT_export_surface(bpy.types.Operator, ExportHelper):
    """Write the surface as GLB, OBJ or PLY, with its frame's position, licence and credit"""

    bl_idname = "curecon.export_surface"
    bl_label = "Export Surface"

    form: EnumProperty(name="Format", description="Kind of file", items=FORMS, default="GLB")
    texture: EnumProperty(
        name="Texture", description="How the pictures are kept inside the GLB", items=TEXTURES, default="AUTO",
    )
    compression: EnumProperty(
        name="Compression", description="How the mesh is kept inside the GLB", items=COMPRESSIONS, default="NONE",
    )
    unlit: BoolProperty(
        name="Photo Colours", default=True,
        description="Viewers show the photos' colours as they are. Off: viewers light the surface themselves",
    )
    position: position_property()
    filter_glob: StringProperty(default="*.glb;*.obj;*.ply", options={"HIDDEN"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if surfaces_of(context.scene):
            return True
        cls.poll_message_set("There is no surface in the scene: Build Mesh first")
        return False

    @property
    def filename_ext(self) -> str:  # ExportHelper's name for it
        return f".{self.form.lower()}"

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        owner.recall(context)
        self.filepath = str(paths.export_file(context.scene, self.filename_ext))
        return ExportHelper.invoke(self, context, event)

    def draw(self, context: bpy.types.Context) -> None:
        layout, properties = self.layout, context.scene.curecon
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(self, "form")
        if self.form == "GLB":
            layout.prop(self, "texture")
            layout.prop(self, "compression")
            layout.prop(self, "unlit")
        layout.prop(self, "position")
        layout.prop(properties, "licence")
        layout.prop(properties, "credit")

    def execute(self, context: bpy.types.Context) -> set[str]:
        properties, found = context.scene.curecon, surfaces_of(context.scene)
        items = [item for item in found if item.select_get()] or found
        path = Path(bpy.path.ensure_ext(self.filepath, self.filename_ext))
        choices = Choices(
            form=self.form, texture=self.texture, compression=self.compression, unlit=self.unlit,
            position=self.position, licence=properties.licence, credit=properties.credit,
        )
        try:
            exported = export_surfaces(context, items, path, choices)
        except CuReconError as error:
            self.report({"ERROR"}, running.explain(error))
            return {"CANCELLED"}
        owner.remember(context)
        if exported.has_position:
            said = rpt_("{} is written; it carries the site's GPS position.")
        else:
            said = rpt_("{} is written; it carries no GPS position.")
        if exported.note:
            self.report({"WARNING"}, translated(exported.note))
        self.report({"INFO"}, said.format(path.name))
        return {"FINISHED"}


CLASSES = (CURECON_OT_export_surface,)
