# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Whatever the user's scene holds, sheets and films show the site as asked; and what Blender cannot do is a sentence
that leaves nothing behind. Argument: a folder."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
import surface_scene
import workspace_scene
from mathutils import Vector
from pictures import pixels_of

import curecon_blender
from curecon_blender.operators import rendering
from curecon_blender.scene import render_scene

FOLDER, OUT = Path(sys.argv[1]) / "work", Path(sys.argv[1]) / "out"
PIXELS_PER_MM, SCALE = 4, 200


def load() -> bpy.types.Scene:
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.curecon.import_workspace(directory=str(FOLDER))
    scene = bpy.context.scene
    present = scene.curecon.present
    present.folder, present.sheet_scale, present.seconds, scene.render.fps = str(OUT), str(SCALE), 1.0, 4
    return scene


def assert_the_roof_is_right(name: str) -> None:
    """It is 10 x 10 m in the quarters' colours, whatever a picture of an earlier run showed."""
    assert bpy.ops.curecon.render_elevations() == {"FINISHED"}, name
    pixels = pixels_of(OUT / "5_roof_plan.png")
    found = np.ptp(pixels, axis=2) > 0.1
    rows, columns = np.flatnonzero(found.any(axis=1)), np.flatnonzero(found.any(axis=0))
    assert len(rows), name
    metres = np.array([np.ptp(columns) + 1, np.ptp(rows) + 1]) / PIXELS_PER_MM * SCALE / 1000
    assert np.abs(metres - 10).max() < 0.12, (name, metres)
    middle = [(rows[0] + np.ptp(rows) * a // 4, columns[0] + np.ptp(columns) * b // 4)
              for a in (1, 3) for b in (1, 3)]
    colours = 255 * np.array([pixels[place] for place in middle])
    assert np.abs(colours - surface_scene.QUARTERS).max() < 6, (name, colours)  # between the lines of its hatching
    assert [item.name for item in bpy.data.scenes] == ["Scene"], name


def marker(scene: bpy.types.Scene) -> None:
    shot = bpy.data.objects.new("My shot", bpy.data.cameras.new("My shot"))
    scene.collection.objects.link(shot)
    shot.location = (-9, -12, 9)
    shot.rotation_euler = (Vector((5, 5, 0)) - shot.location).to_track_quat("-Z", "Y").to_euler()
    for frame in (0, 1):
        scene.timeline_markers.new(f"shot {frame}", frame=frame).camera = shot


def stereo(scene: bpy.types.Scene) -> None:
    scene.render.use_multiview = True


def view_layers(scene: bpy.types.Scene) -> None:
    layer = scene.view_layers[0]
    layer.material_override = bpy.data.materials.new("Clay")
    for child in layer.layer_collection.children:
        child.holdout = True
    scene.view_layers.new("Second")


def colours(scene: bpy.types.Scene) -> None:
    view = scene.view_settings
    view.view_transform, view.exposure, view.gamma = "False Color", 2.0, 1.6
    view.use_white_balance, view.white_balance_temperature = True, 3000
    scene.render.image_settings.file_format = "OPEN_EXR"


def object_settings(scene: bpy.types.Scene) -> None:
    surface = bpy.data.objects["work Surface"]
    surface.is_holdout, surface.visible_camera = True, False


def a_veil(scene: bpy.types.Scene) -> None:
    bpy.ops.mesh.primitive_plane_add(size=100, location=(5, 5, 2.0))
    world = bpy.data.worlds.new("Mist")
    if world.node_tree is None:
        world.use_nodes = True
    mist = world.node_tree.nodes.new("ShaderNodeVolumeScatter")
    world.node_tree.links.new(mist.outputs[0], world.node_tree.nodes["World Output"].inputs["Volume"])
    scene.world = world


def rendering_settings(scene: bpy.types.Scene) -> None:
    scene.frame_step, scene.frame_current = 3, 40
    scene.render.use_border, scene.render.border_max_x = True, 0.5
    scene.render.use_simplify, scene.render.pixel_aspect_x, scene.render.use_overwrite = True, 2.0, False
    scene.render.use_stamp = scene.render.use_motion_blur = True
    scene.render.use_file_extension = False
    scene.render.frame_map_new = 300


def a_name_like_a_template(scene: bpy.types.Scene) -> None:
    global OUT
    OUT = Path(sys.argv[1]) / "out {blend_name} #2"
    scene.curecon.present.folder = str(OUT)


def error_of(operator: Callable[..., set[str]], **arguments: object) -> str:
    try:
        operator(**arguments)
    except RuntimeError as error:
        return str(error)
    raise AssertionError("no error was reported")


def count() -> tuple[int, ...]:
    kinds = ("scenes", "objects", "cameras", "actions", "materials", "meshes", "node_groups")
    return tuple(len(getattr(bpy.data, kind)) for kind in kinds)


def check_films() -> None:
    """A film has all its frames at any frame step; without FFmpeg there are stills, and a warning."""
    scene = load()
    for change in (marker, stereo, rendering_settings):
        change(scene)
    before = count()
    assert bpy.ops.curecon.render_showreel() == {"FINISHED"} and count() == before, (count(), before)
    film = bpy.data.movieclips.load(str(OUT / "film.mp4"))
    assert (film.frame_duration, tuple(film.size)) == (4, (960, 540))
    can_film, render_scene.can_film = render_scene.can_film, lambda: False
    try:
        (OUT / "film.mp4").unlink()
        assert bpy.ops.curecon.render_showreel() == {"FINISHED"}
        assert not (OUT / "film.mp4").exists() and (OUT / "contact_sheet.png").is_file()
    finally:
        render_scene.can_film = can_film


def check_engine_off() -> None:
    scene = load()
    before = count()
    bpy.ops.preferences.addon_disable(module="cycles")
    try:
        for operator in (bpy.ops.curecon.render_elevations, bpy.ops.curecon.render_showreel):
            said = error_of(operator)
            assert "Cycles is switched off" in said and "Location" not in said and "Choose EEVEE" in said, said
        assert count() == before and not rendering.progress.running
        # What needs no render is made all the same.
        assert bpy.ops.curecon.move_camera(kind="ORBIT") == {"FINISHED"} and scene.camera.name == "CU-Recon Orbit"
        assert bpy.ops.curecon.look_through() == {"FINISHED"}
        scene.curecon.present.engine = "EEVEE"
        assert not render_scene.missing(scene) and "EEVEE" in scene.render.engine
    finally:
        bpy.ops.preferences.addon_enable(module="cycles")


def check_other_camera() -> None:
    """An add-on that swaps the camera while it renders is told of; no sheet is signed."""
    load()
    other = bpy.data.objects.new("Other", bpy.data.cameras.new("Other"))

    def swap(scene: bpy.types.Scene, *_: object) -> None:
        scene.camera = other

    bpy.app.handlers.render_pre.append(swap)
    try:
        assert "drawn by another camera" in error_of(bpy.ops.curecon.render_elevations)
    finally:
        bpy.app.handlers.render_pre.remove(swap)
    assert len(bpy.data.scenes) == 1 and not rendering.progress.running


curecon_blender.register()
try:
    workspace_scene.write(FOLDER)
    surface_scene.write(FOLDER, textured=False)
    for change in (marker, stereo, view_layers, colours, object_settings, a_veil, rendering_settings,
                   a_name_like_a_template):
        change(load())
        before = count()
        assert_the_roof_is_right(change.__name__)
        assert count() == before, (change.__name__, count(), before)
    check_films()
    check_engine_off()
    check_other_camera()
finally:
    curecon_blender.unregister()
print("CHECKED")
