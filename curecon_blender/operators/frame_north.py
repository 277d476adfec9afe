# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""North from a bearing, or a turn that is typed."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

from datetime import datetime

import bpy
import numpy as np
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import BoolProperty, FloatProperty

from ..core.site.adjustment import angle_between, with_bearing, with_turn
from ..scene import frame
from .picking import PickingOperator, place_property


class CURECON_OT_frame_north(PickingOperator, bpy.types.Operator):
    """Pick two points, such as a wall's ends, and type the bearing from the first to the second: the whole site is
turned until Y is north"""

    bl_idname = "curecon.frame_north"
    bl_label = "North from Bearing"
    bl_options = {"REGISTER", "UNDO"}

    first: place_property("First")
    second: place_property("Second")
    bearing: FloatProperty(
        name="Bearing", description="Of the second point seen from the first, in degrees clockwise from true north, "
                                    "0 to 360", default=0.0, min=-360.0, max=360.0, precision=1, step=100,
    )

    places = ("first", "second")
    prompts = ("Pick where the bearing is taken from", "Pick what it is taken to")
    asks = True

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.use_property_split = True
        self.layout.prop(self, "bearing")

    def apply(self, context: bpy.types.Context, places: list[np.ndarray]) -> str:
        part = frame.part_at(context.scene, places[0])
        first, second = (part.local(place) for place in places)
        before = part.adjustment
        after = with_bearing(before, first, second, self.bearing, when=datetime.now())
        frame.adjust(context.scene, part, after)
        return rpt_("The site is turned by {:.2f}°: Y is north.").format(angle_between(before, after))


class CURECON_OT_frame_turn(PickingOperator, bpy.types.Operator):
    """Turn the whole site about the vertical by an angle that you type"""

    bl_idname = "curecon.frame_turn"
    bl_label = "Turn"
    bl_options = {"REGISTER", "UNDO"}

    turn: FloatProperty(
        name="Turn", description="Clockwise seen from above, in degrees, -360 to 360", default=0.0, min=-360.0,
        max=360.0, precision=1, step=100,
    )
    is_north: BoolProperty(
        name="Y Is North Then", default=True,
        description="Y points to true north after the turn. Off: it was turned to suit something else",
    )

    asks = True

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.use_property_split = True
        self.layout.prop(self, "turn")
        self.layout.prop(self, "is_north")

    def apply(self, context: bpy.types.Context, places: list[np.ndarray]) -> str:
        part = frame.part_of(context)
        after = with_turn(part.adjustment, self.turn, north=self.is_north, when=datetime.now())
        frame.adjust(context.scene, part, after)
        return rpt_("The site is turned by {:.1f}°.").format(self.turn)


CLASSES = (CURECON_OT_frame_north, CURECON_OT_frame_turn)
