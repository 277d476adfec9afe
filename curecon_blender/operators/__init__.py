# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""One file an action; each lists its CLASSES. Operators are thin: core does the work, scene/ writes bpy.data."""

from __future__ import annotations

import bpy

from . import (
    accuracy_report,
    build_surface,
    check_photos,
    choose_photos,
    cloud_points,
    control_points,
    export_surface,
    frame_ground,
    frame_level,
    frame_north,
    frame_position,
    frame_reset,
    frame_scale,
    import_workspace,
    mark_points,
    measure,
    present_elevations,
    present_moves,
    present_photos,
    present_renders,
    present_sun,
    presets,
    reconstruct,
    self_check,
)

CLASSES = (
    *choose_photos.CLASSES, *check_photos.CLASSES, *reconstruct.CLASSES, *presets.CLASSES, *import_workspace.CLASSES,
    *build_surface.CLASSES, *export_surface.CLASSES, *accuracy_report.CLASSES,
    *present_elevations.CLASSES, *present_moves.CLASSES, *present_renders.CLASSES, *present_photos.CLASSES,
    *present_sun.CLASSES,
    *frame_scale.CLASSES, *frame_level.CLASSES, *frame_north.CLASSES, *frame_ground.CLASSES, *frame_reset.CLASSES,
    *frame_position.CLASSES, *measure.CLASSES,
    *control_points.CLASSES, *mark_points.CLASSES,
    *cloud_points.CLASSES, *self_check.CLASSES,
)


def _file_import(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    menu.layout.operator("curecon.choose_photos")
    menu.layout.operator("curecon.import_workspace", text="CU-Recon Workspace")
    menu.layout.operator("curecon.import_model", text="COLMAP Model (CU-Recon)")


def _file_export(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    menu.layout.operator("curecon.export_surface", text="Surface (CU-Recon)")


def add_menus() -> None:
    bpy.types.TOPBAR_MT_file_import.append(_file_import)
    bpy.types.TOPBAR_MT_file_export.append(_file_export)


def remove_menus() -> None:
    bpy.types.TOPBAR_MT_file_import.remove(_file_import)
    bpy.types.TOPBAR_MT_file_export.remove(_file_export)
