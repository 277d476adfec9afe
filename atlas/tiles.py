# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Tiles of strangers: a tileset that names only its own files, and GLB that hold what *Publish* writes and no more.

A tile is checked before anything of its size is made: lengths against the file, views against the buffer, accessors
against their views, indices against their vertices. What a record here does not know is refused, so no tile can name
another file or carry what nobody looks at.
"""

from __future__ import annotations

import math
import re
import struct
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np

from curecon_blender.core.base.language import Text
from curecon_blender.core.base.reading import OneOf, Within, build, parse_json
from curecon_blender.core.publish.glb import MATERIALS

from . import pictures
from .problems import refused, why
from .records import NEAR

MOST_TILE = 16 << 20  # bytes
MOST_TILESET = 8 << 20
_TILE = re.compile(r"(0|[1-9]\d{0,5})\.glb")
_DEEPEST = 40
_MOST_JSON = 1 << 15  # of a tile
_TYPES: dict[int, np.dtype[Any]] = {5121: np.dtype("u1"), 5123: np.dtype("<u2"), 5125: np.dtype("<u4")}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_number = Annotated[int, Within(0, 1 << 31)]
_finite = Annotated[float, Within(-1e9, 1e9)]


# ---- tilesets

@dataclass(frozen=True, kw_only=True)
class _Asset:
    version: Annotated[str, OneOf("1.1")]


@dataclass(frozen=True, kw_only=True)
class _Volume:
    box: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class _Content:
    uri: str


@dataclass(frozen=True, kw_only=True)
class _Entry:
    boundingVolume: _Volume  # noqa: N815
    geometricError: Annotated[float, Within(0, 1e9)]  # noqa: N815
    refine: Annotated[str, OneOf("REPLACE", "ADD")]
    content: _Content | None = None
    children: tuple[_Entry, ...] = ()
    transform: tuple[float, ...] | None = None


@dataclass(frozen=True, kw_only=True)
class _Tileset:
    asset: _Asset
    geometricError: Annotated[float, Within(0, 1e9)]  # noqa: N815
    root: _Entry


def tileset(content: bytes, tiles: set[str]) -> None:
    """A tileset whose every tile is one of `tiles` beside it, each named once, and none left over. Raises Problem."""
    try:
        found: _Tileset = build(_Tileset, parse_json(content.decode()))
        named: list[str] = []
        _visit(found.root, named, 0)
    except (ValueError, RecursionError) as error:
        raise refused(Text("{}: {}.", "tileset.json", why(error))) from error
    if len(named) != len(set(named)) or set(named) != tiles:
        raise refused(Text("{}: {}.", "tileset.json", Text("it does not name each tile once")))


def _visit(entry: _Entry, named: list[str], depth: int) -> None:
    if depth > _DEEPEST:
        raise ValueError("tiles within tiles without end")
    if entry.transform is not None:
        raise ValueError("tiles that are moved elsewhere")
    _check_box(entry.boundingVolume)
    if entry.content:
        if not _TILE.fullmatch(entry.content.uri):
            raise ValueError(Text("{} is no tile's name", repr(entry.content.uri[:60])))
        named.append(entry.content.uri)
    for child in entry.children:
        _visit(child, named, depth + 1)


def _check_box(volume: _Volume) -> None:
    if len(volume.box) != 12 or any(abs(value) > NEAR for value in volume.box):
        raise ValueError("a box that is none, or far from the site")


def earth(content: bytes) -> None:
    """earth.json of a site whose place is exact: one entry that puts the tileset beside it in its place. Raises
    Problem."""
    try:
        root = build(_Tileset, parse_json(content.decode())).root
        _check_box(root.boundingVolume)
        if root.children or root.content != _Content(uri="tileset.json"):
            raise ValueError("it names other tiles than its own")
        matrix = np.array(root.transform or ())
        if matrix.shape != (16,):
            raise ValueError("it has no transform")
        turned = matrix.reshape(4, 4).T
        rotation = turned[:3, :3]
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-6 or np.abs(turned[3] - [0, 0, 0, 1]).max() > 0 or \
                not 6.3e6 < np.linalg.norm(turned[:3, 3]) < 6.5e6:
            raise ValueError("its transform is no place on Earth")
    except (ValueError, RecursionError) as error:
        raise refused(Text("{}: {}.", "earth.json", why(error))) from error


# ---- tiles

@dataclass(frozen=True, kw_only=True)
class _GltfAsset:
    version: Annotated[str, OneOf("2.0")]
    generator: str = ""
    copyright: str = ""


@dataclass(frozen=True, kw_only=True)
class _Scene:
    nodes: tuple[_number, ...]


@dataclass(frozen=True, kw_only=True)
class _Node:
    mesh: _number
    translation: tuple[_finite, _finite, _finite]
    scale: tuple[_finite, _finite, _finite]


@dataclass(frozen=True, kw_only=True)
class _Buffer:
    byteLength: _number  # noqa: N815


@dataclass(frozen=True, kw_only=True)
class _View:
    buffer: _number
    byteOffset: _number  # noqa: N815
    byteLength: _number  # noqa: N815
    byteStride: _number = 0  # noqa: N815
    target: _number = 0


@dataclass(frozen=True, kw_only=True)
class _Accessor:
    bufferView: _number  # noqa: N815
    componentType: _number  # noqa: N815
    count: Annotated[int, Within(1, 1 << 24)]
    type: Annotated[str, OneOf(*_WIDTHS)]
    normalized: bool = False
    min: tuple[float, ...] = ()
    max: tuple[float, ...] = ()


@dataclass(frozen=True, kw_only=True)
class _Primitive:
    attributes: dict
    material: _number
    mode: _number
    indices: _number | None = None


@dataclass(frozen=True, kw_only=True)
class _Mesh:
    primitives: tuple[_Primitive, ...]


@dataclass(frozen=True, kw_only=True)
class _Index:
    index: _number


@dataclass(frozen=True, kw_only=True)
class _Look:
    metallicFactor: float = 1.0  # noqa: N815
    baseColorTexture: _Index | None = None  # noqa: N815


@dataclass(frozen=True, kw_only=True)
class _Material:
    name: Annotated[str, OneOf(*MATERIALS)]
    extensions: dict
    doubleSided: bool = False  # noqa: N815
    pbrMetallicRoughness: _Look | None = None  # noqa: N815


@dataclass(frozen=True, kw_only=True)
class _Image:
    bufferView: _number  # noqa: N815
    mimeType: Annotated[str, OneOf("image/webp")]  # noqa: N815


@dataclass(frozen=True, kw_only=True)
class _Gltf:
    asset: _GltfAsset
    scene: Annotated[int, Within(0, 0)]
    scenes: tuple[_Scene, ...]
    nodes: tuple[_Node, ...]
    meshes: tuple[_Mesh, ...]
    materials: tuple[_Material, ...]
    accessors: tuple[_Accessor, ...]
    bufferViews: tuple[_View, ...]  # noqa: N815
    buffers: tuple[_Buffer, ...]
    extensionsUsed: tuple[str, ...]  # noqa: N815
    extensionsRequired: tuple[str, ...]  # noqa: N815
    images: tuple[_Image, ...] = ()
    samplers: tuple[dict, ...] = ()
    textures: tuple[dict, ...] = ()


_EXTENSIONS = {"KHR_materials_unlit", "KHR_mesh_quantization", "EXT_texture_webp"}
_SAMPLER = {"magFilter", "minFilter", "wrapS", "wrapT"}


def tile(name: str, content: bytes, copyright: str) -> int:
    """The pixels of a tile's texture; it says whose it is as its site does, in `copyright`. Raises Problem."""
    try:
        return _Glb(content).check(copyright)
    except (ValueError, RecursionError, struct.error) as error:
        raise refused(Text("{}: {}.", name, why(error))) from error


@dataclass
class _Glb:
    content: bytes
    binary: memoryview = field(default_factory=lambda: memoryview(b""))

    def check(self, copyright: str) -> int:
        self.gltf: _Gltf = self._json()
        gltf = self.gltf
        for kind, most in (("scenes", 1), ("nodes", 1), ("meshes", 1), ("buffers", 1), ("images", 1), ("samplers", 1),
                           ("textures", 1), ("materials", len(MATERIALS)), ("accessors", 20), ("bufferViews", 20)):
            if len(getattr(gltf, kind)) > most:
                raise ValueError(Text("more {} than publishing writes", kind))
        if (
            not gltf.nodes
            or not gltf.meshes
            or not gltf.buffers
            or gltf.scenes != (_Scene(nodes=(0,)),)
            or gltf.nodes[0].mesh
        ):
            raise ValueError("no scene of one mesh")
        if gltf.asset.generator != "CU-Recon" or gltf.asset.copyright != copyright:
            raise ValueError("another copyright than the site's")
        if not {*gltf.extensionsUsed, *gltf.extensionsRequired} <= _EXTENSIONS:
            raise ValueError("an extension that publishing does not use")
        if gltf.buffers[0].byteLength != len(self.binary):
            raise ValueError("a buffer that is not the tile's own")
        for view in gltf.bufferViews:
            if view.buffer or view.byteOffset % 4 or view.byteOffset + view.byteLength > len(self.binary):
                raise ValueError("a view that reaches out of the tile")
        pixels = self._check_looks()
        used = {number for primitive in gltf.meshes[0].primitives for number in self._primitive(primitive)}
        used |= {image.bufferView for image in gltf.images}
        if used != set(range(len(gltf.bufferViews))):
            raise ValueError("bytes that nothing shows")
        self._check_gaps()
        return pixels

    def _json(self) -> _Gltf:
        """The content's record; sets `binary`."""
        data = self.content
        if len(data) > MOST_TILE:
            raise ValueError("a tile too large")
        magic, version, total, length, kind = struct.unpack_from("<4sIII4s", data)
        if (magic, version, total, kind) != (b"glTF", 2, len(data), b"JSON") or length % 4 or length > _MOST_JSON or \
                28 + length > len(data):
            raise ValueError("no GLB of one JSON and one binary part")
        size, kind = struct.unpack_from("<I4s", data, 20 + length)
        if kind != b"BIN\0" or 28 + length + size != len(data):
            raise ValueError("no GLB of one JSON and one binary part")
        self.binary = memoryview(data)[28 + length :]
        found: _Gltf = build(_Gltf, parse_json(data[20 : 20 + length].decode()))
        return found

    def _check_looks(self) -> int:
        """The pixels of its pictures."""
        gltf = self.gltf
        for material in gltf.materials:
            look = material.pbrMetallicRoughness or _Look()
            if material.extensions != {"KHR_materials_unlit": {}} or (
                look.baseColorTexture and look.baseColorTexture.index >= len(gltf.textures)
            ):
                raise ValueError("a material that publishing does not write")
        for texture in gltf.textures:
            if (
                texture != {"sampler": 0, "extensions": {"EXT_texture_webp": {"source": 0}}}
                or not gltf.images
                or not gltf.samplers
            ):
                raise ValueError("a texture that is not of its own picture")
        for sampler in gltf.samplers:
            if set(sampler) != _SAMPLER or not all(
                type(value) is int and 0 < value < 65536 for value in sampler.values()
            ):
                raise ValueError("a sampler that is none")
        pixels = 0
        for image in gltf.images:
            if image.bufferView >= len(gltf.bufferViews):
                raise ValueError("a picture that is not there")
            view = gltf.bufferViews[image.bufferView]
            pixels += pictures.webp(bytes(self.binary[view.byteOffset : view.byteOffset + view.byteLength]))
        return pixels

    def _primitive(self, primitive: _Primitive) -> set[int]:
        """The views that a primitive uses."""
        kinds = {"POSITION": "VEC3", "TEXCOORD_0": "VEC2", "COLOR_0": "VEC4"}
        if "POSITION" not in primitive.attributes or not set(primitive.attributes) <= set(kinds):
            raise ValueError("attributes that publishing does not write")
        if primitive.material >= len(self.gltf.materials) or (primitive.indices is None) != (primitive.mode == 0) or \
                primitive.mode not in (0, 4):
            raise ValueError("neither triangles nor points")
        views = set()
        counts = set()
        for name, number in primitive.attributes.items():
            accessor, view, rows = self._rows(number)
            if accessor.type != kinds[name]:
                raise ValueError(Text("{} of another kind", name))
            if name == "POSITION":
                self._check_places(rows)
            views.add(view)
            counts.add(accessor.count)
        if len(counts) != 1:
            raise ValueError("attributes of different lengths")
        if primitive.indices is not None:
            accessor, view, rows = self._rows(primitive.indices)
            if accessor.type != "SCALAR" or accessor.count % 3 or int(rows.max()) >= counts.pop():
                raise ValueError("triangles of vertices that are not there")
            views.add(view)
        return views

    def _rows(self, number: Any) -> tuple[_Accessor, int, np.ndarray]:
        """An accessor, its view's number and its rows (N,width), read where they lie."""
        if type(number) is not int or not 0 <= number < len(self.gltf.accessors):
            raise ValueError("an accessor that is not there")
        accessor = self.gltf.accessors[number]
        if accessor.bufferView >= len(self.gltf.bufferViews) or accessor.componentType not in _TYPES:
            raise ValueError("an accessor of nothing")
        view, kind = self.gltf.bufferViews[accessor.bufferView], _TYPES[accessor.componentType]
        width = _WIDTHS[accessor.type]
        stride = view.byteStride or kind.itemsize * width
        if stride < kind.itemsize * width or stride > 252 or stride % kind.itemsize or \
                (accessor.count - 1) * stride + kind.itemsize * width > view.byteLength or \
                view.byteLength > (accessor.count + 1) * stride + 4:
            raise ValueError("an accessor that reaches out of its view, or leaves bytes in it")
        rows: np.ndarray = np.ndarray((accessor.count, width), kind, self.binary, view.byteOffset,
                                      (stride, kind.itemsize))
        return accessor, accessor.bufferView, rows

    def _check_places(self, rows: np.ndarray) -> None:
        """Vertices near the site's middle: a place on Earth cannot be hidden in them."""
        node = self.gltf.nodes[0]
        for axis in range(3):
            low, high = (node.translation[axis] + node.scale[axis] * float(value)
                         for value in (rows[:, axis].min(), rows[:, axis].max()))
            if not all(math.isfinite(value) and abs(value) <= NEAR for value in (low, high)):
                raise ValueError("vertices far from the site's middle")

    def _check_gaps(self) -> None:
        """Between the views there is padding alone."""
        end = 0
        for view in sorted(self.gltf.bufferViews, key=lambda one: one.byteOffset):
            if view.byteOffset < end or view.byteOffset - end > 3 or any(self.binary[end : view.byteOffset]):
                raise ValueError("views that overlap, or bytes between them")
            end = view.byteOffset + view.byteLength
        if len(self.binary) - end > 3 or any(self.binary[end:]):
            raise ValueError("bytes behind the last view")
