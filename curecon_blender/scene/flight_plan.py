# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A planned flight in the scene: its building comes of an object; its cameras, ways and coverage are drawn."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix

from ..core.base.errors import PlanError
from ..core.base.language import Text
from ..core.base.records import GeoPosition
from ..core.plan import coverage, site
from ..core.plan.drones import DRONES
from ..core.plan.mission import plan
from ..core.plan.records import Building, Plan
from ..core.plan.wishes import Wishes
from . import cameras, frame, points

NAME = "CU-Recon Flight Plan"
PLAN_KEY = "curecon_plan"  # marks the collection
ALONG = "Fly Along"
# On the collection while the scene looks through its camera: the scene's camera and frames of before.
_CAMERA_KEY, _FRAMES_KEY = "curecon_camera_before", "curecon_frames_before"
FEW, MANY = 2, 8  # photos, of the colours from red to green
_MOST_POINTS = 1_000_000
_FRAMES = 6  # of the camera that flies along, for each photo


def make(scene: bpy.types.Scene) -> tuple[Plan, coverage.Seen]:
    """Plan what the scene's properties ask for, and draw it in place of an earlier plan. Raises PlanError."""
    properties = scene.curecon.plan
    building, ground = building_of(scene)
    x, y, z = properties.takeoff
    wishes = Wishes(pixel=properties.pixel, forward=properties.forward / 100, side=properties.side / 100,
                    clearance=properties.clearance, ceiling=properties.ceiling, takeoff=(x, y, z - ground))
    made = plan(properties.kind, building, DRONES[properties.drone], wishes)
    parts = coverage.parts_of(building)
    seen = coverage.of_plan(made, parts)
    remove(scene)
    _draw(scene, made, parts, seen, ground)
    properties.photos, properties.batteries = made.photos, made.batteries
    properties.minutes = sum(flight.minutes for flight in made.flights)
    properties.covered, properties.said = seen.share, "\n".join(made.notes)
    return made, seen


def building_of(scene: bpy.types.Scene) -> tuple[Building, float]:
    """The building that the properties name, and the scene's height of its ground. Raises PlanError."""
    properties = scene.curecon.plan
    item = properties.building
    if item is None:
        raise PlanError("No building is chosen.", remedy="Choose a cloud, or add an outline and move it onto the "
                        "building.")
    places = _places(item)
    if len(places) < 3:
        raise PlanError(Text("{} has no shape.", item.name), remedy="Choose a cloud, a mesh or a curve.")
    court = None if properties.court is None else _places(properties.court)[:, :2]
    origin = _origin(scene, properties.position)
    if points.is_cloud(item) or len(places) > 10_000:
        return site.of_points(places, origin=origin), site.ground_of(places)
    ground = float(places[:, 2].min())
    return site.of_outline(places[:, :2], float(np.ptp(places[:, 2])), court=court, origin=origin), ground


def remove(scene: bpy.types.Scene, key: str = PLAN_KEY) -> None:
    """Take out what an earlier plan drew, or another that marks its collection with a key."""
    for collection in [item for item in scene.collection.children if key in item]:
        if _FRAMES_KEY in collection:
            _back(scene, collection)
        for item in list(collection.all_objects):
            data = item.data
            bpy.data.objects.remove(item)
            if data is not None and not data.users:
                bpy.data.batch_remove([data])
        for child in list(collection.children):
            bpy.data.collections.remove(child)
        bpy.data.collections.remove(collection)


def drawn(scene: bpy.types.Scene) -> bpy.types.Collection | None:
    """The collection of the plan that is drawn."""
    return next((item for item in scene.collection.children if PLAN_KEY in item), None)


def is_flown(scene: bpy.types.Scene) -> bool:
    """Whether the scene looks through the camera that flies along."""
    plan = drawn(scene)
    return plan is not None and _FRAMES_KEY in plan


def fly_along(scene: bpy.types.Scene) -> bool:
    """Let the scene look through the camera that flies along its plan, and play just its frames; where it does so
    already, give the scene its own camera and frames back. Returns whether it flies now. Raises PlanError."""
    plan = drawn(scene)
    camera = None if plan is None else next((item for item in plan.objects if item.name.startswith(ALONG)), None)
    if plan is None or camera is None:
        raise PlanError("No flight is drawn.", remedy="Press Plan Flight first.")
    if _FRAMES_KEY in plan:
        _back(scene, plan)
        return False
    plan[_CAMERA_KEY], plan[_FRAMES_KEY] = scene.camera, [scene.frame_start, scene.frame_end, scene.frame_current]
    scene.camera = camera
    scene.frame_start, scene.frame_end = (round(frame) for frame in camera.animation_data.action.frame_range)
    scene.frame_set(scene.frame_start)
    return True


def _back(scene: bpy.types.Scene, plan: bpy.types.Collection) -> None:
    scene.camera = plan.get(_CAMERA_KEY)
    scene.frame_start, scene.frame_end, current = plan[_FRAMES_KEY]
    scene.frame_set(current)
    plan.pop(_CAMERA_KEY, None)
    del plan[_FRAMES_KEY]


def add_outline(scene: bpy.types.Scene, place: np.ndarray, *, ring: bool) -> None:
    """A box, or a ring and its court, of a building's usual size on a place (3,), chosen as the building."""
    properties = scene.curecon.plan
    if not ring:
        properties.building, properties.court = _block(scene, "Building Outline", place, 10.0, 10.0, 4), None
        return
    properties.building = _block(scene, "Building Outline", place, 20.0, 12.0, 48)
    properties.court = _block(scene, "Court Outline", place, 11.0, 12.0, 48)


def _block(
    scene: bpy.types.Scene, name: str, place: np.ndarray, reach: float, height: float, sides: int
) -> bpy.types.Object:
    """An upright prism whose corners lie `reach` metres from its middle along x and y, drawn as wires."""
    turns = (np.arange(sides) + 0.5) / sides * 2 * np.pi
    rim = np.stack([np.cos(turns), np.sin(turns)], axis=1) * reach * (np.sqrt(2) if sides == 4 else 1)
    data = bpy.data.meshes.new(name)
    corners = [*np.c_[rim, np.zeros(sides)].tolist(), *np.c_[rim, np.full(sides, height)].tolist()]
    walls = [(n, (n + 1) % sides, sides + (n + 1) % sides, sides + n) for n in range(sides)]
    data.from_pydata(corners, [], [*walls, tuple(range(sides, 2 * sides))])
    item = bpy.data.objects.new(name, data)
    item.location = place.tolist()
    item.display_type, item.hide_render = "WIRE", True
    scene.collection.objects.link(item)
    return item


def _places(item: bpy.types.Object) -> np.ndarray:
    """Vertices or points (N,3) of an object in the world; of a curve those of its drawn line."""
    if item.type == "CURVE":
        data = item.to_mesh()
        local = points.positions(data).astype(float)
        item.to_mesh_clear()
    elif item.type in ("MESH", "POINTCLOUD"):
        local = points.positions(item.data).astype(float)
    else:
        return np.empty((0, 3))
    local = local[:: max(len(local) // _MOST_POINTS, 1)]
    matrix = np.array(item.matrix_world)
    return local @ matrix[:3, :3].T + matrix[:3, 3]


def _origin(scene: bpy.types.Scene, typed: str) -> GeoPosition | None:
    """Where the scene's origin lies: as typed, or as the scene's first site knows it. Raises PlanError."""
    if typed.strip():
        try:
            latitude, longitude = (float(part) for part in typed.replace(";", ",").split(","))
        except ValueError as error:
            raise PlanError(Text("{} is not a latitude and a longitude.", typed),
                            remedy="Type both in degrees with a comma between them: 24.6581, 117.0523.") from error
        if not (abs(latitude) <= 90 and abs(longitude) <= 180):
            raise PlanError(Text("{} is no place on Earth.", typed), remedy="Latitude comes first, then longitude.")
        return GeoPosition(latitude=latitude, longitude=longitude, altitude=None)
    for part in frame.parts_of(scene):
        found = part.reconstructed
        if found.origin is not None and found.north and part.metre == 1.0:
            return found.origin
    return None


def _draw(scene: bpy.types.Scene, made: Plan, parts: coverage.Parts, seen: coverage.Seen, ground: float) -> None:
    top = bpy.data.collections.new(NAME)
    top[PLAN_KEY] = True
    scene.collection.children.link(top)
    size = 0.03 * float(np.ptp(made.building.outline, axis=0).max())
    for leg in made.legs:
        holder = bpy.data.collections.new(leg.name)
        top.children.link(holder)
        data = _lens(made, leg.name, size)
        for n, matrix in enumerate(_matrices(leg.places + [0, 0, ground], leg.headings, leg.pitches), start=1):
            camera = bpy.data.objects.new(f"{leg.name} {n}", data)
            camera.matrix_world = Matrix(matrix.tolist())
            camera.hide_render = True
            holder.objects.link(camera)
    for n, flight in enumerate(made.flights, start=1):
        places = np.array([waypoint.place for waypoint in flight.waypoints]) + [0, 0, ground]
        curve = bpy.data.curves.new(f"Flight {n}", "CURVE")
        curve.dimensions = "3D"
        spline = curve.splines.new("POLY")
        spline.points.add(len(places) - 1)
        spline.points.foreach_set("co", np.c_[places, np.ones(len(places))].astype(np.float32).ravel())
        top.objects.link(bpy.data.objects.new(curve.name, curve))
    top.objects.link(_coverage(parts, seen, ground))
    _along(scene, made, ground, top, size)


def _along(scene: bpy.types.Scene, made: Plan, ground: float, top: bpy.types.Collection, size: float) -> None:
    """A camera with a key at each photo, that one flies along with the space bar."""
    camera = bpy.data.objects.new(ALONG, _lens(made, ALONG, size))
    top.objects.link(camera)
    camera.rotation_mode = "QUATERNION"
    frame_number, before = 1, None
    for leg in made.legs:
        for matrix in _matrices(leg.places + [0, 0, ground], leg.headings, leg.pitches):
            place, turn, _ = Matrix(matrix.tolist()).decompose()
            if before is not None:
                turn.make_compatible(before)
            camera.location, camera.rotation_quaternion, before = place, turn, turn
            camera.keyframe_insert("location", frame=frame_number)
            camera.keyframe_insert("rotation_quaternion", frame=frame_number)
            frame_number += _FRAMES


def _lens(made: Plan, name: str, size: float) -> bpy.types.Camera:
    data = bpy.data.cameras.new(name)
    data.sensor_fit, data.sensor_width = "HORIZONTAL", cameras.SENSOR_WIDTH
    data.lens = made.drone.focal_px / made.drone.picture[0] * cameras.SENSOR_WIDTH
    data.display_size = size
    return data


def _matrices(places: np.ndarray, headings: np.ndarray, pitches: np.ndarray) -> np.ndarray:
    """World matrices (N,4,4) of Blender cameras."""
    right, down, forward = coverage.axes(headings, pitches)
    found = np.tile(np.eye(4), (len(places), 1, 1))
    found[:, :3, 0], found[:, :3, 1], found[:, :3, 2], found[:, :3, 3] = right, -down, -forward, places
    return found


def _coverage(parts: coverage.Parts, seen: coverage.Seen, ground: float) -> bpy.types.Object:
    """A small square on each part of the building, from red (too few photos) by yellow to green (many)."""
    share = np.clip((seen.photos - FEW) / (MANY - FEW), 0, 1)
    colours = np.stack([np.clip(2 - 2 * share, 0, 1), np.clip(2 * share, 0, 1), np.zeros(len(share)),
                        np.ones(len(share))], axis=1)
    lifted = coverage.Parts(parts.places + [0, 0, ground] + 0.05 * parts.normals, parts.normals)
    return squares("Coverage", lifted, np.full(len(share), coverage.SPACING), colours)


def squares(name: str, parts: coverage.Parts, sides: np.ndarray, colours: np.ndarray) -> bpy.types.Object:
    """A square of a side (N,) on each part, a little smaller so that they stand apart, in colours (N,4) sRGB."""
    side = np.cross(parts.normals, np.where(np.abs(parts.normals[:, 2:]) > 0.5, [[1.0, 0, 0]], [[0, 0, 1.0]]))
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-9)
    other = np.cross(parts.normals, side)
    half = 0.42 * sides[:, None]
    square = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    corners = np.stack([parts.places + half * (a * side + b * other) for a, b in square], axis=1)
    data = bpy.data.meshes.new(name)
    data.from_pydata(corners.reshape(-1, 3).tolist(), [], np.arange(4 * len(corners)).reshape(-1, 4).tolist())
    layer = data.color_attributes.new("photos", "BYTE_COLOR", "POINT")
    layer.data.foreach_set("color_srgb", np.repeat(colours, 4, axis=0).astype(np.float32).ravel())
    item = bpy.data.objects.new(name, data)
    item.hide_render = True
    return item
