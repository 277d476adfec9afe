# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A finished workspace as a collection: one part a component, each with its cameras, its cloud and its surface."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import bpy

from ..core import alignment, components
from ..core.cloud_edits import is_stale, read_removed
from ..core.mesh import Mesh, filled_share, mesh_file, read_mesh, textured_folder
from ..core.ply import read_cloud
from ..core.types import Frame
from . import cameras, cloud_edits, display, frame, points, surface

WORKSPACE_KEY = "curecon_workspace"  # on the collection: the workspace it was imported from


@dataclass(frozen=True, kw_only=True)
class Imported:
    """What an import brought in. `clouds` are the PointCloud objects and `surfaces` the mesh objects, largest component
    first; `filled` is the share of the surfaces' area that no photo measured."""

    collection: bpy.types.Collection
    clouds: tuple[bpy.types.Object, ...]
    surfaces: tuple[bpy.types.Object, ...]
    filled: float
    cameras: tuple[bpy.types.Object, ...]
    frame: Frame
    scale_source: str  # what the true scale rests on, in words; empty when it is unknown
    parts: int
    missing_pictures: int
    stale_edits: bool  # points were taken out of an earlier cloud; this one has all of its own

    @property
    def points(self) -> int:
        return sum(len(cloud.data.points) for cloud in self.clouds)

    @property
    def faces(self) -> int:
        return sum(len(item.data.polygons) for item in self.surfaces)

    @property
    def textured(self) -> bool:
        return any(item.data.uv_layers for item in self.surfaces)


def import_workspace(scene: bpy.types.Scene, folder: Path, *, pack: bool = False) -> Imported:
    """Bring the workspace's cameras, clouds and surfaces into the scene, in place of what an earlier import of it
    brought.

    A component comes with what has been made of it: a textured surface goes before a plain one, and where there is a
    surface its cloud is hidden. `pack` puts the textures into the .blend. The render size, pixel aspect and active
    camera follow the first photo. Everything is read before the scene is touched. Raises WorkspaceError.
    """
    folder = folder.resolve()
    parts = components.read(folder)
    clouds = [read_cloud(path) if (path := folder / part.cloud).is_file() else None for part in parts]
    taken = [read_removed(folder / part.cloud, len(cloud)) if cloud is not None else None
             for part, cloud in zip(parts, clouds, strict=True)]
    adjustments = [alignment.read(folder / part.sparse) for part in parts]
    meshes = [_read_surface(folder, part.index) for part in parts]

    _remove_earlier(scene, folder)
    name = f"CU-Recon: {folder.name.removesuffix('_curecon')}"
    top = bpy.data.collections.new(name)
    top[WORKSPACE_KEY] = str(folder)
    scene.collection.children.link(top)
    cloud_objects, surface_objects, camera_objects, missing = [], [], [], 0
    for part, cloud, removed, mesh, adjustment in zip(parts, clouds, taken, meshes, adjustments, strict=True):
        collection = top if len(parts) == 1 else _child(top, f"Part {part.index + 1}")
        holder = _child(collection, "Cameras")
        holder[cameras.CAMERAS_KEY] = True
        size = cameras.display_size(part.views) if part.views else 1.0
        for view in part.views:
            camera_objects.append(cameras.add(view, folder, holder, size))
            missing += not camera_objects[-1].data.background_images
        if cloud is not None:
            label = "Cloud" if len(parts) == 1 else f"Cloud {part.index + 1}"
            cloud_objects.append(points.add(cloud, label, collection))
            cloud_edits.attach(cloud_objects[-1], folder / part.cloud, removed)
            hide([cloud_objects[-1]], mesh is not None)
        if mesh is not None:
            label = "Surface" if len(parts) == 1 else f"Surface {part.index + 1}"
            surface_objects.append(surface.add(*mesh, label, collection, pack=pack))
        frame.set_up(collection, part, folder, adjustment)
    if camera_objects:
        scene.camera = camera_objects[0]
        cameras.fit_render(scene, camera_objects[0])
    placed = [part for part in frame.parts_of(scene) if part.collection in {top, *top.children}]
    if placed:
        frame.show(scene, placed[0].frame)
    display.apply(scene, cloud_objects)
    return Imported(
        collection=top, clouds=tuple(cloud_objects), surfaces=tuple(surface_objects), cameras=tuple(camera_objects),
        filled=filled_share(mesh for mesh, _ in filter(None, meshes)),
        frame=placed[0].frame if placed else Frame(scale="unknown", up="given"),
        scale_source=placed[0].scale_source if placed else "", parts=len(parts),
        missing_pictures=missing, stale_edits=any(is_stale(folder / part.cloud) for part in parts),
    )


def clouds_of(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The scene's imported clouds, largest first."""
    found = [item for item in scene.objects if item.type == "POINTCLOUD" and points.CLOUD_KEY in item.data]
    return sorted(found, key=lambda item: -len(item.data.points))


def hide(items: list[bpy.types.Object], hidden: bool) -> None:
    """Hide objects from viewports and renders, or show them."""
    for item in items:
        item.hide_viewport = item.hide_render = hidden


def _read_surface(folder: Path, index: int) -> tuple[Mesh, list[Path]] | None:
    """A component's surface and its texture's pages; the textured one where there is one. Raises WorkspaceError."""
    for path in (folder / textured_folder(index) / "mesh.ply", folder / mesh_file(index)):
        if path.is_file():
            mesh = read_mesh(path)
            return mesh, surface.pictures(mesh, path)
    return None


def _child(parent: bpy.types.Collection, name: str) -> bpy.types.Collection:
    child = bpy.data.collections.new(name)
    parent.children.link(child)
    return child


def _remove_earlier(scene: bpy.types.Scene, folder: Path) -> None:
    for collection in list(scene.collection.children):
        if collection.get(WORKSPACE_KEY) != str(folder):
            continue
        for item in list(collection.all_objects):
            data = item.data
            if surface.is_surface(item):
                surface.remove(item)
                continue
            ours = cameras.is_photo_camera(item) or (item.type == "POINTCLOUD" and points.CLOUD_KEY in data)
            if not ours:  # something that the user put here: keep it in the scene
                if item.name not in scene.collection.objects:
                    scene.collection.objects.link(item)
                continue
            bpy.data.objects.remove(item)
            if not data.users:
                (bpy.data.cameras if isinstance(data, bpy.types.Camera) else bpy.data.pointclouds).remove(data)
        for child in list(collection.children_recursive):
            bpy.data.collections.remove(child)
        bpy.data.collections.remove(collection)
