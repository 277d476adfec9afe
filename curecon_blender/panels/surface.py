# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Fourth step: the mesh and its texture."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..operators import running
from ..operators.build_surface import LEVELS
from ..scene.surface import surfaces_of
from .layout import QUALITYS_OWN, AdvancedPanel, Panel, counted, draw_outcome, draw_progress, paragraph

LEVEL_NAMES = {level: name for level, name, _ in LEVELS}


class CURECON_PT_surface(Panel, bpy.types.Panel):
    bl_idname = "CURECON_PT_surface"
    bl_label = "Surface"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return bool(context.scene.curecon.result.workspace)  # the step after the cloud

    def draw(self, context: bpy.types.Context) -> None:
        layout, properties, status = self.layout, context.scene.curecon, running.status
        result, found = properties.result, surfaces_of(context.scene)
        if found:
            self._draw_state(context, result)
        else:
            paragraph(layout, context, "None yet. A mesh closes the cloud to a surface; the texture paints it with "
                      "the photos.")
        if status.running and running.panel == "surface":
            draw_progress(layout, status)
        else:
            self._draw_actions(result, bool(found))
        if running.panel == "surface":
            draw_outcome(layout, context, status)
        if found:
            row = layout.row(align=True)
            row.prop(properties, "show_surface", toggle=True, icon="MESH_DATA")
            row.prop(properties, "show_filled", toggle=True, icon="OVERLAY")
            row.prop(properties, "show_weak", toggle=True, icon="OVERLAY")
            row = layout.row(align=True)
            row.label(text="Light")
            row.prop(properties, "surface_light", expand=True)
            if result.textured:
                row = layout.row(align=True)
                row.label(text="Detail")
                row.operator_menu_enum("curecon.detail", "level", text=LEVEL_NAMES[properties.shown_detail or "full"])
            layout.operator("curecon.export_surface", icon="EXPORT")

    def _draw_state(self, context: bpy.types.Context, result: bpy.types.PropertyGroup) -> None:
        column = self.layout.box().column(align=True)
        column.label(text=counted(result.faces, "{:,} face", "{:,} faces"), icon="MESH_DATA", translate=False)
        column.label(text="Painted with the photos" if result.textured else "Colours at the vertices only",
                     icon="TEXTURE" if result.textured else "COLOR")
        if result.filled >= 0.05:
            filled = iface_("{:.1f} % filled: no photo measured it").format(result.filled)
        else:
            filled = iface_("All of it measured")
        paragraph(column, context, filled, icon="OVERLAY")
        if result.weak >= 0.05:
            weak = iface_("{:.1f} % weak: one photo alone measured it").format(result.weak)
            paragraph(column, context, weak, icon="OVERLAY")
        if result.unseen >= 0.05:
            unseen = iface_("{:.1f} % unseen: no photo shows its colour").format(result.unseen)
            paragraph(column, context, unseen, icon="HIDE_ON")

    def _draw_actions(self, result: bpy.types.PropertyGroup, found: bool) -> None:
        """The next action first and large."""
        mesh = ("curecon.build_mesh", "Build Mesh Again" if found else "Build Mesh", "MESH_ICOSPHERE")
        words = "Texture Again" if result.textured else "Texture" if found else "Build and Texture"
        texture = ("curecon.texture", words, "TEXTURE")
        column = self.layout.column(align=True)
        for index, (operator, text, icon) in enumerate(
            (texture, mesh) if found and not result.textured else (mesh, texture)
        ):
            row = column.row(align=True)
            row.scale_y = 1.6 if index == 0 and not result.textured else 1.0
            row.operator(operator, text=text, icon=icon)


class CURECON_PT_surface_advanced(AdvancedPanel, bpy.types.Panel):
    bl_idname = "CURECON_PT_surface_advanced"
    bl_parent_id = "CURECON_PT_surface"

    def draw_settings(self, context: bpy.types.Context, properties: bpy.types.PropertyGroup) -> None:
        layout = self.layout
        layout.prop(properties, "fill_holes")
        layout.prop(properties, "extent", expand=True)
        column = layout.column(align=True)
        column.label(text=QUALITYS_OWN)
        column.prop(properties, "max_faces")
        row = layout.row(heading="Region")
        row.prop(properties, "use_region", text="")
        sub = row.row()
        sub.enabled = properties.use_region
        sub.prop(properties, "region", text="", placeholder="Box")
        row.operator("curecon.add_region", text="", icon="ADD")
        layout.separator()
        layout.prop(properties, "texture_size", text="Texture Page")
        layout.prop(properties, "texture_format", expand=True)
        layout.prop(properties, "pack_textures")
        layout.separator()
        layout.prop(properties, "licence")
        layout.prop(properties, "credit")
        if context.scene.view_settings.view_transform != "Standard":
            layout.separator()
            # What Blender starts with tones bright and saturated colours down, the photos' among them.
            layout.prop(context.scene.view_settings, "view_transform")
            paragraph(layout, context, "Standard shows the photos' colours as they are.", icon="INFO")


CLASSES = (CURECON_PT_surface, CURECON_PT_surface_advanced)
