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
from ..core.base.language import Text
from ..core.site import footprint
from ..core.site.adjustment import FrameError
from . import points, surface
from .frame import ADJUSTED_KEY, Part, parts_of, world_matrix
from .surface import is_surface, surfaces_of
from .workspace import WORKSPACE_KEY, clouds_of

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
class Known:
    """What is known of the frame of what is presented: are its units metres, and what that rests on in words; how long
    such a unit is in the scene; is +Y north; its origin's (latitude, longitude) in degrees; and a sentence on all of it
    for the user."""

    metres: bool = False
    scale_source: str = ""
    metre: float = 1.0
    north: bool = False
    origin: tuple[float, float] | None = None
    note: str = ""
    doubt: str = ""  # why heights are doubtful


def subject(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """What is presented: the largest surface, or else cloud, that renders show, of those about the middle of the region
    box where there is one. Where renders show none, the largest of all."""
    shown = _shown(scene)
    region = scene.curecon.region
    about = [item for item in shown if _holds(item, region)] if region is not None else []
    return next(iter(about or shown), None)


def box(scene: bpy.types.Scene, turned_by: float = 0.0, strays: float = 0.5) -> Box:
    """The region box where one is chosen, else a box about the building along its walls; `turned_by` further radians.
    Of what lies outermost on each side, `strays` per cent are left out of it.

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
        raise SurfaceError(Text("{} is empty.", item.name), remedy="Import its workspace again.")
    direction, is_round = _direction_of(item)
    turn = turned_by + direction
    plan = footprint.turned(places[:, :2], turn)
    low, high = np.percentile(plan, [strays, 100 - strays], axis=0)
    inside = places[np.all((plan >= low) & (plan <= high), axis=1), 2]
    bottom, top = inside.min(), inside.max()  # a spire is few points, and so are eaves: neither must be cut off
    middle = footprint.turned(((low + high) / 2)[None], -turn)[0]
    return Box(
        centre=np.array([*middle, (bottom + top) / 2]), half=np.array([*(high - low) / 2, (top - bottom) / 2]),
        turn=turn, round=is_round,
    )


def known(scene: bpy.types.Scene) -> Known:
    """What is known of the frame of what is presented: its part's record, or its own where the user has taken it out of
    the part's collection."""
    item = subject(scene)
    holders = [*item.users_collection, item] if item is not None else []
    holder = next((h for h in holders if "scale" in h), None)
    if item is None or holder is None:
        return Known()
    origin = (holder["origin_latitude"], holder["origin_longitude"]) if "origin_latitude" in holder else None
    return Known(
        metres=holder["scale"] == "metres", metre=world_matrix(item).median_scale / holder.get(ADJUSTED_KEY, 1.0),
        scale_source=holder.get("scale_source", ""), north=bool(holder["north"]),
        origin=origin, note=holder.get("note", ""),
        doubt=holder.get("doubt", ""),
    )


def part(scene: bpy.types.Scene) -> Part | None:
    """The part that holds what is presented."""
    item = subject(scene)
    return next((found for found in parts_of(scene) if item is not None and item.name in found.collection.all_objects),
                None)


def workspace(scene: bpy.types.Scene) -> str:
    """The folder of the workspace that what is presented came from; of the last import where no collection tells."""
    item = subject(scene)
    found: str = next((child[WORKSPACE_KEY] for child in scene.collection.children if item is not None
                       and WORKSPACE_KEY in child and item.name in child.all_objects), scene.curecon.result.workspace)
    return found


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
            Text("Nothing level was measured in {}.", cloud.name), remedy="Level the site first, or move it by hand.")
    return lowest_wide_level(heights, level)


def drawn(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """What pictures of the site show, of what renders show: its surfaces and clouds, what else stands in its
    collections, the scene's lamps, and the ground under it."""
    held = {item for top in scene.collection.children if WORKSPACE_KEY in top for item in top.all_objects}
    seen = _drawn(scene)
    also = [item for item in scene.objects
            if (item in held or item.type == "LIGHT" or surface.is_ground(item)) and item.type != "CAMERA"
            and not item.hide_render and seen.intersection(item.users_collection)]
    return list(dict.fromkeys([*_shown(scene), *also]))


def _shown(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The surfaces, then the clouds, that renders show; all of them where renders show none."""
    found, seen = [*surfaces_of(scene), *clouds_of(scene)], _drawn(scene)
    return [item for item in found if not item.hide_render and seen.intersection(item.users_collection)] or found


def _drawn(scene: bpy.types.Scene) -> set[bpy.types.Collection]:
    """The collections that renders show."""
    found, layers = set(), [scene.view_layers[0].layer_collection]
    while layers:
        layer = layers.pop()
        if not layer.exclude and not layer.collection.hide_render:
            found.add(layer.collection)
            layers += layer.children
    return found


def _holds(item: bpy.types.Object, region: bpy.types.Object) -> bool:
    """Whether the middle of a region box lies within the bounds of a surface or a cloud."""
    middle = region.matrix_world @ Vector(np.mean([list(corner) for corner in region.bound_box], axis=0).tolist())
    inside = np.array(world_matrix(item).inverted_safe() @ middle)
    corners = np.array([list(corner) for corner in item.bound_box])
    return bool(np.all((inside >= corners.min(axis=0)) & (inside <= corners.max(axis=0))))


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
