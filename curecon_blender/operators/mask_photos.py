# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What is to be left out of all photos, marked once in the scene."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
from bpy.app.translations import pgettext_rpt as rpt_

from ..core.base.options import MASK, MASKS_FOLDER
from ..scene import solids
from . import paths, running
from .job_options import reference
from .running import WorkerOperator


class _MaskOperator(WorkerOperator):
    task = "Masking photos"
    panel = "masks"
    lacking: str  # what the button says while there is nothing for it
    there_is: Callable[[bpy.types.Context], bool]

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not (running.idle(cls) and paths.cloud_finished(cls, context)):
            return False
        if not cls.there_is(context):
            cls.poll_message_set(cls.lacking)
            return False
        return True

    def workspace(self, context: bpy.types.Context) -> Path:
        return paths.absolute(context.scene.curecon.result.workspace)


class CURECON_OT_mask_photos(_MaskOperator, bpy.types.Operator):
    """Leave out of all photos what stands inside the selected objects, such as a box around a car or a tree, or else
inside the region box. Reconstruct again to have the site without it"""

    bl_idname = "curecon.mask_photos"
    bl_label = "Leave Out of Photos"

    lacking = "Select a mesh around what is to be left out, such as a cube, or add a region box"

    @classmethod
    def there_is(cls, context: bpy.types.Context) -> bool:
        return bool(solids.chosen(context))

    def arguments(self, context: bpy.types.Context) -> list[str]:
        workspace = self.workspace(context)
        solid = solids.write(solids.chosen(context), reference(context.scene, workspace), workspace / MASKS_FOLDER)
        return [MASK, str(workspace), "--solid", str(solid)]

    def done(self, context: bpy.types.Context, scene: bpy.types.Scene, summary: dict[str, Any]) -> str:
        found = summary["mask"]
        return rpt_("{} of {} photos show it and have masks now. Reconstruct again to leave it out.").format(
            found["photos"], found["of"])


class CURECON_OT_clear_masks(_MaskOperator, bpy.types.Operator):
    """Use the photos whole again: take away the masks that were made here. Masks beside the photos stay"""

    bl_idname = "curecon.clear_masks"
    bl_label = "Clear Masks"

    lacking = "No photo was masked here"

    @classmethod
    def there_is(cls, context: bpy.types.Context) -> bool:
        return masked(context) > 0

    def arguments(self, context: bpy.types.Context) -> list[str]:
        return [MASK, str(self.workspace(context)), "--clear"]

    def done(self, context: bpy.types.Context, scene: bpy.types.Scene, summary: dict[str, Any]) -> str:
        return rpt_("{} masks were taken away. Reconstruct again to use the photos whole.").format(
            summary["mask"]["cleared"])


def masked(context: bpy.types.Context) -> int:
    """How many photos have masks that were made here."""
    return len(list((paths.absolute(context.scene.curecon.result.workspace) / MASKS_FOLDER).glob("*.png")))


CLASSES = (CURECON_OT_mask_photos, CURECON_OT_clear_masks)
