# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera moves and the photo overlay, as a user meets them. Argument: a folder."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
import surface_scene
import workspace_scene
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

import curecon_blender
from curecon_blender.scene import cameras, flight, site
from curecon_blender.scene.points import about_the_subject

FOLDER = Path(sys.argv[1]) / "work"
ORDER = ("quote'd.jpg", "照片 3.jpg", "DJI_0001.JPG", "with space.png")  # of capture; not that of the names


def played(camera: bpy.types.Object) -> np.ndarray:
    """Where the camera is on every frame: (F,3)."""
    scene = bpy.context.scene
    places = []
    for frame in range(scene.frame_start, scene.frame_end + 1):
        scene.frame_set(frame)
        places.append(list(camera.matrix_world.translation))
    return np.array(places)


def sees(camera: bpy.types.Object, point: tuple[float, float, float]) -> bool:
    x, y, z = world_to_camera_view(bpy.context.scene, camera, Vector(point))
    return 0 < x < 1 and 0 < y < 1 and z > 0


def litter() -> tuple[int, ...]:
    return tuple(len(getattr(bpy.data, kind)) for kind in ("objects", "cameras", "actions", "collections", "curves"))


def check_slim() -> None:
    """A still of something slim shows the sky behind it: it is taken from lower than was asked for."""
    tower = site.Box(centre=np.array([0.0, 0, 20]), half=np.array([2.0, 2, 20]), turn=0.0)
    for steepest, down in ((22.0, (15, 25)), (90.0, (40, 90))):
        place, _ = flight.look_from(tower, 30.0, 80.0, steepest)
        looks = np.degrees(np.arctan2(place[2] - 20, np.hypot(*place[:2])))
        assert down[0] < looks < down[1], looks


check_slim()
curecon_blender.register()
try:
    bpy.ops.wm.read_homefile(use_empty=True)
    assert not bpy.ops.curecon.move_camera.poll() and not bpy.ops.curecon.look_through.poll()
    workspace_scene.write(FOLDER)
    surface_scene.write(FOLDER, textured=False)
    workspace_scene.tell_times(FOLDER, {
        name: f"2024-09-28T10:0{index}:00" for index, name in enumerate(ORDER)
    })
    bpy.ops.curecon.import_workspace(directory=str(FOLDER))
    scene = bpy.context.scene
    present = scene.curecon.present
    present.seconds, present.height, present.start_angle = 2, 3, 0
    corners = [(x, y, z) for x in (0, 10) for y in (0, 10) for z in (0, 1)]

    assert bpy.ops.curecon.move_camera(kind="ORBIT") == {"FINISHED"}
    assert scene.frame_end == round(2 * scene.render.fps) and scene.camera.name == "CU-Recon Orbit"
    assert (scene.render.engine, scene.render.resolution_percentage) == ("CYCLES", 50)  # as Draft has films
    places = played(scene.camera)
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert np.ptp(steps) < 1e-3 * steps.mean() and np.ptp(places[:, 2]) < 1e-4
    assert abs(places[0, 0] - 5) < 0.1 and places[0, 1] > 10  # north of the tent
    for frame in (1, 15, 30):
        scene.frame_set(frame)
        assert all(sees(scene.camera, corner) for corner in corners), frame

    assert bpy.ops.curecon.move_camera(kind="CRANE") == {"FINISHED"}
    places = played(scene.camera)
    assert np.all(np.diff(places[:, 2]) > 0) and np.ptp(places[:, :2], axis=0).max() < 1e-4

    assert bpy.ops.curecon.move_camera(kind="FLIGHT") == {"FINISHED"}
    places = played(scene.camera)
    for end, name in ((0, ORDER[0]), (-1, ORDER[-1])):
        np.testing.assert_allclose(places[end], bpy.data.objects[name].matrix_world.translation, atol=1e-3)
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert steps.max() < 1.5 * np.median(steps) and steps.min() > 0.3 * np.median(steps)

    # Made again, nothing is left behind of the earlier ones; the user's lens stays.
    scene.camera.data.lens = 24
    before = litter()
    for kind in ("ORBIT", "CRANE", "FLIGHT"):
        bpy.ops.curecon.move_camera(kind=kind)
    assert litter() == before and scene.camera.data.lens == 24

    # About the region box where there is one.
    bpy.ops.curecon.add_region()
    scene.curecon.region.location, scene.curecon.region.scale = (30, 0, 0), (1, 1, 1)
    bpy.context.view_layer.update()
    bpy.ops.curecon.move_camera(kind="ORBIT")
    np.testing.assert_allclose(played(scene.camera).mean(axis=0)[:2], [30, 0], atol=1e-3)

    # Land about a building that few photos show, and strays above it, are no part of the view.
    rng = np.random.default_rng(4)
    house, land, strays = (rng.uniform(-np.array(half), half, (count, 3)) for half, count in (
        ((10, 10, 5), 60_000), ((24, 24, 0.1), 6000), ((10, 10, 14), 30)))
    side = np.abs(house[:, :2]).argmax(axis=1)
    house[np.arange(len(house)), side] = 10 * np.sign(house[np.arange(len(house)), side])  # walls are thin
    places = np.concatenate([house, land, strays])
    kept = places[about_the_subject(places)]
    assert len(kept) > 0.8 * len(house) and np.abs(kept[:, 2]).max() < 6
    assert np.abs(np.percentile(kept[:, :2], [1, 99], axis=0)).max() < 12
    # A spire on it is, as thin and high as it may be, and a bird in the sky is not.
    spire, bird = (rng.uniform(low, high, (count, 3)) for low, high, count in (
        ((-0.2, -0.2, 5), (0.2, 0.2, 17), 600), ((3, 3, 9), (3.2, 3.2, 9.2), 3)))
    places = np.concatenate([places, spire, bird])
    kept = places[about_the_subject(places)]
    assert kept[:, 2].max() > 16.5 and not ((kept[:, 0] > 1) & (kept[:, 2] > 6)).any()

    # Photo after photo in order of capture, around both ends, with the photo over the scene.
    for expected in (ORDER[0], ORDER[1]):
        assert bpy.ops.curecon.look_through() == {"FINISHED"} and scene.camera.name == expected
    for expected in (ORDER[0], ORDER[-1]):
        assert bpy.ops.curecon.look_through(which="PREVIOUS") == {"FINISHED"} and scene.camera.name == expected
    assert (scene.render.resolution_x, scene.render.resolution_y) == workspace_scene.SIZE
    present.photo_opacity = 0.25
    (background,) = scene.camera.data.background_images
    assert cameras.is_overlaid(scene.camera)
    assert background.display_depth == "FRONT" and abs(background.alpha - 0.25) < 1e-6
    bpy.ops.curecon.look_through()
    assert abs(scene.camera.data.background_images[0].alpha - 0.25) < 1e-6
    chosen = bpy.data.objects[ORDER[1]]
    with bpy.context.temp_override(active_object=chosen):
        assert bpy.ops.curecon.look_through(which="SELECTED") == {"FINISHED"}
    assert scene.camera == chosen and cameras.is_overlaid(chosen)
finally:
    curecon_blender.unregister()
print("CHECKED")
