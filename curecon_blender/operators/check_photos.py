# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The photo check: what is in the folder, and what of it cannot be used."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy

from . import places
from .running import WorkerOperator


class CURECON_OT_check_photos(WorkerOperator, bpy.types.Operator):
    """Read every photo and say what is usable: cameras, GPS, blur, ground sampling distance"""

    bl_idname = "curecon.check_photos"
    bl_label = "Check Photos"

    task = "Checking photos"

    def arguments(self, context: bpy.types.Context) -> list[str]:
        return ["check", str(places.photos_folder(context.scene))]

    def done(self, context: bpy.types.Context, scene: bpy.types.Scene, summary: dict[str, Any]) -> str:
        check = scene.curecon.check
        check.folder = scene.curecon.photos
        check.photos, check.cameras = summary["photos"], summary["cameras"]
        check.gps, check.blurred = summary["gps"], summary["blurred"]
        check.gsd_mm = summary["gsd_mm"] or 0.0
        check.skipped.clear()
        for file in summary["skipped"]:
            entry = check.skipped.add()
            entry.name, entry.reason = Path(file["path"]).name, file["reason"]
        return f"{check.photos} photos can be used, {len(check.skipped)} files cannot."


CLASSES = (CURECON_OT_check_photos,)
