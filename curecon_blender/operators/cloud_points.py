# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Taking points out of the clouds, and bringing them back."""

from __future__ import annotations

from collections.abc import Callable

import bpy
import numpy as np
from bpy.app.translations import pgettext_iface

from ..core.base.errors import CuReconError
from ..scene import cloud_edits, viewport
from ..scene.workspace import clouds_of
from . import running


class _CloudOperator:
    """A subclass gives `taken`: which of a cloud's points (N,) bool are to be out in the end."""

    taken: Callable[[bpy.types.Context, bpy.types.Object], np.ndarray]
    report: Callable[..., None]  # Blender's own
    poll_message_set: Callable[..., None]

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not running.idle(cls):
            return False
        why = cls.missing(context) if clouds_of(context.scene) else "There is no cloud in the scene"
        if why:
            cls.poll_message_set(why)
        return not why

    @classmethod
    def missing(cls, context: bpy.types.Context) -> str:
        """What the operator lacks, in words; empty when it can run."""
        return "" if context.scene.curecon.region is not None else "Add a region box first"

    def execute(self, context: bpy.types.Context) -> set[str]:
        before = after = 0
        try:
            for item in clouds_of(context.scene):
                now, wanted = cloud_edits.removed(item), self.taken(context, item)
                before, after = before + int(now.sum()), after + int(wanted.sum())
                if not np.array_equal(now, wanted):
                    cloud_edits.set_removed(item, wanted)
        except CuReconError as error:
            self.report({"ERROR"}, running.explain(error))
            return {"CANCELLED"}
        viewport.redraw()
        words = pgettext_iface("{:,} points are taken out.") if after >= before else pgettext_iface(
            "{:,} points are back.")
        self.report({"INFO"}, words.format(abs(after - before)))
        return {"FINISHED"}


class CURECON_OT_cloud_crop(_CloudOperator, bpy.types.Operator):
    """Take out all points that lie outside of the region box. The workspace's cloud file stays as it is"""

    bl_idname = "curecon.cloud_crop"
    bl_label = "Crop to Region"
    bl_options = {"REGISTER", "UNDO"}

    def taken(self, context: bpy.types.Context, item: bpy.types.Object) -> np.ndarray:
        return cloud_edits.removed(item) | ~cloud_edits.in_region(item, context.scene.curecon.region)


class CURECON_OT_cloud_delete_region(_CloudOperator, bpy.types.Operator):
    """Take out all points that lie inside of the region box. The workspace's cloud file stays as it is"""

    bl_idname = "curecon.cloud_delete_region"
    bl_label = "Delete in Region"
    bl_options = {"REGISTER", "UNDO"}

    def taken(self, context: bpy.types.Context, item: bpy.types.Object) -> np.ndarray:
        return cloud_edits.removed(item) | cloud_edits.in_region(item, context.scene.curecon.region)


class CURECON_OT_cloud_delete_selected(_CloudOperator, bpy.types.Operator):
    """Take out the points that are selected in the cloud's edit mode. The workspace's cloud file stays as it is"""

    bl_idname = "curecon.cloud_delete_selected"
    bl_label = "Delete Selected"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def missing(cls, context: bpy.types.Context) -> str:
        held = any(cloud_edits.SELECTION in item.data.attributes for item in clouds_of(context.scene))
        return "" if held else "Select points in the cloud's edit mode first (Tab)"

    def taken(self, context: bpy.types.Context, item: bpy.types.Object) -> np.ndarray:
        return cloud_edits.removed(item) | cloud_edits.selected(item)


class CURECON_OT_cloud_restore(_CloudOperator, bpy.types.Operator):
    """Bring back every point that was taken out"""

    bl_idname = "curecon.cloud_restore"
    bl_label = "Restore All Points"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def missing(cls, context: bpy.types.Context) -> str:
        held = any(item.data.get(cloud_edits.COUNT_KEY) for item in clouds_of(context.scene))
        return "" if held else "No point was taken out"

    def taken(self, context: bpy.types.Context, item: bpy.types.Object) -> np.ndarray:
        return np.zeros(len(item.data.points), bool)


CLASSES = (
    CURECON_OT_cloud_crop, CURECON_OT_cloud_delete_region, CURECON_OT_cloud_delete_selected, CURECON_OT_cloud_restore,
)
