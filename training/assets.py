# SPDX-License-Identifier: GPL-3.0-or-later
"""The asset folder: GLB models, photo textures and skies, read on demand.

The folder holds `manifest.json`, `models/`, `tex/`, `ground/` and `skies/` (with `skies/sh9.json`).  Models are
turned from glTF's y-up frame into the Z-up frame used everywhere here; lengths are metres.
"""

import json
import struct
import zlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np
from PIL import Image

MAX_TEXTURE_SIZE = 1024
HELD_OUT_PERCENT = 15

_COMPONENT_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_COMPONENT_COUNTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}
_NORMALISED_MAX = {"u1": 255.0, "<u2": 65535.0, "i1": 127.0, "<i2": 32767.0}


@dataclass(frozen=True)
class Material:
    """How a mesh is coloured.  `blend` adds two more textures, mixed by the mesh's second UV set (ground)."""

    texture: str
    blend: tuple[str, str] | None = None
    tiles: tuple[float, float, float] = (1.0, 1.0, 1.0)  # length of one texture repeat, in UV units (or metres)
    box_mapped: bool = False  # take UVs from the world position (metres) instead of the mesh
    ao: str | None = None
    alpha_cut: bool = False
    mirror: Literal["", "water", "glass"] = ""  # what it shows beside its colour: the world upside down, or the sky
    sheltered: float = 1.0  # share of the sky's light that reaches it, as deep in a gallery


@dataclass(frozen=True)
class Mesh:
    """positions (N,3), normals (N,3), uv (N,2), uv2 (N,2) float32; faces (M,3) int32; Z up, metres."""

    positions: np.ndarray
    normals: np.ndarray
    uv: np.ndarray
    uv2: np.ndarray
    faces: np.ndarray
    material: Material


def vertex_normals(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Area-weighted unit normals (N,3) float32 of vertices (N,3) and faces (M,3)."""
    corners = positions[faces]
    face_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.empty_like(positions, dtype=np.float32)
    for axis in range(3):
        weights = np.repeat(face_normals[:, axis], 3)
        normals[:, axis] = np.bincount(faces.ravel(), weights=weights, minlength=len(positions))
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(lengths > 1e-12, normals / np.maximum(lengths, 1e-12), np.array([0, 0, 1])).astype(np.float32)


def read_glb(path: Path) -> list[Mesh]:
    """The meshes of one GLB in the Z-up frame.  Texture names are relative to the asset folder."""
    data = path.read_bytes()
    json_length = struct.unpack("<I", data[12:16])[0]
    document = json.loads(data[20 : 20 + json_length])
    binary = data[28 + json_length :]

    def accessor(index: int) -> np.ndarray:
        spec = document["accessors"][index]
        view = document["bufferViews"][spec["bufferView"]]
        code = _COMPONENT_TYPES[spec["componentType"]]
        count = _COMPONENT_COUNTS[spec["type"]]
        item = np.dtype(code).itemsize
        stride = view.get("byteStride") or item * count
        offset = view.get("byteOffset", 0) + spec.get("byteOffset", 0)
        values: np.ndarray = np.ndarray((spec["count"], count), code, binary, offset, (stride, item))
        if spec.get("normalized"):
            return values.astype(np.float32) / _NORMALISED_MAX[code]
        return values

    def texture_name(slot: dict | None) -> str | None:
        if slot is None:
            return None
        uri = document["images"][document["textures"][slot["index"]]["source"]]["uri"]
        return (Path(path.parent.name) / uri).as_posix().replace(f"{path.parent.name}/../", "")

    node = document["nodes"][0]
    scale = np.asarray(node.get("scale", [1, 1, 1]), np.float64)
    translation = np.asarray(node.get("translation", [0, 0, 0]), np.float64)
    meshes = []
    for primitive in document["meshes"][node["mesh"]]["primitives"]:
        attributes = primitive["attributes"]
        material = document["materials"][primitive["material"]]
        y_up = accessor(attributes["POSITION"]) * scale + translation
        positions = np.stack([y_up[:, 0], -y_up[:, 2], y_up[:, 1]], axis=1).astype(np.float32)
        faces = accessor(primitive["indices"]).reshape(-1, 3).astype(np.int32)
        uv = accessor(attributes["TEXCOORD_0"]).astype(np.float32)
        uv2 = accessor(attributes["TEXCOORD_1"]).astype(np.float32) if "TEXCOORD_1" in attributes else uv
        base = texture_name(material["pbrMetallicRoughness"].get("baseColorTexture"))
        meshes.append(
            Mesh(
                positions,
                vertex_normals(positions, faces),
                uv,
                uv2,
                faces,
                Material(
                    texture=base or "plain",
                    ao=texture_name(material.get("occlusionTexture")),
                    alpha_cut=material.get("alphaMode") == "MASK",
                ),
            )
        )
    return meshes


def subdivide(mesh: Mesh, max_edge: float, max_faces: int) -> Mesh:
    """Halve every edge longer than `max_edge` until none is left or the mesh has `max_faces` faces.

    An edge is split or not by its own length alone, so neighbouring faces agree and no crack opens.
    """
    attributes = np.concatenate([mesh.positions, mesh.uv, mesh.uv2], axis=1)
    faces = mesh.faces
    while len(faces) < max_faces:
        edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2)  # (M,3,2): corner i to corner i+1
        lengths = np.linalg.norm(attributes[edges[..., 0], :3] - attributes[edges[..., 1], :3], axis=2)
        split = lengths > max_edge
        if not split.any():
            break
        keys = np.sort(edges, axis=2)[split]
        unique, inverse = np.unique(keys, axis=0, return_inverse=True)
        middle = np.zeros((len(faces), 3), np.int32)
        middle[split] = len(attributes) + inverse.ravel()
        attributes = np.concatenate([attributes, attributes[unique].mean(axis=1)])
        faces = _split_faces(faces, split, middle)
    positions = np.ascontiguousarray(attributes[:, :3])
    return Mesh(
        positions, vertex_normals(positions, faces), attributes[:, 3:5], attributes[:, 5:7], faces, mesh.material
    )


def _split_faces(faces: np.ndarray, split: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """New faces (M',3) from the split flags (M,3) and middle vertices (M,3) of each face's edges."""
    out = [faces[~split.any(axis=1)]]
    counts = split.sum(axis=1)
    for first in range(3):  # rotate each face so that one case covers three
        order = [(first + k) % 3 for k in range(3)]
        a, b, c = (faces[:, k] for k in order)
        ab, bc, ca = (middle[:, k] for k in order)
        one = (counts == 1) & split[:, first]
        two = (counts == 2) & ~split[:, order[2]]
        out += [np.stack(t, 1)[one] for t in ((a, ab, c), (ab, b, c))]
        out += [np.stack(t, 1)[two] for t in ((ab, b, bc), (a, ab, bc), (a, bc, c))]
    three = counts == 3
    a, b, c = faces[three].T
    ab, bc, ca = middle[three].T
    out += [np.stack(t, 1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    return np.concatenate(out).astype(np.int32)


def roof_tile_texture(seed: int, size: int = 512) -> np.ndarray:
    """(size,size,3) uint8 rows of half-round tiles seen from above, each a little different in brightness."""
    rng = np.random.default_rng(seed)
    columns, rows = 16, 12
    y, x = np.mgrid[0:size, 0:size] / size
    across, along = x * columns, y * rows
    shape = np.abs(np.sin(np.pi * across)) ** 0.7
    lip = 0.55 + 0.45 * np.clip((along % 1) * 6, 0, 1)
    tone = rng.uniform(0.6, 1.25, (rows, columns))[along.astype(int), across.astype(int)]
    stain = np.asarray(
        Image.fromarray(rng.uniform(0, 1, (24, 24)).astype(np.float32)).resize((size, size), Image.Resampling.BICUBIC)
    )
    grain = rng.normal(1, 0.07, (size, size))
    base = np.array([[95, 95, 98], [120, 84, 66], [140, 92, 70], [105, 100, 88]])[seed % 4]
    grey = (0.35 + 0.65 * shape) * lip * tone * grain * (0.65 + 0.7 * stain)
    return np.clip(grey[..., None] * base * 1.25, 0, 255).astype(np.uint8)


def plaster_texture(seed: int, size: int = 512) -> np.ndarray:
    """(size,size,3) uint8 rammed earth or plaster: horizontal lifts, stains that run down, fine grain, cracks."""
    rng = np.random.default_rng(seed)

    def noise(rows: int, columns: int) -> np.ndarray:
        small = Image.fromarray(rng.normal(0, 1, (rows, columns)).astype(np.float32))
        return np.asarray(small.resize((size, size), Image.Resampling.BICUBIC))

    value = 0.12 * noise(8, 8) + 0.10 * noise(10, 60) + 0.08 * noise(64, 64) + 0.07 * noise(256, 256)
    value += 0.06 * rng.normal(0, 1, (size, size))
    lifts = (np.arange(size) * 6 // size)[:, None]
    value += rng.normal(0, 0.05, 6)[lifts] - 0.1 * ((np.arange(size) * 6 % size) < size // 40)[:, None]
    for _ in range(int(rng.integers(0, 14))):  # cracks: random walks
        path = np.cumsum(rng.normal(0, 1.2, 160)) + rng.uniform(0, size)
        start = int(rng.uniform(0, size))
        value[(start + np.arange(160)) % size, path.astype(int) % size] -= 0.35
    base = np.array([[176, 140, 98], [205, 188, 160], [150, 118, 84], [214, 210, 200]])[seed % 4]
    return np.clip((0.85 + value)[..., None] * base, 0, 255).astype(np.uint8)


def overcast_texture(seed: int, height: int = 256) -> np.ndarray:
    """(height,2*height,3) uint8 panorama of a white to grey sky with hardly any clouds, often burnt out."""
    rng = np.random.default_rng(seed)
    small = Image.fromarray(np.tile(rng.normal(0, 1, (6, 12)), 3).astype(np.float32))  # the middle third has no seam
    clouds = np.asarray(small.resize((6 * height, height), Image.Resampling.BICUBIC))[:, 2 * height : 4 * height]
    zenith, horizon = rng.uniform(190, 270, 2)
    level = np.linspace(zenith, horizon, height)[:, None] + rng.uniform(0, 9) * clouds
    tint = 1 - rng.uniform(0, 0.1) * np.array([1.0, 0.45, 0.0])  # towards blue
    return np.clip(level[..., None] * tint, 0, 255).astype(np.uint8)


class Assets:
    """Lazy, cached access to one asset folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = Path(folder)
        manifest = json.loads((self.folder / "manifest.json").read_text())
        self._names: dict[str, list[str]] = {}
        held: list[str] = []
        for item in manifest:
            self._names.setdefault(item["cls"], []).append(item["file"])
            if item["cls"] != "building":
                continue
            # Models re-used under another name have the same face count: hashing that keeps copies on one side, where
            # the manifest does not say it.
            by_hash = zlib.crc32(str(item["faces"]).encode()) % 100 < HELD_OUT_PERCENT
            if item.get("held_out", by_hash):
                held.append(item["file"])
        self._held_out = frozenset(held)
        self._lighting = json.loads((self.folder / "skies" / "sh9.json").read_text())
        self.model = lru_cache(maxsize=256)(self._model)
        self.texture = lru_cache(maxsize=8)(self._texture)

    def names(self, kind: str) -> list[str]:
        """Items of a kind: rock, tree, prop, texture or sky."""
        return self._names[kind]

    def buildings(self, held_out: bool) -> list[str]:
        """Buildings kept for evaluation (held_out) or those for training; never both."""
        return [name for name in self._names["building"] if (name in self._held_out) == held_out]

    def lighting(self, sky: str) -> np.ndarray:
        """(9,3) float64 radiance SH of a sky, y-up basis order 1,y,z,x,xy,yz,3z2-1,xz,x2-y2."""
        return np.asarray(self._lighting[Path(sky).stem]["sh"], np.float64)

    def _model(self, name: str) -> tuple[Mesh, ...]:
        return tuple(read_glb(self.folder / name))

    def _texture(self, name: str) -> np.ndarray:
        """(H,W,3 or 4) uint8.  `roof:SEED`, `plaster:SEED` and `overcast:SEED` are made, not read."""
        if name.startswith("roof:"):
            return roof_tile_texture(int(name[5:]))
        if name.startswith("plaster:"):
            return plaster_texture(int(name[8:]))
        if name.startswith("overcast:"):
            return overcast_texture(int(name[9:]))
        if name == "plain":
            return np.full((4, 4, 3), 180, np.uint8)
        file = Image.open(self.folder / name)
        image = file.convert("RGBA" if file.mode in ("RGBA", "LA", "P") else "RGB")
        if max(image.size) > MAX_TEXTURE_SIZE:
            image.thumbnail((MAX_TEXTURE_SIZE, MAX_TEXTURE_SIZE), Image.Resampling.LANCZOS)
        return np.asarray(image)
