# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Z up from a floor or a wall."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

from datetime import datetime

import bpy
import numpy as np
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import EnumProperty

from ..core.site.adjustment import angle_between, with_level
from ..scene import frame
from .picking import PickingOperator, place_property

PLANES = (
    ("FLOOR", "Floor", "The three points lie on something level, such as a floor, a plinth or eaves"),
    ("WALL", "Wall", "The three points lie on a wall, which becomes upright; its other tilt stays"),
)


class CURECON_OT_frame_level(PickingOperator, bpy.types.Operator):
    """Pick three points, far apart, on a floor or on a wall: the whole site is tilted until it is level or upright"""

    bl_idname = "curecon.frame_level"
    bl_label = "Level"
    bl_options = {"REGISTER", "UNDO"}

    plane: EnumProperty(name="Plane", description="What the three points lie on", items=PLANES, default="FLOOR")
    first: place_property("First")
    second: place_property("Second")
    third: place_property("Third")

    places = ("first", "second", "third")
    prompts = ("Pick three points of one plane, far apart and not in a line",)

    def apply(self, context: bpy.types.Context, places: list[np.ndarray]) -> str:
        part = frame.part_at(context.scene, places[0])
        before = part.adjustment
        after = with_level(
            before, np.stack([part.local(place) for place in places]), wall=self.plane == "WALL",
            above=part.local(part.above), when=datetime.now(),
        )
        frame.adjust(context.scene, part, after)
        return rpt_("The site is tilted by {:.2f}°.").format(angle_between(before, after))


CLASSES = (CURECON_OT_frame_level,)
