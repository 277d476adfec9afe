# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes as other programs export them: OBJ and GLB. Only their shape is read, and colours of vertices."""

from __future__ import annotations

import math
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np

from ..base.reading import parse_json, read_bytes
from ..base.rotations import from_quaternion
from .result import MOST_POINTS, Result, result_of, triangles

_MOST_BYTES = 4 << 30
_GLB, _JSON, _BINARY = 0x46546C67, 0x4E4F534A, 0x004E4942
_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_TRIANGLES, _DEEPEST = 4, 64
_Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # from glTF's Y up


def read_obj(path: Path) -> Result:
    """Vertices, their colours if they have them, and faces of any number of corners. Raises OSError, ValueError."""
    content = read_bytes(path, _MOST_BYTES)
    vertices = _rows(re.findall(rb"^v[ \t]+([^\r\n#]*)", content, re.MULTILINE))
    if not len(vertices):
        raise ValueError("it has no vertices")
    lines = re.findall(rb"^f[ \t]+([^\r\n#]*)", content, re.MULTILINE)
    faces = _faces(lines, len(vertices)) if lines else None
    colours = vertices[:, 3:6] if vertices.shape[1] >= 6 else None
    return result_of(path.stem, vertices[:, :3], colours=colours, faces=faces)


def _rows(lines: list[bytes]) -> np.ndarray:
    """Lines of equally many numbers (N,k)."""
    if not lines:
        return np.empty((0, 3))
    width = len(lines[0].split())
    numbers = np.array(b" ".join(lines).split(), dtype=np.bytes_).astype(np.float64)
    if width < 3 or len(numbers) != width * len(lines):
        raise ValueError("its vertices have different numbers of values")
    return numbers.reshape(-1, width)


def _faces(lines: list[bytes], vertices: int) -> np.ndarray:
    lengths = np.array([len(line.split()) for line in lines], np.int64)
    words = re.sub(rb"/[-\d/]*", b"", b" ".join(lines)).split()
    corners = np.array(words, dtype=np.bytes_).astype(np.int64)
    if len(corners) != lengths.sum():
        raise ValueError("its faces cannot be read")
    corners = np.where(corners < 0, corners + vertices, corners - 1)
    if (corners < 0).any() or (corners >= vertices).any():
        raise ValueError("its faces name vertices that are not there")
    return triangles(corners, lengths)


def read_glb(path: Path) -> Result:
    """Every triangle of a binary glTF's scene, turned to Z up. Raises OSError, ValueError."""
    content = read_bytes(path, _MOST_BYTES)
    try:
        document, binary = _chunks(content)
        used = set(document.get("extensionsRequired", []))
        if packed := used & {"KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression"}:
            raise ValueError(f"its mesh is packed ({min(packed)}): export it without compression")
        places, colours, faces = _Scene(document, binary).meshes()
    except (KeyError, IndexError, TypeError, AttributeError, struct.error, OverflowError) as error:
        raise ValueError(f"no sound glTF ({type(error).__name__}: {str(error)[:80]})") from error
    return result_of(path.stem, places @ _Z_UP.T, colours=colours, faces=faces)


def _chunks(content: bytes) -> tuple[Any, bytes]:
    magic, version, _ = struct.unpack_from("<3I", content)
    if magic != _GLB or version != 2:
        raise ValueError("it does not begin as a binary glTF of version 2")
    length, kind = struct.unpack_from("<2I", content, 12)
    if kind != _JSON:
        raise ValueError("its first part is no JSON")
    document = parse_json(content[20 : 20 + length].decode())
    at = 20 + length
    if at + 8 > len(content):
        return document, b""
    length, kind = struct.unpack_from("<2I", content, at)
    return document, content[at + 8 : at + 8 + length] if kind == _BINARY else b""


class _Scene:
    """Meshes of a glTF, each placed by its nodes."""

    def __init__(self, document: Any, binary: bytes) -> None:
        self._document, self._binary = document, binary
        self._places: list[np.ndarray] = []
        self._colours: list[np.ndarray | None] = []
        self._faces: list[np.ndarray] = []
        self._count = 0

    def meshes(self) -> tuple[np.ndarray, np.ndarray | None, np.ndarray]:
        scene = self._document["scenes"][self._document.get("scene", 0)]
        for node in scene["nodes"]:
            self._node(node, np.eye(4), 0)
        if not self._places:
            raise ValueError("it has no triangles")
        coloured = [colours for colours in self._colours if colours is not None]
        return (np.concatenate(self._places), np.concatenate(coloured) if len(coloured) == len(self._colours) else None,
                np.concatenate(self._faces))

    def _node(self, number: int, above: np.ndarray, depth: int) -> None:
        if depth > _DEEPEST:
            raise ValueError("its nodes are nested without end")
        node = self._document["nodes"][number]
        placed = above @ _matrix(node)
        if "mesh" in node:
            for part in self._document["meshes"][node["mesh"]]["primitives"]:
                if part.get("mode", _TRIANGLES) == _TRIANGLES:
                    self._part(part, placed)
        for child in node.get("children", []):
            self._node(child, placed, depth + 1)

    def _part(self, part: Any, placed: np.ndarray) -> None:
        places = self._accessor(part["attributes"]["POSITION"]).astype(np.float64)
        if "indices" in part:
            corners = self._accessor(part["indices"])[:, 0].astype(np.int64)
        else:
            corners = np.arange(len(places))
        faces = corners[: len(corners) // 3 * 3].reshape(-1, 3)
        if len(faces) and faces.max() >= len(places):
            raise ValueError("its faces name points that are not there")
        colours = None
        if "COLOR_0" in part["attributes"]:
            linear = self._accessor(part["attributes"]["COLOR_0"])[:, :3]
            fractions = linear / np.iinfo(linear.dtype).max if linear.dtype.kind == "u" else linear
            colours = _srgb(np.asarray(fractions, np.float64))
        if self._count + len(places) > MOST_POINTS:
            raise ValueError(f"it has more than {MOST_POINTS:,} points")
        self._faces.append(faces + self._count)
        self._places.append(places @ placed[:3, :3].T + placed[:3, 3])
        self._colours.append(colours)
        self._count += len(places)

    def _accessor(self, number: int) -> np.ndarray:
        """Values (n,k), as they are kept. Raises ValueError where they are not in the file."""
        accessor = self._document["accessors"][number]
        if "sparse" in accessor or "bufferView" not in accessor:
            raise ValueError("its values are kept sparsely: export it anew")
        view = self._document["bufferViews"][accessor["bufferView"]]
        if self._document["buffers"][view["buffer"]].get("uri"):
            raise ValueError("its values are in another file: export it as one GLB")
        kind = np.dtype(_COMPONENTS[accessor["componentType"]])
        width, count = _WIDTHS[accessor["type"]], int(accessor["count"])
        size = width * kind.itemsize
        start = int(view.get("byteOffset", 0)) + int(accessor.get("byteOffset", 0))
        stride = int(view.get("byteStride", size))
        if count < 1 or start < 0 or stride < size or start + (count - 1) * stride + size > len(self._binary):
            raise ValueError(f"it is cut short: it claims {count:,} values")
        values: np.ndarray = np.ndarray((count, width), kind, self._binary, start, (stride, kind.itemsize))
        return values


def _matrix(node: Any) -> np.ndarray:
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    made = np.eye(4)
    w_last = np.array(node.get("rotation", (0, 0, 0, 1)), np.float64).reshape(4)
    if not math.isfinite(float(np.linalg.norm(w_last))):
        raise ValueError("a node is turned by no number")
    made[:3, :3] = from_quaternion(w_last[[3, 0, 1, 2]]) * np.array(node.get("scale", (1, 1, 1)), np.float64)
    made[:3, 3] = np.array(node.get("translation", (0, 0, 0)), np.float64)
    return made


def _srgb(linear: np.ndarray) -> np.ndarray:
    """Linear colours as 8-bit sRGB."""
    linear = np.clip(np.nan_to_num(linear), 0, 1)
    shown = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.rint(255 * shown).astype(np.uint8)
