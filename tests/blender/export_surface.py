# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Exports surfaces in every form for tests/test_surface_scene.py to read, and checks that the scene stays as it was.
Argument: an empty folder."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
import surface_scene
import workspace_scene

import curecon_blender
from curecon_blender.operators import running
from curecon_blender.scene.surface import surfaces_of

FOLDER = Path(sys.argv[1])


def state() -> list[object]:
    scene, objects = bpy.context.scene, bpy.context.view_layer.objects
    active = objects.active
    return [
        [(item.name, item.select_get(), item.hide_get(), item.hide_viewport) for item in objects],
        active and active.name, scene.curecon.show_filled, len(bpy.data.images), len(bpy.data.objects),
        [(tuple(m.diffuse_color), [(link.from_node.name, link.to_node.name) for link in m.node_tree.links])
         for item in surfaces_of(scene) for m in item.data.materials],
    ]


def export(name: str, form: str, **options: object) -> None:
    before, options = state(), {"position": True, **options}
    assert bpy.ops.curecon.export_surface(filepath=str(FOLDER / name), form=form, **options) == {"FINISHED"}
    assert state() == before, (before, state())


def open_workspace(name: str, *, textured: bool, pages: int = 1) -> None:
    bpy.ops.wm.read_homefile(use_empty=True)
    workspace_scene.write(FOLDER / name)
    surface_scene.write(FOLDER / name, textured=textured, pages=pages)
    bpy.ops.curecon.import_workspace(directory=str(FOLDER / name))
    bpy.context.scene.curecon.licence, bpy.context.scene.curecon.credit = "CC BY 4.0", "福建 Team\nand Co"


curecon_blender.register()
try:
    try:
        bpy.ops.curecon.export_surface(filepath=str(FOLDER / "none.glb"))
        raise AssertionError("exported nothing")
    except RuntimeError as error:
        assert "poll" in str(error), error

    open_workspace("plain", textured=False)
    for form in ("GLB", "OBJ", "PLY"):
        export(f"plain.{form.lower()}", form)

    open_workspace("textured", textured=True)
    scene = bpy.context.scene
    scene.curecon.show_filled = scene.curecon.show_weak = True  # the file must be the same whatever is shown
    scene.curecon.show_surface = False
    export("textured", "GLB")
    scene.curecon.show_surface = True
    for form in ("OBJ", "PLY"):
        export(f"my site.{form.lower()}", form)
    export("jpeg.glb", "GLB", texture="JPEG", unlit=False)
    export("webp.glb", "GLB", texture="WEBP")
    export("draco.glb", "GLB", compression="DRACO")
    export("meshopt.glb", "GLB", compression="MESHOPT")
    bpy.ops.import_scene.gltf(filepath=str(FOLDER / "draco.glb"))
    item = bpy.context.object
    places = np.array([item.matrix_world @ vertex.co for vertex in item.data.vertices])
    np.save(FOLDER / "draco.npy", places)
    bpy.data.objects.remove(item)
    export("secret.glb", "GLB", position=False)
    export("secret.obj", "OBJ", position=False)
    export("secret.ply", "PLY", position=False)

    for image in bpy.data.images:
        if image.filepath:
            image.pack()
    (FOLDER / "textured" / "textured" / "texture_0.png").unlink()
    export("packed.obj", "OBJ")
    export("packed.glb", "GLB")

    open_workspace("pages", textured=True, pages=2)
    for form in ("GLB", "OBJ", "PLY"):
        export(f"pages.{form.lower()}", form)
    bpy.ops.preferences.addon_disable(module="io_scene_gltf2")
    try:
        bpy.ops.curecon.export_surface(filepath=str(FOLDER / "off.glb"))
        raise AssertionError("exported with an exporter that is switched off")
    except RuntimeError as error:
        assert "glTF 2.0 format" in str(error), error
    (FOLDER / "pages" / "textured" / "texture_1.png").unlink()
    before = (FOLDER / "pages.obj").read_bytes()
    try:
        bpy.ops.curecon.export_surface(filepath=str(FOLDER / "pages.obj"), form="OBJ")
        raise AssertionError("exported a texture that is not there")
    except RuntimeError as error:
        assert "texture_1.png is missing" in str(error)
    assert (FOLDER / "pages.obj").read_bytes() == before
    assert not list(FOLDER.glob(".curecon*"))
    assert not running.status.running
finally:
    curecon_blender.unregister()
print("CHECKED")
