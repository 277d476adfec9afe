# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""An imported workspace is right to the pixel, once, and survives saving. Argument: an empty folder."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
import workspace_scene
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

import curecon_blender
from curecon_blender.scene.workspace import clouds_of

FOLDER = Path(sys.argv[1])


def attribute(data: bpy.types.PointCloud, name: str, field: str, width: int) -> np.ndarray:
    values = np.empty(len(data.points) * width, np.float32)
    data.attributes[name].data.foreach_get(field, values)
    return values.reshape(-1, width)


def check_cloud(data: bpy.types.PointCloud) -> None:
    """Each stored point carries the colour, confidence and view count it was written with."""
    wanted = workspace_scene.cloud()
    positions = attribute(data, "position", "vector", 3)
    order = np.lexsort(positions.T)
    target = np.lexsort(wanted.points.T)
    assert np.array_equal(positions[order], wanted.points[target])
    colours = attribute(data, "Color", "color_srgb", 4)[order]
    assert np.abs(colours[:, :3] * 255 - wanted.colours[target]).max() < 0.51
    assert np.array_equal(attribute(data, "confidence", "value", 1)[order, 0], wanted.confidence[target])
    views = np.empty(len(data.points), np.int32)
    data.attributes["views"].data.foreach_get("value", views)
    assert np.array_equal(views[order], wanted.views[target])
    radius = attribute(data, "radius", "value", 1)
    assert 0.02 < radius.min() <= radius.max() < 0.5, (radius.min(), radius.max())
    # A prefix is a fair sample: the first tenth spreads over the whole slab.
    first = positions[: len(positions) // 10]
    assert np.all(first.max(axis=0) - first.min(axis=0) > [9, 9, 0.9])


def check_cameras() -> None:
    """The world falls on each photo as K, R, t say, within a hundredth of a pixel."""
    width, height = workspace_scene.SIZE
    scene = bpy.context.scene
    for index, name in enumerate(workspace_scene.PHOTOS):
        camera = bpy.data.objects[name]
        with bpy.context.temp_override(active_object=camera):
            assert bpy.ops.curecon.look_through(which="SELECTED") == {"FINISHED"}
        bpy.context.view_layer.update()
        calibration, cam_from_world = workspace_scene.camera(index)
        for point in workspace_scene.cloud().points[:50].astype(float):
            seen = world_to_camera_view(scene, camera, Vector(point))
            projected = calibration @ (cam_from_world[:, :3] @ point + cam_from_world[:, 3])
            pixel = np.array([seen.x * width, (1 - seen.y) * height])
            assert np.abs(pixel - projected[:2] / projected[2]).max() < 0.01, (name, pixel, projected)
            assert abs(seen.z - projected[2]) < 1e-4
        assert (scene.render.resolution_x, scene.render.resolution_y) == workspace_scene.SIZE
        picture = camera.data.background_images[0].image
        assert tuple(picture.size) == workspace_scene.SIZE, picture.filepath


def check_new_file() -> None:
    """What Blender puts into a new file makes room, unless the user has touched any of it; an undo brings it back."""
    own = {"Cube", "Camera", "Light"}
    for touch in (False, True):
        bpy.ops.wm.read_factory_settings()
        curecon_blender.register()
        bpy.data.objects["Cube"].location.x = float(touch)
        bpy.ops.ed.undo_push(message="before")
        assert bpy.ops.curecon.import_workspace(directory=str(FOLDER / "one")) == {"FINISHED"}
        bpy.ops.ed.undo_push(message="imported")
        assert own & set(bpy.data.objects.keys()) == (own if touch else set())
        assert ("Collection" in bpy.context.scene.collection.children) == touch
        bpy.ops.ed.undo()
        assert {item.name for item in bpy.context.scene.objects} == own
        assert set(bpy.context.scene.collection.children["Collection"].objects.keys()) == own
        curecon_blender.unregister()


curecon_blender.register()
try:
    workspace_scene.write(FOLDER / "one")
    for _ in range(2):  # the second import takes the first one's place
        assert bpy.ops.curecon.import_workspace(directory=str(FOLDER / "one")) == {"FINISHED"}
    assert len(bpy.data.pointclouds) == 1 and len(clouds_of(bpy.context.scene)) == 1
    assert sum(item.name in bpy.data.objects for item in bpy.data.cameras) >= 4
    check_cloud(bpy.data.pointclouds[0])
    check_cameras()
    result = bpy.context.scene.curecon.result
    assert (result.points, result.cameras) == (workspace_scene.POINTS, 4)
    collection = bpy.data.collections["CU-Recon: one"]
    assert (collection["scale"], collection["origin_latitude"]) == ("metres", 24.5)
    bpy.context.scene.curecon.show_cameras = False
    assert not bpy.data.objects[workspace_scene.PHOTOS[0]].visible_get()
    assert clouds_of(bpy.context.scene)[0].visible_get()

    blend = FOLDER / "saved.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    bpy.ops.wm.read_homefile(use_empty=True)
    assert not bpy.data.pointclouds
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    check_cloud(clouds_of(bpy.context.scene)[0].data)
    check_cameras()
    assert bpy.context.scene.curecon.result.points == workspace_scene.POINTS

    workspace_scene.write(FOLDER / "parts", parts=2, scale="unknown")
    assert bpy.ops.curecon.import_workspace(directory=str(FOLDER / "parts")) == {"FINISHED"}
    assert len(bpy.data.collections["CU-Recon: parts"].children) == 2
    assert len(clouds_of(bpy.context.scene)) == 3  # with the other workspace's
    assert bpy.context.scene.curecon.result.parts == 2
    assert bpy.context.scene.unit_settings.system == "NONE"
finally:
    curecon_blender.unregister()
check_new_file()
print("CHECKED")
