# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo's Blender half: a workspace in, a .blend with its cloud and cameras and a rendered picture out.

    python scripts/demo_scene.py WORKSPACE OUT.blend OUT.png

Needs the bpy wheel, no window and no graphics card.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import curecon_blender
from curecon_blender.core.base.errors import CuReconError
from curecon_blender.scene.points import about_the_subject
from curecon_blender.scene.workspace import Imported, import_workspace

WIDTH, HEIGHT, SAMPLES = 1280, 720, 16
ELEVATION = 32.0  # degrees above the horizon
LENS, SENSOR = 45.0, 36.0  # millimetres
BACKGROUND = (0.72, 0.78, 0.85)  # linear; a hazy sky


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("workspace", type=Path)
    parser.add_argument("blend", type=Path)
    parser.add_argument("picture", type=Path)
    arguments = parser.parse_args()
    bpy.ops.wm.read_homefile(use_empty=True)
    curecon_blender.register()
    try:
        make(arguments.workspace, arguments.blend.resolve(), arguments.picture.resolve())
    except CuReconError as error:
        print(f"{error.message} {error.remedy}", file=sys.stderr)
        sys.exit(error.exit_code)
    finally:
        curecon_blender.unregister()


def make(workspace: Path, blend: Path, picture: Path) -> None:
    """Import, light, frame, save and render. Raises WorkspaceError."""
    scene = bpy.context.scene
    imported = import_workspace(scene, workspace)
    add_light(scene)
    add_view(scene, imported)
    set_render(scene, picture)
    bpy.context.preferences.filepaths.save_version = 0  # no .blend1 beside it
    blend.parent.mkdir(parents=True, exist_ok=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    bpy.ops.file.make_paths_relative()
    bpy.ops.wm.save_mainfile()
    bpy.ops.render.render(write_still=True)
    print(f"{imported.points:,} points and {len(imported.cameras)} cameras in {blend}; picture in {picture}")


def add_light(scene: bpy.types.Scene) -> None:
    """A sun and a sky, for what the user will add: the cloud's own colours need no light."""
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    sun.data.energy, sun.data.angle = 3.0, np.radians(0.5)
    sun.rotation_euler = np.radians((40, 0, 140))
    scene.collection.objects.link(sun)
    scene.world = bpy.data.worlds.new("Sky")
    if scene.world.node_tree is None:  # before Blender 5.0 a new world has no nodes yet
        scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (*BACKGROUND, 1)


def add_view(scene: bpy.types.Scene, imported: Imported) -> None:
    """An oblique camera that holds the largest cloud, without what lies far from most of it; it becomes the active one.

    It looks from where most photos were taken, so that the recorded sides show.
    """
    positions = np.array([camera.matrix_world.translation for camera in imported.cameras])
    if imported.clouds:
        data = imported.clouds[0].data
        values = np.empty(len(data.points) * 3, np.float32)
        data.attributes["position"].data.foreach_get("vector", values)
        # Stored in random order: the first are a fair sample.
        points = values.reshape(-1, 3)[:50_000].astype(float)
        points = points[about_the_subject(points)]
    else:
        points = positions
    if not len(points):
        points = np.zeros((1, 3))
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    away = positions.mean(axis=0)[:2] - middle[:2] if len(positions) else np.zeros(2)
    spread = np.linalg.norm(positions[:, :2] - middle[:2], axis=1).mean() if len(positions) else 1.0
    if np.linalg.norm(away) < 0.2 * spread:  # photos from all around: any corner will do
        away = np.array([0.6, -0.8])
    azimuth, elevation = np.arctan2(away[1], away[0]), np.radians(ELEVATION)
    back = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    right = np.cross([0, 0, 1], back)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(back, right), back], axis=1)

    slope_x = SENSOR / LENS / 2 * 0.96  # of the frame's edge, with a margin
    slope_y = slope_x * HEIGHT / WIDTH
    for _ in range(4):  # the least distance that holds every point; then what it shows moves to the frame's middle
        seen = (points - middle) @ rotation
        reach = np.maximum(np.abs(seen[:, 0]) / slope_x, np.abs(seen[:, 1]) / slope_y)
        distance = max(float(np.max(seen[:, 2] + reach)), 1e-3)
        shown = seen[:, :2] / (distance - seen[:, 2:])
        middle += rotation[:, :2] @ ((shown.min(axis=0) + shown.max(axis=0)) / 2 * distance)
    camera = bpy.data.objects.new("Presentation", bpy.data.cameras.new("Presentation"))
    camera.data.lens, camera.data.sensor_width = LENS, SENSOR
    camera.data.clip_start, camera.data.clip_end = distance / 1000, distance * 10
    camera.matrix_world = Matrix.Translation(Vector(middle + back * distance)) @ Matrix(rotation.tolist()).to_4x4()
    scene.collection.objects.link(camera)
    scene.camera = camera


def set_render(scene: bpy.types.Scene, picture: Path) -> None:
    """Cycles on the processor, with colours as the photos have them."""
    render = scene.render
    render.engine = "CYCLES"
    render.resolution_x, render.resolution_y, render.resolution_percentage = WIDTH, HEIGHT, 100
    render.pixel_aspect_x = render.pixel_aspect_y = 1.0
    render.filepath, render.image_settings.file_format = str(picture), "PNG"
    scene.cycles.device, scene.cycles.samples, scene.cycles.use_denoising = "CPU", SAMPLES, False
    scene.view_settings.view_transform, scene.view_settings.look = "Standard", "None"


if __name__ == "__main__":
    main()
