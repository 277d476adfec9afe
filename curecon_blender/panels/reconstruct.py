# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Second step: from the photos to the cloud, with its progress."""

from __future__ import annotations

import bpy
from bl_ui.utils import PresetPanel
from bpy.app.translations import pgettext_iface as iface_

from ..core.base.options import QUALITIES
from ..job import duration
from ..languages import translated
from ..operators import presets, running
from ..preferences import ADDON
from .layout import QUALITYS_OWN, AdvancedPanel, Panel, action, draw_outcome, draw_progress, gibibytes, paragraph


class CURECON_PT_presets(PresetPanel, bpy.types.Panel):
    bl_label = "Reconstruct Presets"
    bl_space_type = "VIEW_3D"
    preset_subdir = presets.SUBFOLDER
    preset_operator = "script.execute_preset"
    preset_add_operator = "curecon.add_preset"


class CURECON_PT_reconstruct(Panel, bpy.types.Panel):
    bl_idname = "CURECON_PT_reconstruct"
    bl_label = "Reconstruct"

    def draw_header_preset(self, context: bpy.types.Context) -> None:
        if not running.status.running:
            CURECON_PT_presets.draw_panel_header(self.layout)

    def draw(self, context: bpy.types.Context) -> None:
        layout, properties, status = self.layout, context.scene.curecon, running.status
        ours = running.panel == "reconstruct"
        if status.running and ours:
            draw_progress(layout, status)
        elif not properties.photos:
            paragraph(layout, context, "Choose photos first.")
        else:
            self._draw_choice(context, properties)
        if ours:
            draw_outcome(layout, context, status)

    def _draw_choice(self, context: bpy.types.Context, properties: bpy.types.PropertyGroup) -> None:
        layout, check = self.layout, properties.check
        column = layout.column()
        column.enabled = not running.status.running
        column.row().prop(properties, "quality", text="")
        column.row().prop(properties, "goal", text="")
        checked = check.folder == properties.photos
        if checked:
            self._draw_costs(check, properties)
        cost = check.costs.get(f"{properties.quality}:{properties.goal}") if checked else None
        if cost is not None and not (properties.max_image_size or properties.views):  # it is of the quality's own
            self._draw_cost(context, properties, cost)
        if checked and not properties.result.points:
            action(layout, "curecon.reconstruct", icon="PLAY")
        else:  # the check is the next action, or what comes after the cloud
            layout.operator("curecon.reconstruct", icon="PLAY")

    def _draw_costs(self, check: bpy.types.PropertyGroup, properties: bpy.types.PropertyGroup) -> None:
        """What each quality takes, side by side."""
        table = self.layout.grid_flow(row_major=True, columns=3, align=True)
        table.scale_y = 0.8
        for name in QUALITIES:
            if (cost := check.costs.get(f"{name}:{properties.goal}")) is None:
                continue
            time = translated(duration(cost.seconds)) if cost.seconds >= 60 else iface_("< 1 min")
            for text in (iface_(name.capitalize()), time, gibibytes(cost.memory_gib)):
                cell = table.row()
                cell.active = _fits(check, cost)
                cell.label(text=text, translate=False)

    def _draw_cost(
        self, context: bpy.types.Context, properties: bpy.types.PropertyGroup, cost: bpy.types.PropertyGroup
    ) -> None:
        check = properties.check
        takes = iface_("About {}, {} of memory and {} of disk") if cost.seconds >= 60 else iface_(
            "Takes {}, {} of memory and {} of disk")
        text = takes.format(translated(duration(cost.seconds)), gibibytes(cost.memory_gib), gibibytes(cost.disk_gib))
        if _fits(check, cost):
            paragraph(self.layout, context, text)
            return
        box = self.layout.box()
        paragraph(box, context, text)
        if cost.memory_gib > check.free_memory_gib:
            text = iface_("Only {} of memory are free").format(gibibytes(check.free_memory_gib))
            paragraph(box, context, text, icon="ERROR", alert=True)
        if cost.disk_gib > check.free_disk_gib:
            text = iface_("Only {} of disk are free").format(gibibytes(check.free_disk_gib))
            paragraph(box, context, text, icon="ERROR", alert=True)
        lower = QUALITIES[: QUALITIES.index(properties.quality)]
        fitting = [name for name in lower if _fits(check, check.costs[f"{name}:{properties.goal}"])]
        if fitting:
            text = iface_("Use {}").format(iface_(fitting[-1].capitalize()))
            box.prop_enum(properties, "quality", fitting[-1], text=text)
        else:
            paragraph(box, context, "No quality fits: free some, then check the photos again.")


def _fits(check: bpy.types.PropertyGroup, cost: bpy.types.PropertyGroup) -> bool:
    return cost.memory_gib <= check.free_memory_gib and cost.disk_gib <= check.free_disk_gib


class CURECON_PT_advanced(AdvancedPanel, bpy.types.Panel):
    bl_idname = "CURECON_PT_advanced"
    bl_parent_id = "CURECON_PT_reconstruct"

    def draw_settings(self, context: bpy.types.Context, properties: bpy.types.PropertyGroup) -> None:
        layout = self.layout
        column = layout.column(align=True)
        column.label(text=QUALITYS_OWN)
        column.prop(properties, "max_image_size")
        column.prop(properties, "views")
        layout.prop(properties, "workspace", placeholder="Beside the photos")
        layout.prop(properties, "model", placeholder="Find the cameras")
        column = layout.column(align=True)
        column.operator("curecon.import_workspace", icon="IMPORT")
        column.operator("curecon.import_model", icon="IMPORT")
        layout.operator("preferences.addon_show", text="Device and Memory...", icon="PREFERENCES").module = ADDON


CLASSES = (CURECON_PT_presets, CURECON_PT_reconstruct, CURECON_PT_advanced)
