# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The models and pictures of 0 A.D. as its archive has them: meshes, actors with their props, textures."""

from __future__ import annotations

import io
import struct
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

MOST_LOOKS = 4  # models made of one actor with several variants
# Of actors: what flies, burns, lies flat or belongs to the game's interface.
UNWANTED = ("fndn", "foundation", "scaf", "rubble", "destruct", "decal", "particle", "flag", "garrison", "banner",
            "smoke", "fire", "units/", "fauna", "field", "water", "bird", "light_", "waypoint", "marker", "test")


@dataclass
class Part:
    """Triangles under one texture: y up, right-handed, metres, UVs as in glTF."""

    positions: np.ndarray
    uv: np.ndarray
    uv2: np.ndarray
    faces: np.ndarray
    texture: str
    ao: str | None
    cut: bool
    player: bool


@dataclass
class Pmd:
    """A static mesh of 0 A.D. in its left-handed frame; `props` maps an attachment point to its 4x4 transform."""

    positions: np.ndarray
    uvs: np.ndarray  # (N,sets,2)
    faces: np.ndarray
    props: dict[str, np.ndarray] = field(default_factory=dict)


def read_pmd(data: bytes) -> Pmd:
    """The mesh format of 0 A.D.'s engine, versions 1 to 4. Raises ValueError for anything else."""
    if data[:4] != b"PSMD":
        raise ValueError("not a PMD mesh")
    at = 12

    def number() -> int:
        nonlocal at
        at += 4
        return int(struct.unpack_from("<I", data, at - 4)[0])

    version = struct.unpack_from("<I", data, 4)[0]
    count = number()
    sets = number() if version >= 4 else 1
    vertex = np.dtype([("p", "<f4", 3), ("n", "<f4", 3), ("uv", "<f4", (sets, 2)), ("b", "u1", 4), ("w", "<f4", 4)])
    vertices = np.frombuffer(data, vertex, count, at)
    at += count * vertex.itemsize
    triangles = number()
    faces = np.frombuffer(data, "<u2", 3 * triangles, at).reshape(-1, 3).astype(np.int64)
    at += 6 * triangles
    bones = number()
    at += 28 * bones
    mesh = Pmd(vertices["p"].copy(), vertices["uv"].copy(), faces)
    for _ in range(number() if version >= 2 else 0):
        length = number()
        name = data[at : at + length].decode("utf-8", "replace")
        at += length
        values = struct.unpack_from("<7f", data, at)
        transform = np.eye(4)
        transform[:3, :3] = Rotation.from_quat(values[3:]).as_matrix() if any(values[3:]) else np.eye(3)
        transform[:3, 3] = values[:3]
        mesh.props[name] = transform
        at += 29
    return mesh


class Archive:
    """The game's art, by the names that its actors use."""

    def __init__(self, path: Path) -> None:
        self._zip = zipfile.ZipFile(path)
        self.names = set(self._zip.namelist())

    def read(self, name: str) -> bytes:
        return self._zip.read(name)

    def mesh(self, name: str) -> Pmd | None:
        path = f"art/meshes/{name}.cached.pmd" if not name.endswith(".pmd") else f"art/meshes/{name}"
        return read_pmd(self.read(path)) if path in self.names else None

    def image(self, path: str) -> Image.Image | None:
        """A picture by its name in the art folder, RGBA; None where it is missing."""
        stem = path.rsplit(".", 1)[0]
        for name in (f"{path}.cached.dds", f"{stem}.png.cached.dds", f"{stem}.dds.cached.dds", path):
            if name in self.names:
                return Image.open(io.BytesIO(self.read(name))).convert("RGBA")
        return None

    def parts(self, actor: str, look: int, transform: np.ndarray, depth: int = 0) -> tuple[list[Part], str]:
        """Triangles of an actor with its props, and its own mesh's name; `look` chooses among its variants."""
        path = f"art/actors/{actor}"
        if depth > 3 or path not in self.names or any(word in actor for word in UNWANTED):
            return [], ""
        root = ET.fromstring(self.read(path).decode("utf-8-sig").strip())
        mesh_name, textures, props = "", {}, {}
        for variant in _chosen(root, look):
            found = variant.find("mesh")
            mesh_name = (found.text or "").strip() if found is not None else mesh_name
            for texture in variant.iter("texture"):
                textures[texture.get("name")] = f"art/textures/skins/{texture.get('file')}"
            for prop in variant.iter("prop"):
                props[prop.get("attachpoint", "root"), prop.get("actor")] = prop
        material = (root.findtext("material") or "").strip()
        mesh = self.mesh(mesh_name) if mesh_name else None
        if mesh is None:
            return [], ""
        parts = []
        if len(mesh.faces) and "baseTex" in textures and self.image(textures["baseTex"]) is not None:
            placed = mesh.positions @ transform[:3, :3].T + transform[:3, 3]
            uv = mesh.uvs * [1, -1] + [0, 1]
            ao = textures.get("aoTex") if uv.shape[1] > 1 and "ao" in material else None
            player = "player" in material
            parts.append(Part(
                placed * [1, 1, -1], uv[:, 0], uv[:, -1], mesh.faces[:, ::-1], textures["baseTex"], ao,
                cut="trans" in material and not player, player=player,
            ))
        for (point, prop_actor), _ in props.items():
            if prop_actor and (point == "root" or point in mesh.props):
                at = mesh.props.get(point, np.eye(4))
                parts += self.parts(prop_actor, look, transform @ at, depth + 1)[0]
        return parts, mesh_name


def _chosen(root: ET.Element, look: int) -> Iterator[ET.Element]:
    """One variant of each group of an actor, the look-th that shows it whole."""
    for group in root.iter("group"):
        usable = [v for v in group.findall("variant") if not v.get("file") and v.get("frequency", "0") != "0"
                  and (v.get("name") or "").lower() not in ("death", "garrisoned", "construction")]
        if usable:
            yield usable[look % len(usable)]


def looks(archive: Archive, actor: str) -> int:
    """How many different models an actor gives."""
    root = ET.fromstring(archive.read(f"art/actors/{actor}").decode("utf-8-sig").strip())
    counts = [len([v for v in group.findall("variant") if v.find("mesh") is not None or v.find("textures") is not None])
              for group in root.iter("group")]
    return min(max(counts, default=1) or 1, MOST_LOOKS)
