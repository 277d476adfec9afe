# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Bringing in what `compare` measured of other programs' results, and how it is coloured."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import bpy
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import EnumProperty, FloatProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from ..scene import comparison
from . import paths, running
from .running import ModalOperator, Work

SUFFIX = ".compared.ply"


class CURECON_OT_import_comparison(ModalOperator, bpy.types.Operator, ImportHelper):
    """Bring in a cloud that the command compare measured, coloured by its distance from the reference"""

    bl_idname = "curecon.import_comparison"
    bl_label = "Import Comparison"
    bl_options = {"UNDO"}

    filename_ext = SUFFIX
    filter_glob: StringProperty(default="*.ply", options={"HIDDEN"})

    task = "Importing"

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if self.filepath:  # a caller's own
            return ModalOperator.invoke(self, context, event)
        return self.browse(context)

    def work(self, context: bpy.types.Context) -> Work:
        session_uid = context.scene.session_uid
        path = paths.absolute(self.filepath)
        yield "Reading the cloud"
        pool = ThreadPoolExecutor(1, thread_name_prefix="curecon-read")
        reading = pool.submit(comparison.read, path)
        pool.shutdown(wait=False)
        while not reading.done():
            yield None
        content = reading.result()
        name = Path(path).name.removesuffix(SUFFIX).removesuffix(".ply")
        item = yield from comparison.build(content, name, running.scene_with(session_uid))
        for other in context.view_layer.objects:
            other.select_set(other == item)
        context.view_layer.objects.active = item
        return rpt_("{:,} compared points are in the scene.").format(len(content.distance))


class CURECON_OT_colour_comparison(bpy.types.Operator):
    """Colour the compared cloud by its distances, or as it came"""

    bl_idname = "curecon.colour_comparison"
    bl_label = "Colour Comparison"
    bl_options = {"REGISTER", "UNDO"}

    by: EnumProperty(
        name="Colour", description="What the colours show", default=comparison.DISTANCE,
        items=((comparison.DISTANCE, "Distance", "From the reference; of a change, red is lost and blue has come"),
               (comparison.PHOTO, "Own", "The colours that it came with")),
    )
    most: FloatProperty(
        name="Up To", description="The distance that has the last colour, in metres", default=0.1, min=1e-6,
        soft_max=10,
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if comparison.is_compared(context.active_object):
            return True
        cls.poll_message_set("Select a compared cloud first")
        return False

    def execute(self, context: bpy.types.Context) -> set[str]:
        comparison.colour(context.active_object, self.by, self.most)
        return {"FINISHED"}


CLASSES = (CURECON_OT_import_comparison, CURECON_OT_colour_comparison)
