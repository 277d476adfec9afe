# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A coarse surface with the normal map of a bumpy one is shaded as that one is, and a lit GLB takes the map along.
Argument: a workspace with both, the coarse one as its level 20k."""

from __future__ import annotations

import json
import struct
import sys
from pathlib import Path

import bpy
import numpy as np

import curecon_blender
from curecon_blender.scene import render_scene
from curecon_blender.scene.surface import RELIEF_NODE, light, simplify, surfaces_of

FOLDER = Path(sys.argv[1])
SIZE = 96


def import_level(level: str) -> bpy.types.Object:
    bpy.context.scene.curecon.shown_detail = level
    assert bpy.ops.curecon.import_workspace(directory=str(FOLDER)) == {"FINISHED"}
    (item,) = surfaces_of(bpy.context.scene)
    light(bpy.context.scene, by_scene=True)
    return item


def rendered(name: str) -> np.ndarray:
    scene, render = bpy.context.scene, bpy.context.scene.render
    # An import sets camera, world and size.
    scene.camera, scene.world, render.filepath = bpy.data.objects["Camera"], None, str(FOLDER / f"{name}.png")
    render.resolution_x, render.resolution_y, render.resolution_percentage = SIZE, SIZE, 100
    render.pixel_aspect_x = render.pixel_aspect_y = 1
    bpy.ops.render.render(write_still=True)
    return render_scene.read_pixels(FOLDER / f"{name}.png")[..., 0].astype(float)


def set_up() -> None:
    """A camera straight above and a low sun."""
    scene = bpy.context.scene
    lens, lamp = bpy.data.cameras.new("Camera"), bpy.data.lights.new("Sun", "SUN")
    lens.type, lens.ortho_scale, lamp.energy = "ORTHO", 1.8, 3.0
    for data, place, turn in ((lens, (1, 1, 5), (0, 0, 0)), (lamp, (0, 0, 5), (0.6, 0.7, 0))):
        item = bpy.data.objects.new(data.name, data)
        item.location, item.rotation_euler = place, turn
        scene.collection.objects.link(item)
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 16, False


def materials_of(name: str, *, unlit: bool) -> list[dict]:
    path = FOLDER / name
    assert bpy.ops.curecon.export_surface(filepath=str(path), form="GLB", unlit=unlit) == {"FINISHED"}
    content = path.read_bytes()
    return json.loads(content[20 : 20 + struct.unpack("<I", content[12:16])[0]])["materials"]


curecon_blender.register()
try:
    bpy.ops.wm.read_homefile(use_empty=True)
    assert RELIEF_NODE not in import_level("").data.materials[0].node_tree.nodes
    set_up()
    true = rendered("fine")
    item = import_level("20k")
    assert len(item.data.polygons) < 100
    bumpy = rendered("with")
    simplify([item], False, relief=False)
    flat = rendered("without")
    off_with, off_without = (np.sqrt(((picture - true) ** 2).mean()) for picture in (bumpy, flat))
    assert true.std() > 12, true.std()
    assert off_with < 0.3 * off_without, (off_with, off_without)
    simplify([item], False)
    assert all("normalTexture" in material for material in materials_of("lit.glb", unlit=False))
    # Without lights there is nothing for it to do but be downloaded.
    assert not any("normalTexture" in material for material in materials_of("unlit.glb", unlit=True))
    assert (FOLDER / "unlit.glb").stat().st_size < (FOLDER / "lit.glb").stat().st_size
finally:
    curecon_blender.unregister()
print("CHECKED")
