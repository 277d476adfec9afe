# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What Blender's menus offer, and what the exports from there write. Argument: an empty folder."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import surface_scene
import workspace_scene

import curecon_blender
from curecon_blender import operators
from curecon_blender.core.cloud.ply import read_cloud
from curecon_blender.operators import paths, running

FOLDER = Path(sys.argv[1])
SITE = FOLDER / "old_mill_curecon"
WORDS = ("photogrammetry", "measure", "texture", "scan", "drone")  # that F3 must find


class Layout:
    """Stands in for Blender's own, which there is only in a window: keeps what a menu offers."""

    operator_context = ""

    def __init__(self) -> None:
        self.offered: dict[str, str] = {}

    def operator(self, name: str, *, text: str = "", **_: object) -> SimpleNamespace:
        module, _, function = name.partition(".")
        assert getattr(getattr(bpy.ops, module), function).get_rna_type(), name
        self.offered[name] = text or getattr(getattr(bpy.ops, module), function).get_rna_type().name
        return SimpleNamespace()

    def menu(self, name: str, **_: object) -> None:
        kind = getattr(bpy.types, name)
        self.offered[name] = kind.bl_label
        kind.draw(SimpleNamespace(layout=self), bpy.context)

    def separator(self) -> None:
        pass


def offered(menu: str) -> dict[str, str]:
    layout = Layout()
    for name, draw in operators.MENUS:
        if name == menu:
            draw(SimpleNamespace(layout=layout), bpy.context)
    return layout.offered


def check_menus() -> None:
    for name, draw in operators.MENUS:
        assert draw in getattr(bpy.types, name).draw._draw_funcs, name
    found = " ".join(text for name, _ in operators.MENUS for text in offered(name).values()).lower()
    assert all(word in found for word in WORDS), found
    assert set(offered("TOPBAR_MT_file_export")) == {
        "curecon.export_surface", "curecon.export_cloud", "curecon.export_deliverables", "curecon.publish",
            "curecon.render_elevations"}
    # Over an object of the user's own, the context menu is Blender's alone.
    bpy.context.view_layer.objects.active = bpy.data.objects["old_mill Surface"]
    assert "curecon.measure" in offered("VIEW3D_MT_object_context_menu")
    bpy.ops.mesh.primitive_cube_add()
    assert not offered("VIEW3D_MT_object_context_menu")


def check_cloud_export() -> None:
    scene = bpy.context.scene
    path = FOLDER / "given.ply"
    assert bpy.ops.curecon.add_region() == {"FINISHED"}
    scene.curecon.region.location, scene.curecon.region.scale = (2.5, 5, 0.5), (2.5, 20, 5)  # the west half
    bpy.context.view_layer.update()
    assert bpy.ops.curecon.cloud_crop() == {"FINISHED"}
    scene.curecon.licence = "CC BY 4.0"
    assert bpy.ops.curecon.export_cloud(filepath=str(path)) == {"FINISHED"}
    before = read_cloud(SITE / "cloud.ply")
    kept, found = before.take(before.points[:, 0] < 5), read_cloud(path)
    np.testing.assert_allclose(found.points, kept.points, atol=1e-6)
    np.testing.assert_array_equal(found.colours, kept.colours)
    content = path.read_bytes()
    assert b"117.25" not in content and b"CC BY 4.0" in content and b"metres" in content
    assert bpy.ops.curecon.export_cloud(filepath=str(path), position=True) == {"FINISHED"}
    assert b"117.25" in path.read_bytes()
    # Moved and scaled, as in a scene of centimetres, a file is in metres all the same.
    for item in bpy.data.collections["CU-Recon: old_mill"].all_objects:
        item.location, item.scale = item.location * 100, item.scale * 100
    bpy.context.view_layer.update()
    assert bpy.ops.curecon.export_cloud(filepath=str(path)) == {"FINISHED"}
    np.testing.assert_allclose(read_cloud(path).points, kept.points, atol=1e-5)


def check_names() -> None:
    """An export is named after the site, beside its workspace, or the .blend once there is one."""
    assert paths.export_file(bpy.context.scene, ".glb") == FOLDER / "old_mill.glb"
    (FOLDER / "blends").mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / "blends" / "any.blend"))
    assert paths.export_file(bpy.context.scene, " cloud.ply") == FOLDER / "blends" / "old_mill cloud.ply"


def check_end() -> None:
    """Esc ends a young job at once and asks about an old one; the remaining time makes no leap."""
    status = running.status
    status.running, status.began = True, time.monotonic()
    assert status.seconds_running < running.LONG_SECONDS
    assert bpy.ops.curecon.cancel("INVOKE_DEFAULT") == {"FINISHED"} and status.cancelling
    status.running = status.cancelling = False


curecon_blender.register()
try:
    workspace_scene.write(SITE)
    surface_scene.write(SITE, textured=False)
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.curecon.import_workspace(directory=str(SITE))
    check_menus()
    check_cloud_export()
    check_names()
    check_end()
finally:
    curecon_blender.unregister()
print("CHECKED")
