# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras that move: about the building, along the photos, and up."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import EnumProperty

from ..core.base.errors import CuReconError, WorkspaceError
from ..core.photos import capture
from ..languages import translated
from ..scene import cameras, flight, render_scene, site
from . import paths, running

KINDS = (
    ("ORBIT", "Orbit", "Once around the building or the region box, in a loop"),
    ("FLIGHT", "Fly-Through", "Along the photos' own cameras in order of capture, smoothly and at one speed"),
    ("CRANE", "Crane", "Up on one side of the building, looking at it all the while"),
)


class CURECON_OT_move_camera(bpy.types.Operator):
    """Make a camera that moves, with a key on every frame.

Made again, it takes the place of the earlier one"""

    bl_idname = "curecon.move_camera"
    bl_label = "Camera Move"
    bl_options = {"REGISTER", "UNDO"}

    kind: EnumProperty(name="Move", description="How the camera moves", items=KINDS, default="ORBIT")

    @classmethod
    def description(cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        return next(text for name, _, text in KINDS if name == properties.kind)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return paths.site_stands(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        scene = context.scene
        try:
            times = capture.read_times(paths.absolute(site.workspace(scene)))
        except WorkspaceError as error:
            times = {}
            if self.kind == "FLIGHT":
                said = rpt_("{} The photos are flown in order of their names.")
                self.report({"WARNING"}, said.format(translated(error.message)))
        try:
            camera = flight.make(scene, self.kind, times)
        except CuReconError as error:
            self.report({"ERROR"}, running.explain(error))
            return {"CANCELLED"}
        if missing := render_scene.apply_quality(scene):
            self.report({"WARNING"}, translated(missing))
        cameras.enter_view(context)
        said = rpt_("{}: {} frames. Play it with the space bar.").format(camera.name, scene.frame_end)
        self.report({"INFO"}, said)
        return {"FINISHED"}


CLASSES = (CURECON_OT_move_camera,)
