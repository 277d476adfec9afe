# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""From a finished cloud to a mesh and its texture, and the region that they are made of."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
from bpy.props import EnumProperty

from ..core.base.options import DETAILS, SURFACE, arguments
from ..scene import region
from ..scene.surface import surfaces_of
from ..scene.workspace import clouds_of
from . import paths, running
from .import_workspace import bring_in
from .job_options import surface_options
from .running import Work, WorkerOperator

LEVELS = (
    ("full", "Full", "All faces that the mesh was made with"),
    ("1m", "1,000,000 faces", "For presentations on a good computer"),
    ("150k", "150,000 faces", "For web pages and laptops"),
    ("20k", "20,000 faces", "For phones and overviews"),
)


class _SurfaceOperator(WorkerOperator):
    """Works in the workspace that the scene's cloud came from."""

    panel = "surface"
    until = ""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not running.idle(cls):
            return False
        result = context.scene.curecon.result
        if not result.workspace:
            cls.poll_message_set("Reconstruct photos or import a workspace first")
            return False
        if not result.points:
            cls.poll_message_set("The workspace has no point cloud yet: run Reconstruct to the end first")
            return False
        return True

    def workspace(self, context: bpy.types.Context) -> Path | None:
        return paths.absolute(context.scene.curecon.result.workspace)

    def arguments(self, context: bpy.types.Context) -> list[str]:
        folder = paths.absolute(context.scene.curecon.result.workspace)
        return arguments(surface_options(context.scene, folder, until=self.until), SURFACE)

    def done(self, context: bpy.types.Context, scene: bpy.types.Scene, summary: dict[str, Any]) -> Work:
        result = scene.curecon.result
        return bring_in(context, scene, paths.absolute(result.workspace), photos=result.photos, show=False)


class CURECON_OT_build_mesh(_SurfaceOperator, bpy.types.Operator):
    """Make a closed surface of the point cloud, with the photos' colours at its vertices.

What no photo measured is marked as filled"""

    bl_idname = "curecon.build_mesh"
    bl_label = "Build Mesh"
    bl_options = {"UNDO"}

    task = "Building the mesh"
    until = "mesh"


class CURECON_OT_texture(_SurfaceOperator, bpy.types.Operator):
    """Paint the surface with the photos themselves; builds the mesh first where there is none.

A cancelled or broken run goes on where it stopped"""

    bl_idname = "curecon.texture"
    bl_label = "Texture"
    bl_options = {"UNDO"}

    task = "Texturing"
    until = "texture"


class CURECON_OT_detail(_SurfaceOperator, bpy.types.Operator):
    """Show the surface with fewer faces and a texture of its own, as phones and web pages need it, or in full.

It is made where it is not there yet; what is exported is what is shown"""

    bl_idname = "curecon.detail"
    bl_label = "Detail"
    bl_options = {"UNDO"}

    task = "Changing the detail"
    until = "texture"

    level: EnumProperty(name="Detail", description="How many faces the surface may have", items=LEVELS)

    def arguments(self, context: bpy.types.Context) -> list[str]:
        folder = paths.absolute(context.scene.curecon.result.workspace)
        detail = (self.level,) if self.level in DETAILS else ()
        return arguments(surface_options(context.scene, folder, until=self.until, detail=detail), SURFACE)

    def done(self, context: bpy.types.Context, scene: bpy.types.Scene, summary: dict[str, Any]) -> Work:
        scene.curecon.shown_detail = self.level if self.level in DETAILS else ""
        return super().done(context, scene, summary)


class CURECON_OT_add_region(bpy.types.Operator):
    """Add a box about the building, to be moved and scaled: the mesh is made of what lies inside"""

    bl_idname = "curecon.add_region"
    bl_label = "Add Region Box"
    bl_options = {"UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return paths.site_stands(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        around = [*clouds_of(context.scene), *surfaces_of(context.scene)][0]
        box = region.add(context.scene, around)
        properties = context.scene.curecon
        properties.region, properties.use_region = box, True
        for item in context.selected_objects:
            item.select_set(False)
        box.select_set(True)
        context.view_layer.objects.active = box
        return {"FINISHED"}


CLASSES = (CURECON_OT_build_mesh, CURECON_OT_texture, CURECON_OT_detail, CURECON_OT_add_region)
