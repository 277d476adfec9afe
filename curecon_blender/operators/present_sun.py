# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The light of the day on which the photos were taken."""

from __future__ import annotations

from datetime import timedelta
from math import degrees

import bpy
from bpy.app.translations import pgettext_rpt as rpt_

from ..core.base.errors import CuReconError, WorkspaceError
from ..core.base.language import Text
from ..core.photos import capture
from ..core.present import sun
from ..languages import translated
from ..scene import daylight, ground, render_scene, site, view
from ..scene.surface import surfaces_of
from . import paths, running


class CURECON_OT_set_sun(bpy.types.Operator):
    """Set a sun lamp and a sky as they stood when the photos were taken, and let them light the surface.

Press again after a change of the settings"""

    bl_idname = "curecon.set_sun"
    bl_label = "Sun of the Photos"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return paths.site_stands(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            level, said = _set_sun(context.scene)
        except CuReconError as error:
            self.report({"ERROR"}, running.explain(error))
            return {"CANCELLED"}
        if not view.shows_lamps(context):
            said = rpt_("{} To see it, press Z over the viewport and choose Rendered.").format(said)
        self.report({level}, said)
        return {"FINISHED"}


class CURECON_OT_remove_sun(bpy.types.Operator):
    """Take the sun and the sky away, and put back the world that was there before"""

    bl_idname = "curecon.remove_sun"
    bl_label = "Remove Sun and Sky"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if daylight.is_shining(context.scene):
            return True
        cls.poll_message_set("There is no sun of CU-Recon in the scene")
        return False

    def execute(self, context: bpy.types.Context) -> set[str]:
        daylight.remove(context.scene)
        context.scene.curecon.surface_light = "PHOTO"
        return {"FINISHED"}


class CURECON_OT_lay_ground(bpy.types.Operator):
    """Lay a plain ground just under the site, of its colours around, so that pictures do not float.

It is no part of the record: sheets and exports leave it out"""

    bl_idname = "curecon.lay_ground"
    bl_label = "Lay Ground"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not paths.site_stands(cls, context):
            return False
        if surfaces_of(context.scene):
            return True
        cls.poll_message_set("Build the mesh first: the ground takes its heights and colours")
        return False

    def execute(self, context: bpy.types.Context) -> set[str]:
        scene = context.scene
        ground.add(scene, site.box(scene), surfaces_of(scene)[0])
        return {"FINISHED"}


class CURECON_OT_remove_ground(bpy.types.Operator):
    """Take the plain ground away"""

    bl_idname = "curecon.remove_ground"
    bl_label = "Remove Ground"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if ground.is_there(context.scene):
            return True
        cls.poll_message_set("There is no ground of CU-Recon in the scene")
        return False

    def execute(self, context: bpy.types.Context) -> set[str]:
        ground.remove(context.scene)
        return {"FINISHED"}


def _set_sun(scene: bpy.types.Scene) -> tuple[str, str]:
    """Returns the report's level and its words. Raises CuReconError."""
    properties = scene.curecon
    present, known = properties.present, site.known(scene)
    times = capture.read_times(paths.absolute(site.workspace(scene)))
    if not times:
        raise WorkspaceError(
            "No photo says when it was taken.", remedy="Add a Sun lamp by hand (Add > Light > Sun).",
        )
    latitude, longitude = known.origin or (present.latitude, present.longitude)
    north = 0.0 if known.north else degrees(present.north)
    taken = capture.middle_time(times)
    utc = capture.to_utc(taken, longitude) + timedelta(hours=present.hour_correction)
    azimuth, altitude = sun.position(utc, latitude, longitude)
    if altitude < 0:
        raise WorkspaceError(
            Text("At {:%H:%M} on {:%d %B %Y} the sun was {:.0f} degrees below the horizon there.", taken, taken,
                 -altitude),
            remedy="Check the latitude and longitude, or correct the hour under Sun and Sky.",
        )
    daylight.shine(scene, site.box(scene), azimuth, altitude, north)
    properties.surface_light = "SCENE"
    said = [rpt_("{:%d %B %Y, %H:%M} UTC: the sun {:.0f}° high in {:.0f}°.").format(utc, altitude, azimuth)]
    if missing := render_scene.apply_quality(scene):
        said.append(translated(missing))
    if known.origin is None:
        said.append(rpt_("The place is the one typed in."))
    if not known.north:
        said.append(rpt_("North is the one typed in."))
    if taken.tzinfo is None:
        said.append(rpt_("The time zone is taken from the longitude."))
    return ("WARNING" if len(said) > 1 else "INFO"), " ".join(said)


CLASSES = (CURECON_OT_set_sun, CURECON_OT_remove_sun, CURECON_OT_lay_ground, CURECON_OT_remove_ground)
