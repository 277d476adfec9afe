# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Looking through one photo's camera after another, with the photo over the scene."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import BoolProperty

from ..core import capture
from ..core.errors import WorkspaceError
from ..scene import cameras, flight, stage
from . import places


class CURECON_OT_step_photo(bpy.types.Operator):
    """Look through the next photo's camera, in order of capture, with the photo laid over the scene"""

    bl_idname = "curecon.step_photo"
    bl_label = "Next Photo"
    bl_options = {"REGISTER", "UNDO"}

    back: BoolProperty(name="Back", description="Go to the photo before", default=False)

    @classmethod
    def description(cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        if properties.back:
            return "Look through the previous photo's camera, in order of capture, with the photo laid over the scene"
        return "Look through the next photo's camera, in order of capture, with the photo laid over the scene"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if any(cameras.is_photo_camera(item) for item in context.scene.objects):
            return True
        cls.poll_message_set("There are no photo cameras in the scene")
        return False

    def execute(self, context: bpy.types.Context) -> set[str]:
        scene = context.scene
        try:
            times = capture.read_times(places.absolute(scene.curecon.result.workspace))
        except WorkspaceError as error:
            times = {}
            said = rpt_("{} The photos are gone through in order of their names.")
            self.report({"WARNING"}, said.format(error.message))
        found = flight.in_order(scene, times)
        step = -1 if self.back else 1
        if scene.camera in found:
            camera = found[(found.index(scene.camera) + step) % len(found)]
        else:
            camera = found[-1 if self.back else 0]
        cameras.look_through(context, camera)
        stage.apply_quality(scene)
        cameras.overlay(camera, scene.curecon.present.photo_opacity)
        return {"FINISHED"}


CLASSES = (CURECON_OT_step_photo,)
