# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A flight planned in Blender for an outline and for a cloud, drawn, flown along and exported. Argument: an empty
folder."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import bpy
import numpy as np

import curecon_blender
from curecon_blender.core.plan import coverage, site
from curecon_blender.scene.flight_plan import NAME

FOLDER = Path(sys.argv[1])


def check_outline() -> None:
    scene, plan = bpy.context.scene, bpy.context.scene.curecon.plan
    scene.cursor.location = 5, 0, 2
    assert bpy.ops.curecon.add_outline(ring=True) == {"FINISHED"}
    assert plan.building is not None and plan.court is not None
    plan.building.scale = 1, 1, 1.25
    plan.kind, plan.pixel = "tulou", 8
    scene.cursor.location = 5, -60, 2
    assert bpy.ops.curecon.take_off_here() == {"FINISHED"}
    bpy.context.view_layer.update()
    assert bpy.ops.curecon.plan_flight() == {"FINISHED"}
    assert plan.photos > 100 and plan.covered > 0.97 and 1 <= plan.batteries <= 3
    top = bpy.data.collections[NAME]
    photos = [item for child in top.children for item in child.objects]
    assert len(photos) == plan.photos and all(item.type == "CAMERA" for item in photos)
    # What a camera of an orbit sees in its middle is the building, from outside and above the ground.
    camera = next(item for item in photos if "Orbit" in item.name)
    forward = np.array(camera.matrix_world.to_3x3()) @ [0, 0, -1]
    eye = np.array(camera.matrix_world.translation)
    assert np.linalg.norm(eye[:2] - [5, 0]) > 20 and eye[2] > 10
    assert np.dot(forward[:2], [5, 0] - eye[:2]) > 0.9 * np.linalg.norm([5, 0] - eye[:2]) * np.linalg.norm(forward[:2])
    along = top.objects["Fly Along"]
    scene.frame_set(1)
    first = np.array(photos[0].matrix_world)
    assert np.allclose(np.array(along.matrix_basis), first, atol=1e-4)
    squares = next(item for item in top.objects if item.name.startswith("Coverage"))
    assert len(squares.data.polygons) > 1000
    before = len(bpy.data.objects)
    assert bpy.ops.curecon.plan_flight() == {"FINISHED"}  # takes the earlier plan's place
    assert len(bpy.data.objects) == before and sum(item.name.startswith(NAME) for item in bpy.data.collections) == 1


def check_fly_along() -> None:
    """The scene looks through the drone's camera and plays its way, and has its own camera and frames back."""
    scene, plan = bpy.context.scene, bpy.context.scene.curecon.plan
    own = bpy.data.objects.new("Own", bpy.data.cameras.new("Own"))
    scene.collection.objects.link(own)
    scene.camera, scene.frame_start, scene.frame_end = own, 5, 77
    scene.frame_set(20)
    assert bpy.ops.curecon.fly_along() == {"FINISHED"}
    along = bpy.data.collections[NAME].objects["Fly Along"]
    assert scene.camera == along and (scene.frame_start, scene.frame_end) == (1, 6 * (plan.photos - 1) + 1)
    first = np.array(along.matrix_world.translation)
    scene.frame_set(scene.frame_end)
    assert np.linalg.norm(np.array(along.matrix_world.translation) - first) > 1
    assert bpy.ops.curecon.fly_along() == {"FINISHED"}
    assert scene.camera == own and (scene.frame_start, scene.frame_end, scene.frame_current) == (5, 77, 20)
    assert bpy.ops.curecon.fly_along() == {"FINISHED"}
    assert bpy.ops.curecon.plan_flight() == {"FINISHED"}  # a new plan gives the scene back, too
    assert scene.camera == own and scene.frame_end == 77


def check_export() -> None:
    plan = bpy.context.scene.curecon.plan
    plan.position = "24.66, 117.05"
    assert bpy.ops.curecon.export_flight(directory=str(FOLDER / "plan")) == {"FINISHED"}
    told = json.loads((FOLDER / "plan" / "plan.json").read_text())
    assert told["photos"] == plan.photos and (FOLDER / "plan" / "flight_1.kmz").is_file()
    heights = [waypoint["place"][2] for waypoint in told["waypoints"][0]]
    assert min(heights) > 5 and max(heights) < 60  # above the building's ground, which lies 2 m up in the scene


def check_refused() -> None:
    plan = bpy.context.scene.curecon.plan
    for change, said in (({"position": "117.05"}, "latitude"), ({"position": "95, 10"}, "no place"),
                         ({"position": "", "ceiling": 10}, "ceiling"), ({"ceiling": 120, "court": None}, "court")):
        for name, value in change.items():
            setattr(plan, name, value)
        try:
            bpy.ops.curecon.plan_flight()
        except RuntimeError as error:
            assert said in str(error), error
        else:
            raise AssertionError(f"not refused: {change}")
    assert bpy.data.collections[NAME].objects, "the earlier plan stays"


def check_cloud() -> None:
    """A cloud in the scene, lifted by hand, is the building and everything that stands about it."""
    rng = np.random.default_rng(1)
    ground = np.c_[rng.uniform(-40, 40, (40000, 2)), np.zeros(40000)]
    house = np.c_[rng.uniform((-10, -6), (10, 6), (20000, 2)), np.full(20000, 9.0)]
    data = bpy.data.meshes.new("Points")
    data.from_pydata(np.concatenate([ground, house]).tolist(), [], [])
    item = bpy.data.objects.new("Points", data)
    item.location.z = 100
    bpy.context.scene.collection.objects.link(item)
    plan = bpy.context.scene.curecon.plan
    plan.building, plan.court, plan.kind, plan.takeoff = item, None, "building", (0, -30, 100)
    bpy.context.view_layer.update()
    assert bpy.ops.curecon.plan_flight() == {"FINISHED"}
    top = bpy.data.collections[NAME]
    heights = [camera.location.z for child in top.children for camera in child.objects]
    places = np.array([camera.matrix_world.translation for child in top.children for camera in child.objects])
    assert places[:, 2].min() > 105 and places[:, 2].max() < 160, heights
    building = site.of_points(np.concatenate([ground, house]))
    assert len(coverage.parts_of(building).places) > 200


curecon_blender.register()
assert not bpy.ops.curecon.fly_along.poll()
check_outline()
check_fly_along()
check_export()
check_refused()
check_cloud()
curecon_blender.unregister()
print("CHECKED")
