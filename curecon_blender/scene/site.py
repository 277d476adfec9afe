# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What is presented: the building's box, and what is known of where it stands."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Vector

from ..core.base.errors import SurfaceError
from ..core.base.ground import LEVEL, lowest_wide_level
from ..core.site import footprint
from ..core.site.adjustment import FrameError
from . import points, surface
from .surface import is_surface, surfaces_of
from .workspace import clouds_of

GROUND_SAMPLE = 25_000  # points that suffice to tell where the ground is, in a step that nobody notices


@dataclass(frozen=True, kw_only=True)
class Box:
    """A box with Z up in the scene's world: `centre` (3,), `half` its half sizes (3,) in scene units along its own
    axes, which are turned by `turn` radians, anticlockwise. About a round building it has the scene's axes."""

    centre: np.ndarray
    half: np.ndarray
    turn: float
    round: bool = False

    @property
    def ground(self) -> float:
        return float(self.centre[2] - self.half[2])

    @property
    def height(self) -> float:
        return float(2 * self.half[2])

    @property
    def radius(self) -> float:
        """Of the sphere about it."""
        return float(np.linalg.norm(self.half))

    def axis(self, index: int) -> np.ndarray:
        """Unit vector (3,) of its own x, y or z in the world."""
        cos, sin = np.cos(self.turn), np.sin(self.turn)
        return np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])[index]


@dataclass(frozen=True, kw_only=True)
class Place:
    """What is known of the frame: is +Y north, and its origin's (latitude, longitude) in degrees."""

    north: bool
    origin: tuple[float, float] | None


def subject(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """The largest surface or cloud that renders show; where all are hidden, the largest of all."""
    found = [*surfaces_of(scene), *clouds_of(scene)]
    return next((item for item in found if not item.hide_render), found[0] if found else None)


def box(scene: bpy.types.Scene, turned_by: float = 0.0) -> Box:
    """The region box where one is chosen, else a box about the building along its walls; `turned_by` further radians.

    Raises SurfaceError when there is nothing to present.
    """
    region = scene.curecon.region
    if region is not None:
        return _box_of_region(region, turned_by)
    item = subject(scene)
    if item is None:
        raise SurfaceError(
            "There is nothing to present in the scene.", remedy="Reconstruct photos or import a workspace first."
        )
    places = points.subject(item)
    if not len(places):
        raise SurfaceError(f"{item.name} is empty.", remedy="Import its workspace again.")
    direction, is_round = _direction_of(item)
    turn = turned_by + direction
    plan = footprint.turned(places[:, :2], turn)
    low, high = np.percentile(plan, [0.5, 99.5], axis=0)
    inside = places[np.all((plan >= low) & (plan <= high), axis=1), 2]
    bottom, top = inside.min(), inside.max()  # a spire is few points, and so are eaves: neither must be cut off
    middle = footprint.turned(((low + high) / 2)[None], -turn)[0]
    return Box(
        centre=np.array([*middle, (bottom + top) / 2]), half=np.array([*(high - low) / 2, (top - bottom) / 2]),
        turn=turn, round=is_round,
    )


def place(scene: bpy.types.Scene) -> Place:
    """What is known of the frame of what is presented."""
    item = subject(scene)
    holders = [item, *item.users_collection] if item is not None else []
    holder = next((h for h in holders if "north" in h), None)
    if holder is None:
        return Place(north=False, origin=None)
    origin = (holder["origin_latitude"], holder["origin_longitude"]) if "origin_latitude" in holder else None
    return Place(north=bool(holder["north"]), origin=origin)


def ground(cloud: bpy.types.Object, world_from_cloud: np.ndarray) -> float:
    """Height in the world of the lowest level that spreads wide in a cloud, which stands there by a similarity (4,4).
    Raises FrameError when none does."""
    data, (slope, high) = cloud.data, (world_from_cloud[2, :3], world_from_cloud[2, 3])
    step = max(1, len(data.points) // GROUND_SAMPLE)
    places = points.positions(data)[::step]
    subject = points.about_the_subject(places)
    heights = places[subject] @ slope + high
    up = points.vectors(data, "normal")[::step][subject] @ (slope / np.linalg.norm(slope))
    level = heights[up > LEVEL]
    if not len(level):
        raise FrameError(
            f"Nothing level was measured in {cloud.name}.", remedy="Level the site first, or move it by hand.")
    return lowest_wide_level(heights, level)


def _box_of_region(region: bpy.types.Object, turned_by: float) -> Box:
    corners = np.array([region.matrix_world @ Vector(corner) for corner in region.bound_box])
    along = np.array(region.matrix_world.to_3x3().col[0])
    turn = float(np.arctan2(along[1], along[0])) + turned_by
    plan = footprint.turned(corners[:, :2], turn)
    low, high = np.array([*plan.min(axis=0), corners[:, 2].min()]), np.array([*plan.max(axis=0), corners[:, 2].max()])
    middle = (low + high) / 2
    return Box(
        centre=np.array([*footprint.turned(middle[None, :2], -turn)[0], middle[2]]), half=(high - low) / 2, turn=turn,
    )


def _direction_of(item: bpy.types.Object) -> tuple[float, bool]:
    """Of the walls of a surface or a cloud, and whether they are round; without any, of the rectangle about it."""
    if is_surface(item):
        normals, areas = surface.facing(item.data)
    else:
        normals = points.vectors(item.data, "normal")
        normals = normals[:: max(1, len(normals) // points.SUBJECT_SAMPLE)]
        areas = np.ones(len(normals), np.float32)
    walls = footprint.wall_direction(normals @ np.array(item.matrix_world.to_3x3().normalized()).T, areas)
    if walls is not None:
        return walls
    places = points.positions(item.data)
    sample = places[:: max(1, len(places) // points.SUBJECT_SAMPLE)] @ np.array(item.matrix_world.to_3x3()).T
    return footprint.rectangle_direction(sample[:, :2]), False
