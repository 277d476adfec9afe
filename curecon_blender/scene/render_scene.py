# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A scene of our own to render from: the user's markers, view layers, colours, stereo and size neither show in it nor
change.

It holds copies of the site's objects, which share their data; it is there only while pictures are made. The scene's
own are the lamps, the world, the frame rate, and the engine and quality that its properties ask for.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from ..core.base.errors import CuReconError
from ..core.base.files import disk_errors
from ..core.base.language import Text
from ..core.present.camera_path import CameraPath
from ..core.present.marks import Facts
from . import flight, presentation, site, surface
from .surface import surfaces_of

STAGE_ROLE = "stage"
NAME = "CU-Recon Rendering"
FACTS_NODE = "Facts"
FLAG = 4.0  # what a mark adds to a part of a normal, which is never so large
SAMPLES_KEY, DENOISE_KEY = "curecon_samples", "curecon_denoise"  # on the stage: what colours are rendered with
FILTER = 1.5  # pixels: Blender's own
EEVEES = ("BLENDER_EEVEE", "BLENDER_EEVEE_NEXT")  # 4.5 has the second, 5.0 and later the first


class RenderError(CuReconError):
    """Blender cannot draw what was asked for, or drew something else."""

    kind = "render"


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
    background. One of `facts` holds in place of colours what `read_facts` reads."""

    name: str
    file: Path
    camera: str
    size: tuple[int, int]
    frames: int = 1
    clear: bool = False
    facts: bool = False


def create(scene: bpy.types.Scene) -> bpy.types.Scene:
    """A scene with the site alone, in the colours of the photos and with the quality that `scene`'s properties ask for.
    Raises RenderError, and leaves nothing behind, where Blender cannot."""
    if (earlier := find()) is not None:  # of a run that was cut off
        remove(earlier)
    engine = engine_of(scene)
    stage = bpy.data.scenes.new(NAME)
    stage[presentation.ROLE_KEY] = STAGE_ROLE
    try:
        _set_output(stage)
        _apply(stage, scene.curecon, engine)
        stage[SAMPLES_KEY] = QUALITIES[scene.curecon.present.quality].samples
        stage[DENOISE_KEY] = scene.curecon.surface_light == "SCENE"
    except BaseException:
        remove(stage)
        raise
    render, asked = stage.render, scene.render
    render.fps, render.fps_base, stage.frame_current = asked.fps, asked.fps_base, scene.frame_current
    render.threads_mode, render.threads = asked.threads_mode, asked.threads
    if hasattr(scene, "cycles"):
        stage.cycles.device = scene.cycles.device
    stage.world = scene.world
    for item in site.drawn(scene):
        _share(stage, item)
    surface.light(stage, by_scene=scene.curecon.surface_light == "SCENE")
    return stage


def engine_of(scene: bpy.types.Scene) -> str:
    """Blender's name of the engine that the scene's properties ask for. Raises RenderError where it is switched off."""
    if scene.curecon.present.engine == "EEVEE":
        known = {item.identifier for item in scene.render.bl_rna.properties["engine"].enum_items}
        return next(name for name in EEVEES if name in known)
    if not hasattr(scene, "cycles"):
        raise RenderError(
            "Cycles is switched off in this Blender.",
            remedy="Choose EEVEE under Pictures and Film, or enable Cycles Render Engine among the preferences' "
                   "add-ons.",
        )
    return "CYCLES"


def missing(scene: bpy.types.Scene) -> str:
    """Why the engine that the scene's properties ask for cannot render, in words; empty when it can."""
    try:
        engine_of(scene)
    except RenderError as error:
        return f"{error.message} {error.remedy}"
    return ""


def apply_quality(scene: bpy.types.Scene) -> str:
    """Let what the scene renders, F12's pictures too, have the engine and the quality that its properties ask for;
    returns what `missing` does."""
    if not (why := missing(scene)):
        _apply(scene, scene.curecon, engine_of(scene))
    if flight.is_move(scene.camera):
        scene.render.resolution_percentage = QUALITIES[scene.curecon.present.quality].film_percentage
    return why


def film_size(scene: bpy.types.Scene) -> tuple[int, int]:
    """Width and height in pixels of films and stills in the quality that the scene's properties ask for."""
    share = QUALITIES[scene.curecon.present.quality].film_percentage / 100
    return round(flight.FILM_SIZE[0] * share), round(flight.FILM_SIZE[1] * share)


def can_film() -> bool:
    """Whether this Blender writes films; some builds have no FFmpeg."""
    return bool(bpy.app.build_options.codec_ffmpeg)


def find() -> bpy.types.Scene | None:
    """The stage that is there, if any."""
    return next((item for item in bpy.data.scenes if item.get(presentation.ROLE_KEY) == STAGE_ROLE), None)


def remove(stage: bpy.types.Scene) -> None:
    """Take away the stage with all that only it has."""
    materials = {material for item in stage.objects for material in _own_materials(item)}
    own = {item: item.data for item in stage.objects if item.type == "CAMERA" and presentation.ROLE_KEY in item.data}
    keys = {item.animation_data.action for item in own if item.animation_data is not None}
    bpy.data.batch_remove([*stage.objects, *materials, *own.values(), *keys])
    bpy.data.scenes.remove(stage)


def _apply(scene: bpy.types.Scene, properties: bpy.types.PropertyGroup, engine: str) -> None:
    quality = QUALITIES[properties.present.quality]
    scene.render.engine = engine
    if hasattr(scene, "cycles"):  # the Cycles add-on can be switched off
        scene.cycles.samples, scene.cycles.max_bounces, scene.cycles.transparent_max_bounces = quality.samples, 4, 64
        # Photos' colours have no noise to be taken away, only detail.
        scene.cycles.use_denoising = properties.surface_light == "SCENE"
    scene.eevee.taa_render_samples = quality.samples


def _set_output(stage: bpy.types.Scene) -> None:
    render, view = stage.render, stage.view_settings
    render.use_persistent_data = True  # a film's frames share the geometry
    render.use_compositing = render.use_sequencer = False
    for setting in render.bl_rna.properties:  # else a picture tells the .blend's path, and so often who made it
        if setting.identifier.startswith("use_stamp"):
            setattr(render, setting.identifier, False)
    render.resolution_percentage = 100
    try:  # as they are on the photos: other view transforms would change them
        stage.display_settings.display_device = "sRGB"
        view.view_transform, view.look, view.exposure, view.gamma = "Standard", "None", 0, 1
    except TypeError as error:  # what the names are comes from the OpenColorIO configuration
        raise RenderError(
            "Blender's colour configuration has no display sRGB with the view Standard, which shows photos' colours as "
            "they are.", remedy="Start Blender without the environment variable OCIO.",
        ) from error


def _share(stage: bpy.types.Scene, item: bpy.types.Object) -> bpy.types.Object:
    """Link a copy of an object that shares its data into the stage, seen by every ray; its materials are copies."""
    copy = item.copy()
    copy[presentation.ROLE_KEY] = STAGE_ROLE
    copy.hide_render = copy.is_holdout = copy.is_shadow_catcher = False
    for ray in ("camera", "diffuse", "glossy", "transmission", "volume_scatter", "shadow"):
        setattr(copy, f"visible_{ray}", True)
    copy.light_linking.receiver_collection = copy.light_linking.blocker_collection = None
    stage.collection.objects.link(copy)
    if surface.is_surface(copy):
        for slot in copy.material_slots:
            material = slot.material
            slot.link = "OBJECT"
            if material is not None:
                slot.material = material.copy()
                slot.material[presentation.ROLE_KEY] = STAGE_ROLE
    return copy


def set_up(stage: bpy.types.Scene, shot: Shot) -> None:
    """Make the stage ready for a shot, whose file of an earlier run goes. Raises RenderError, WorkspaceError."""
    with disk_errors(shot.file):
        shot.file.unlink(missing_ok=True)
    render, settings = stage.render, stage.render.image_settings
    stage.camera = bpy.data.objects[shot.camera]
    render.resolution_x, render.resolution_y = shot.size
    render.film_transparent = shot.clear
    render.filepath = _literal(shot.file)
    stage.frame_start, stage.frame_end = 1, shot.frames
    film = shot.frames > 1
    _show_facts(stage, shot.facts)
    if hasattr(settings, "media_type"):  # Blender 5
        settings.media_type = "VIDEO" if film else "IMAGE"
    settings.file_format = "FFMPEG" if film else "OPEN_EXR" if shot.facts else "PNG"
    settings.color_mode = "RGBA" if shot.clear else "RGB"
    if shot.facts:
        settings.color_depth, settings.exr_codec = "32", "ZIP"
    elif film:
        encoding = render.ffmpeg
        encoding.format, encoding.codec, encoding.audio_codec = "MPEG4", "H264", "NONE"
        encoding.constant_rate_factor, encoding.gopsize = "HIGH", 12
    else:
        settings.color_depth = "8"


def spare_the_window(stage: bpy.types.Scene) -> None:
    """Leave a processor to the window, where the user has not said how many may render."""
    if stage.render.threads_mode == "AUTO":
        processors = stage.render.threads  # Blender's count, in this mode
        stage.render.threads_mode, stage.render.threads = "FIXED", max(processors - 1, 1)


def check(stage: bpy.types.Scene, shot: Shot) -> None:
    """Make sure that a shot is what was asked for: by its camera, of its size or length. Raises RenderError."""
    remedy = "Check the disk's free space and the folder's permissions, and switch off add-ons that change renders."
    if not shot.file.is_file():
        raise RenderError(Text("Blender could not write {}.", shot.file), remedy=remedy, path=shot.file)
    if stage.camera is None or stage.camera.name != shot.camera:
        raise RenderError(Text("{} was drawn by another camera.", shot.file), remedy=remedy, path=shot.file)
    if shot.facts:
        fits = True  # reading them will tell
    elif shot.frames == 1:
        found = struct.unpack(">II", shot.file.read_bytes()[16:24])
        fits = found == shot.size
    else:
        clip = bpy.data.movieclips.load(str(shot.file))
        fits = clip.frame_duration == shot.frames
        bpy.data.movieclips.remove(clip)
    if not fits:
        raise RenderError(Text("{} is of another size than was asked for.", shot.file), remedy=remedy, path=shot.file)


def add_still(
    stage: bpy.types.Scene, name: str, about: site.Box, azimuth: float, height: float, steepest: float
) -> str:
    """A camera of the stage alone that sees all of the box; returns the object's name. See flight.look_from."""
    camera = _own_camera(stage, flight.new_lens(name, about))
    place, rotation = flight.look_from(about, azimuth, height, steepest)
    camera.rotation_mode = "QUATERNION"
    camera.location, camera.rotation_quaternion = place, rotation
    return camera.name


def add_orbit(stage: bpy.types.Scene, about: site.Box, path: CameraPath) -> str:
    """A camera of the stage alone that goes along `path`; returns the object's name."""
    camera = _own_camera(stage, flight.new_lens("Turntable", about))
    flight.animate(camera, path)
    return camera.name


def add_own(stage: bpy.types.Scene, camera: bpy.types.Object) -> str:
    """The user's own camera, with its keys where it has any, in the stage; returns the object's name."""
    return _share(stage, camera).name


def add_square(
    stage: bpy.types.Scene, name: str, about: site.Box, axes: np.ndarray, size: tuple[float, float]
) -> str:
    """An orthographic camera of the stage alone that sees just the box's depth; returns the object's name.

    `axes` (3,3) are rows: right, up and out towards the viewer; `size` is the picture's width and height in scene
    units.
    """
    data = bpy.data.cameras.new(name)
    depth = float(np.abs(np.array([about.axis(i) for i in range(3)]) @ axes[2]) @ about.half) * 1.001
    data.type, data.sensor_fit, data.ortho_scale = "ORTHO", "HORIZONTAL", size[0]
    data.clip_start, data.clip_end = depth * 1e-4, 2 * depth
    camera = _own_camera(stage, data)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = axes.T, about.centre + depth * axes[2]
    camera.matrix_world = Matrix(matrix.tolist())
    return camera.name


def add_facts(stage: bpy.types.Scene) -> bool:
    """Let the surfaces be able to show what is known of them in place of their colours; False where something stands
    on the stage that is no surface, of which nothing is known."""
    items = [item for item in stage.objects if item.type in ("MESH", "POINTCLOUD")]
    if not items or not all(map(surface.is_surface, items)):
        return False
    for material in {material for item in items for material in _own_materials(item)}:
        surface.add_facts(material, FACTS_NODE, FLAG)
    return True


def read_facts(shot: Shot, pixel: float) -> Facts:
    """What a shot of facts by an orthographic camera shows, of which a pixel is `pixel` scene units wide. The file
    goes. Raises RenderError, WorkspaceError."""
    file = shot.file
    image = bpy.data.images.load(str(file))
    try:
        image.colorspace_settings.is_data = True
        across, down = image.size
        values = np.empty((down, across, 4), np.float32)
        image.pixels.foreach_get(values.ravel())
    finally:
        bpy.data.images.remove(image)
    with disk_errors(file):
        file.unlink()
    if (across, down) != shot.size:
        raise RenderError(Text("{} is of another size than was asked for.", file), path=file,
                          remedy="Switch off add-ons that change renders.")
    values = values[::-1]
    flags = np.rint(values[..., 1:3] / FLAG)
    return Facts(shown=values[..., 3] > 0.5, depth=values[..., 0] / pixel, normals=values[..., 1:3] - FLAG * flags,
                 filled=flags[..., 0] > 0, unseen=flags[..., 1] > 0)


def _show_facts(stage: bpy.types.Scene, facts: bool) -> None:
    """Let one ray through each pixel's middle find facts, or many all over it find colours."""
    nodes = [material.node_tree.nodes[FACTS_NODE] for item in stage.objects for material in _own_materials(item)
             if material.node_tree is not None and FACTS_NODE in material.node_tree.nodes]
    for node in nodes:
        node.inputs[0].default_value = float(facts)
    if not nodes:
        return
    samples = 1 if facts else stage[SAMPLES_KEY]
    stage.render.filter_size = 0.0 if facts else FILTER
    stage.eevee.taa_render_samples = samples
    if hasattr(stage, "cycles"):
        cycles = stage.cycles
        cycles.samples, cycles.use_denoising = samples, not facts and stage[DENOISE_KEY]
        cycles.pixel_filter_type, cycles.filter_width = ("BOX", 0.01) if facts else ("BLACKMAN_HARRIS", FILTER)


def show_fronts_only(stage: bpy.types.Scene) -> None:
    """Let nobody see through the surfaces' backs: a façade that no photo shows stays empty and is not the opposite one
    from within."""
    for material in {material for item in surfaces_of(stage) for material in _own_materials(item)}:
        tree = material.node_tree
        output = tree.get_output_node("ALL") if tree is not None else None
        if output is None or not output.inputs["Surface"].links:
            continue
        kinds = ("ShaderNodeMixShader", "ShaderNodeNewGeometry", "ShaderNodeBsdfTransparent")
        mix, geometry, nothing = (tree.nodes.new(kind) for kind in kinds)
        tree.links.new(geometry.outputs["Backfacing"], mix.inputs[0])
        tree.links.new(output.inputs["Surface"].links[0].from_socket, mix.inputs[1])
        tree.links.new(nothing.outputs[0], mix.inputs[2])
        tree.links.new(mix.outputs[0], output.inputs["Surface"])


def _own_materials(item: bpy.types.Object) -> set[bpy.types.Material]:
    """The materials of an object in the stage that are copies."""
    found = {slot.material for slot in item.material_slots if slot.material is not None}
    return {material for material in found if material.get(presentation.ROLE_KEY) == STAGE_ROLE}


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


def _own_camera(stage: bpy.types.Scene, data: bpy.types.Camera) -> bpy.types.Object:
    camera = bpy.data.objects.new(data.name, data)
    camera[presentation.ROLE_KEY] = data[presentation.ROLE_KEY] = STAGE_ROLE
    stage.collection.objects.link(camera)
    return camera


def _literal(file: Path) -> str:
    """A path as Blender's render settings hold it, where braces would be a template."""
    return str(file).replace("{", "{{").replace("}", "}}")
