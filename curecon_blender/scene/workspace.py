# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A finished workspace as a collection: one part a component, each with its cameras, its cloud and its surface."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Generator
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

from ..core.adjust.control import ControlSet, read_control
from ..core.adjust.record import Accuracy, read_accuracy
from ..core.base.options import DETAILS
from ..core.base.records import Component
from ..core.cloud.edits import is_stale, read_removed
from ..core.cloud.ply import read_cloud
from ..core.run.workspace import refuse_links
from ..core.site.adjustment import Adjustment
from ..core.site.adjustment import read as read_adjustment
from ..core.surface.mesh import (
    Mesh,
    detail_folder,
    filled_share,
    mesh_file,
    read_mesh,
    textured_folder,
    unseen_share,
    weak_share,
)
from ..core.views.record import read as read_components
from . import backdrop, cameras, cloud_edits, display, frame, new_file, placing, points, surface
from .writable import require

WORKSPACE_KEY = "curecon_workspace"  # on the collection: the workspace it was imported from
LONGEST_NAME = 40  # bytes of a site's name; Blender cuts all names at 63
UNPLACED_KEY = "curecon_unplaced"  # on the collection while it is built, and in no scene yet


@dataclass(frozen=True, kw_only=True)
class Imported:
    """What an import brought in. `clouds` are the PointCloud objects and `surfaces` the mesh objects, largest component
    first; `filled`, `weak` and `unseen` are the shares of the surfaces' area that no photo measured, that one
    alone measured, and whose colour none shows; `bounds` is what a view should hold."""

    collection: bpy.types.Collection
    clouds: tuple[bpy.types.Object, ...]
    surfaces: tuple[bpy.types.Object, ...]
    filled: float
    weak: float
    unseen: float
    cameras: tuple[bpy.types.Object, ...]
    parts: int
    missing_pictures: int
    stale_edits: bool  # points were taken out of an earlier cloud; this one has all of its own
    stray: tuple[str, ...]  # parts too far from the first one to stand where they belong
    cleared: bool  # the cube, camera and light of a new file made room
    bounds: points.Bounds | None

    @property
    def points(self) -> int:
        return sum(len(cloud.data.points) for cloud in self.clouds)

    @property
    def faces(self) -> int:
        return sum(len(item.data.polygons) for item in self.surfaces)

    @property
    def textured(self) -> bool:
        return any(item.data.uv_layers for item in self.surfaces)


@dataclass(frozen=True, kw_only=True)
class PartContent:
    """A component as it is read. `removed` (N,) bool are the points taken out of its cloud, None where none are."""

    component: Component
    adjustment: Adjustment
    cloud: points.CloudArrays | None
    removed: np.ndarray | None
    surface: surface.SurfaceArrays | None
    accuracy: Accuracy | None


@dataclass(frozen=True, kw_only=True)
class Content:
    """All that a workspace `folder` brings into a scene, in arrays as Blender stores them; `filled`, `weak`,
    `unseen`, `stale_edits` and `bounds` as in Imported, `ground` the linear colour of the ground."""

    folder: Path
    parts: tuple[PartContent, ...]
    filled: float
    weak: float
    unseen: float
    stale_edits: bool
    bounds: points.Bounds | None  # in the frame of the part `about`
    about: int
    ground: tuple[float, float, float]
    control: ControlSet


def read(folder: Path, detail: str = "") -> Content:
    """Read a workspace; its surface at the level `detail` (of options.DETAILS) where that was made. No bpy: it may run
    on any thread. Raises WorkspaceError."""
    folder = folder.resolve()
    refuse_links(folder)
    parts, meshes = [], []
    for component in read_components(folder):
        file = folder / component.cloud
        cloud = read_cloud(file) if file.is_file() else None
        removed = read_removed(file, len(cloud)) if cloud is not None else None
        found = _read_surface(folder, component.index, detail)
        if found is not None:
            meshes.append(found[0])
        parts.append(PartContent(
            component=component, adjustment=read_adjustment(folder / component.sparse),
            cloud=points.arrays(cloud) if cloud is not None else None,
            removed=removed[points.file_order(len(removed))] if removed is not None else None,
            surface=surface.arrays(*found) if found is not None else None,
            accuracy=read_accuracy(folder / component.sparse),
        ))
    bounds, about = _bounds(parts)
    return Content(
        folder=folder, parts=tuple(parts), filled=filled_share(meshes), weak=weak_share(meshes),
        unseen=unseen_share(meshes),
        control=read_control(folder),
        stale_edits=any(is_stale(folder / part.component.cloud) for part in parts), bounds=bounds, about=about,
        ground=next((backdrop.ground_colour(part.cloud) for part in parts if part.cloud is not None), backdrop.GREY),
    )


def build(
    content: Content, find_scene: Callable[[], bpy.types.Scene], *, pack: bool = False
) -> Generator[str, None, Imported]:
    """Make the workspace's collection, a few milliseconds of work a slice; each slice says what is being made.

    The last one puts it into the scene, in place of what an earlier import of the workspace brought; until then it
    belongs to none, and stopped or failed the import leaves nothing behind. A component comes with what has been made
    of it: a textured surface goes before a plain one, and where there is a surface its cloud is hidden. `pack` puts the
    textures into the .blend. The render size, pixel aspect and active camera follow the first photo. `find_scene` is
    asked at the start and in the last slice, since Python holds no scene over an undo; what it raises goes through.
    Raises LinkedError where another .blend keeps the scene or the earlier import.
    """
    scene = find_scene()
    require([scene, *_earlier(scene, content.folder)])
    try:
        top = bpy.data.collections.new(_name(content))
        top[WORKSPACE_KEY], top[UNPLACED_KEY] = str(content.folder), True
        for part in content.parts:
            yield from _build_part(part, content, top, pack)
        yield "Placing it in the scene"
        return _place(find_scene(), content, top)
    except BaseException:  # being closed among them
        sweep()
        raise


def import_workspace(scene: bpy.types.Scene, folder: Path, *, pack: bool = False) -> Imported:
    """Read a workspace and build it in the scene at once. Raises WorkspaceError."""
    slices = build(read(folder), lambda: scene, pack=pack)
    while True:
        try:
            next(slices)
        except StopIteration as end:
            return end.value


def sweep() -> None:
    """Remove what was built and never placed: by an import that was stopped, or by an undo to the midst of one."""
    for collection in [item for item in bpy.data.collections if UNPLACED_KEY in item]:
        _remove(None, collection)


def clouds_of(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The scene's imported clouds, largest first."""
    found = [item for item in scene.objects if item.type == "POINTCLOUD" and points.CLOUD_KEY in item.data]
    return sorted(found, key=lambda item: -len(item.data.points))


def in_workspace(
    scene: bpy.types.Scene, folder: Path, items: list[bpy.types.Object]
) -> list[bpy.types.Object]:
    """Those of the items that a workspace's collection holds."""
    tops = [top for top in scene.collection.children if top.get(WORKSPACE_KEY) == str(folder.resolve())]
    return [item for item in items if any(item.name in top.all_objects for top in tops)]


def hide(items: list[bpy.types.Object], hidden: bool) -> None:
    """Hide objects from viewports and renders, or show them."""
    for item in items:
        item.hide_viewport = item.hide_render = hidden


def _read_surface(folder: Path, index: int, detail: str) -> tuple[Mesh, list[Path], list[Path]] | None:
    """A component's surface and the pages of its texture and of its normal map: at the level of detail, or else the
    textured one, or else the plain one, whichever there is. Raises WorkspaceError."""
    levels = [detail_folder(index, detail)] if detail in DETAILS else []
    folders = [*levels, textured_folder(index)]
    for path in (*(folder / name / "mesh.ply" for name in folders), folder / mesh_file(index)):
        if path.is_file():
            mesh = read_mesh(path)
            return mesh, *surface.pictures(mesh, path)
    return None


def _bounds(parts: list[PartContent]) -> tuple[points.Bounds | None, int]:
    """What the largest part with a surface, or else with a cloud, is about, and which part that is."""
    for number, part in sorted(enumerate(parts), key=lambda found: found[1].surface is None):
        places = part.surface.mesh.vertices if part.surface is not None else None
        cloud = part.cloud.points if part.cloud is not None else places
        if cloud is not None:
            return points.bounds(points.subject_of(cloud, part.adjustment.matrix, within=places)), number
    return None, 0


def _child(parent: bpy.types.Collection, name: str) -> bpy.types.Collection:
    child = bpy.data.collections.new(name)
    parent.children.link(child)
    return child


def _site(content: Content) -> str:
    """The site's name, short enough for Blender to keep what is put after it."""
    name = content.folder.name.removesuffix("_curecon")
    return name.encode()[:LONGEST_NAME].decode(errors="ignore")


def _name(content: Content) -> str:
    return f"CU-Recon: {_site(content)}"


def _build_part(
    part: PartContent, content: Content, top: bpy.types.Collection, pack: bool
) -> Generator[str, None, None]:
    component, folder, only, site = part.component, content.folder, len(content.parts) == 1, _site(content)
    number = "" if only else f" {component.index + 1}"
    collection = top if only else _child(top, f"{site} Part{number}")
    holder = _child(collection, f"{site} Cameras{number}")
    holder[cameras.CAMERAS_KEY] = True
    size = cameras.display_size(component.views) if component.views else 1.0
    for view in component.views:
        yield "Making the cameras"
        cameras.add(view, folder, holder, size)
    if part.cloud is not None:
        item = yield from points.build(part.cloud, f"{site} Cloud{number}", collection)
        cloud_edits.attach(item, folder / component.cloud, part.removed)
        hide([item], part.surface is not None)
    if part.surface is not None:
        yield from surface.build(part.surface, f"{site} Surface{number}", collection, pack=pack)
    frame.set_up(collection, component, folder, part.adjustment)
    if part.accuracy is not None:
        collection[frame.RESIDUALS_KEY] = json.dumps({
            kind: [asdict(one) for one in getattr(part.accuracy, kind)] for kind in ("control", "check", "left_out")})


def _place(scene: bpy.types.Scene, content: Content, top: bpy.types.Collection) -> Imported:
    first = not frame.parts_of(scene)
    for collection in _earlier(scene, content.folder):
        _remove(scene, collection)
    cleared = new_file.clear(scene)
    if not scene.objects:
        frame.claim_units(scene)
    if first:  # later ones leave what the user has changed since
        backdrop.set_up(scene, content.ground)
    del top[UNPLACED_KEY]
    top[backdrop.GROUND_KEY] = content.ground
    top.name = _name(content)
    _drop_numbers(top)
    scene.collection.children.link(top)
    parts = [frame.Part(item) for item in (top, *top.children_recursive) if frame.FRAME_KEY in item]
    stray = placing.place(scene, parts)
    clouds = tuple(item for item in top.all_objects if item.type == "POINTCLOUD")
    photo_cameras = tuple(item for item in top.all_objects if item.type == "CAMERA")
    if photo_cameras:
        scene.camera = photo_cameras[0]
        cameras.fit_render(scene, photo_cameras[0])
    frame.show_units(scene)
    display.apply(scene, list(clouds))
    return Imported(
        collection=top, clouds=clouds, cameras=photo_cameras,
        surfaces=tuple(item for item in top.all_objects if surface.is_surface(item)), filled=content.filled,
        weak=content.weak, unseen=content.unseen, parts=len(content.parts),
        missing_pictures=sum(not item.data.background_images for item in photo_cameras),
        stale_edits=content.stale_edits, cleared=cleared, stray=tuple(part.collection.name for part in stray),
        bounds=_in_world(content.bounds, parts[content.about]) if content.bounds is not None else None,
    )


def _earlier(scene: bpy.types.Scene, folder: Path) -> list[bpy.types.Collection]:
    """What an earlier import of the workspace brought into the scene."""
    return [item for item in scene.collection.children if item.get(WORKSPACE_KEY) == str(folder)]


def _in_world(bounds: points.Bounds, part: frame.Part) -> points.Bounds:
    """Bounds in a part's frame as it stands in the scene."""
    corners = np.array([part.moved @ Vector(corner) for corner in product(*np.stack(bounds, axis=1).tolist())])
    return corners.min(axis=0), corners.max(axis=0)


def _drop_numbers(top: bpy.types.Collection) -> None:
    """Blender numbers a second datablock of a name, and the first one was an earlier import's, which is gone now."""
    blocks: list[bpy.types.ID] = list(top.children_recursive)
    for item in top.all_objects:
        blocks += [item, item.data]
        if surface.is_surface(item):
            blocks += [*item.data.materials, *surface.page_images(item).values()]
    for block in blocks:
        if numbered := re.fullmatch(r"(.+)\.\d{3}", block.name):
            block.name = numbered[1]  # or the next free number, where something else has that name


def _remove(scene: bpy.types.Scene | None, collection: bpy.types.Collection) -> None:
    """Remove a workspace's collection with all of ours in it; what a user put there stays in the scene."""
    for item in list(collection.all_objects):
        data = item.data
        if surface.is_surface(item):
            surface.remove(item)
            continue
        ours = cameras.is_photo_camera(item) or (item.type == "POINTCLOUD" and points.CLOUD_KEY in data)
        if not ours:
            if scene is not None and item.name not in scene.collection.objects:
                scene.collection.objects.link(item)
            continue
        bpy.data.objects.remove(item)
        if data.users:
            continue
        if isinstance(data, bpy.types.PointCloud):
            bpy.data.pointclouds.remove(data)
            continue
        photos = {background.image for background in data.background_images if background.image is not None}
        bpy.data.cameras.remove(data)
        for image in photos:
            if not image.users:
                bpy.data.images.remove(image)
    for child in list(collection.children_recursive):
        bpy.data.collections.remove(child)
    bpy.data.collections.remove(collection)
