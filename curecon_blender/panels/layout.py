# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the panels have in common: where they stand, words that wrap, and how a job is going."""

from __future__ import annotations

import re
from collections.abc import Callable

import blf
import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..core.base.messages import Failure
from ..job import Status, duration
from ..languages import CONTEXT, translated
from ..operators import running
from ..operators.running import STAGE_NAMES
from ..preferences import ADDON, LOCKS
from ..scene.sidebar import TAB

# Chinese and Japanese have no spaces: a line may end after each of their letters, but not before a closing mark.
WORD = re.compile(r"(?:[\u3040-\u9fff\uff00-\uffef“‘（《]|[^\s\u3040-\u9fff“‘（《]+)[，。、；：！？）”’》]*\s*")
QUALITYS_OWN = "0 takes the quality's own:"


class Panel:
    """A part of the tab."""

    layout: bpy.types.UILayout  # Blender's own, at drawing
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = TAB
    bl_translation_context = CONTEXT


class AdvancedPanel(Panel):
    """Settings that most users never need: folded away, and locked while a job runs.

    A subclass gives `draw_settings`.
    """

    draw_settings: Callable[[bpy.types.Context, bpy.types.PropertyGroup], None]
    bl_label = "Advanced"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.enabled = not running.status.running
        self.layout.use_property_split = True
        self.layout.use_property_decorate = False
        self.draw_settings(context, context.scene.curecon)


def wrap(text: str, context: bpy.types.Context, indent: int = 0) -> list[str]:
    """`text` in lines that fit the sidebar; `indent` is taken off its width, in pixels at scale 1."""
    preferences = context.preferences
    scale = preferences.system.ui_scale
    blf.size(0, preferences.ui_styles[0].widget.points * scale)
    width = context.region.width - (76 + indent) * scale
    lines: list[str] = []
    for word in WORD.findall(text):
        if lines and blf.dimensions(0, lines[-1] + word.rstrip())[0] <= width:
            lines[-1] += word
        else:
            lines.append(word)
    return lines


def paragraph(
    layout: bpy.types.UILayout, context: bpy.types.Context, text: str, *, icon: str = "NONE", alert: bool = False
) -> None:
    """`text` in as many lines as it takes: in the user's language where it has a translation."""
    column = layout.column(align=True)
    column.alert = alert
    column.scale_y = 0.8
    for index, words in enumerate(wrap(translated(text), context, indent=28 if icon != "NONE" else 0)):
        shown = (icon if index == 0 else "BLANK1") if icon != "NONE" else "NONE"
        column.label(text=words, icon=shown, translate=False)


def action(
    layout: bpy.types.UILayout, operator: str, *, text: str = "", icon: str = "NONE"
) -> bpy.types.OperatorProperties:
    """The one next action of a step: a tall button."""
    row = layout.row()
    row.scale_y = 1.6
    return row.operator(operator, text=text or None, icon=icon)


def counted(count: int, one: str, many: str) -> str:
    """`one` or `many` in the user's language, with the count in its place: "{:,} photo", "{:,} photos"."""
    return iface_(one if count == 1 else many).format(count)


def gibibytes(amount: float) -> str:
    return f"{amount:.1f} GiB" if amount >= 1 else f"{max(amount * 1024, 1):.0f} MiB"


def draw_outcome(layout: bpy.types.UILayout, context: bpy.types.Context, status: Status) -> None:
    """How the last job ended, and its warnings."""
    if status.said:
        paragraph(layout, context, status.said, icon="CHECKMARK")
    if status.warning_count:
        box = layout.box()
        for text in status.warnings:
            paragraph(box, context, text, icon="ERROR")
        if status.warning_count > len(status.warnings):
            earlier = status.warning_count - len(status.warnings)
            box.label(text=counted(earlier, "and {:,} earlier warning", "and {:,} earlier warnings"), translate=False)
    if status.failure is not None:
        box = layout.box()
        cancelled = status.failure.kind == "cancelled"
        paragraph(box, context, status.failure.message, icon="INFO" if cancelled else "CANCEL", alert=not cancelled)
        paragraph(box, context, status.failure.remedy)
        _draw_remedy(box, context, status.failure)


def _draw_remedy(layout: bpy.types.UILayout, context: bpy.types.Context, failure: Failure) -> None:
    """The remedy as a button, where one can do it."""
    if failure.kind == "photos":
        layout.operator("curecon.choose_photos", text="Choose Photos", icon="FILE_FOLDER")
    elif failure.kind == "setup" and LOCKS.is_dir():
        layout.operator("curecon.get_libraries", icon="IMPORT")
    elif failure.kind in ("setup", "device", "worker", "weights"):
        layout.operator("preferences.addon_show", text="Open Preferences", icon="PREFERENCES").module = ADDON
    elif failure.kind == "workspace":
        layout.prop(context.scene.curecon, "workspace", text="", placeholder="Another Workspace Folder")


def draw_progress(layout: bpy.types.UILayout, status: Status) -> None:
    column = layout.column(align=True)
    left = status.seconds_left
    overall = f"{status.overall:.0%}"
    if left is not None:
        overall = iface_("{}, {} left").format(overall, translated(duration(left)))
    if status.stages or status.overall:  # an import has no worker to tell of it
        column.progress(factor=status.overall, text="Cancelling..." if status.cancelling else overall)
        column.separator()
    for stage in status.stages:  # in per cent: some count photos, some steps of their own
        name = iface_(STAGE_NAMES.get(stage.stage, stage.stage))
        column.progress(factor=stage.fraction, text=f"{name}  {stage.fraction:.0%}" if stage.total > 1 else name)
    if not status.stages:
        column.label(text=f"{iface_(status.task)}...", translate=False)
    row = layout.row()
    row.operator_context = "EXEC_DEFAULT"  # Esc may be a slip, a click on this is none
    row.operator("curecon.cancel", icon="X")
