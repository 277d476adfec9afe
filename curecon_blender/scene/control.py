# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene's control points, and where they and their marks are in the world and in the photos.

`scene.curecon.control.text` holds them, so that undo takes changes back; the workspace's control.json follows it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from bpy_extras import view3d_utils
from mathutils import Matrix, Vector

from ..core.adjust import control as points
from ..core.adjust.control import CHECK, CONTROL, ControlSet, Mark
from ..core.adjust.marking import best_first, seen, to_pixels, to_rays, triangulate
from ..core.adjust.record import PointResidual
from ..core.base.reading import build, parse_json
from ..core.base.records import Lens
from . import cameras
from .frame import ADJUSTMENT_KEY, RESIDUALS_KEY, Part, parts_of, world_matrix
from .points import positions
from .workspace import clouds_of

AROUND = 40_000  # points of the clouds that are looked at for what hides a point
_written: dict[str, str] = {}  # what this session last wrote, by workspace


@lru_cache(maxsize=4)
def _parsed(text: str) -> ControlSet:
    return points.from_json(text) if text else ControlSet()


def of(scene: bpy.types.Scene) -> ControlSet:
    """The scene's points and marks; none where its text is no such thing, as in a .blend that somebody spoiled."""
    try:
        return _parsed(scene.curecon.control.text)
    except ValueError:
        return ControlSet()


def put(scene: bpy.types.Scene, control: ControlSet, folder: Path | None = None) -> None:
    """Keep other points and marks, in the workspace `folder` (default: the one that has them) and in the scene. Raises
    WorkspaceError before anything has changed."""
    properties = scene.curecon.control
    folder = Path(properties.folder) if folder is None else folder
    points.write_control(folder, control)
    _show(scene, control, folder)
    _written[str(folder)] = properties.text
    properties.changed = True


def take_up(scene: bpy.types.Scene, control: ControlSet, folder: Path) -> None:
    """Take up what a workspace keeps and its cameras are adjusted to."""
    _show(scene, control, folder)
    _written[str(folder)] = scene.curecon.control.text
    scene.curecon.control.changed = False


def _show(scene: bpy.types.Scene, control: ControlSet, folder: Path) -> None:
    properties = scene.curecon.control
    properties.text, properties.folder = points.to_json(control), str(folder)
    if [item.name for item in properties.points] != [point.name for point in control.points]:
        properties.points.clear()
        for point in control.points:
            properties.points.add().name = point.name
        properties.index = max(0, min(properties.index, len(properties.points) - 1))


def keep_up(scene: bpy.types.Scene) -> None:
    """After an undo or a redo: the workspace's file becomes what the scene says again."""
    properties = scene.curecon.control
    if properties.folder and _written.get(properties.folder, properties.text) != properties.text:
        points.write_control(Path(properties.folder), of(scene))
        _written[properties.folder] = properties.text


def active(scene: bpy.types.Scene) -> str:
    """The name of the chosen point; "" where there is none."""
    properties = scene.curecon.control
    return properties.points[properties.index].name if properties.index < len(properties.points) else ""


# ---- photos and their cameras


@dataclass(frozen=True)
class PhotoCamera:
    """A photo's camera where it stands in the scene: `pose` (3,4) is cam_from_world."""

    item: bpy.types.Object
    name: str
    lens: Lens
    size: tuple[int, int]
    pose: np.ndarray

    @property
    def file(self) -> Path:
        return Path(self.item.data[cameras.PHOTO_KEY])

    @property
    def turn(self) -> int:
        """EXIF's orientation of the file."""
        return int(self.item.data[cameras.TURN_KEY])

    def ray_of(self, direction: np.ndarray) -> np.ndarray:
        """The ray (2,) of a direction (3,) in the world; NaN behind the camera."""
        along = self.pose[:, :3] @ direction
        return np.asarray(along[:2] / along[2]) if along[2] > 0 else np.full(2, np.nan)

    def place_on(self, ray: np.ndarray) -> np.ndarray:
        """A place (3,) in the world on a ray (2,)."""
        local = np.array([*ray, 1.0]) * self.item.data.clip_start * 4
        return np.asarray(self.pose[:, :3].T @ (local - self.pose[:, 3]))


def photo_camera(item: bpy.types.Object | None) -> PhotoCamera | None:
    """A photo's camera; None for another, and for one whose lens is not known."""
    if item is None or item.type != "CAMERA" or cameras.LENS_KEY not in item.data:
        return None
    data, matrix = item.data, world_matrix(item)
    turn = cameras.BLENDER_FROM_OPENCV @ np.array(matrix.to_3x3().normalized()).T
    pose = np.column_stack([turn, -turn @ np.array(matrix.translation)])
    width, height = data[cameras.PHOTO_SIZE_KEY]
    return PhotoCamera(item, data[cameras.NAME_KEY], Lens(**dict(zip(_LENS, data[cameras.LENS_KEY], strict=True))),
                       (width, height), pose)


_LENS = tuple(Lens.__dataclass_fields__)


def photo_cameras(scene: bpy.types.Scene, names: set[str] | None = None) -> dict[str, PhotoCamera]:
    """The cameras of the scene's photos (of those with such names) whose lens is known, by the photos' names."""
    found = (photo_camera(item) for item in scene.objects if item.type == "CAMERA"
             and (names is None or item.data.get(cameras.NAME_KEY) in names))
    return {camera.name: camera for camera in found if camera is not None}


def can_mark(scene: bpy.types.Scene) -> bool:
    """Whether there is a photo to mark in."""
    return any(item.type == "CAMERA" and cameras.LENS_KEY in item.data for item in scene.objects)


# ---- where points are


def place_of(scene: bpy.types.Scene, name: str) -> np.ndarray | None:
    """Where the marks of a point put it in the world (3,); None before two photos tell."""
    key = (scene.session_uid, scene.curecon.control.text, *(
        (part.collection.session_uid, part.collection[ADJUSTMENT_KEY]) for part in parts_of(scene)))
    if _places.get("key") != key:
        _places.clear()
        _places["key"] = key
    if name not in _places:
        _places[name] = _place_of(scene, name)
    return _places[name]


_places: dict[str, Any] = {}  # by point, as long as nothing changes: the viewport asks with every drawing


def _place_of(scene: bpy.types.Scene, name: str) -> np.ndarray | None:
    marks = of(scene).marks_of(name)
    known = photo_cameras(scene, {mark.photo for mark in marks}) if len(marks) >= 2 else {}
    marks = tuple(mark for mark in marks if mark.photo in known)
    if len(marks) < 2:
        return None
    used = [known[mark.photo] for mark in marks]
    rays = np.array([to_rays(camera.lens, np.array([[mark.x, mark.y]]))[0]
                     for camera, mark in zip(used, marks, strict=True)])
    sigmas = np.array([mark.sigma / camera.lens.f for camera, mark in zip(used, marks, strict=True)])
    return triangulate(np.array([camera.pose for camera in used]), rays, sigmas)


def given_place(scene: bpy.types.Scene, name: str) -> np.ndarray | None:
    """Where its coordinates put a point in the world (3,), as well as the scene's frame knows that; else None."""
    point = of(scene).point(name)
    part = _part_on_earth(scene, local=point.system == points.LOCAL) if point is not None else None
    if point is None or part is None:
        return None
    local = points.frame_positions([point], part.reconstructed.origin)[0]
    world = part.moved @ Matrix(part.adjustment.matrix.tolist())
    return np.array(world @ Vector(local.tolist()))


def _part_on_earth(scene: bpy.types.Scene, *, local: bool) -> Part | None:
    for part in parts_of(scene):
        frame = part.reconstructed
        if frame.scale == "metres" and (frame.up == "control" if local else frame.north and frame.origin is not None):
            return part
    return None


def expected(scene: bpy.types.Scene, name: str) -> np.ndarray | None:
    """Where to look for a point in the world (3,): by its marks, else by its coordinates, else where its one mark met
    the site."""
    place = place_of(scene, name)
    if place is None:
        place = given_place(scene, name)
    return met.get(name) if place is None else place


met: dict[str, np.ndarray] = {}  # by point: where the cloud or the surface lay under its latest mark


def walk(scene: bpy.types.Scene, name: str) -> list[PhotoCamera]:
    """The photos in which a point can be marked, best first; all in order of their names where nobody knows its
    place."""
    known = photo_cameras(scene)
    place, listed = expected(scene, name), [known[photo] for photo in sorted(known)]
    if place is None or not listed:
        return listed
    order = best_first(
        np.array([camera.pose for camera in listed]), [camera.lens for camera in listed],
        np.array([camera.size for camera in listed]), place, _around(scene),
    )
    return [listed[number] for number in order]


def _around(scene: bpy.types.Scene) -> np.ndarray | None:
    """Some points (M,3) of the clouds, in the world. They are stored in random order."""
    found = []
    for item in clouds_of(scene):
        matrix = np.array(world_matrix(item))
        found.append(positions(item.data)[:AROUND].astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3])
    return np.concatenate(found) if found else None


def pixel_of(camera: PhotoCamera, place: np.ndarray) -> np.ndarray | None:
    """Where a place (3,) of the world falls in a photo: (2,) pixels; None outside."""
    ray = seen(camera.pose[None], place)[0]
    if not np.isfinite(ray).all():
        return None
    pixel = to_pixels(camera.lens, ray)[0]
    inside = ((pixel >= 0) & (pixel <= camera.size)).all()
    # Far outside, the polynomial of a lens may come back into the photo.
    return pixel if inside and np.abs(to_rays(camera.lens, pixel[None])[0] - ray[0]).max() < 1e-3 else None


def errors(scene: bpy.types.Scene, name: str) -> dict[str, float]:
    """For each photo how far the point's mark lies from where all its marks put it, in pixels."""
    place, marks = place_of(scene, name), of(scene).marks_of(name)
    if place is None:
        return {}
    known, found = photo_cameras(scene, {mark.photo for mark in marks}), {}
    for mark in marks:
        if mark.photo in known and (pixel := pixel_of(known[mark.photo], place)) is not None:
            found[mark.photo] = float(np.hypot(pixel[0] - mark.x, pixel[1] - mark.y))
    return found


# ---- in a 3D viewport that looks through a photo's camera


def pixel_under(
    region: bpy.types.Region, view: bpy.types.RegionView3D, camera: PhotoCamera, mouse: tuple[float, float]
) -> np.ndarray | None:
    """The photo's pixel (2,) under `mouse` (pixels of `region`); None outside of the photo."""
    direction = np.array(view3d_utils.region_2d_to_vector_3d(region, view, mouse))
    ray = camera.ray_of(direction)
    if not np.isfinite(ray).all():
        return None
    pixel = to_pixels(camera.lens, ray[None])[0]
    return pixel if ((pixel >= 0) & (pixel <= camera.size)).all() else None


def on_screen(
    region: bpy.types.Region, view: bpy.types.RegionView3D, camera: PhotoCamera, pixel: np.ndarray
) -> Vector | None:
    """Where a photo's pixel (2,) is in a viewport that looks through its camera."""
    ray = to_rays(camera.lens, pixel[None])[0]
    if not np.isfinite(ray).all():
        return None
    found: Vector | None = view3d_utils.location_3d_to_region_2d(region, view, Vector(camera.place_on(ray).tolist()))
    return found


def add_mark(scene: bpy.types.Scene, name: str, photo: str, pixel: tuple[float, float]) -> None:
    """Mark a point in a photo, in place of an earlier mark there. Raises WorkspaceError."""
    mark = Mark(point=name, photo=photo, x=round(pixel[0], 3), y=round(pixel[1], 3))
    put(scene, of(scene).with_marks([mark]))


def remove_mark(scene: bpy.types.Scene, name: str, photo: str) -> None:
    put(scene, of(scene).without_mark(name, photo))


def remove_point(scene: bpy.types.Scene, name: str) -> None:
    put(scene, of(scene).without_point(name))


def residuals(scene: bpy.types.Scene) -> dict[str, tuple[PointResidual, ...]]:
    """What points were off when the cameras were last adjusted, by kind: "control", "check", "left_out"."""
    found: dict[str, tuple[PointResidual, ...]] = {"control": (), "check": (), "left_out": ()}
    for part in parts_of(scene):
        for kind, told in _residuals(part.collection.get(RESIDUALS_KEY, "{}")).items():
            found[kind] = (*found.get(kind, ()), *told)
    return found


@lru_cache(maxsize=8)
def _residuals(text: str) -> dict[str, tuple[PointResidual, ...]]:
    try:
        return {kind: build(tuple[PointResidual, ...], told) for kind, told in parse_json(text).items()}
    except (AttributeError, ValueError):
        return {}


def ready(scene: bpy.types.Scene) -> tuple[int, int]:
    """How many control points and how many check points are marked in two photos or more."""
    control = of(scene)
    counts = [sum(len(control.marks_of(point.name)) >= 2 for point in control.of_role(role))
              for role in (CONTROL, CHECK)]
    return counts[0], counts[1]
