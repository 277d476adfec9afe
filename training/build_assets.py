# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Build an asset folder for training from Debian's package 0ad-data (the art of 0 A.D., CC-BY-SA-3.0).

    apt-get download 0ad-data
    python -m training.build_assets 0ad-data_*.deb --out DIR [--base FOLDER]

Every building, rock, tree and prop becomes a GLB, every ground texture a JPEG, every sky a panorama with its spherical
harmonics; manifest.json lists them and SOURCES.md credits them. With --base, the ground textures and skies of another
asset folder are taken along, and a building that folder keeps for evaluation is kept for evaluation here too.
"""

from __future__ import annotations

import argparse
import json
import shutil
import struct
import subprocess
import tempfile
import zlib
from pathlib import Path
from typing import Any, Literal

import numpy as np
from PIL import Image

from training.assets import HELD_OUT_PERCENT, Assets
from training.game_archive import MOST_LOOKS, Archive, Part, looks

ARCHIVE = "usr/share/games/0ad/mods/public/public.zip"
LICENCE = "CC-BY-SA-3.0 Wildfire Games"
CREDIT = """# Sources and licences of this folder

Models, textures and skies named zad_* or with a source in 0ad-data are the art of 0 A.D.: Copyright (C) Wildfire Games,
http://www.wildfiregames.com/ , CC-BY-SA-3.0, http://creativecommons.org/licenses/by-sa/3.0/ , from Debian's package
0ad-data. Some textures derive from CGTextures, re-licensed by special permission (art/LICENSE.txt). Changes: PMD to
GLB, DDS to JPEG and PNG, player colour baked, resized. Renders that show them may be given on under the same licence.
The other items keep the licence that manifest.json names.
"""
TEXTURE_SIZE = 1024
PLAYER_COLOUR = (120, 92, 70)
FEWEST_FACES = {"building": 150, "rock": 30, "tree": 30, "prop": 60}
PANORAMA = (512, 1024)
# Actors by class; see also game_archive.UNWANTED.
PLACES = {
    "building": ("art/actors/structures/",),
    "rock": ("art/actors/geology/",),
    "tree": ("art/actors/flora/trees/",),
    "prop": ("art/actors/props/special/eyecandy/",),
}
UNWANTED_GROUND = ("_norm", "_spec", "lava", "blackness", "blue", "red.", "green", "white", "grid",
                   "whirl", "ocean", "sea")


def write_glb(path: Path, parts: list[Part], texture_of: dict[tuple[str, bool, bool], str]) -> None:
    """A GLB of the parts, textures by relative name."""
    binary = bytearray()
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    images: list[dict[str, str]] = []
    materials: list[dict[str, Any]] = []

    def add(values: np.ndarray, kind: str, component: int, bounds: bool = False) -> int:
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": values.nbytes})
        accessor = {"bufferView": len(views) - 1, "componentType": component, "count": len(values), "type": kind}
        if bounds:
            accessor |= {"min": values.min(0).tolist(), "max": values.max(0).tolist()}
        accessors.append(accessor)
        binary.extend(values.tobytes())
        return len(accessors) - 1

    def slot(name: str) -> dict[str, int]:
        if {"uri": name} not in images:
            images.append({"uri": name})
        return {"index": images.index({"uri": name})}

    primitives = []
    for part in parts:
        used, faces = np.unique(part.faces, return_inverse=True)
        material: dict[str, Any] = {"doubleSided": True, "pbrMetallicRoughness": {
            "baseColorTexture": slot(texture_of[part.texture, part.cut, part.player])}}
        attributes = {"POSITION": add(part.positions[used].astype("<f4"), "VEC3", 5126, bounds=True),
                      "TEXCOORD_0": add(part.uv[used].astype("<f4"), "VEC2", 5126)}
        if part.ao is not None:
            material["occlusionTexture"] = slot(texture_of[part.ao, False, False]) | {"texCoord": 1}
            attributes["TEXCOORD_1"] = add(part.uv2[used].astype("<f4"), "VEC2", 5126)
        if part.cut:
            material["alphaMode"] = "MASK"
        materials.append(material)
        primitives.append({"attributes": attributes, "material": len(materials) - 1,
                           "indices": add(faces.ravel().astype("<u4")[:, None], "SCALAR", 5125)})
    document = {
        "asset": {"version": "2.0", "copyright": "Wildfire Games, CC-BY-SA-3.0"}, "scene": 0,
        "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "meshes": [{"primitives": primitives}],
        "materials": materials, "images": images, "textures": [{"source": i} for i in range(len(images))],
        "accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": len(binary)}],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    binary.extend(b"\0" * (-len(binary) % 4))
    head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(binary))
    path.write_bytes(head + struct.pack("<I4s", len(text), b"JSON") + text
                     + struct.pack("<I4s", len(binary), b"BIN\0") + binary)


def _texture(image: Image.Image, cut: bool, player: bool) -> Image.Image:
    """A model's texture in its final size; where the player's colour shows through, it is baked in."""
    image = image.copy()
    image.thumbnail((TEXTURE_SIZE, TEXTURE_SIZE), Image.Resampling.LANCZOS)
    if cut:
        return image
    if player:
        return Image.composite(image.convert("RGB"), Image.new("RGB", image.size, PLAYER_COLOUR), image.getchannel("A"))
    return image.convert("RGB")


def build_models(archive: Archive, out: Path, held_out: set[str]) -> list[dict[str, Any]]:
    """Models and their textures; rows for the manifest. `held_out`: meshes kept for evaluation."""
    rows = []
    seen: set[str] = set()
    written: dict[tuple[str, bool, bool], str] = {}
    for kind, places in PLACES.items():
        actors = sorted(n for n in archive.names if n.endswith(".xml") and n.startswith(places))
        for path in actors:
            actor = path.removeprefix("art/actors/")
            for look in range(looks(archive, actor)):
                parts, mesh = archive.parts(actor, look, np.eye(4))
                shape = hashed(parts)
                if sum(len(p.faces) for p in parts) < FEWEST_FACES[kind] or shape in seen:
                    continue
                seen.add(shape)
                for part in parts:
                    keys = [(part.texture, part.cut, part.player)]
                    if part.ao is not None and archive.image(part.ao) is None:
                        part.ao = None
                    if part.ao is not None:
                        keys.append((part.ao, False, False))
                    for key in keys:
                        if key not in written:
                            written[key] = _write_texture(archive, out, *key)
                name = f"{kind[0]}_{actor.removesuffix('.xml').split('/', 1)[1].replace('/', '_')}_{look}"
                write_glb(out / "models" / f"{name}.glb", parts, written)
                points = np.concatenate([p.positions for p in parts])
                row = {"file": f"models/{name}.glb", "cls": kind, "src": f"0ad-data {path}", "lic": LICENCE,
                       "verts": len(points), "faces": sum(len(p.faces) for p in parts),
                       "lo": points.min(0).round(2).tolist(), "hi": points.max(0).round(2).tolist()}
                if kind == "building":
                    row["held_out"] = mesh in held_out
                rows.append(row)
    return rows


def hashed(parts: list[Part]) -> str:
    """What tells one look from another: its triangles and textures."""
    return json.dumps([(p.texture, len(p.faces), p.positions.round(2).sum(0).tolist()) for p in parts])


def _write_texture(archive: Archive, out: Path, name: str, cut: bool, player: bool) -> str:
    image = archive.image(name)
    assert image is not None, name  # parts() and build_models() leave out what is missing
    stem = name.removeprefix("art/textures/skins/").rsplit(".", 1)[0].replace("/", "_")
    file = f"{stem}{'_player' if player else ''}{'.png' if cut else '.jpg'}"
    _texture(image, cut, player).save(out / "tex" / file, quality=90)
    return f"../tex/{file}"


def build_ground(archive: Archive, out: Path) -> list[dict[str, Any]]:
    """Ground textures that tile and that one can tell apart from a plain colour."""
    rows = []
    for name in sorted(archive.names):
        if not (name.startswith("art/textures/terrain/types/") and name.endswith(".cached.dds")):
            continue
        path = name.removesuffix(".cached.dds")
        image = archive.image(path)
        if image is None or any(word in path.lower() for word in UNWANTED_GROUND) or min(image.size) < 256:
            continue
        picture = _texture(image, False, False)
        if np.asarray(picture.convert("L"), np.float32).std() < 6:
            continue
        stem = path.removeprefix("art/textures/terrain/types/").rsplit(".", 1)[0].replace("/", "_")
        picture.save(out / "ground" / f"zad_{stem}.jpg", quality=88)
        rows.append({"file": f"ground/zad_{stem}.jpg", "cls": "texture", "src": f"0ad-data {path}", "lic": LICENCE,
                     "size": list(picture.size)})
    return rows


def panorama(faces: dict[str, np.ndarray]) -> np.ndarray:
    """(512,1024,3) float32 in [0, 1] from the cube's pictures by name (front, back, left, right, top); y up. Below
    the horizon it repeats the colour beside it."""
    rows, columns = PANORAMA
    height = (0.5 - (np.arange(rows) + 0.5) / rows) * np.pi
    angle = ((np.arange(columns) + 0.5) / columns * 2 - 1) * np.pi
    y = np.sin(np.maximum(height, 0.02))[:, None] * np.ones(columns)
    level = np.cos(np.maximum(height, 0.02))[:, None]
    x, z = level * np.sin(angle), level * np.cos(angle)
    out = np.zeros((rows, columns, 3), np.float32)
    sides = {"front": (z, x, y), "back": (-z, -x, y), "right": (x, -z, y), "left": (-x, z, y), "top": (y, x, -z)}
    largest = np.maximum(np.maximum(abs(x), abs(z)), abs(y))
    for name, (ahead, right, up) in sides.items():
        picture = faces[name]
        here = (ahead >= largest - 1e-9) & (ahead > 0)
        u = np.clip((right[here] / ahead[here] + 1) / 2 * picture.shape[1], 0, picture.shape[1] - 1).astype(int)
        v = np.clip((1 - up[here] / ahead[here]) / 2 * picture.shape[0], 0, picture.shape[0] - 1).astype(int)
        out[here] = picture[v, u]
    return out


def harmonics(radiance: np.ndarray) -> np.ndarray:
    """(9,3) spherical harmonics of a panorama's radiance, made to mean 1; basis 1,y,z,x,xy,yz,3z2-1,xz,x2-y2."""
    rows, columns = radiance.shape[:2]
    height = (0.5 - (np.arange(rows) + 0.5) / rows)[:, None] * np.pi
    angle = ((np.arange(columns) + 0.5) / columns * 2 - 1)[None] * np.pi
    x, y, z = np.cos(height) * np.sin(angle), np.sin(height) + 0 * angle, np.cos(height) * np.cos(angle)
    basis = np.stack([0.282095 + 0 * x, 0.488603 * y, 0.488603 * z, 0.488603 * x, 1.092548 * x * y, 1.092548 * y * z,
                      0.315392 * (3 * z * z - 1), 1.092548 * x * z, 0.546274 * (x * x - y * y)])
    area = np.cos(height) * (np.pi / rows) * (2 * np.pi / columns) + 0 * angle
    radiance = radiance / np.average(radiance.mean(2), weights=area)
    coefficients: np.ndarray = np.einsum("bhw,hwc,hw->bc", basis, radiance, area)
    return coefficients


def build_skies(archive: Archive, out: Path) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Panoramas of the game's skies, and their spherical harmonics by name."""
    rows, lighting = [], {}
    for folder in sorted({n.split("/")[3] for n in archive.names if n.startswith("art/textures/skies/")}):
        pictures = {side: archive.image(f"art/textures/skies/{folder}/{side}.dds")
                    for side in ("front", "back", "left", "right", "top")}
        faces = {side: np.asarray(p.convert("RGB"), np.float32) / 255 for side, p in pictures.items() if p is not None}
        if len(faces) < len(pictures):
            continue
        view = panorama(faces)
        name = f"zad_{folder}"
        Image.fromarray((view * 255).astype(np.uint8)).save(out / "skies" / f"{name}.jpg", quality=90)
        source = f"0ad-data art/textures/skies/{folder}"
        lighting[name] = {"sh": harmonics(view**2.2).round(5).tolist(), "src": source}
        rows.append({"file": f"skies/{name}.jpg", "cls": "sky", "src": source, "lic": LICENCE})
    return rows, lighting


def held_out_meshes(archive: Archive, base: Path | None) -> set[str]:
    """Meshes of the buildings kept for evaluation: those of the base folder, or a share of all."""
    if base is None:
        meshes = {n for n in archive.names if n.startswith("art/meshes/structural/")}
        return {n.removeprefix("art/meshes/").removesuffix(".cached.pmd") for n in meshes
                if zlib.crc32(n.encode()) % 100 < HELD_OUT_PERCENT}
    kept = set(Assets(base).buildings(held_out=True))
    actors = [item["src"].split()[1].removeprefix("art/actors/")
              for item in json.loads((base / "manifest.json").read_text()) if item["file"] in kept]
    return {archive.parts(actor, look, np.eye(4))[1] for actor in actors for look in range(MOST_LOOKS)} - {""}


def build(package: Path, out: Path, base: Path | None) -> dict[str, int]:
    """The whole folder; returns how many items of each class it holds."""
    for folder in ("models", "tex", "ground", "skies"):
        (out / folder).mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=out) as scratch:
        path = package
        if package.suffix == ".deb":
            with subprocess.Popen(["dpkg-deb", "--fsys-tarfile", package], stdout=subprocess.PIPE) as stream:
                subprocess.run(["tar", "-x", "-C", scratch, f"./{ARCHIVE}"], stdin=stream.stdout, check=True)
            path = Path(scratch) / ARCHIVE
        archive = Archive(path)
        rows = build_models(archive, out, held_out_meshes(archive, base))
        rows += build_ground(archive, out)
        skies, lighting = build_skies(archive, out)
    rows += skies
    if base is not None:
        known = {row["file"] for row in rows}
        lighting = json.loads((base / "skies" / "sh9.json").read_text()) | lighting
        for item in json.loads((base / "manifest.json").read_text()):
            if item["cls"] in ("texture", "sky") and item["file"] not in known:
                shutil.copyfile(base / item["file"], out / item["file"])
                rows.append(item)
    (out / "skies" / "sh9.json").write_text(json.dumps(lighting))
    (out / "manifest.json").write_text(json.dumps(rows, indent=1))
    (out / "SOURCES.md").write_text(CREDIT)
    kinds: list[Literal["building", "rock", "tree", "prop", "texture", "sky"]] = [
        "building", "rock", "tree", "prop", "texture", "sky"]
    return {kind: sum(row["cls"] == kind for row in rows) for kind in kinds}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("package", type=Path, help="0ad-data_*.deb, or the public.zip inside it")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--base", type=Path, help="another asset folder, whose ground textures and skies are added")
    options = parser.parse_args()
    print(build(options.package, options.out, options.base))


if __name__ == "__main__":
    main()
