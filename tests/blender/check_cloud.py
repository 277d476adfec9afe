# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What is shown of a cloud in renders and in the viewport is what the settings say; points that are taken out stay out
over imports and come back. Argument: an empty folder."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
import workspace_scene
from mathutils import Euler, Matrix

import curecon_blender
from curecon_blender.core.base.rotations import from_quaternion
from curecon_blender.core.cloud.edits import read_edited_cloud, removed_file
from curecon_blender.core.cloud.ply import CloudWriter
from curecon_blender.operators.job_options import surface_options
from curecon_blender.scene import display
from curecon_blender.scene.points import positions
from curecon_blender.scene.workspace import clouds_of

FOLDER = Path(sys.argv[1])
SITE = FOLDER / "one"


def scene() -> bpy.types.Scene:
    return bpy.context.scene


def cloud() -> bpy.types.Object:
    return clouds_of(scene())[0]


def rows(places: np.ndarray) -> np.ndarray:
    return places[np.lexsort(places.T)]


def shown() -> np.ndarray:
    """The points (n,3) that the viewport draws; Geometry Nodes must keep the same."""
    item = cloud()
    bpy.context.view_layer.update()
    places = positions(item.data)
    drawn = places[display.shown(scene(), item, places)]
    evaluated = item.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    np.testing.assert_array_equal(rows(positions(evaluated)), rows(drawn))
    if len(drawn):  # deleting points loses materials, were it left at that
        names = [material.name for material in evaluated.materials if material is not None]
        assert names == ["CU-Recon Colour"], list(evaluated.materials)
    return drawn


def check_settings() -> None:
    properties = scene().curecon
    settings, everything = properties.cloud, workspace_scene.cloud()
    assert len(shown()) == workspace_scene.POINTS
    settings.min_confidence = 0.25
    assert np.array_equal(rows(shown()), rows(everything.points[everything.confidence >= 0.25]))
    settings.min_views = 5
    both = (everything.confidence >= 0.25) & (everything.views >= 5)
    assert np.array_equal(rows(shown()), rows(everything.points[both]))
    settings.min_confidence, settings.min_views = 0.0, 0
    properties.display_fraction = 25
    assert len(shown()) == workspace_scene.POINTS // 4
    properties.display_fraction, properties.point_size = 100, 2.0
    bpy.context.view_layer.update()
    evaluated = cloud().evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    radius = np.empty((2, workspace_scene.POINTS), np.float32)
    evaluated.attributes["radius"].data.foreach_get("value", radius[0])
    cloud().data.attributes["radius"].data.foreach_get("value", radius[1])
    np.testing.assert_allclose(radius[0], 2 * radius[1], rtol=1e-6)
    properties.point_size = 1.0
    normals = np.empty((workspace_scene.POINTS, 3), np.float32)
    cloud().data.attributes["normal"].data.foreach_get("vector", normals.ravel())
    assert np.array_equal(normals, np.tile([0, 0, 1], (len(normals), 1)))


def turned_region() -> np.ndarray:
    """Put the region box, 4 x 2 x 3 m and turned by 30 degrees, in the slab's middle; which points (N,) lie in it."""
    if scene().curecon.region is None:
        bpy.ops.curecon.add_region()
    scene().curecon.region.matrix_world = Matrix.LocRotScale((5, 5, 0.5), Euler((0, 0, np.radians(30))), (2, 1, 1.5))
    bpy.context.view_layer.update()
    x, y = (workspace_scene.cloud().points[:, :2] - 5).T
    cosine, sine = np.cos(np.radians(30)), np.sin(np.radians(30))
    return (np.abs(x * cosine + y * sine) <= 2) & (np.abs(y * cosine - x * sine) <= 1)


def check_region() -> None:
    everything, within = workspace_scene.cloud().points, turned_region()
    scene().curecon.cloud.only_region = True
    assert np.array_equal(rows(shown()), rows(everything[within])) and 100 < within.sum() < 300
    # The worker is told of the same box.
    told = surface_options(scene(), SITE, until="mesh")
    along = everything @ from_quaternion(told.region_turn).T
    counted = ((along >= told.region[:3]) & (along <= told.region[3:])).all(axis=1)
    assert np.array_equal(counted, within)
    # The frame tools move box and cloud as one.
    bpy.ops.curecon.frame_scale(first=(0, 0, 0), second=(10, 0, 0), length=30.0)
    bpy.ops.curecon.frame_turn(turn=77.0)
    assert np.array_equal(rows(shown()), rows(everything[within]))
    told = surface_options(scene(), SITE, until="mesh")
    along = everything @ from_quaternion(told.region_turn).T
    assert (((along >= told.region[:3]) & (along <= told.region[3:])).all(axis=1) == within).mean() > 0.999
    bpy.ops.curecon.frame_reset()
    scene().curecon.cloud.only_region = False


def check_edits() -> None:
    everything, within = workspace_scene.cloud().points, turned_region()
    before = (SITE / "cloud.ply").read_bytes()
    assert not bpy.ops.curecon.cloud_restore.poll() and not bpy.ops.curecon.cloud_delete_selected.poll()
    bpy.ops.ed.undo_push(message="all")
    assert bpy.ops.curecon.cloud_delete_region() == {"FINISHED"}
    assert np.array_equal(rows(shown()), rows(everything[~within]))
    bpy.ops.ed.undo_push(message="deleted")
    assert len(read_edited_cloud(SITE / "cloud.ply")) == (~within).sum()
    bpy.ops.ed.undo()
    assert len(shown()) == len(everything) and not removed_file(SITE / "cloud.ply").exists()
    bpy.ops.ed.redo()
    assert removed_file(SITE / "cloud.ply").exists()
    for _ in range(2):
        bpy.ops.curecon.import_workspace(directory=str(SITE))
        assert np.array_equal(rows(shown()), rows(everything[~within]))

    # What is selected in edit mode.
    with bpy.context.temp_override(active_object=cloud(), object=cloud()):
        bpy.context.view_layer.objects.active = cloud()
        bpy.ops.object.mode_set(mode="EDIT")
        bpy.ops.pointcloud.select_all(action="DESELECT")
        bpy.ops.pointcloud.select_random(probability=0.5, seed=4)
        bpy.ops.object.mode_set(mode="OBJECT")
    left = len(shown())
    assert bpy.ops.curecon.cloud_delete_selected() == {"FINISHED"}
    assert 0.4 * left < len(shown()) < 0.6 * left
    assert bpy.ops.curecon.cloud_crop() == {"FINISHED"} and len(shown()) == 0
    assert bpy.ops.curecon.cloud_restore() == {"FINISHED"} and len(shown()) == len(everything)
    assert bpy.ops.curecon.cloud_crop() == {"FINISHED"}
    assert np.array_equal(rows(shown()), rows(everything[within]))
    assert (SITE / "cloud.ply").read_bytes() == before

    # Another cloud has all of its points, and the report says so.
    with CloudWriter(SITE / "cloud.ply") as writer:
        made = workspace_scene.cloud()
        made.points[:] += 1
        writer.write(made)
    bpy.ops.curecon.import_workspace(directory=str(SITE))
    assert len(shown()) == len(everything) and len(read_edited_cloud(SITE / "cloud.ply")) == len(everything)


def check_colours() -> None:
    settings = scene().curecon.cloud
    for kind, low, high in (("HEIGHT", 1.0, 2.0), ("VIEWS", 3, 6), ("CONFIDENCE", 0, 1)):
        settings.colour_by = kind
        assert abs(settings.low - low) < 0.05 and abs(settings.high - high) < 0.05, (kind, settings.low, settings.high)
        output = cloud().data.materials[0].node_tree.nodes["Ramp"].outputs["Color"]
        assert output.links, kind
    settings.colour_by = "NORMAL"
    settings.colour_by = "PHOTO"
    assert not output.links
    assert sum(node.type == "ATTRIBUTE" for node in cloud().data.materials[0].node_tree.nodes) == 1


curecon_blender.register()
try:
    workspace_scene.write(SITE)
    bpy.ops.curecon.import_workspace(directory=str(SITE))
    check_settings()
    check_region()
    check_edits()
    check_colours()
finally:
    curecon_blender.unregister()
print("CHECKED")
