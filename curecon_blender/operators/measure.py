# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Measured distances: pick, delete, copy."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

import bpy
import numpy as np
from bpy.app.translations import pgettext_iface
from bpy.props import BoolProperty

from ..core.site.adjustment import FrameError
from ..scene import measurements, viewport
from .picking import PickingOperator, place_property


class CURECON_OT_measure(PickingOperator, bpy.types.Operator):
    """Pick two points: their distance, with its uncertainty, goes on the list"""

    bl_idname = "curecon.measure"
    bl_label = "Measure Distance"
    bl_options = {"REGISTER", "UNDO"}

    first: place_property("From")
    second: place_property("To")

    places = ("first", "second")
    prompts = ("Pick where to measure from", "Pick where to measure to")

    def apply(self, context: bpy.types.Context, places: list[np.ndarray]) -> str:
        if np.array_equal(places[0], places[1]):
            raise FrameError("The two points lie at the same place.", remedy="Pick two points that lie apart.")
        return measurements.in_words(context.scene, measurements.add(context.scene, *places))


class _ListOperator:
    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.scene.curecon.measurements:
            return True
        cls.poll_message_set("Nothing has been measured yet")  # type: ignore[attr-defined]
        return False


class CURECON_OT_delete_measurement(_ListOperator, bpy.types.Operator):
    """Take the chosen distance, or all of them, off the list"""

    bl_idname = "curecon.delete_measurement"
    bl_label = "Delete Measurement"
    bl_options = {"REGISTER", "UNDO"}

    all: BoolProperty(name="All", description="Every distance on the list", default=False, options={"SKIP_SAVE"})

    def execute(self, context: bpy.types.Context) -> set[str]:
        properties = context.scene.curecon
        if self.all:
            properties.measurements.clear()
        else:
            properties.measurements.remove(properties.measurement_index)
            properties.measurement_index = max(0, min(properties.measurement_index, len(properties.measurements) - 1))
        viewport.redraw()
        return {"FINISHED"}


class CURECON_OT_copy_measurements(_ListOperator, bpy.types.Operator):
    """Copy the list as text, one distance a line, with the places it was measured between"""

    bl_idname = "curecon.copy_measurements"
    bl_label = "Copy as Text"

    def execute(self, context: bpy.types.Context) -> set[str]:
        scene = context.scene
        context.window_manager.clipboard = measurements.as_text(scene)
        self.report({"INFO"}, pgettext_iface("{} distances are copied.").format(len(scene.curecon.measurements)))
        return {"FINISHED"}


CLASSES = (CURECON_OT_measure, CURECON_OT_delete_measurement, CURECON_OT_copy_measurements)
