# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The photo check: what is in the folder, what of it cannot be used, and a closer look at what is doubtful."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import StringProperty

from .. import thumbnails
from ..core.base.errors import PhotoError
from ..core.base.options import CHECK, arguments
from ..scene import new_file, pictures, stations_overlay, view
from . import paths, running
from .job_options import job_options
from .running import WorkerOperator

CHECKING = "Checking photos"


class CURECON_OT_check_photos(WorkerOperator, bpy.types.Operator):
    """Read every photo and say what is usable: cameras, GPS, overlap, blur, exposure, and what each quality costs"""

    bl_idname = "curecon.check_photos"
    bl_label = "Check Photos"

    task = CHECKING
    panel = "photos"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return running.idle(cls) and paths.photos_chosen(cls, context)

    def arguments(self, context: bpy.types.Context) -> list[str]:
        thumbnails.clear()
        return [*arguments(job_options(context, until="photos"), CHECK), "--thumbnails", str(thumbnails.folder())]

    def done(self, context: bpy.types.Context, scene: bpy.types.Scene, summary: dict[str, Any]) -> str:
        check = scene.curecon.check
        check.folder = scene.curecon.photos
        check.photos, check.cameras, check.gps = summary["photos"], summary["cameras"], summary["with_gps"]
        check.masked = summary["masked"]
        check.taken_first, check.taken_last = summary["taken"] or ("", "")
        check.gsd_mm = summary["ground_sampling_distance_mm"] or 0.0
        overlap = summary["overlap"]
        check.forward, check.side = (
            -1.0 if overlap[way] is None else 100 * overlap[way] for way in ("forward", "side")
        )
        check.overlap_unknown = overlap["unknown"]
        check.weak, check.weak_count = ", ".join(overlap["weak"]), len(overlap["weak"])
        check.advice.clear()
        for advice in summary["advice"]:
            entry = check.advice.add()
            entry.says, entry.remedy = advice["says"], advice["remedy"]
        check.doubtful.clear()
        check.doubtful_index = 0
        for photo in summary["doubtful"]:
            entry = check.doubtful.add()
            entry.name, entry.path, entry.thumbnail = photo["name"], photo["path"], photo["thumbnail"]
            entry.problems = ", ".join(photo["problems"])
        check.skipped.clear()
        for file in summary["skipped"]:
            entry = check.skipped.add()
            entry.name, entry.reason, entry.surplus = Path(file["path"]).name, file["reason"], file["surplus"]
        check.stations.clear()
        for station in summary["stations"]:
            entry = check.stations.add()
            entry.name, entry.place = station["name"], station["place"]
            if station["ground"] is not None:
                entry.ground, entry.sees_ground = station["ground"], True
        check.costs.clear()
        for quality, goals in summary["presets"].items():
            for goal, cost in goals.items():
                entry = check.costs.add()
                entry.name, entry.seconds = f"{quality}:{goal}", cost["seconds"]
                entry.memory_gib, entry.disk_gib = cost["memory_gib"], cost["disk_gib"]
        check.free_memory_gib, check.free_disk_gib = summary["free_memory_gib"], summary["free_disk_gib"]
        if (covered := stations_overlay.bounds(scene)) is not None and new_file.is_untouched(scene):
            view.turn_to(context, covered)  # there is nothing else to look at
        if not check.skipped:
            return rpt_("{} photos can be used.").format(check.photos)
        return rpt_("{} photos are used, {} files are not.").format(check.photos, len(check.skipped))


class CURECON_OT_open_photo(bpy.types.Operator):
    """Show this photo at full size in an Image Editor, in a new window if none is open"""

    bl_idname = "curecon.open_photo"
    bl_label = "Open Photo"

    path: StringProperty(
        name="File", description="The photo to show", subtype="FILE_PATH", options={"SKIP_SAVE", "HIDDEN"},
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if bpy.app.background:
            cls.poll_message_set("Blender runs without a window")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            pictures.show(context, paths.absolute(self.path))
        except PhotoError as error:
            self.report({"ERROR"}, running.explain(error))
            return {"CANCELLED"}
        return {"FINISHED"}


CLASSES = (CURECON_OT_check_photos, CURECON_OT_open_photo)
