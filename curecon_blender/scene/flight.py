# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera moves as ordinary Blender cameras with a key on every frame."""

from __future__ import annotations

from datetime import datetime
from math import degrees

import bpy
import numpy as np

from ..core.base.errors import SurfaceError
from ..core.present import camera_path
from ..core.present.camera_path import CameraPath
from . import cameras, presentation, site, surface

LENS, SENSOR = 35.0, cameras.SENSOR_WIDTH  # millimetres
WIDE = 16 / 9  # a film's width over its height
MARGIN = 1.05  # of the distance at which the building fills the picture
FILM_SIZE = (1920, 1080)
STEEPEST = 18.0  # degrees that stills from the side look down, or no sky would be seen
CORE = 0.7  # of the box in plan: what a still must not cut off when it looks above the middle
LIFT = 2.5  # degrees at most that they look above the site's middle
FRINGE = 10.0  # per cent of the points on each side, which stills need not show whole
STILL, STILL_NAME = "STILL", "CU-Recon Still"
NAMES = {"ORBIT": "CU-Recon Orbit", "FLIGHT": "CU-Recon Flight", "CRANE": "CU-Recon Crane"}


def make(scene: bpy.types.Scene, kind: str, times: dict[str, datetime]) -> bpy.types.Object:
    """The camera of one of the moves in NAMES, in place of the one that an earlier call made; the scene looks through
    it and plays just its frames. `times` are the photos' capture times. Raises SurfaceError."""
    present = scene.curecon.present
    frames = frame_count(scene)
    about = site.box(scene)
    path = _along_photos(scene, times, frames) if kind == "FLIGHT" else around(about, kind, present, frames)
    camera = _camera(scene, kind, about)
    animate(camera, path)
    scene.camera = camera
    scene.frame_start, scene.frame_end = 1, frames
    scene.frame_set(1)
    render = scene.render
    render.resolution_x, render.resolution_y = FILM_SIZE
    render.pixel_aspect_x = render.pixel_aspect_y = 1.0
    return camera


def still(scene: bpy.types.Scene) -> bpy.types.Object:
    """A camera that stands still and sees what most of the site's points are about from the side that the photos were
    taken from, or, where they went around, one with much wall that they measured, in place of the one that an earlier
    call made; the scene looks through it. Raises SurfaceError."""
    present, about = scene.curecon.present, site.box(scene, strays=FRINGE)
    from_side = cameras.side(scene, about.centre)
    azimuth = _walled_side(scene, about, degrees(present.start_angle)) if from_side is None else from_side
    place, rotation = look_from(about, azimuth, (present.height - 0.5) * about.height, STEEPEST)
    camera = presentation.find(scene, STILL) or presentation.put(scene, STILL, new_lens(STILL_NAME, about))
    camera.rotation_mode = "QUATERNION"
    camera.location, camera.rotation_quaternion = place, rotation
    scene.camera = camera
    scene.render.resolution_x, scene.render.resolution_y = FILM_SIZE
    scene.render.pixel_aspect_x = scene.render.pixel_aspect_y = 1.0
    return camera


def _walled_side(scene: bpy.types.Scene, about: site.Box, preferred: float) -> float:
    """The azimuth from which most measured wall within the box's plan shows, or the preferred one."""
    item = site.subject(scene)
    if item is None or not surface.is_surface(item):
        return preferred
    places, normals, areas = surface.measured_faces(item)
    axes = np.array([about.axis(0), about.axis(1)])
    inside = (np.abs((places - about.centre) @ axes.T) <= about.half[:2]).all(axis=1)
    return camera_path.walled_side(places[inside], normals[inside], areas[inside], about.centre, preferred)


def frame_count(scene: bpy.types.Scene) -> int:
    """How many frames a move has at the scene's frame rate."""
    return max(2, round(scene.curecon.present.seconds * scene.render.fps / scene.render.fps_base))


def is_move(candidate: bpy.types.Object | None) -> bool:
    return candidate is not None and candidate.get(presentation.ROLE_KEY) in NAMES and frames_of(candidate) > 1


def frames_of(camera: bpy.types.Object) -> int:
    """The last frame of a move's keys; 0 when they are gone."""
    animation = camera.animation_data
    return round(animation.action.frame_range[1]) if animation is not None and animation.action is not None else 0


def in_order(scene: bpy.types.Scene, times: dict[str, datetime]) -> list[bpy.types.Object]:
    """The scene's photo cameras in order of capture; those without a time come last, by name."""
    order = {name: index for index, name in enumerate(times)}
    photos = [item for item in scene.objects if cameras.is_photo_camera(item)]
    # Blender may have added .001 to a name that another scene has, too.
    return sorted(photos, key=lambda item: (order.get(item.name, order.get(item.name[:-4], len(order))), item.name))


def look_from(
    about: site.Box, azimuth: float, height: float, steepest: float = 90.0
) -> tuple[np.ndarray, np.ndarray]:
    """A place (3,) and rotation (4,) from which the box fills a film's picture: from `azimuth` (degrees, clockwise from
    +Y), `height` above its middle in scene units, or lower, so as to look down by about `steepest` degrees at most."""
    signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    corners = (signs * about.half) @ np.array([about.axis(index) for index in range(3)])
    x, y = -np.sin(np.radians(azimuth)), -np.cos(np.radians(azimuth))  # the way that the camera looks, in plan
    axes = np.array([[y, -x, 0], [x, y, 0], [0, 0, 1]])
    height = min(height, _distance(corners @ axes.T, 0) * np.tan(np.radians(steepest)))
    away = _distance(corners @ axes.T, height)
    path = camera_path.orbit(about.centre, away, height, azimuth, 1)
    place, reach = path.places[0], float(np.hypot(away, height))
    # The site a little below the picture's middle, where it leaves room: above it then stands the sky.
    down = (place - about.centre) / reach
    up = np.array([0, 0, 1]) - down[2] * down
    core = corners * [CORE, CORE, 1]  # a building hardly reaches into the corners of the box about it
    lowest = np.min(core @ up / np.linalg.norm(up) / (reach - core @ down)) if steepest < 90 else -np.inf
    rise = np.arctan(lowest) + np.arctan(SENSOR / (2 * LENS * WIDE * MARGIN))
    target = about.centre + [0, 0, reach * np.tan(np.clip(rise, 0, np.radians(LIFT))) / np.linalg.norm(up)]
    return place, camera_path.look_at(place[None], target)[0]


def new_lens(name: str, about: site.Box) -> bpy.types.Camera:
    """A film camera's data, with clip planes for the box."""
    data = bpy.data.cameras.new(name)
    data.lens, data.sensor_fit, data.sensor_width = LENS, "HORIZONTAL", SENSOR
    data.clip_start, data.clip_end = about.radius / 1000, about.radius * 100
    return data


def around(about: site.Box, kind: str, present: bpy.types.PropertyGroup, frames: int) -> CameraPath:
    """The path of an orbit or a crane shot about the box, as the properties ask for."""
    height, start = (present.height - 0.5) * about.height, degrees(present.start_angle)
    distance = _distance(_cylinder(about), height)  # fits from every side
    if kind == "ORBIT":
        return camera_path.orbit(about.centre, distance, height, start, frames)
    low = -0.4 * about.height  # a person's view of a two-storey house
    return camera_path.crane(about.centre, distance, low, height, start, frames)


def _cylinder(about: site.Box) -> np.ndarray:
    """Points (N,3) of the upright cylinder about the box, from its middle."""
    turns, reach = np.linspace(0, 2 * np.pi, 33), float(np.hypot(*about.half[:2]))
    rim = np.stack([reach * np.cos(turns), reach * np.sin(turns)], axis=1)
    return np.concatenate([np.column_stack([rim, np.full(33, z)]) for z in (-about.half[2], about.half[2])])


def _distance(points: np.ndarray, height: float) -> float:
    """How far off in plan, along -y, points (N,3) about the middle just fit a film's picture from `height` above it."""
    room = np.array([1.0, 1 / WIDE]) * SENSOR / (2 * LENS * MARGIN)
    near = float(np.hypot(points[:, 0], points[:, 1]).max())
    far = 100 * float(np.linalg.norm(points, axis=1).max()) + abs(height)
    for _ in range(40):
        middle = (near + far) / 2
        back = np.array([0.0, -middle, height]) / np.hypot(middle, height)
        depth = np.hypot(middle, height) - points @ back
        seen = np.stack([points[:, 0], points @ np.array([0.0, -back[2], back[1]])], axis=1)
        fits = depth.min() > 0 and np.all(np.abs(seen) <= room * depth[:, None])
        near, far = (near, middle) if fits else (middle, far)
    return far


def _along_photos(scene: bpy.types.Scene, times: dict[str, datetime], frames: int) -> CameraPath:
    found = in_order(scene, times)
    places = np.array([item.matrix_world.translation for item in found]).reshape(-1, 3)
    if len(found) < 2 or np.ptp(places, axis=0).max() <= 0:
        raise SurfaceError(
            "A fly-through needs at least two photo cameras in different places.",
            remedy="Import the workspace again, or make an orbit.",
        )
    rotations = np.array([item.matrix_world.to_quaternion() for item in found])
    return camera_path.fly_through(places, rotations, frames)


def _camera(scene: bpy.types.Scene, kind: str, about: site.Box) -> bpy.types.Object:
    """The move's camera without its keys; made again, it keeps the lens that the user gave it."""
    camera = presentation.find(scene, kind)
    if camera is None:
        data = new_lens(NAMES[kind], about)
        if kind == "FLIGHT":  # what the photos held, the film holds: their lens on a sensor of the same width
            data.lens = float(np.median([item.data.lens for item in scene.objects if cameras.is_photo_camera(item)]))
        return presentation.put(scene, kind, data)
    if camera.animation_data is not None and camera.animation_data.action is not None:
        bpy.data.actions.remove(camera.animation_data.action)
    return camera


def animate(camera: bpy.types.Object, path: CameraPath) -> None:
    """Put a key of the path on every frame, from frame 1."""
    camera.rotation_mode = "QUATERNION"
    frames = np.arange(1, len(path.places) + 1)
    for name, values in (("location", path.places), ("rotation_quaternion", path.rotations)):
        setattr(camera, name, values[0])
        camera.keyframe_insert(name, frame=1)
    (strip,) = camera.animation_data.action.layers[0].strips
    for curve in strip.channelbag(camera.animation_data.action_slot).fcurves:
        values = path.places if curve.data_path == "location" else path.rotations
        keys = curve.keyframe_points
        keys.add(len(frames) - 1)  # all at once: inserted one by one they take twice as long as all else
        keys.foreach_set("co", np.column_stack([frames, values[:, curve.array_index]]).ravel())
        for key in keys:
            key.interpolation = "LINEAR"
        curve.update()
