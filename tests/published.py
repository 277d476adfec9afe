# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Readers of a published folder that share nothing with what wrote it."""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

_TYPES = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_SHAPES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


@dataclass(frozen=True)
class Primitive:
    """Of a tile: `places` (N,3) in the site frame, Z up; triangles (M,3), or none for points; `uv` (N,2) on `picture`
    (H,W,3), or `colours` (N,3) in 0 to 1, linear."""

    material: str
    places: np.ndarray
    faces: np.ndarray
    uv: np.ndarray | None
    colours: np.ndarray | None
    picture: np.ndarray | None


@dataclass(frozen=True)
class Tile:
    name: str
    depth: int
    error: float
    box: np.ndarray  # middle, and half the sides
    primitives: list[Primitive]
    leaf: bool
    copyright: str


def tiles(folder: Path) -> Iterator[Tile]:
    """All tiles of a folder's tileset, those above first. Each child's box is asserted to lie in its parent's."""
    tileset = json.loads((folder / "tileset.json").read_text())
    assert tileset["asset"]["version"] == "1.1"
    waiting = [(tileset["root"], 0, tileset["geometricError"])]
    while waiting:
        entry, depth, above = waiting.pop(0)
        assert entry["geometricError"] <= above
        box = np.array(entry["boundingVolume"]["box"])
        box = np.stack([box[:3], box[[3, 7, 11]]])
        children = entry.get("children", [])
        waiting += [(child, depth + 1, entry["geometricError"]) for child in children]
        content = entry.get("content")
        found = _glb(folder / content["uri"]) if content else ([], "")
        yield Tile(content["uri"] if content else "", depth, entry["geometricError"], box, found[0], not children,
                   found[1])


def _glb(path: Path) -> tuple[list[Primitive], str]:
    data = path.read_bytes()
    magic, version, total, length, kind = struct.unpack("<4sIII4s", data[:20])
    assert (magic, version, total, kind) == (b"glTF", 2, len(data), b"JSON")
    content = json.loads(data[20 : 20 + length])
    binary = data[28 + length :]

    def view(number: int) -> tuple[bytes, int]:
        one = content["bufferViews"][number]
        return binary[one["byteOffset"] : one["byteOffset"] + one["byteLength"]], one.get("byteStride", 0)

    def accessor(number: int) -> np.ndarray:
        one = content["accessors"][number]
        raw, stride = view(one["bufferView"])
        kind, width = np.dtype(_TYPES[one["componentType"]]), _SHAPES[one["type"]]
        stride = stride or kind.itemsize * width
        rows = np.ndarray((one["count"], width), kind, raw, strides=(stride, kind.itemsize)).astype(np.float64)
        return rows / np.iinfo(kind).max if one.get("normalized") else rows

    node = content["nodes"][0]
    found = []
    for one in content["meshes"][0]["primitives"]:
        attributes = {name: accessor(number) for name, number in one["attributes"].items()}
        places = attributes["POSITION"] * node["scale"] + node["translation"]
        picture = None
        if "images" in content:
            with Image.open(io.BytesIO(view(content["images"][0]["bufferView"])[0])) as image:
                assert image.format == "WEBP" and not {"exif", "xmp", "icc_profile"} & set(image.info)
                picture = np.asarray(image.convert("RGB"))
        faces = accessor(one["indices"]).astype(int).reshape(-1, 3) if "indices" in one else np.zeros((0, 3), int)
        found.append(Primitive(content["materials"][one["material"]]["name"],
                               np.stack([places[:, 0], -places[:, 2], places[:, 1]], axis=1), faces,
                               attributes.get("TEXCOORD_0"), attributes.get("COLOR_0"), picture))
    return found, content["asset"].get("copyright", "")


def telling(folder: Path, needles: dict[str, bytes]) -> list[str]:
    """Which of the needles stand in which file, and whatever else might hide them: metadata and packed files."""
    found = []
    for path in sorted(file for file in folder.rglob("*") if file.is_file()):
        data = path.read_bytes()
        found += [f"{path.name}: {what}" for what, needle in needles.items() if needle in data]
        found += [f"{path.name}: {kind}" for kind, mark in (("EXIF", b"Exif\0\0"), ("XMP", b"<x:xmpmeta"),
                                                            ("WebP metadata", b"EXIF"), ("IPTC", b"8BIM"))
                  if mark in data and path.suffix in (".jpg", ".png", ".webp", ".glb")]
        if data[:4] in (b"PK\3\4", b"\x1f\x8b\x08\0", b"%PDF") or data[:2] == b"\x1f\x8b":
            found.append(f"{path.name}: packed")
        if path.suffix in (".jpg", ".png", ".webp"):
            with Image.open(path) as image:
                found += [f"{path.name}: {name}" for name in set(image.info) & {"exif", "xmp", "comment", "Comment"}]
    return found


def needles(workspace: Path) -> dict[str, bytes]:
    """What a workspace knows of where, when and from which photos: as text of several lengths, and as numbers."""
    from rasterio.warp import transform

    views: Any = json.loads((workspace / "views.json").read_text())
    origin = views["components"][0]["frame"]["origin"]
    place = origin["longitude"], origin["latitude"], origin["altitude"]
    # Text is cut, not rounded: whatever follows, it is found. Decimals: 11 m, 1 mm, whole metres.
    numbers = {"longitude": (place[0], 4), "latitude": (place[1], 4), "altitude": (place[2], 3)}
    for code, names in (("EPSG:32650", ("easting", "northing")), ("EPSG:4978", ("x", "y", "z"))):
        moved = transform("EPSG:4979", code, [place[0]], [place[1]], [place[2]])
        numbers |= {name: (value[0], 0) for name, value in zip(names, moved, strict=False)}
    found = {}
    for name, (value, decimals) in numbers.items():
        found[f"{name} as text"] = str(int(abs(value) * 10**decimals) / 10**decimals).removesuffix(".0").encode()
        found[f"{name} as double"] = struct.pack("<d", value)
        if abs(value) > 1e5:
            found[f"{name} as float"] = struct.pack("<f", value)
    photos: Any = json.loads((workspace / "photos.json").read_text())["photos"]
    for photo in photos:
        stem = Path(photo["name"]).stem
        found |= {f"photo {stem}": stem.encode(), f"time of {stem}": photo["time"][11:19].encode()}
        found[f"GPS of {stem}"] = f"{photo['gps']['latitude']:.6f}"[:-1].encode()
    return found
