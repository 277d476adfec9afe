# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts of a site in the scene, and the similarity that puts a part's frame right.

A part is a component's collection. The adjustment stands on it as a custom property, which undo takes back with all
else, and in the workspace, where imports find it; `keep_up` makes the file follow undo and redo.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ..core.base.reading import build, parse_json
from ..core.base.records import Component, Frame, GeoPosition
from ..core.site import adjustment as adjustments
from ..core.site.adjustment import Adjustment
from . import points, surface
from .writable import require

FRAME_KEY = "curecon_frame"  # on a part: its Frame as it was reconstructed, as JSON
SHIFT_KEY = "shift"  # on a part and its surfaces: what to add to come back to a given model's coordinates
FOLDER_KEY = "curecon_sparse"  # on a part: the folder of its frame.json
ADJUSTMENT_KEY = "curecon_adjustment"  # on a part: its Adjustment as JSON
UNITS_KEY = "curecon_units"  # on a scene that holds our parts alone: its units are ours to tell
ADJUSTED_KEY = "curecon_adjusted_scale"  # on a part and its surfaces: how much larger the adjustment made it
RESIDUALS_KEY = "curecon_residuals"  # on a part: what control and check points are off, each kind apart, as JSON
GPS_SIGMA_KEY = "curecon_gps_sigma"  # on a part: relative standard deviation of the scale that GPS gave it, if any
_written: dict[str, str] = {}  # what this session last wrote, by folder


@dataclass(frozen=True)
class Part:
    """A component in the scene."""

    collection: bpy.types.Collection

    @property
    def folder(self) -> Path:
        return Path(self.collection[FOLDER_KEY])

    @property
    def reconstructed(self) -> Frame:
        frame: Frame = build(Frame, parse_json(self.collection[FRAME_KEY]))
        return frame

    @property
    def adjustment(self) -> Adjustment:
        return adjustments.from_json(self.collection[ADJUSTMENT_KEY])

    @property
    def frame(self) -> Frame:
        """What is known of the part as it stands in the scene."""
        return adjustments.adjusted_frame(self.reconstructed, self.adjustment)

    @property
    def scale_source(self) -> str:
        """What the true scale rests on, in words; empty when the scale is unknown."""
        return adjustments.scale_source(self.reconstructed, self.adjustment)

    @property
    def scale_sigma(self) -> float | None:
        """Relative standard deviation of the scale; None when nothing tells it."""
        step = self.adjustment.of(adjustments.SCALE)
        sigma: float | None = self.collection.get(GPS_SIGMA_KEY) if step is None else step.sigma
        return sigma

    @property
    def clouds(self) -> list[bpy.types.Object]:
        return [item for item in self.collection.all_objects if item.type == "POINTCLOUD"]

    @property
    def above(self) -> np.ndarray:
        """The middle (3,) of the cameras, in the world; the origin raised when there are none."""
        centres = [world_matrix(item).translation for item in self.collection.all_objects if item.type == "CAMERA"]
        return np.mean([list(centre) for centre in centres], axis=0) if centres else np.array([0.0, 0.0, 1.0])

    @property
    def moved(self) -> Matrix:
        """world_from_frame: by how much the user has moved the part's points away from where its frame has them."""
        shown = [item for item in self.collection.all_objects if item.type == "POINTCLOUD" or surface.is_surface(item)]
        shown.sort(key=lambda item: item.hide_viewport)  # a hidden object does not follow when the user moves things
        if not shown:
            return Matrix.Identity(4)
        return world_matrix(shown[0]) @ Matrix(self.adjustment.matrix.tolist()).inverted()

    @property
    def metre(self) -> float:
        """How long a metre of its frame is in the world, in scene units; where the scale is unknown, a frame's unit."""
        return float(self.moved.median_scale)

    def local(self, place: np.ndarray) -> np.ndarray:
        """A place (3,) of the world in the part's frame as it is adjusted now."""
        return np.array(self.moved.inverted() @ Vector(place.tolist()))


def parts_of(scene: bpy.types.Scene) -> list[Part]:
    """The scene's parts, in the order of their import, largest of a workspace first."""
    return [Part(collection) for collection in scene.collection.children_recursive if FRAME_KEY in collection]


def world_matrix(item: bpy.types.Object) -> Matrix:
    """Where an object stands; after an undo Blender leaves `matrix_world` of hidden ones as it was."""
    return item.matrix_basis.copy() if item.parent is None else item.matrix_world.copy()


def part_of(context: bpy.types.Context) -> Part:
    """The part that holds the active object, else the first of a scene that has any."""
    found = parts_of(context.scene)
    active = context.active_object
    holding = [part for part in found if active is not None and active.name in part.collection.all_objects]
    return (holding or found)[0]


def part_in(scene: bpy.types.Scene, folder: str) -> Part | None:
    """The part whose frame.json lies in `folder`."""
    return next((part for part in parts_of(scene) if str(part.folder) == folder), None)


def part_at(scene: bpy.types.Scene, place: np.ndarray) -> Part:
    """The part whose points lie nearest to `place` (3,) in the world, of a scene that has any."""
    found = parts_of(scene)
    if len(found) == 1:
        return found[0]

    def distance(part: Part) -> float:
        nearest = np.inf
        for item in part.collection.all_objects:
            if item.type in {"MESH", "POINTCLOUD"} and len(places := points.positions(item.data)):
                local = np.array(world_matrix(item).inverted() @ Vector(place.tolist()), np.float32)
                gap = float(np.sqrt(((places - local) ** 2).sum(axis=1).min()))
                nearest = min(nearest, gap * world_matrix(item).median_scale)
        return nearest

    return min(found, key=distance)


def set_up(collection: bpy.types.Collection, component: Component, workspace: Path, adjustment: Adjustment) -> None:
    """Make the collection of a component just brought in a part, in the frame that its workspace keeps for it."""
    collection[FRAME_KEY] = json.dumps(asdict(component.frame))
    collection[FOLDER_KEY] = str(workspace / component.sparse)
    centres = np.array([view.centre for view in component.views]).reshape(-1, 3)
    sigma = component.frame.scale_sigma or adjustments.gps_scale_sigma(component.frame, centres)
    if sigma is not None:
        collection[GPS_SIGMA_KEY] = sigma
    _put(collection, adjustment)
    for item in list(collection.all_objects):
        _move(item, Matrix(adjustment.matrix.tolist()))


def stand(part: Part, matrix: Matrix) -> None:
    """Let a part whose frame is the world's stand elsewhere: world_from_frame, a similarity."""
    for item in list(part.collection.all_objects):
        _move(item, matrix)


def adjust(scene: bpy.types.Scene, part: Part, adjustment: Adjustment) -> None:
    """Give a part another adjustment: keep it in its workspace, then move all that is the part's.

    Everything in the part's collection moves, the region box with the first part, and the part's measured distances.
    Raises WorkspaceError or LinkedError, before anything has moved, when workspace or scene cannot be written.
    """
    require([scene, part.collection, *part.collection.all_objects])
    adjustments.write(part.folder, adjustment)
    _written[str(part.folder)] = adjustments.to_json(adjustment)
    before, moved, first = part.adjustment, part.moved, parts_of(scene)[0] == part
    step = moved @ Matrix((adjustment.matrix @ np.linalg.inv(before.matrix)).tolist()) @ moved.inverted()
    _put(part.collection, adjustment)
    items = list(part.collection.all_objects)
    properties = scene.curecon
    if first and properties.region is not None and properties.region not in items:
        items.append(properties.region)
    for item in items:
        _move(item, step)
    for measurement in properties.measurements:
        if measurement.part == str(part.folder):
            measurement.first, measurement.second = step @ measurement.first, step @ measurement.second
            measurement.spread *= step.median_scale
    show_units(scene)


def forget_position() -> None:
    """Take the geodetic position of every part, those typed for the sun and the control points out of all scenes, so
    that a .blend can be given away. The workspace keeps its own: an import brings it back. Raises LinkedError, before
    anything is forgotten, when another .blend keeps a position."""
    holders = _position_holders()
    require(holders)
    for holder in holders:
        if isinstance(holder, bpy.types.Scene):
            for name in ("latitude", "longitude"):
                holder.curecon.present.property_unset(name)
            holder.curecon.control.points.clear()
            for name in ("text", "folder"):
                holder.curecon.control.property_unset(name)
        elif FRAME_KEY in holder:
            part = Part(holder)
            holder[FRAME_KEY] = json.dumps(asdict(replace(part.reconstructed, origin=None, shift=None)))
            _put(holder, part.adjustment)
    for holder in _position_holders():  # a surface that was taken out of its part
        for field in fields(GeoPosition):
            holder.pop(f"origin_{field.name}", None)
        holder.pop(SHIFT_KEY, None)


def has_position() -> bool:
    """Whether something in the .blend knows where on Earth it is."""
    return bool(_position_holders())


def _position_holders() -> list[bpy.types.ID]:
    scenes = [scene for scene in bpy.data.scenes if scene.curecon.control.points
              or any(scene.curecon.present.is_property_set(name) for name in ("latitude", "longitude"))]
    parts = [item for item in bpy.data.collections
             if FRAME_KEY in item and (Part(item).reconstructed.origin or Part(item).reconstructed.shift)]
    return [*scenes, *parts, *(item for item in bpy.data.objects if "origin_latitude" in item or SHIFT_KEY in item)]


def claim_units(scene: bpy.types.Scene) -> None:
    """Mark a scene, in which nothing but ours stands, as one whose units we tell, unless the user has chosen some."""
    if _has_plain_units(scene):
        scene[UNITS_KEY] = True


def show_units(scene: bpy.types.Scene) -> None:
    """Let lengths read as metres, or as plain numbers where nobody measured those of some part. A scene with things of
    the user's keeps its units."""
    if UNITS_KEY not in scene or not _has_plain_units(scene):
        return
    if all(part.frame.scale == "metres" for part in parts_of(scene)):
        scene.unit_settings.system, scene.unit_settings.length_unit = "METRIC", "METERS"
    else:
        scene.unit_settings.system = "NONE"


def _has_plain_units(scene: bpy.types.Scene) -> bool:
    """Whether lengths are those of a new file, or numbers."""
    settings = scene.unit_settings
    return settings.scale_length == 1 and (settings.system == "NONE" or (
        settings.system == "METRIC" and settings.length_unit == "METERS"))


def keep_up(scene: bpy.types.Scene) -> None:
    """After an undo or a redo: what this session wrote into workspaces becomes what the scene says again."""
    for part in parts_of(scene):
        folder, text = str(part.folder), part.collection[ADJUSTMENT_KEY]
        if _written.get(folder, text) != text:
            adjustments.write(part.folder, part.adjustment)
            _written[folder] = text


def _put(collection: bpy.types.Collection, adjustment: Adjustment) -> None:
    """Write the adjustment on a part, and what is then known of its frame also on its surfaces, which keep it when they
    are exported on their own."""
    collection[ADJUSTMENT_KEY] = adjustments.to_json(adjustment)
    part = Part(collection)
    frame = part.frame
    known = {"scale": frame.scale, "scale_source": part.scale_source or None, "up": frame.up, "north": frame.north,
             "note": frame.note or None, "doubt": frame.doubt or None, "gps_residual": frame.gps_residual,
             ADJUSTED_KEY: adjustment.scale,
             SHIFT_KEY: frame.shift}
    for field in fields(GeoPosition):
        known[f"origin_{field.name}"] = None if frame.origin is None else getattr(frame.origin, field.name)
    for holder in (collection, *filter(surface.is_surface, collection.all_objects)):
        for name, value in known.items():
            if value is not None:
                holder[name] = value
            elif name in holder:
                del holder[name]


def _move(item: bpy.types.Object, step: Matrix) -> None:
    """Move an object by a similarity; what hangs on a parent comes along by itself."""
    if item.parent is not None:
        return
    moved = step @ item.matrix_basis
    if item.type != "CAMERA":
        item.matrix_world = moved
        return
    # A camera has no size: what is in world units grows instead.
    place, turn, _ = moved.decompose()
    item.matrix_world = Matrix.LocRotScale(place, turn, item.scale)
    scale = step.median_scale
    item.data.display_size *= scale
    item.data.clip_start, item.data.clip_end = item.data.clip_start * scale, item.data.clip_end * scale
