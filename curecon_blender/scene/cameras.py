# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The photos' cameras as Blender cameras, each with its undistorted photo behind it."""

from __future__ import annotations

from dataclasses import astuple
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from ..core.base.records import View

SENSOR_WIDTH = 36.0  # millimetres; only the ratio of lens to sensor matters
# On camera data: the view's name, the photo's file, its size (w, h) and EXIF orientation, and its lens.
NAME_KEY, PHOTO_KEY, PHOTO_SIZE_KEY, TURN_KEY = "curecon_name", "curecon_photo", "curecon_photo_size", "curecon_turn"
LENS_KEY = "curecon_lens"
SIZE_KEY, ASPECT_KEY = "curecon_size", "curecon_pixel_aspect"  # on camera data: pixels (w, h) and fx / fy
ONE_SIDED = 0.35  # length of the mean of the photos' ways from the site, the longest 1, from which on they have a side
CAMERAS_KEY = "curecon_cameras"  # marks the collections that hold cameras
BLENDER_FROM_OPENCV = np.diag([1.0, -1.0, -1.0])  # Blender's camera looks along -z with y up


def add(view: View, workspace: Path, collection: bpy.types.Collection, display_size: float) -> bpy.types.Object:
    """Link a camera for `view` into `collection`; through it the world falls on the photo as K, R, t say.

    `display_size` is in world units. The picture is referred to by its file, not packed; a camera whose picture is
    missing gets no background.
    """
    data = bpy.data.cameras.new(view.name)
    fx, fy, cx, cy = view.K[0, 0], view.K[1, 1], view.K[0, 2], view.K[1, 2]
    data.sensor_fit, data.sensor_width = "HORIZONTAL", SENSOR_WIDTH
    data.lens = fx * SENSOR_WIDTH / view.width
    # Both shifts are in units of the sensor's width; pixel centres at .5 make (w/2, h/2) the middle.
    data.shift_x = (view.width / 2 - cx) / view.width
    data.shift_y = (cy - view.height / 2) * (fx / fy) / view.width
    data.clip_start, data.clip_end = view.near * 0.05, view.far * 10
    data.display_size = display_size
    data[SIZE_KEY], data[ASPECT_KEY] = [view.width, view.height], fx / fy
    data[NAME_KEY], data[PHOTO_KEY] = view.name, view.original
    if view.lens is not None and view.photo_size is not None:
        data[LENS_KEY], data[PHOTO_SIZE_KEY], data[TURN_KEY] = astuple(view.lens), view.photo_size, view.photo_turn

    picture = workspace / view.image
    if picture.is_file():
        background = data.background_images.new()
        background.image = bpy.data.images.load(str(picture), check_existing=True)
        background.frame_method, background.alpha, background.display_depth = "STRETCH", 1.0, "BACK"
        data.show_background_images = True

    camera = bpy.data.objects.new(view.name, data)
    world_from_cam = np.eye(4)
    world_from_cam[:3, :3] = view.cam_from_world[:, :3].T @ BLENDER_FROM_OPENCV
    world_from_cam[:3, 3] = view.centre
    camera.matrix_world = Matrix(world_from_cam.tolist())
    collection.objects.link(camera)
    return camera


def display_size(views: tuple[View, ...]) -> float:
    """A size in world units at which neighbouring cameras do not hide each other."""
    centres = np.array([view.centre for view in views])
    if len(centres) < 2:
        return views[0].near * 0.1
    distances = np.linalg.norm(centres[:, None] - centres[None], axis=2)
    np.fill_diagonal(distances, np.inf)
    depth = float(np.median([view.near for view in views]))
    return float(np.clip(0.35 * np.median(distances.min(axis=1)), 0.005 * depth, 0.15 * depth))


def fit_render(scene: bpy.types.Scene, camera: bpy.types.Object) -> None:
    """Give the scene's renders the size and pixel aspect of the camera's photo."""
    width, height = camera.data[SIZE_KEY]
    aspect = camera.data[ASPECT_KEY]
    render = scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, height, 100
    # Blender wants both aspects at 1 or above.
    render.pixel_aspect_x, render.pixel_aspect_y = max(1.0, 1 / aspect), max(1.0, aspect)


def look_through(context: bpy.types.Context, camera: bpy.types.Object) -> None:
    """Let the scene, its renders and the 3D viewport that the user is in look through a photo's camera."""
    context.scene.camera = camera
    fit_render(context.scene, camera)
    enter_view(context)


def enter_view(context: bpy.types.Context) -> None:
    """Let the 3D viewport that the user is in look through the scene's camera, and its picture fill the viewport; one
    that does so already keeps its zoom."""
    if context.area is None or context.area.type != "VIEW_3D":
        return
    view = context.area.spaces.active.region_3d
    if view.view_perspective == "CAMERA":
        return
    view.view_perspective = "CAMERA"
    region = next(region for region in context.area.regions if region.type == "WINDOW")
    with context.temp_override(region=region):
        bpy.ops.view3d.view_center_camera()


def overlay(camera: bpy.types.Object, opacity: float) -> None:
    """Lay a camera's photo over the scene in its view: `opacity` 0 shows the scene alone, 1 the photo alone."""
    for background in camera.data.background_images:
        background.display_depth, background.alpha = "FRONT", opacity


def is_overlaid(camera: bpy.types.Object | None) -> bool:
    """Whether one who looks through a camera sees its photo over the scene."""
    return camera is not None and is_photo_camera(camera) and camera.data.show_background_images and any(
        background.display_depth == "FRONT" and background.alpha > 0 for background in camera.data.background_images)


def hides_scene(camera: bpy.types.Object | None) -> bool:
    """Whether one who looks through a camera sees its photo alone."""
    return camera is not None and is_overlaid(camera) and any(
        background.alpha >= 1 for background in camera.data.background_images)


def is_photo_camera(candidate: bpy.types.Object | None) -> bool:
    return candidate is not None and candidate.type == "CAMERA" and SIZE_KEY in candidate.data


def side(scene: bpy.types.Scene, centre: np.ndarray) -> float | None:
    """From which side of `centre` (3,) the photos were taken, in degrees clockwise from +Y; None where from all."""
    places = [item.matrix_world.translation for item in scene.objects if is_photo_camera(item)]
    away = np.array(places).reshape(-1, 3)[:, :2] - centre[:2]
    lengths = np.linalg.norm(away, axis=1)
    if not lengths.any():
        return None
    mean = (away / lengths.max()).mean(axis=0)  # those overhead tell little
    return float(np.degrees(np.arctan2(*mean)) % 360) if np.linalg.norm(mean) > ONE_SIDED else None


def show(scene: bpy.types.Scene, visible: bool) -> None:
    """Show or hide every imported camera collection of the scene in viewports."""
    for collection in scene.collection.children_recursive:
        if CAMERAS_KEY in collection:
            collection.hide_viewport = not visible
