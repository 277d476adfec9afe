# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A tile as GLB: triangles with a texture or colours, or points. Coordinates are whole numbers of steps, a power of
two, counted from zero: neighbours whose steps are the same meet exactly (KHR_mesh_quantization).

A tile says nothing of place or time. Its axes are glTF's, x east, y up, -z north: readers of 3D Tiles turn them back.
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np

MATERIALS = "measured", "filled", "unseen"  # of faces: no photo measured filled ones, or shows unseen ones' colour
_STEPS = 65535
_UNLIT, _QUANTIZED, _WEBP = "KHR_materials_unlit", "KHR_mesh_quantization", "EXT_texture_webp"
_UBYTE, _USHORT, _UINT = 5121, 5123, 5125
_VERTICES, _INDICES = 34962, 34963
_POINTS, _TRIANGLES = 0, 4


def _step(places: np.ndarray) -> float:
    """The finest step, a power of two, by which 16 bits reach across places (N,3)."""
    extent = float(np.ptp(places, axis=0).max())
    return float(2.0 ** np.ceil(np.log2(max(extent, 1e-6) / (_STEPS - 2))))


def most_off(places: np.ndarray) -> float:
    """How far any of places (N,3) may lie from where it was, once it is in a tile."""
    return _step(places) * float(np.sqrt(3)) / 2


class _Glb:
    """A GLB as it grows."""

    def __init__(self, copyright: str) -> None:
        asset = {"version": "2.0", "generator": "CU-Recon"} | ({"copyright": copyright} if copyright else {})
        self.content: dict[str, Any] = {
            "asset": asset, "scene": 0, "scenes": [{"nodes": [0]}], "bufferViews": [], "accessors": [],
        }
        self._bytes = bytearray()

    def view(self, data: bytes, **facts: int) -> int:
        """Append bytes as a buffer view; its number."""
        self.content["bufferViews"].append({"buffer": 0, "byteOffset": len(self._bytes), "byteLength": len(data),
                                            **facts})
        self._bytes += data + b"\0" * (-len(data) % 4)
        return len(self.content["bufferViews"]) - 1

    def accessor(self, view: int, kind: int, count: int, shape: str, **facts: Any) -> int:
        self.content["accessors"].append({"bufferView": view, "componentType": kind, "count": count, "type": shape,
                                          **facts})
        return len(self.content["accessors"]) - 1

    def positions(self, places: np.ndarray) -> int:
        """Places (N,3), Z up, on the grid; makes the node that puts them back."""
        step = _step(places)
        turned = np.stack([places[:, 0], places[:, 2], -places[:, 1]], axis=1)
        whole = np.rint(turned / step).astype(np.int64)
        low = whole.min(axis=0)
        whole -= low
        padded = np.zeros((len(whole), 4), "<u2")
        padded[:, :3] = whole
        self.content["nodes"] = [{"mesh": 0, "translation": (low * step).tolist(), "scale": [step] * 3}]
        view = self.view(padded.tobytes(), byteStride=8, target=_VERTICES)
        return self.accessor(view, _USHORT, len(whole), "VEC3", min=[0, 0, 0], max=whole.max(axis=0).tolist())

    def colours(self, colours: np.ndarray) -> int:
        """sRGB (N,3) uint8 as glTF's linear colours, which have 8 bits alone: dark ones lose steps."""
        padded = np.full((len(colours), 4), 255, np.uint8)
        padded[:, :3] = _LINEAR[colours]
        view = self.view(padded.tobytes(), byteStride=4, target=_VERTICES)
        return self.accessor(view, _UBYTE, len(colours), "VEC4", normalized=True)

    def indices(self, corners: np.ndarray, vertices: int) -> int:
        kind, name = (_USHORT, "<u2") if vertices <= _STEPS else (_UINT, "<u4")
        view = self.view(corners.ravel().astype(name).tobytes(), target=_INDICES)
        return self.accessor(view, kind, corners.size, "SCALAR")

    def finish(self, extensions: list[str]) -> bytes:
        required = [name for name in extensions if name != _UNLIT]
        self.content |= {"extensionsUsed": extensions, "extensionsRequired": required,
                         "buffers": [{"byteLength": len(self._bytes)}]}
        text = json.dumps(self.content, ensure_ascii=False, separators=(",", ":")).encode("utf-8", "replace")
        text += b" " * (-len(text) % 4)
        total = 28 + len(text) + len(self._bytes)
        return b"".join([struct.pack("<4sII", b"glTF", 2, total), struct.pack("<I4s", len(text), b"JSON"), text,
                         struct.pack("<I4s", len(self._bytes), b"BIN\0"), self._bytes])


def _linear() -> np.ndarray:
    values = np.arange(256) / 255
    linear = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    return np.rint(255 * linear).astype(np.uint8)


_LINEAR = _linear()


def mesh_tile(
    places: np.ndarray, faces: np.ndarray, material: np.ndarray, copyright: str, *,
    uv: np.ndarray | None = None, picture: bytes = b"", colours: np.ndarray | None = None,
) -> bytes:
    """Triangles (M,3) of places (N,3), with `uv` (N,2), v downwards, on a WebP `picture`, or else with `colours` (N,3).
    `material` (M,) are the faces' numbers in MATERIALS."""
    glb = _Glb(copyright)
    attributes = {"POSITION": glb.positions(places)}
    extensions = [_QUANTIZED, _UNLIT]
    look: dict[str, Any] = {"metallicFactor": 0}
    if uv is not None:
        whole = np.rint(np.clip(uv, 0, 1) * _STEPS).astype("<u2")
        view = glb.view(whole.tobytes(), byteStride=4, target=_VERTICES)
        attributes["TEXCOORD_0"] = glb.accessor(view, _USHORT, len(whole), "VEC2", normalized=True)
        glb.content |= {
            "images": [{"bufferView": glb.view(picture), "mimeType": "image/webp"}],
            "samplers": [{"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}],
            "textures": [{"sampler": 0, "extensions": {_WEBP: {"source": 0}}}],
        }
        look["baseColorTexture"] = {"index": 0}
        extensions.append(_WEBP)
    elif colours is not None:
        attributes["COLOR_0"] = glb.colours(colours)
    primitives: list[dict[str, Any]] = []
    materials: list[dict[str, Any]] = []
    for number, name in enumerate(MATERIALS):
        if (members := material == number).any():
            primitives.append({"attributes": attributes, "indices": glb.indices(faces[members], len(places)),
                               "material": len(materials), "mode": _TRIANGLES})
            materials.append({"name": name, "doubleSided": True, "pbrMetallicRoughness": look,
                              "extensions": {_UNLIT: {}}})
    glb.content |= {"meshes": [{"primitives": primitives}], "materials": materials}
    return glb.finish(extensions)


def point_tile(places: np.ndarray, colours: np.ndarray, copyright: str) -> bytes:
    """Points (N,3) with colours (N,3) uint8 sRGB."""
    glb = _Glb(copyright)
    attributes = {"POSITION": glb.positions(places), "COLOR_0": glb.colours(colours)}
    glb.content |= {
        "meshes": [{"primitives": [{"attributes": attributes, "material": 0, "mode": _POINTS}]}],
        "materials": [{"name": "measured", "extensions": {_UNLIT: {}}}],
    }
    return glb.finish([_QUANTIZED, _UNLIT])
