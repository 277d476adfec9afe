# SPDX-License-Identifier: GPL-3.0-or-later
"""The Blender scene of the sample site: meshes, sun and sky, the camera and the renderer's settings.

The camera is a pinhole: focal length FOCAL pixels, principal point at the picture's centre.
"""

from __future__ import annotations

from collections import defaultdict
from datetime import datetime

import bpy
import numpy as np
from mathutils import Matrix
from site_clutter import add_clutter
from site_mesh import MeshBuilder
from site_plants import add_crops, add_trees
from tulou_materials import MATERIALS
from tulou_model import build_tulou
from tulou_surroundings import build_surroundings

WIDTH, HEIGHT = 1200, 900
FOCAL = 900.0
SEED = 20241116


def sun_direction(latitude: float, longitude: float, utc: datetime) -> np.ndarray:
    """Unit vector towards the sun in east, north, up (low-precision almanac, about 0.01 degrees)."""
    days = (utc - datetime(2000, 1, 1, 12)).total_seconds() / 86400
    anomaly = np.radians((357.528 + 0.9856003 * days) % 360)
    ecliptic = np.radians(280.460 + 0.9856474 * days + 1.915 * np.sin(anomaly) + 0.020 * np.sin(2 * anomaly))
    tilt = np.radians(23.439)
    ascension = np.arctan2(np.cos(tilt) * np.sin(ecliptic), np.cos(ecliptic))
    declination = np.arcsin(np.sin(tilt) * np.sin(ecliptic))
    sidereal = np.radians((280.46062 + 360.98564737 * days + longitude) % 360)
    hour, lat = sidereal - ascension, np.radians(latitude)
    east = -np.cos(declination) * np.sin(hour)
    north = np.sin(declination) * np.cos(lat) - np.cos(declination) * np.sin(lat) * np.cos(hour)
    up = np.sin(declination) * np.sin(lat) + np.cos(declination) * np.cos(lat) * np.cos(hour)
    return np.array([east, north, up])


def build_scene(towards_sun: np.ndarray) -> bpy.types.Scene:
    """Make the site's scene from nothing, lit by the sun from the direction given (east, north, up)."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    materials = {name: make() for name, make in MATERIALS.items()}
    site: dict[str, MeshBuilder] = defaultdict(MeshBuilder)
    build_tulou(site, np.random.default_rng(SEED))
    build_surroundings(site)
    rng = np.random.default_rng(SEED + 1)
    add_crops(site, rng)
    add_clutter(site, rng)
    add_trees(materials, rng)
    for name, builder in site.items():
        mesh = builder.mesh(f"site_{name}", materials[name])
        if name in ("earth", "plaster", "ground", "water"):
            mesh.shade_smooth()
        thing = bpy.data.objects.new(f"site_{name}", mesh)
        scene.collection.objects.link(thing)

    sun = bpy.data.lights.new("sun", "SUN")
    sun.energy, sun.angle, sun.color = 4.0, np.radians(0.8), (1.0, 0.93, 0.83)
    lamp = bpy.data.objects.new("sun", sun)
    rotation = np.stack(_frame(towards_sun), 1)
    lamp.matrix_world = Matrix(rotation.tolist()).to_4x4()
    scene.collection.objects.link(lamp)

    world = bpy.data.worlds.new("sky")
    world.use_nodes = True
    scene.world = world
    sky = world.node_tree.nodes.new("ShaderNodeTexSky")
    sky.sky_type, sky.sun_disc = "NISHITA", False
    sky.sun_elevation = float(np.arcsin(towards_sun[2]))
    sky.sun_rotation = float(np.arctan2(towards_sun[0], towards_sun[1]))
    background = world.node_tree.nodes["Background"]
    background.inputs["Strength"].default_value = 0.34
    world.node_tree.links.new(sky.outputs[0], background.inputs[0])

    camera = bpy.data.cameras.new("camera")
    camera.sensor_fit, camera.sensor_width = "HORIZONTAL", 36.0
    camera.lens = 36.0 * FOCAL / WIDTH
    camera.clip_start, camera.clip_end = 0.5, 3000.0
    scene.camera = bpy.data.objects.new("camera", camera)
    scene.collection.objects.link(scene.camera)
    return scene


def _frame(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A right-handed frame whose third axis is `axis`."""
    x = np.cross([0, 0, 1], axis)
    x /= np.linalg.norm(x)
    return x, np.cross(axis, x), axis


def aim(scene: bpy.types.Scene, cam_from_world: np.ndarray) -> None:
    """Put the camera at a COLMAP pose (4, 4): x right, y down, z forward."""
    world_from_cam = np.linalg.inv(cam_from_world) @ np.diag([1.0, -1.0, -1.0, 1.0])
    scene.camera.matrix_world = Matrix(world_from_cam.tolist())


def set_camera(scene: bpy.types.Scene, focal: float, width: int, height: int) -> None:
    """A pinhole of a focal length in pixels over pictures of width x height; run after setting a renderer."""
    scene.render.resolution_x, scene.render.resolution_y = width, height
    scene.camera.data.lens = 36.0 * focal / width


def set_photo_renderer(scene: bpy.types.Scene, samples: int, scale: float = 1.0) -> None:
    """Cycles on the CPU with denoising guided by albedo and normal; PNG output."""
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y = round(WIDTH * scale), round(HEIGHT * scale)
    scene.render.use_persistent_data = True
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_mode = "RGB"
    scene.view_settings.view_transform = "AgX"
    scene.view_settings.look = "AgX - Medium High Contrast"
    scene.view_settings.exposure = 0.3
    cycles = scene.cycles
    cycles.device, cycles.seed = "CPU", SEED % 1000
    cycles.samples, cycles.use_adaptive_sampling = samples, False
    cycles.max_bounces, cycles.diffuse_bounces, cycles.glossy_bounces = 1, 1, 1
    cycles.caustics_reflective = cycles.caustics_refractive = False
    cycles.use_denoising, cycles.denoiser = True, "OPENIMAGEDENOISE"
    cycles.denoising_input_passes, cycles.denoising_prefilter = "RGB_ALBEDO_NORMAL", "NONE"
    cycles.denoising_quality = "BALANCED"


def set_depth_renderer(scene: bpy.types.Scene) -> None:
    """One sample at each pixel's centre; every surface emits its z-depth in metres; the sky is 0. EXR output."""
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y = WIDTH, HEIGHT
    scene.render.use_persistent_data = True
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.render.image_settings.color_mode = "RGB"
    cycles = scene.cycles
    cycles.device, cycles.samples, cycles.use_denoising, cycles.use_adaptive_sampling = "CPU", 1, False, False
    cycles.pixel_filter_type, cycles.filter_width, cycles.max_bounces = "BOX", 0.01, 0
    cycles.use_light_tree = False
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.0
    material = bpy.data.materials.new("depth")
    material.cycles.emission_sampling = "NONE"  # millions of faces are no lamps to choose among
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    camera, emission = tree.nodes.new("ShaderNodeCameraData"), tree.nodes.new("ShaderNodeEmission")
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(camera.outputs["View Z Depth"], emission.inputs["Color"])
    tree.links.new(emission.outputs[0], output.inputs[0])
    scene.view_layers[0].material_override = material
