# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""True scale from a distance that somebody measured on site."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

from datetime import datetime

import bpy
import numpy as np
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import FloatProperty

from ..core.site.adjustment import with_length
from ..languages import translated
from ..scene import frame, measurements
from .picking import PickingOperator, place_property


class CURECON_OT_frame_scale(PickingOperator, bpy.types.Operator):
    """Pick two points whose distance was measured on site: the whole site is scaled to it"""

    bl_idname = "curecon.frame_scale"
    bl_label = "Scale from Distance"
    bl_options = {"REGISTER", "UNDO"}

    first: place_property("First")
    second: place_property("Second")
    length: FloatProperty(
        name="Known Distance (m)", description="Between the two points, as measured on site, in metres", default=1.0,
        min=0.001, soft_max=100.0, precision=3, step=10,
    )
    known_to: FloatProperty(
        name="Known to ± (m)", description="How far that distance may be off, in metres (one standard deviation)",
        default=0.01, min=0.0, soft_max=1.0, precision=3, step=1,
    )

    places = ("first", "second")
    prompts = ("Pick one end of a distance that you know", "Pick its other end")
    asks = True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if self._has_places() and not self.properties.is_property_set("length"):
            metre = frame.part_at(context.scene, np.array(self.first)).metre
            self.length = float(np.linalg.norm(np.subtract(self.second, self.first))) / metre  # so far
        return super().invoke(context, event)

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.use_property_split = True
        self.layout.prop(self, "length")
        self.layout.prop(self, "known_to")

    def apply(self, context: bpy.types.Context, places: list[np.ndarray]) -> str:
        part = frame.part_at(context.scene, places[0])
        first, second = (part.local(place) for place in places)
        before = part.adjustment
        found = float(np.linalg.norm(places[1] - places[0]))
        # The picks' own deviation, which is in units of the scale so far, in metres.
        picks = measurements.spread(part, *places) * self.length / max(found, 1e-9)
        after = with_length(
            before, first, second, self.length, sigma=float(np.hypot(self.known_to, picks)), when=datetime.now(),
        )
        frame.adjust(context.scene, part, after)
        return rpt_("The site is scaled by {:.4g}: true scale from {}.").format(
            after.scale / before.scale, translated(part.scale_source))


CLASSES = (CURECON_OT_frame_scale,)
