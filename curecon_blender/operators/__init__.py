# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""One file an action; each lists its CLASSES. Operators are thin: core does the work, scene/ writes bpy.data."""

from __future__ import annotations

import bpy

from ..scene import cameras, points, surface
from . import (
    accuracy_report,
    build_surface,
    check_photos,
    choose_photos,
    cloud_points,
    comparison,
    control_points,
    deliver,
    export_cloud,
    export_surface,
    find_gaps,
    frame_ground,
    frame_level,
    frame_north,
    frame_position,
    frame_reset,
    frame_scale,
    import_workspace,
    libraries,
    make_model,
    mark_points,
    mask_photos,
    measure,
    plan_flight,
    present_elevations,
    present_moves,
    present_photos,
    present_renders,
    present_sun,
    presets,
    publish,
    reconstruct,
    self_check,
    take_frames,
    upload,
)

CLASSES: tuple[type, ...] = (
    *choose_photos.CLASSES, *check_photos.CLASSES, *reconstruct.CLASSES, *make_model.CLASSES, *presets.CLASSES,
    *import_workspace.CLASSES, *comparison.CLASSES,
    *build_surface.CLASSES, *export_surface.CLASSES, *export_cloud.CLASSES, *accuracy_report.CLASSES,
    *deliver.CLASSES, *publish.CLASSES, *upload.CLASSES,
    *present_elevations.CLASSES, *present_moves.CLASSES, *present_renders.CLASSES, *present_photos.CLASSES,
    *present_sun.CLASSES,
    *frame_scale.CLASSES, *frame_level.CLASSES, *frame_north.CLASSES, *frame_ground.CLASSES, *frame_reset.CLASSES,
    *frame_position.CLASSES, *measure.CLASSES,
    *control_points.CLASSES, *mark_points.CLASSES,
    *plan_flight.CLASSES, *find_gaps.CLASSES, *take_frames.CLASSES, *cloud_points.CLASSES, *mask_photos.CLASSES,
    *self_check.CLASSES,
    *libraries.CLASSES,
)


def _file_import(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    menu.layout.operator("curecon.choose_photos", text="Drone Photos (CU-Recon)")
    menu.layout.operator("curecon.import_workspace", text="CU-Recon Workspace")
    menu.layout.operator("curecon.import_model", text="COLMAP Model (CU-Recon)")
    menu.layout.operator("curecon.import_comparison", text="Comparison (CU-Recon)")


def _file_export(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    menu.layout.operator("curecon.export_surface", text="Surface (CU-Recon)")
    menu.layout.operator("curecon.export_cloud", text="Point Cloud (CU-Recon)")
    menu.layout.operator("curecon.export_deliverables", text="Survey Deliverables (CU-Recon)")
    menu.layout.operator("curecon.publish", text="Web Pages (CU-Recon)")
    menu.layout.operator("curecon.render_elevations", text="Elevation Sheets (CU-Recon)")


class CURECON_MT_add(bpy.types.Menu):
    """What can be brought in; the words are those that people look for with F3."""

    bl_idname = "CURECON_MT_add"
    bl_label = "Photogrammetry"

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.operator_context = "INVOKE_DEFAULT"
        layout.operator("curecon.choose_photos", text="Scan from Drone Photos...", icon="FILE_FOLDER")
        layout.operator("curecon.make_model", text="Textured Model from the Photos", icon="OUTLINER_OB_MESH")
        layout.operator("curecon.import_workspace", icon="IMPORT")
        layout.operator("curecon.add_region", icon="MESH_CUBE")
        layout.separator()
        layout.operator("curecon.show_tab", text="Open CU-Recon in the Sidebar", icon="MENU_PANEL")
        layout.operator("curecon.open_workspace", icon="WORKSPACE")


class CURECON_MT_object(bpy.types.Menu):
    """What can be done with a site in the scene."""

    bl_idname = "CURECON_MT_object"
    bl_label = "Photogrammetry Scan"

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.operator_context = "INVOKE_DEFAULT"
        layout.operator("curecon.measure", icon="ARROW_LEFTRIGHT")
        layout.operator("curecon.frame_scale", icon="DRIVER_DISTANCE")
        layout.operator("curecon.frame_cloud", text="Frame the Scan", icon="VIEWZOOM")
        layout.separator()
        layout.operator("curecon.build_mesh", text="Build Mesh from Cloud", icon="MESH_DATA")
        layout.operator("curecon.texture", text="Texture from Drone Photos", icon="TEXTURE")
        layout.separator()
        layout.operator("curecon.look_through", text="Look Through Photo", icon="CAMERA_DATA").which = "SELECTED"
        layout.operator("curecon.set_sun", icon="LIGHT_SUN")
        layout.operator("curecon.render_elevations", icon="SNAP_PERPENDICULAR")
        layout.separator()
        layout.operator("curecon.export_surface", text="Export Surface...", icon="EXPORT")
        layout.operator("curecon.export_cloud", text="Export Point Cloud...", icon="EXPORT")


def _add(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    menu.layout.menu("CURECON_MT_add", icon="OUTLINER_OB_POINTCLOUD")


def _header(menu: bpy.types.Header, context: bpy.types.Context) -> None:
    """At the right end of the 3D viewport's header."""
    menu.layout.operator("curecon.show_tab", text="", icon="OUTLINER_OB_POINTCLOUD")


def _object(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    menu.layout.separator()
    menu.layout.menu("CURECON_MT_object", icon="OUTLINER_OB_POINTCLOUD")


def _object_context(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Only over what is ours: the menu is long as it is."""
    item = context.active_object
    if item is not None and (cameras.is_photo_camera(item) or surface.is_surface(item) or points.is_cloud(item)):
        _object(menu, context)


def _workspace(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    """In the menu of the tabs at the top."""
    menu.layout.separator()
    menu.layout.operator("curecon.open_workspace", icon="WORKSPACE")


CLASSES += (CURECON_MT_add, CURECON_MT_object)
MENUS = (
    ("TOPBAR_MT_file_import", _file_import), ("TOPBAR_MT_file_export", _file_export), ("VIEW3D_MT_add", _add),
    ("VIEW3D_MT_object", _object), ("VIEW3D_MT_object_context_menu", _object_context),
    ("VIEW3D_HT_header", _header), ("TOPBAR_MT_workspace_menu", _workspace),
)
KEYMAP = "3D View"


def add_menus() -> None:
    """Entries in Blender's menus, and a key that the user may change in the preferences."""
    for name, draw in MENUS:
        getattr(bpy.types, name).append(draw)
    if not bpy.app.background:
        keymap = bpy.context.window_manager.keyconfigs.addon.keymaps.new(name=KEYMAP, space_type="VIEW_3D")
        keymap.keymap_items.new("curecon.show_tab", "U", "PRESS", ctrl=True, alt=True)


def remove_menus() -> None:
    for name, draw in MENUS:
        getattr(bpy.types, name).remove(draw)
    if bpy.app.background:
        return
    keymap = bpy.context.window_manager.keyconfigs.addon.keymaps[KEYMAP]  # Python's hold on an item ends with a file
    for item in [item for item in keymap.keymap_items if item.idname == "curecon.show_tab"]:
        keymap.keymap_items.remove(item)
