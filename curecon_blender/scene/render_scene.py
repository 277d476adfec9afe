# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A copy of the scene to render from, so that the user's own size, output and colours stay as they are.

The copy shares the objects; it is there only while pictures are made. Engine and quality are the scene's own, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from ..core.present.camera_path import CameraPath
from . import flight, presentation, site, surface
from .surface import surfaces_of

COPY_ROLE = "stage"
NAME = "CU-Recon Rendering"
FRONT_NODES = ("CU-Recon Front", "CU-Recon Backfacing", "CU-Recon Nothing")
EEVEES = ("BLENDER_EEVEE", "BLENDER_EEVEE_NEXT")  # 4.5 has the second, 5.0 and later the first


@dataclass(frozen=True, kw_only=True)
class Quality:
    """What a quality stands for: samples a pixel, a film's share of full HD, and a sheet's pixels to the millimetre."""

    samples: int
    film_percentage: int
    sheet_pixels_per_mm: int


QUALITIES = {
    "DRAFT": Quality(samples=8, film_percentage=50, sheet_pixels_per_mm=4),
    "GOOD": Quality(samples=48, film_percentage=100, sheet_pixels_per_mm=8),
}


@dataclass(frozen=True, kw_only=True)
class Shot:
    """One render: `camera` is an object, `size` in pixels; `frames` above 1 make a film. A `clear` one has no
    background."""

    name: str
    file: Path
    camera: str
    size: tuple[int, int]
    frames: int = 1
    clear: bool = False


def create(scene: bpy.types.Scene) -> bpy.types.Scene:
    """A copy of the scene in the colours of the photos, with the quality that the scene's properties ask for."""
    if (earlier := find()) is not None:  # of a run that was cut off
        remove(earlier)
    copy = scene.copy()
    copy.name = NAME
    copy[presentation.ROLE_KEY] = COPY_ROLE
    apply_quality(copy)
    render, view = copy.render, copy.view_settings
    render.use_persistent_data = True  # a film's frames share the geometry
    render.use_compositing = render.use_sequencer = render.use_border = render.use_stamp = False
    for setting in render.bl_rna.properties:  # else a picture tells the .blend's path, and so often who made it
        if setting.identifier.startswith("use_stamp_"):
            setattr(render, setting.identifier, False)
    render.resolution_percentage, render.pixel_aspect_x, render.pixel_aspect_y = 100, 1, 1
    # As they are on the photos: other view transforms would change them.
    view.view_transform, view.look, view.exposure, view.gamma = "Standard", "None", 0, 1
    return copy


def apply_quality(scene: bpy.types.Scene) -> None:
    """Let what the scene renders, F12's pictures too, have the engine and the quality that its properties ask for."""
    present = scene.curecon.present
    quality, render = QUALITIES[present.quality], scene.render
    known = {item.identifier for item in render.bl_rna.properties["engine"].enum_items}
    render.engine = "CYCLES" if present.engine == "CYCLES" else next(name for name in EEVEES if name in known)
    if hasattr(scene, "cycles"):  # the Cycles add-on can be switched off
        scene.cycles.samples, scene.cycles.max_bounces, scene.cycles.transparent_max_bounces = quality.samples, 4, 64
        # Photos' colours have no noise to be taken away, only detail.
        scene.cycles.use_denoising = scene.curecon.surface_light == "SCENE"
    scene.eevee.taa_render_samples = quality.samples
    if flight.is_move(scene.camera):
        render.resolution_percentage = quality.film_percentage


def find() -> bpy.types.Scene | None:
    """The copy that is there, if any."""
    return next((item for item in bpy.data.scenes if item.get(presentation.ROLE_KEY) == COPY_ROLE), None)


def remove(copy: bpy.types.Scene) -> None:
    """Take away the copy, with the cameras that only it has and what it changed on the surfaces."""
    _show_both_sides(copy)
    surface.light(copy, by_scene=copy.curecon.surface_light == "SCENE")
    own = [item for item in copy.collection.objects if item.get(presentation.ROLE_KEY) == COPY_ROLE]
    for camera in own:
        bpy.data.cameras.remove(camera.data)
    bpy.data.scenes.remove(copy)


def set_up(copy: bpy.types.Scene, shot: Shot) -> None:
    """Make the copy ready for a shot."""
    render, settings = copy.render, copy.render.image_settings
    copy.camera = bpy.data.objects[shot.camera]
    render.resolution_x, render.resolution_y = shot.size
    render.film_transparent = shot.clear
    render.filepath = str(shot.file)
    copy.frame_start, copy.frame_end = 1, shot.frames
    film = shot.frames > 1
    if hasattr(settings, "media_type"):  # Blender 5
        settings.media_type = "VIDEO" if film else "IMAGE"
    settings.file_format = "FFMPEG" if film else "PNG"
    settings.color_mode = "RGBA" if shot.clear else "RGB"
    if film:
        encoding = render.ffmpeg
        encoding.format, encoding.codec, encoding.audio_codec = "MPEG4", "H264", "NONE"
        encoding.constant_rate_factor, encoding.gopsize = "HIGH", 12
    else:
        settings.color_depth = "8"


def add_still(
    copy: bpy.types.Scene, name: str, about: site.Box, azimuth: float, height: float, steepest: float
) -> str:
    """A camera of the copy alone that sees all of the box; returns the object's name. See flight.look_from."""
    camera = _own_camera(copy, flight.new_lens(name, about))
    place, rotation = flight.look_from(about, azimuth, height, steepest)
    camera.rotation_mode = "QUATERNION"
    camera.location, camera.rotation_quaternion = place, rotation
    return camera.name


def add_orbit(copy: bpy.types.Scene, about: site.Box, path: CameraPath) -> str:
    """A camera of the copy alone that goes along `path`; returns the object's name."""
    camera = _own_camera(copy, flight.new_lens("Turntable", about))
    flight.animate(camera, path)
    return camera.name


def add_square(
    copy: bpy.types.Scene, name: str, about: site.Box, axes: np.ndarray, size: tuple[float, float]
) -> str:
    """An orthographic camera of the copy alone that sees just the box's depth; returns the object's name.

    `axes` (3,3) are rows: right, up and out towards the viewer; `size` is the picture's width and height in scene
    units.
    """
    data = bpy.data.cameras.new(name)
    depth = float(np.abs(np.array([about.axis(i) for i in range(3)]) @ axes[2]) @ about.half) * 1.001
    data.type, data.sensor_fit, data.ortho_scale = "ORTHO", "HORIZONTAL", size[0]
    data.clip_start, data.clip_end = depth * 1e-4, 2 * depth
    camera = _own_camera(copy, data)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = axes.T, about.centre + depth * axes[2]
    camera.matrix_world = Matrix(matrix.tolist())
    return camera.name


def show_fronts_only(copy: bpy.types.Scene) -> None:
    """Let nobody see through the surfaces' backs until the copy is taken away: a façade that no photo shows stays empty
    and is not the opposite one from within."""
    _show_both_sides(copy)
    for tree in _trees(copy):
        output = tree.get_output_node("ALL")
        if output is None or not output.inputs["Surface"].links:
            continue
        kinds = ("ShaderNodeMixShader", "ShaderNodeNewGeometry", "ShaderNodeBsdfTransparent")
        mix, geometry, nothing = (tree.nodes.new(kind) for kind in kinds)
        for node, name in zip((mix, geometry, nothing), FRONT_NODES, strict=True):
            node.name = name
        tree.links.new(geometry.outputs["Backfacing"], mix.inputs[0])
        tree.links.new(output.inputs["Surface"].links[0].from_socket, mix.inputs[1])
        tree.links.new(nothing.outputs[0], mix.inputs[2])
        tree.links.new(mix.outputs[0], output.inputs["Surface"])


def _show_both_sides(copy: bpy.types.Scene) -> None:
    for tree in _trees(copy):
        nodes = [tree.nodes[name] for name in FRONT_NODES if name in tree.nodes]
        if len(nodes) == len(FRONT_NODES):
            shader, target = nodes[0].inputs[1].links[0].from_socket, nodes[0].outputs[0].links[0].to_socket
            tree.links.new(shader, target)
        for node in nodes:
            tree.nodes.remove(node)


def _trees(copy: bpy.types.Scene) -> list[bpy.types.NodeTree]:
    """The node trees of the surfaces' materials, each once."""
    materials = {material for item in surfaces_of(copy) for material in item.data.materials if material is not None}
    return [material.node_tree for material in materials if material.node_tree is not None]


def read_pixels(file: Path) -> np.ndarray:
    """A rendered PNG on white paper, (H,W,3) sRGB bytes, top row first."""
    image = bpy.data.images.load(str(file))
    try:
        image.alpha_mode = "STRAIGHT"
        width, height = image.size
        values = np.empty((height, width, 4), np.float32)
        image.pixels.foreach_get(values.ravel())
    finally:
        bpy.data.images.remove(image)
    alpha = values[::-1, :, 3:]
    return np.rint(255 * (values[::-1, :, :3] * alpha + 1 - alpha)).astype(np.uint8)


def _own_camera(copy: bpy.types.Scene, data: bpy.types.Camera) -> bpy.types.Object:
    camera = bpy.data.objects.new(data.name, data)
    camera[presentation.ROLE_KEY] = COPY_ROLE
    copy.collection.objects.link(camera)
    return camera
