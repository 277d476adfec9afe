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
        check.photos, check.cameras, check.gps = summary["photos"], summary["cameras"], summary["with_gps"]
        check.blurred = ", ".join(summary["blurred"])
        check.blurred_count = len(summary["blurred"])
        check.gsd_mm = summary["ground_sampling_distance_mm"] or 0.0
        check.skipped.clear()
        for file in summary["skipped"]:
            entry = check.skipped.add()
            entry.name, entry.reason = Path(file["path"]).name, file["reason"]
        check.costs.clear()
        for quality, cost in summary["presets"].items():
            entry = check.costs.add()
            entry.name, entry.seconds = quality, cost["seconds"]
            entry.memory_gib, entry.disk_gib = cost["memory_gib"], cost["disk_gib"]
        return f"{check.photos} photos can be used, {len(check.skipped)} files cannot."


CLASSES = (CURECON_OT_check_photos,)
