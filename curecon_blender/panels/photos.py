# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""First step: which photos, and what the photo check says of them."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_

from .. import thumbnails
from ..core.base.options import VIDEO_SUFFIXES
from ..job import duration
from ..languages import translated
from ..operators import running
from ..operators.check_photos import CHECKING
from ..operators.make_model import GOAL
from ..preferences import settings
from .layout import Panel, action, counted, draw_outcome, draw_progress, paragraph
from .preferences import draw_libraries

SHOWN_SKIPPED = 6
SHOWN_NAMES = 200  # characters of a list of names


class CURECON_UL_doubtful(bpy.types.UIList):
    """Photos that are used although something is wrong with them."""

    def draw_item(
        self, context: bpy.types.Context, layout: bpy.types.UILayout, data: bpy.types.PropertyGroup,
        item: bpy.types.PropertyGroup, icon: int, active_data: bpy.types.PropertyGroup, active_property: str,
    ) -> None:
        split = layout.split(factor=0.55)
        split.label(text=item.name, icon_value=thumbnails.icon(item.thumbnail), translate=False)
        split.label(text=translated(item.problems), translate=False)


class CURECON_PT_photos(Panel, bpy.types.Panel):
    bl_idname = "CURECON_PT_photos"
    bl_label = "Photos"

    def draw(self, context: bpy.types.Context) -> None:
        layout, properties, status = self.layout, context.scene.curecon, running.status
        ours = running.panel == "photos"
        if settings(context).lacks_libraries and not status.running:
            draw_libraries(layout.box(), context)
        if not properties.photos:
            action(layout, "curecon.choose_photos", text="Choose Photos", icon="FILE_FOLDER")
            paragraph(layout, context, "Or drop photos on the viewport: their whole folder is taken.")
            return
        checked = properties.check.folder == properties.photos
        row = layout.row(align=True)
        row.enabled = not status.running
        row.prop(properties, "photos", text="")
        if checked:
            row.operator("curecon.check_photos", text="", icon="FILE_REFRESH")
        if status.running and ours:
            draw_progress(layout, status)
        elif checked:
            self._draw_check(context, properties.check)
            self._draw_all_at_once(context, properties)
        else:
            action(layout, "curecon.check_photos", icon="VIEWZOOM")
        if ours and (status.failure is not None or status.task != CHECKING):
            draw_outcome(layout, context, status)
        refused = ours and status.failure is not None and status.failure.kind == "photos"
        filmed = any(file.name.lower().endswith(VIDEO_SUFFIXES) for file in properties.check.skipped)
        if not status.running and (filmed or refused):
            layout.operator("curecon.take_frames", icon="FILE_MOVIE")

    def _draw_all_at_once(self, context: bpy.types.Context, properties: bpy.types.PropertyGroup) -> None:
        """One press for those who want nothing else."""
        column = self.layout.column()
        column.enabled = not running.status.running
        row = column.row()
        row.scale_y = 1.6
        row.operator("curecon.make_model", icon="OUTLINER_OB_MESH")
        text = iface_("A textured mesh, framed, with a picture of it.")
        cost = properties.check.costs.get(f"{properties.quality}:{GOAL}")
        if cost is not None:
            time = translated(duration(cost.seconds))
            text = iface_("{} {}: {}.").format(text, iface_(properties.quality.capitalize()), time)
        paragraph(column, context, text)

    def _draw_check(self, context: bpy.types.Context, check: bpy.types.PropertyGroup) -> None:
        box = self.layout.box()
        column = box.column(align=True)
        found = [counted(check.photos, "{:,} photo", "{:,} photos"),
                 counted(check.cameras, "{:,} camera", "{:,} cameras")]
        column.label(text=", ".join(found), icon="CHECKMARK", translate=False)
        if check.taken_first:
            column.label(text=_taken(check.taken_first, check.taken_last), icon="TIME", translate=False)
        if check.gps == check.photos:
            gps = iface_("GPS on all")
        elif check.gps:
            gps = iface_("GPS on {} of {}").format(check.gps, check.photos)
        else:
            gps = iface_("No GPS: scale will be unknown")
        row = column.row()
        row.label(text=gps, icon="WORLD")
        if check.stations and not context.scene.curecon.result.workspace:
            row.prop(check, "show_stations", text="", emboss=False,
                     icon="HIDE_OFF" if check.show_stations else "HIDE_ON")
        if check.gsd_mm:
            column.label(text=iface_("About {:.0f} mm on the ground a pixel").format(check.gsd_mm),
                         icon="DRIVER_DISTANCE")
        if check.masked:
            column.label(text=counted(check.masked, "{:,} photo has a mask", "{:,} photos have masks"),
                         icon="MOD_MASK", translate=False)
        self._draw_overlap(context, box, check)
        for advice in check.advice:
            paragraph(box, context, advice.says, icon="ERROR")
            paragraph(box, context, advice.remedy)
        if check.skipped:
            paragraph(box, context, counted(len(check.skipped), "{:,} file left out:", "{:,} files left out:"),
                      icon="ERROR")
            for file in check.skipped[:SHOWN_SKIPPED]:
                paragraph(box, context, file.reason)
            if len(check.skipped) > SHOWN_SKIPPED:
                box.label(text=iface_("and {} more").format(len(check.skipped) - SHOWN_SKIPPED))
        if context.scene.curecon.surplus or any(file.surplus for file in check.skipped):
            box.prop(context.scene.curecon, "surplus")
        if check.doubtful:
            self._draw_doubtful(context, check)

    def _draw_overlap(
        self, context: bpy.types.Context, box: bpy.types.UILayout, check: bpy.types.PropertyGroup
    ) -> None:
        if check.forward < 0:
            unknown = iface_("Overlap unknown: the photos do not tell {}.").format(translated(check.overlap_unknown))
            paragraph(box, context, unknown, icon="OVERLAY")
            return
        if check.side < 0:
            text = iface_("About {:.0f} % overlap with the next photo").format(check.forward)
        else:
            text = iface_("About {:.0f} % forward and {:.0f} % side overlap").format(check.forward, check.side)
        paragraph(box, context, text, icon="OVERLAY")
        if check.weak_count:
            text = iface_("{} overlap less than 60 % with any other: {}").format(
                counted(check.weak_count, "{:,} photo", "{:,} photos"), _shortened(check.weak))
            paragraph(box, context, text, icon="ERROR")

    def _draw_doubtful(self, context: bpy.types.Context, check: bpy.types.PropertyGroup) -> None:
        box = self.layout.box()
        text = counted(len(check.doubtful), "{:,} photo looks doubtful and will be used:",
                       "{:,} photos look doubtful and will be used:")
        paragraph(box, context, text, icon="ERROR")
        rows = min(len(check.doubtful), 5)
        box.template_list("CURECON_UL_doubtful", "", check, "doubtful", check, "doubtful_index", rows=rows)
        if check.doubtful_index < len(check.doubtful):
            chosen = check.doubtful[check.doubtful_index]
            if picture := thumbnails.icon(chosen.thumbnail):
                box.template_icon(picture, scale=8.0)
            box.operator("curecon.open_photo", icon="IMAGE_DATA").path = chosen.path


def _taken(first: str, last: str) -> str:
    """The span of two ISO times, to the minute."""
    (first_day, _, first_time), (last_day, _, last_time) = first.partition("T"), last.partition("T")
    if first_day != last_day:
        return iface_("{} to {}").format(first_day, last_day)
    if first_time[:5] == last_time[:5]:
        return f"{first_day}, {first_time[:5]}"
    return iface_("{}, {} to {}").format(first_day, first_time[:5], last_time[:5])


def _shortened(names: str) -> str:
    return names if len(names) <= SHOWN_NAMES else f"{names[:SHOWN_NAMES]}..."


CLASSES = (CURECON_UL_doubtful, CURECON_PT_photos)
