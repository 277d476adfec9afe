# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""An imported surface has its shape, colours and marks, takes the earlier one's place, and shows what was filled or
weak. Argument: an empty folder."""

from __future__ import annotations

import shutil
import sys
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import surface_scene
import workspace_scene
from surface_scene import FILLED, QUARTERS, WEAK

import curecon_blender
from curecon_blender.core.surface.mesh import write_mesh
from curecon_blender.scene.marks import TINTS
from curecon_blender.scene.surface import facing, surfaces_of
from curecon_blender.scene.workspace import clouds_of

FOLDER = Path(sys.argv[1])


def import_folder(folder: Path) -> bpy.types.Object:
    assert bpy.ops.curecon.import_workspace(directory=str(folder)) == {"FINISHED"}
    return surfaces_of(bpy.context.scene)[0]


def values(data: bpy.types.Mesh, name: str, field: str, kind: type = np.float32, width: int = 1) -> np.ndarray:
    attribute = data.attributes[name]
    found = np.empty(len(attribute.data) * width, kind)
    attribute.data.foreach_get(field, found)
    return found.reshape(-1, width) if width > 1 else found


def check_geometry(data: bpy.types.Mesh, *, pages: int) -> None:
    wanted = surface_scene.mesh(pages=pages)
    assert not data.validate(), "Blender found something to mend"
    assert np.array_equal(values(data, "position", "vector", width=3), wanted.vertices)
    corners = np.empty(len(wanted.faces) * 3, np.int32)
    data.loops.foreach_get("vertex_index", corners)
    assert np.array_equal(corners.reshape(-1, 3), wanted.faces)
    assert np.array_equal(values(data, "distance", "value"), wanted.distance)
    assert np.array_equal(values(data, "views", "value", np.int32), wanted.views)
    assert np.array_equal(values(data, "filled", "value", bool), wanted.filled)
    colours = values(data, "Color", "color_srgb", width=4) * 255
    assert np.abs(colours[:, :3] - wanted.colours).max() < 0.51
    # The ridge of the tent, 23 degrees, is no edge of a building; a cube's would be.
    sharp = data.attributes.get("sharp_edge")
    assert not any(polygon.use_smooth is False for polygon in data.polygons)
    assert sharp is None or not any(item.value for item in sharp.data)
    assert np.array_equal(values(data, "weak", "value", bool), wanted.weak)
    assert len(data.materials) == 3 * max(pages, 1)
    indices = values(data, "material_index", "value", np.int32)
    page = wanted.page if wanted.page is not None else 0
    assert np.array_equal(indices, page * 3 + wanted.filled + 2 * wanted.weak)
    if wanted.uv is not None:
        uv = np.empty(len(wanted.faces) * 6, np.float32)
        data.uv_layers.active.uv.foreach_get("vector", uv)
        assert np.array_equal(uv.reshape(-1, 3, 2), wanted.uv)


def check_colours(*tinted: str) -> None:
    """Of the quarters, those with a mark that is `tinted` have its tint, all others the photos' colours."""
    seen = surface_scene.render()
    marks = {FILLED: "filled", WEAK: "weak"}
    for quarter, colour in enumerate(QUARTERS):
        to_photo = np.abs(seen[quarter] - colour).max()
        if marks.get(quarter) in tinted:
            to_tint = np.abs(seen[quarter] - np.array(TINTS[marks[quarter]]) * 255).max()
            assert to_tint < to_photo and to_photo > 60, (quarter, seen, to_tint, to_photo)
        else:
            assert to_photo < 3, (quarter, seen, to_photo)


def check_facing(item: bpy.types.Object) -> None:
    """Which way faces look is the same where the user has made larger ones of some."""
    import bmesh  # which bpy brings

    data = item.data.copy()
    total = []
    for _ in range(2):
        normals, areas = facing(data)
        assert np.allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)
        total.append((normals * areas[:, None]).sum(axis=0))
        work = bmesh.new()
        work.from_mesh(data)
        bmesh.ops.dissolve_limit(work, angle_limit=0.01, verts=work.verts, edges=work.edges)
        work.to_mesh(data)
        work.free()
    assert len(data.loops) > 3 * len(data.polygons)
    np.testing.assert_allclose(total, [(0, 0, 100)] * 2, atol=1e-2)  # of a tent over 10 x 10 m
    bpy.data.meshes.remove(data)


def check_both_ways() -> None:
    properties = bpy.context.scene.curecon
    item = surfaces_of(bpy.context.scene)[0]
    before = [material.as_pointer() for material in item.data.materials], item.data.as_pointer()
    check_colours()
    properties.show_weak = True
    check_colours("weak")
    properties.show_filled = True
    check_colours("weak", "filled")
    properties.show_weak = False
    check_colours("filled")
    in_solid = item.data.materials[1].diffuse_color
    assert np.allclose(in_solid[:3], [c**2.2 for c in TINTS["filled"]], atol=0.03), tuple(in_solid)
    if item.data.uv_layers:  # what Solid shading shows as texture
        assert item.data.materials[1].node_tree.nodes.active.image.generated_width == 1
    else:
        colours = values(item.data, item.data.color_attributes.active_color.name, "color", width=4)
        assert len(colours) == 3 * len(item.data.polygons)
        assert colours[-1, 0] > colours[-1, 1] + 0.5  # pink, the last face of the filled quarter
        assert np.allclose(colours[0, :3], [(c / 255) ** 2.2 for c in QUARTERS[WEAK]], atol=0.03)
    properties.show_filled = False
    check_colours()
    assert before == ([material.as_pointer() for material in item.data.materials], item.data.as_pointer())


def error_of_import(folder: Path) -> str:
    try:
        bpy.ops.curecon.import_workspace(directory=str(folder))
    except RuntimeError as error:
        return str(error)
    raise AssertionError("no error")


def check_bad_files(folder: Path) -> None:
    """Each is an error in words, and what is in the scene stays."""
    kept = surfaces_of(bpy.context.scene)[0].name
    page = folder / "textured" / "texture_0.png"
    picture = page.read_bytes()
    page.unlink()
    assert "texture_0.png is missing" in error_of_import(folder)
    page.write_bytes(picture)
    good = surface_scene.mesh(pages=1)
    write_mesh(folder / "textured" / "mesh.ply", good.with_texture(good.uv, good.page + 1, good.pages))
    assert "damaged" in error_of_import(folder)
    (folder / "textured" / "mesh.ply").write_bytes((folder / "mesh.ply").read_bytes()[:-5])
    assert "cut short" in error_of_import(folder)
    write_mesh(folder / "textured" / "mesh.ply", good)
    assert [item.name for item in surfaces_of(bpy.context.scene)] == [kept]


curecon_blender.register()
try:
    bpy.ops.wm.read_homefile(use_empty=True)
    scene = bpy.context.scene
    folder = FOLDER / "one"
    workspace_scene.write(folder)
    import_folder_only_cloud = bpy.ops.curecon.import_workspace(directory=str(folder))
    assert not clouds_of(scene)[0].hide_viewport and scene.curecon.result.faces == 0

    # A mesh with vertex colours.
    surface_scene.write(folder, textured=False)
    surface = import_folder(folder)
    check_geometry(surface.data, pages=0)
    check_facing(surface)
    assert not surface.data.uv_layers and not surface.data.materials[0].node_tree.nodes.get("Image Texture")
    result = scene.curecon.result
    assert (result.faces, result.textured, round(result.filled), round(result.weak)) == (800, False, 25, 25)
    assert clouds_of(scene)[0].hide_viewport and clouds_of(scene)[0].hide_render and not scene.curecon.show_cloud
    scene.curecon.show_cloud = True
    assert not clouds_of(scene)[0].hide_viewport and not clouds_of(scene)[0].hide_render
    scene.curecon.show_cloud = False
    check_both_ways()

    # A textured mesh takes its place; the user's own object, even inside of the collection, stays.
    own = bpy.data.objects.new("My Door", bpy.data.meshes.new("My Door"))
    bpy.data.collections["CU-Recon: one"].objects.link(own)
    surface_scene.write(folder, textured=True)
    for _ in range(2):
        surface = import_folder(folder)
    assert len(surfaces_of(scene)) == 1 and "My Door" in scene.objects
    assert sorted(mesh.name for mesh in bpy.data.meshes) == ["My Door", "one Surface"]
    assert sorted(material.name for material in bpy.data.materials) == [
        "CU-Recon Colour", "one Surface", "one Surface Filled", "one Surface Weak"]
    check_geometry(surface.data, pages=1)
    image = surface.data.materials[0].node_tree.nodes["Colour"].image
    assert Path(bpy.path.abspath(image.filepath)) == folder / "textured" / "texture_0.png"
    assert image.packed_file is None and image.colorspace_settings.name == "sRGB"
    assert result.textured
    for material in surface.data.materials:
        matte = material.node_tree.nodes["Principled BSDF"].inputs
        assert matte["Roughness"].default_value == 1 and matte["Specular IOR Level"].default_value == 0
    check_both_ways()

    # At a level of detail it has fewer faces and its own texture.
    shutil.copytree(folder / "textured", folder / "detail" / "20k")
    full = surface_scene.mesh(pages=1)
    write_mesh(folder / "detail" / "20k" / "mesh.ply", replace(
        full, faces=full.faces[:400], filled=full.filled[:400], weak=full.weak[:400], uv=full.uv[:400],
        page=full.page[:400]))
    scene.curecon.shown_detail = "20k"
    image = import_folder(folder).data.materials[0].node_tree.nodes["Colour"].image
    assert result.faces == 400 and Path(bpy.path.abspath(image.filepath)).parent == folder / "detail" / "20k"
    scene.curecon.shown_detail = "150k"  # not made: the full one comes
    surface = import_folder(folder)
    assert result.faces == 800
    scene.curecon.shown_detail = ""

    # In the scene's light it is a matte surface: dark without a sky and lamps, lit with one.
    scene.curecon.surface_light = "SCENE"
    scene.world = None
    assert surface_scene.render().max() < 60
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    sun.data.energy = np.pi  # straight from above: a level matte surface then has its own colour
    scene.collection.objects.link(sun)
    lit = surface_scene.render()
    assert np.abs(lit - QUARTERS).max() < 12, lit
    scene.curecon.surface_light = "PHOTO"
    bpy.data.objects.remove(sun)

    check_bad_files(folder)
    surface = import_folder(folder)

    # Switches survive saving and loading.
    scene.curecon.show_filled = True
    bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / "saved.blend"))
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=str(FOLDER / "saved.blend"))
    scene = bpy.context.scene
    check_colours("filled")
    scene.curecon.show_filled = False
    check_both_ways()
    assert tuple(bpy.data.images["curecon_filled"].pixels[:3]) != (0, 0, 0)

    # Packed, and of several pages and parts.
    scene.curecon.pack_textures = True
    surface = import_folder(folder)
    assert surface.data.materials[0].node_tree.nodes["Colour"].image.packed_file is not None
    two = FOLDER / "two"
    workspace_scene.write(two, parts=2)
    for part in range(2):
        surface_scene.write(two, textured=True, pages=2, part=part)
    bpy.ops.wm.read_homefile(use_empty=True)
    surface = import_folder(two)
    check_geometry(surface.data, pages=2)
    assert [item.name for item in surfaces_of(bpy.context.scene)] == ["two Surface 1", "two Surface 2"]
    assert bpy.context.scene.curecon.result.faces == 1600

    # An import can be undone and redone, and the switches work on what comes back.
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.ed.undo_push(message="empty")
    import_folder(folder)
    bpy.ops.ed.undo_push(message="imported")
    bpy.ops.ed.undo()
    assert not surfaces_of(bpy.context.scene) and not bpy.context.scene.curecon.result.workspace
    bpy.ops.ed.redo()
    check_geometry(surfaces_of(bpy.context.scene)[0].data, pages=1)
    check_both_ways()
finally:
    curecon_blender.unregister()
print("CHECKED")
