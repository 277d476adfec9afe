# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Looking through the photos' cameras, with the photo over the scene."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import EnumProperty

from ..core.base.errors import WorkspaceError
from ..core.photos import capture
from ..languages import translated
from ..scene import cameras, flight, render_scene, site
from . import paths

WHICH = (
    ("NEXT", "Next", "Look through the next photo's camera, in order of capture, with the photo laid over the scene"),
    ("PREVIOUS", "Previous",
     "Look through the previous photo's camera, in order of capture, with the photo laid over the scene"),
    ("SELECTED", "Selected", "Look through the selected photo camera, with its photo laid over the scene"),
)


class CURECON_OT_look_through(bpy.types.Operator):
    """Look through a photo's camera, with the photo laid over the scene and renders of the photo's size"""

    bl_idname = "curecon.look_through"
    bl_label = "Look Through Photo"
    bl_options = {"REGISTER", "UNDO"}

    which: EnumProperty(name="Photo", description="Whose camera is looked through", items=WHICH, default="NEXT")

    @classmethod
    def description(cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        return next(text for name, _, text in WHICH if name == properties.which)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if any(cameras.is_photo_camera(item) for item in context.scene.objects):
            return True
        cls.poll_message_set("There are no photo cameras in the scene")
        return False

    def execute(self, context: bpy.types.Context) -> set[str]:
        scene = context.scene
        camera = context.active_object if self.which == "SELECTED" else self._beside(scene)
        if not cameras.is_photo_camera(camera):
            self.report({"ERROR"}, "Select the camera of a photo first.")
            return {"CANCELLED"}
        cameras.look_through(context, camera)
        if missing := render_scene.apply_quality(scene):
            self.report({"WARNING"}, translated(missing))
        cameras.overlay(camera, scene.curecon.present.photo_opacity)
        return {"FINISHED"}

    def _beside(self, scene: bpy.types.Scene) -> bpy.types.Object:
        """The camera after or before the scene's own in order of capture, around both ends."""
        try:
            times = capture.read_times(paths.absolute(site.workspace(scene)))
        except WorkspaceError as error:
            times = {}
            said = rpt_("{} The photos are gone through in order of their names.")
            self.report({"WARNING"}, said.format(translated(error.message)))
        found, offset = flight.in_order(scene, times), 1 if self.which == "NEXT" else -1
        if scene.camera in found:
            return found[(found.index(scene.camera) + offset) % len(found)]
        return found[0 if offset > 0 else -1]


CLASSES = (CURECON_OT_look_through,)
