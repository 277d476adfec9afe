# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Photos from the videos that lie among the photos."""

from __future__ import annotations

from typing import Any

import bpy
from bpy.app.translations import pgettext_rpt as rpt_

from ..core.base.options import FRAMES
from . import paths, running
from .running import WorkerOperator


class CURECON_OT_take_frames(WorkerOperator, bpy.types.Operator):
    """Take the sharpest frame of each stretch of the way from every MP4 and MOV in the folder, with GPS from the
drone's subtitles (.SRT). The frames become photos in a folder beside the video"""

    bl_idname = "curecon.take_frames"
    bl_label = "Frames from Video"

    task = "Taking frames"
    panel = "photos"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return running.idle(cls) and paths.photos_chosen(cls, context)

    def arguments(self, context: bpy.types.Context) -> list[str]:
        return [FRAMES, str(paths.photos_folder(context.scene))]

    def done(self, context: bpy.types.Context, scene: bpy.types.Scene, summary: dict[str, Any]) -> str:
        scene.curecon.check.folder = ""  # what it said is not true any more
        return rpt_("{} photos were taken from video. Check the photos next.").format(sum(summary["frames"].values()))


CLASSES = (CURECON_OT_take_frames,)
