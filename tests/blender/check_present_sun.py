# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The sun falls as on the photos' day, and is moved and taken away without litter. Argument: a folder."""

from __future__ import annotations

import sys
from datetime import UTC, datetime
from pathlib import Path

import bpy
import numpy as np
import surface_scene
import workspace_scene
from mathutils import Vector

import curecon_blender
from curecon_blender.core.present import sun
from curecon_blender.scene import backdrop, points

FOLDER = Path(sys.argv[1]) / "work"
LATITUDE, LONGITUDE = 24.5, 117.25  # of the little workspace


def tell_times(zone: str) -> None:
    workspace_scene.tell_times(FOLDER, {
        name: f"2024-09-28T10:4{minute}:00{zone}" for minute, name in enumerate(workspace_scene.PHOTOS)
    })


def lamp_direction() -> np.ndarray:
    """Unit vector (3,) towards the lamp."""
    bpy.context.view_layer.update()
    (lamp,) = (item for item in bpy.context.scene.objects if item.type == "LIGHT")
    return np.array(lamp.matrix_world.to_3x3() @ Vector((0, 0, 1)))


def ours() -> tuple[int, int, int]:
    return len(bpy.data.lights), len(bpy.data.worlds), len(bpy.data.objects)


def colour_of_ground(*, blue: bool) -> tuple[float, float, float]:
    """What a wide earthen courtyard, of `blue` shade or in the sun, gives that is half roofed with slates."""
    x, y = (values.ravel().astype(np.float32) for values in np.meshgrid(np.linspace(0, 20, 60), np.linspace(0, 20, 60)))
    roofed = x < 10
    places = np.column_stack([x, y, 8.0 * roofed]).astype(np.float32)
    colours = np.where(roofed[:, None], (0.2, 0.25, 0.4, 1), (0.1, 0.13, 0.2, 1) if blue else (0.4, 0.3, 0.2, 1))
    up = np.tile(np.float32((0, 0, 1)), (len(places), 1))
    return backdrop.ground_colour(points.CloudArrays(
        points=places, radius=np.ones(len(x), np.float32), colours=colours.astype(np.float32),
        confidence=np.ones(len(x), np.float32), views=np.ones(len(x), np.int32), normals=up,
        sigmas=np.zeros((len(x), 3), np.float32),
    ))


red, green, blue = colour_of_ground(blue=False)
assert red > green > blue > 0.2, "the ground's own colour, not the roof's"
assert np.ptp(colour_of_ground(blue=True)) < 1e-6, "shade's blue is the sky's"

curecon_blender.register()
try:
    bpy.ops.wm.read_homefile(use_empty=True)
    assert not bpy.ops.curecon.set_sun.poll() and not bpy.ops.curecon.remove_sun.poll()
    workspace_scene.write(FOLDER)
    surface_scene.write(FOLDER, textured=False)
    bpy.ops.curecon.import_workspace(directory=str(FOLDER))
    scene = bpy.context.scene
    # Against a sky and a ground of its own, in the photos' own colours; the next import leaves the user's.
    assert scene.world.name == "CU-Recon Backdrop" and scene.view_settings.view_transform == "Standard"
    scene.view_settings.view_transform = "AgX"
    before = bpy.data.worlds.new("The user's")
    scene.world = before
    try:
        bpy.ops.curecon.set_sun()
        raise AssertionError("there is no photos.json yet")
    except RuntimeError as error:
        assert "capture times are unknown" in str(error)
    bpy.ops.curecon.import_workspace(directory=str(FOLDER))
    assert scene.world == before and scene.view_settings.view_transform == "AgX"
    none = ours()

    tell_times("+08:00")
    assert bpy.ops.curecon.set_sun() == {"FINISHED"}
    expected = sun.direction(*sun.position(datetime(2024, 9, 28, 2, 42, tzinfo=UTC), LATITUDE, LONGITUDE))
    assert np.degrees(np.arccos(lamp_direction() @ expected)) < 0.1, (lamp_direction(), expected)
    assert scene.curecon.surface_light == "SCENE"
    sky = next(node for node in scene.world.node_tree.nodes if node.type == "TEX_SKY")
    azimuth = np.degrees(np.arctan2(expected[0], expected[1])) % 360
    assert abs(np.degrees(sky.sun_rotation) - azimuth) < 0.1
    assert abs(np.degrees(sky.sun_elevation) - np.degrees(np.arcsin(expected[2]))) < 0.1

    # F12 renders as Present says.
    assert (scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising) == ("CYCLES", 8, True)
    scene.curecon.present.quality, scene.curecon.present.engine = "GOOD", "EEVEE"
    assert "EEVEE" in scene.render.engine and scene.eevee.taa_render_samples == 48
    assert scene.render.resolution_percentage == 100  # of a photo's size

    # A second press moves the same lamp; what the user set on it stays. Without an offset the longitude tells the hour.
    made = ours()
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.5
    tell_times("")
    scene.curecon.present.hour_correction = 3
    assert bpy.ops.curecon.set_sun() == {"FINISHED"} and ours() == made
    later = sun.direction(*sun.position(datetime(2024, 9, 28, 5, 42, tzinfo=UTC), LATITUDE, LONGITUDE))
    assert np.degrees(np.arccos(lamp_direction() @ later)) < 0.1
    assert scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value == 0.5

    # Shadows of one sun only: the lamp goes out, an even light takes its place, and both come back.
    (lamp,) = (item for item in scene.objects if item.type == "LIGHT")
    for alone in (True, False):
        scene.curecon.present.sky_only = alone
        assert lamp.hide_render == alone
        assert scene.world.node_tree.nodes["Overcast"].inputs[1].default_value == alone

    scene.curecon.present.hour_correction = 12
    try:
        bpy.ops.curecon.set_sun()
        raise AssertionError("it is night then")
    except RuntimeError as error:
        assert "below the horizon" in str(error)

    assert bpy.ops.curecon.remove_sun() == {"FINISHED"} and ours() == none
    assert scene.world == before and scene.curecon.surface_light == "PHOTO"
finally:
    curecon_blender.unregister()
print("CHECKED")
