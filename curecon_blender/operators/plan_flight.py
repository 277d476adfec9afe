# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Planning a flight, and its files for the drone."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import BoolProperty, StringProperty

from ..core.base.errors import CuReconError
from ..core.plan.write import write_plan
from ..scene import cameras, flight_plan, view
from . import paths, running


class CURECON_OT_add_outline(bpy.types.Operator):
    """Add an outline at the 3D cursor, to be moved and scaled onto the building: as wide, as deep and as high as it"""

    bl_idname = "curecon.add_outline"
    bl_label = "Add Building Outline"
    bl_options = {"REGISTER", "UNDO"}

    ring: BoolProperty(name="Ring", description="A ring with a court, such as a Tulou")

    def execute(self, context: bpy.types.Context) -> set[str]:
        flight_plan.add_outline(context.scene, np.array(context.scene.cursor.location), ring=self.ring)
        return {"FINISHED"}


class CURECON_OT_take_off_here(bpy.types.Operator):
    """Let the drone start at the 3D cursor"""

    bl_idname = "curecon.take_off_here"
    bl_label = "Take-Off at 3D Cursor"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        context.scene.curecon.plan.takeoff = context.scene.cursor.location
        return {"FINISHED"}


class CURECON_OT_plan_flight(bpy.types.Operator):
    """Plan where each photo is taken, clear of the building, and show it: a camera a photo, the way, and how many
photos will show each part"""

    bl_idname = "curecon.plan_flight"
    bl_label = "Plan Flight"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            made, seen = flight_plan.make(context.scene)
        except CuReconError as error:
            self.report({"ERROR"}, running.explain(error))
            return {"CANCELLED"}
        view.show_texture(context, textured=False)
        said = rpt_("{} photos in {} flights; {:.0%} of walls and roofs will be in three photos or more.")
        self.report({"INFO"}, said.format(made.photos, len(made.flights), seen.share))
        return {"FINISHED"}


class CURECON_OT_fly_along(bpy.types.Operator):
    """Look through the drone's camera along the planned flight, a photo every sixth frame; again for the scene's own
camera and frames"""

    bl_idname = "curecon.fly_along"
    bl_label = "Fly Along"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if flight_plan.drawn(context.scene) is None:
            cls.poll_message_set("Plan a flight first")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            flies = flight_plan.fly_along(context.scene)
        except CuReconError as error:
            self.report({"ERROR"}, running.explain(error))
            return {"CANCELLED"}
        if flies:
            cameras.enter_view(context)
            self.report({"INFO"}, rpt_("Play it with the space bar. Press Fly Along again for the scene's own camera."))
        return {"FINISHED"}


class CURECON_OT_export_flight(bpy.types.Operator):
    """Plan the flight and write it into a folder: missions for DJI and Litchi, KML, GPX, and a page for flying by
hand"""

    bl_idname = "curecon.export_flight"
    bl_label = "Export Flight Plan"

    directory: StringProperty(name="Folder", description="Where the files are written", subtype="DIR_PATH")

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        folder = paths.absolute(self.directory) or Path.cwd()
        item = context.scene.curecon.plan.building
        try:
            made, seen = flight_plan.make(context.scene)
            files = write_plan(folder, made, seen, item.name)
        except CuReconError as error:
            self.report({"ERROR"}, running.explain(error))
            return {"CANCELLED"}
        if made.building.origin is None:
            self.report({"WARNING"}, rpt_("Only the page for flying by hand is written to {}: missions need the site's "
                                          "position.").format(folder))
        else:
            self.report({"INFO"}, rpt_("{} files of the plan are in {}.").format(len(files), folder))
        return {"FINISHED"}


CLASSES = (CURECON_OT_add_outline, CURECON_OT_take_off_here, CURECON_OT_plan_flight, CURECON_OT_fly_along,
           CURECON_OT_export_flight)
