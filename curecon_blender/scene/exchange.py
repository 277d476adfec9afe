# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The surface as GLB, OBJ or PLY for other programs, through Blender's own exporters, and the cloud as PLY."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from math import ceil, log2
from pathlib import Path
from tempfile import TemporaryDirectory

import bpy
import numpy as np
from mathutils import Matrix

from ..core.base.errors import WorkspaceError
from ..core.base.files import disk_errors
from ..core.base.language import Text
from ..core.base.reading import build
from ..core.base.records import GeoPosition
from ..core.cloud.ply import CloudWriter, read_cloud
from ..core.surface import export
from ..core.surface.export import Provenance
from . import cloud_edits, marks, placing, points, surface
from .frame import ADJUSTED_KEY, FRAME_KEY, Part, world_matrix

IMAGE_QUALITY = 90  # of JPEG and WebP in a GLB


# What a compressed GLB says in its JSON, and the exporter's switch.
COMPRESSED = {"DRACO": (b"KHR_draco_mesh_compression", "export_draco_mesh_compression_enable"),
              "MESHOPT": (b"meshopt_compression", "export_meshopt_compression_enable")}
DRACO_STEP, DRACO_LEVEL, DRACO_BITS = 0.0005, 6, (16, 30)  # metres; 0 to 10; fewest and most bits a coordinate


@dataclass(frozen=True, kw_only=True)
class Choices:
    """How to export: `form` is "GLB", "OBJ" or "PLY"; `texture` (GLB only) is "AUTO", "JPEG" or "WEBP"; `unlit` (GLB
    only) asks viewers for the photos' colours without lights of their own, `compression` (GLB only) is one of
    COMPRESSED or "NONE"."""

    form: str
    texture: str = "AUTO"
    compression: str = "NONE"
    unlit: bool = True
    position: bool = True
    licence: str = ""
    credit: str = ""


@dataclass(frozen=True, kw_only=True)
class Exported:
    files: tuple[Path, ...]
    has_position: bool
    note: str = ""  # what the format could not hold


def export_surfaces(
    context: bpy.types.Context, items: list[bpy.types.Object], path: Path, choices: Choices
) -> Exported:
    """Write the surfaces to `path` and its pictures beside it; nothing is replaced unless all went well.

    Vertices are written in the scene's axes (the site frame, Z up) and in metres, whatever the scene's unit is; GLB's
    turned to Y up as glTF wants it. Raises WorkspaceError.
    """
    if not path.parent.is_dir():
        raise WorkspaceError(
            Text("{} is not a folder.", path.parent), remedy="Choose a folder that is there.", path=path.parent
        )
    about = {item.name: _provenance(item, choices) for item in items}
    images = {name: image for item in items for name, image in surface.page_images(item).items()}
    for image in images.values():
        if image.packed_file is None and not _file_of(image).is_file():
            raise WorkspaceError(
                Text("The texture {} is missing.", _file_of(image)), path=_file_of(image),
                remedy="Import the workspace again, or run Texture again.",
            )
    note = ""
    with disk_errors(path), TemporaryDirectory(prefix=".curecon-", dir=path.parent) as scratch:
        made = Path(scratch) / path.name
        # Without lights a normal map is of no use.
        with (_only(context, items, relief=choices.form == "GLB" and not choices.unlit),
              marks.for_export(items, "CORNER" if choices.form == "GLB" else "POINT")):
            if choices.form == "GLB":
                note = _write_glb(made, items, about, choices, textured=bool(images))
            elif choices.form == "OBJ":
                _write_obj(made, about, images)
            else:
                note = _write_ply(made, about, images)
        files = sorted(Path(scratch).iterdir())
        for file in files:
            os.replace(file, path.parent / file.name)
    return Exported(
        files=tuple(path.parent / file.name for file in files), note=note,
        has_position=any(record.origin or record.shift for record in about.values()),
    )


def export_cloud(item: bpy.types.Object, path: Path, choices: Choices) -> Exported:
    """Write a cloud without the points that were taken out as PLY, as `export_surfaces` writes a surface. Raises
    WorkspaceError."""
    source = Path(item.data[cloud_edits.FILE_KEY])
    if not source.is_file() or len(item.data.points) != item.data[points.CLOUD_KEY]:
        raise WorkspaceError(
            Text("The file of {}, {}, is gone or has other points.", item.name, source), path=source,
            remedy="Import its workspace again, then export.",
        )
    with disk_errors(path):
        cloud = read_cloud(source)
        kept = np.empty(len(cloud), bool)
        kept[points.file_order(len(cloud))] = ~cloud_edits.removed(item)
        matrix = np.array(Matrix.Scale(1 / _metre_of(item), 4) @ world_matrix(item))
        turn = matrix[:3, :3] / np.cbrt(np.linalg.det(matrix[:3, :3]))
        cloud = cloud.take(kept)
        cloud = replace(cloud, points=(cloud.points @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32),
                        normals=(cloud.normals @ turn.T).astype(np.float32))
        about = _provenance(item, choices)
        with TemporaryDirectory(prefix=".curecon-", dir=path.parent) as scratch:
            made = Path(scratch) / path.name
            with CloudWriter(made) as writer:
                writer.write(cloud)
            export.comment_ply(made, about.lines())
            os.replace(made, path)
    return Exported(files=(path,), has_position=about.origin is not None)


def _write_glb(
    path: Path, items: list[bpy.types.Object], about: dict[str, Provenance], choices: Choices, *, textured: bool
) -> str:
    """Returns what this Blender could not do, in words."""
    mark, switch = COMPRESSED.get(choices.compression, (b"", ""))
    known = bpy.ops.export_scene.gltf.get_rna_type().properties if switch else ()
    # In steps of half a millimetre, and of a sixteenth of a pixel of a large page: the exporter's own are coarser.
    extent = max(max(item.dimensions) for item in items) / _metre_of(items[0])
    bits = min(max(ceil(log2(max(extent, 1e-9) / DRACO_STEP)), DRACO_BITS[0]), DRACO_BITS[1])
    _run(
        bpy.ops.export_scene.gltf, path, export_format="GLB", use_selection=True, export_yup=True, export_apply=True,
        export_animations=False, export_extras=False, export_materials="EXPORT",
        export_image_format=choices.texture, export_jpeg_quality=IMAGE_QUALITY, export_image_quality=IMAGE_QUALITY,
        # glTF multiplies vertex colours with the texture: a textured surface must not have them.
        export_vertex_color="NONE" if textured else "NAME", export_vertex_color_name=surface.COLOUR,
        export_all_vertex_colors=False, export_attributes=True, **({switch: True} if switch in known else {}),
        export_draco_mesh_compression_level=DRACO_LEVEL, export_draco_position_quantization=bits,
        export_draco_texcoord_quantization=DRACO_BITS[0],
    )
    materials = [m for item in items for m in item.data.materials if m is not None]
    marked = {mark: [m.name for m in materials if marks.has_mark(m, mark)] for mark in marks.MARKS}
    export.describe_glb(path, about, marks=marked, unlit=choices.unlit)
    if mark not in path.read_bytes():
        return f"This Blender comes without {choices.compression.capitalize()}: the file is not compressed."
    return ""


def _write_obj(path: Path, about: dict[str, Provenance], images: dict[str, bpy.types.Image]) -> None:
    _run(
        bpy.ops.wm.obj_export, path, export_selected_objects=True, forward_axis="Y", up_axis="Z", export_uv=True,
        export_normals=True, export_colors=not images, export_materials=True, path_mode="STRIP",
        apply_modifiers=True,
    )
    export.comment_obj(path, _lines(about))
    export.write_mtl(path.with_suffix(".mtl"), _write_pictures(path, images))


def _write_ply(path: Path, about: dict[str, Provenance], images: dict[str, bpy.types.Image]) -> str:
    """Returns what the file could not hold, in words."""
    pictures = set(images.values())
    several = len(pictures) > 1  # a PLY of Blender's has no way to say which face lies on which page
    _run(
        bpy.ops.wm.ply_export, path, export_selected_objects=True, forward_axis="Y", up_axis="Z",
        export_uv=bool(images) and not several, export_normals=True, export_colors="SRGB", export_attributes=True,
        apply_modifiers=True, ascii_format=False,
    )
    comments = _lines(about)
    if images and not several:
        comments += [f"TextureFile {name}" for name in set(_write_pictures(path, images).values())]
    export.comment_ply(path, comments)
    return (f"PLY holds one texture only and this surface has {len(pictures)}: it has vertex colours instead. "
            "GLB and OBJ hold them all.") if several else ""


def _write_pictures(path: Path, images: dict[str, bpy.types.Image]) -> dict[str, str]:
    """Write each image beside `path` once; returns the file's name for each material."""
    names: dict[bpy.types.Image, str] = {}
    for image in images.values():
        if image in names:
            continue
        source = _file_of(image)
        names[image] = f"{path.stem}_texture_{len(names) + 1}{source.suffix}".replace(" ", "_")
        content = image.packed_file.data if image.packed_file is not None else source.read_bytes()
        (path.parent / names[image]).write_bytes(content)
    return {name: names[image] for name, image in images.items()}


def _file_of(image: bpy.types.Image) -> Path:
    return Path(bpy.path.abspath(image.filepath, library=image.library))


def _provenance(item: bpy.types.Object, choices: Choices) -> Provenance:
    """What the importer left on the object, or on the collection of its part."""
    holder = next((found for found in (item, *item.users_collection) if "scale" in found), item)
    origin = None
    part = _part_of(item)
    if choices.position and "origin_latitude" in holder:
        try:
            told = {field.name: holder.get(f"origin_{field.name}") for field in fields(GeoPosition)}
            if told["altitude_datum"] is None:  # a surface imported before datums were kept
                del told["altitude_datum"]
            origin = build(GeoPosition, told)
            if part is not None:
                origin = placing.world_origin(part)
        except ValueError as error:
            raise WorkspaceError(
                Text("The GPS position of {} is none ({}).", item.name, Text(str(error))),
                remedy="Untick GPS Position, or import the workspace again.",
            ) from error
    return Provenance(
        scale=holder.get("scale", "unknown"), north=bool(holder.get("north", False)), origin=origin,
        shift=placing.world_shift(part) if choices.position and part is not None else None,
        licence=choices.licence, credit=choices.credit,
    )


def _part_of(item: bpy.types.Object) -> Part | None:
    return next((Part(holder) for holder in item.users_collection if FRAME_KEY in holder), None)


def _metre_of(item: bpy.types.Object) -> float:
    """How long a metre of a surface's or cloud's frame is in the scene, in Blender's units."""
    adjusted = next((found[ADJUSTED_KEY] for found in (item, *item.users_collection) if ADJUSTED_KEY in found), 1.0)
    return float(world_matrix(item).median_scale / adjusted)


def _lines(about: dict[str, Provenance]) -> list[str]:
    if len(about) == 1:
        return next(iter(about.values())).lines()
    return [f"{' '.join(name.split())}: {line}" for name, record in about.items() for line in record.lines()]


def _run(operator: bpy.types.Operator, path: Path, **arguments: object) -> None:
    try:
        operator(filepath=str(path), check_existing=False, **arguments)
    except AttributeError as error:  # of the three, only glTF's exporter is an add-on
        raise WorkspaceError(
            "Blender's glTF exporter is switched off.",
            remedy="Enable the add-on glTF 2.0 format in the preferences, then export again.", path=path,
        ) from error
    except RuntimeError as error:  # what Blender makes of an operator's error report
        last = str(error).strip().splitlines()[-1]
        raise WorkspaceError(
            Text("Blender could not export the surface: {}", Text(last)),
            remedy="Check the free space of the disk and the folder's permissions, or try another format.", path=path,
        ) from error


@contextmanager
def _only(context: bpy.types.Context, items: list[bpy.types.Object], *, relief: bool) -> Iterator[None]:
    """The given objects shown, untinted and alone selected, as the exporters want it, with their normal maps or without
    (`relief`); afterwards all as before."""
    layer, properties = context.view_layer, context.scene.curecon
    outside = [item.name for item in items if item.name not in layer.objects]
    if outside:
        raise WorkspaceError(
            Text("{} is in a collection that the view layer leaves out.", ', '.join(outside)),
            remedy="Tick that collection in the Outliner, then export again.",
        )
    if context.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    selected, active = [item for item in layer.objects if item.select_get()], layer.objects.active
    hidden = {item: (item.hide_viewport, item.hide_get()) for item in items}
    stood, metre = {item: item.matrix_basis.copy() for item in items}, _metre_of(items[0])
    try:
        if abs(metre - 1) > 1e-6:  # what stands in metres is written to the bit
            for item in items:
                item.matrix_world = Matrix.Scale(1 / metre, 4) @ world_matrix(item)
        marks.show(surface.surfaces_of(context.scene), ())
        surface.simplify(items, True, relief=relief)
        for item in selected:
            item.select_set(False)
        for item in items:
            item.hide_viewport = False
            item.hide_set(False)
            item.select_set(True)
        layer.objects.active = items[0]
        layer.update()
        yield
    finally:
        for item, (in_viewport, in_layer) in hidden.items():
            item.select_set(False)
            item.hide_set(in_layer)
            item.hide_viewport = in_viewport
            item.matrix_basis = stood[item]
        for item in selected:
            item.select_set(True)
        layer.objects.active = active
        surface.simplify(items, False)
        marks.show(surface.surfaces_of(context.scene), properties.shown_marks())
