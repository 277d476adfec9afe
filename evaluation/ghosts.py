# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What people and cars that move leave in a texture: the sample site with such things drawn into its photos.

    python -m evaluation.ghosts WORKSPACE SITE DEPTHS [--things 40] [--out FOLDER]

WORKSPACE is a finished reconstruction (a mesh) of SITE's photos, DEPTHS holds their exact depth maps
(`python samples/make_site.py depth --out DEPTHS`). Boxes as large as cars and people stand on the ground, hidden by
what is before them, each at another place in every photo. The same mesh is textured from the photos without them, with
them, and with them under masks. *Ghost* is the share of the mesh's pixels, seen from all photos' cameras, that differ
by more than LIMIT of 255 in a channel from the texture without things; *covered* is the share of the photos that things
cover, which is what a texture of one photo a place would hold.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from curecon_blender.core.base import images
from curecon_blender.core.base.errors import CuReconError
from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.base.records import Component, View
from curecon_blender.core.surface.mesh import Mesh, mesh_file, read_mesh
from curecon_blender.core.texture.rasterise import nearest_faces
from curecon_blender.core.texture.rendering import render
from curecon_blender.core.texture.texture import TextureOptions, texture_mesh
from curecon_blender.core.views import record

LIMIT = 40  # of 255
SIZES = ((4.4, 1.8, 1.5), (0.5, 0.4, 1.75))  # metres: cars, and as many people
REACH, FLAT = 40.0, 0.25  # metres about the middle where things stand, and within which of the ground's height
_CORNERS = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0, 1)])
_FACES = np.array([(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (1, 5, 7),
                   (1, 7, 3)])


def true_poses(site: Path) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """cam_from_world (3,4) by the photos' names, and their K (3,3)."""
    import pycolmap

    model = pycolmap.Reconstruction(site / "truth")
    camera = next(iter(model.cameras.values()))
    return ({image.name: image.cam_from_world().matrix() for image in model.images.values()},
            camera.calibration_matrix())


def with_things(
    picture: np.ndarray, depth: np.ndarray, pose: np.ndarray, K: np.ndarray, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """The picture (H,W,3) with things on its ground, and where they are seen (H,W) bool."""
    height, width = depth.shape
    y, x = np.mgrid[:height:3, :width:3]
    z = depth[y, x]
    rays = np.stack([(x + 0.5 - K[0, 2]) / K[0, 0] * z, (y + 0.5 - K[1, 2]) / K[1, 1] * z, z], axis=-1)
    places = (rays[z > 0] - pose[:, 3]) @ pose[:, :3]
    level = np.median(places[np.abs(places[:, 2]) < 1.5][:, 2])
    ground = places[(np.abs(places[:, 2] - level) < FLAT) & (np.hypot(places[:, 0], places[:, 1]) < REACH)]
    result, hidden = picture.copy(), np.zeros((height, width), bool)
    for number in range(count):
        size, turn = SIZES[number % 2], rng.uniform(0, 2 * np.pi)
        c, s = np.cos(turn), np.sin(turn)
        corners = (_CORNERS * size) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + ground[rng.integers(len(ground))]
        seen = corners @ pose[:, :3].T + pose[:, 3]
        if seen[:, 2].min() < 1:
            continue
        pixels = (seen / seen[:, 2:]) @ K.T
        face, weights = nearest_faces(pixels[_FACES][..., :2], (1 / seen[:, 2])[_FACES], width, height)
        at = face >= 0
        near = np.zeros((height, width))
        near[at] = 1 / np.einsum("nk,nk->n", weights[at], (1 / seen[:, 2])[_FACES][face[at]])
        at &= (depth == 0) | (near < depth - 0.05)
        colour = rng.uniform(20, 235, 3)
        shade = np.array([0.6, 0.8, 0.5, 0.9, 1.0])[face[at] // 2]
        result[at] = np.clip(shade[:, None] * colour + rng.normal(0, 6, (at.sum(), 3)), 0, 255)
        hidden |= at
    return result, hidden


def ghosts(workspace: Path, site: Path, depths: Path, things: int, out: Path | None) -> dict[str, float]:
    """The shares, in percent."""
    component, mesh = record.read(workspace)[0], read_mesh(workspace / mesh_file(0))
    poses, K = true_poses(site)
    covered = []
    with tempfile.TemporaryDirectory(dir=workspace.parent) as scratch:
        root = Path(scratch)
        for folder in ("depth", component.sparse):
            shutil.copytree(workspace / folder, root / folder, copy_function=os.link)
        (root / "undistorted").mkdir()
        views: dict[str, list[View]] = {"without": [], "with": [], "masked": []}
        for view in component.views:
            photo = images.read_rgb(site / "photos" / view.name)
            with np.load(depths / f"{Path(view.name).stem}.npz") as file:
                depth = file["depth"]
            moved, hidden = with_things(photo, depth, poses[view.name], K, things, np.random.default_rng(
                int.from_bytes(view.name.encode()[-8:], "little") % 2**32))
            covered.append(hidden.mean())
            small = view.width, view.height
            for kind, picture in (("without", photo), ("with", moved)):
                images.write_jpeg(root / f"undistorted/{kind}_{view.name}.jpg", cv2.resize(
                    picture, small, interpolation=cv2.INTER_AREA), quality=92)
            left = cv2.resize(np.where(hidden, 0, 255).astype(np.uint8), small, interpolation=cv2.INTER_AREA)
            (root / f"undistorted/{view.name}.png").write_bytes(images.encode_png(np.where(left < 250, 0, 255).astype(
                np.uint8)))
            plain = replace(view, original="", image=f"undistorted/without_{view.name}.jpg")
            full = replace(plain, image=f"undistorted/with_{view.name}.jpg")
            views["without"].append(plain)
            views["with"].append(full)
            views["masked"].append(replace(full, mask=f"undistorted/{view.name}.png"))
        made = {kind: _textured(mesh, replace(component, views=tuple(ones)), root, root / kind)
                for kind, ones in views.items()}
        return {"covered": 100 * float(np.mean(covered)), **_differences(made, component.views, out)}


def _textured(mesh: Mesh, component: Component, root: Path, folder: Path) -> tuple[Mesh, list[np.ndarray]]:
    folder.mkdir()
    found = texture_mesh(mesh, component, root, TextureOptions(page_size=2048), folder, Reporter())
    return found, [images.read_rgb(folder / page) for page in found.pages]


def _differences(
    made: dict[str, tuple[Mesh, list[np.ndarray]]], views: tuple[View, ...], out: Path | None
) -> dict[str, float]:
    ghost: dict[str, list[float]] = {"with": [], "masked": []}
    for view in views:
        pictures = {kind: render(*found, view) for kind, found in made.items()}
        shown = pictures["without"][2] >= 0
        for kind in ghost:
            apart = np.abs(pictures[kind][0].astype(int) - pictures["without"][0]).max(axis=2)
            ghost[kind].append(float((apart[shown] > LIMIT).mean()))
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
            images.write_jpeg(out / f"{Path(view.name).stem}.jpg", np.hstack([pictures[kind][0] for kind in made]))
    return {f"ghost, {kind}": 100 * float(np.mean(shares)) for kind, shares in ghost.items()}


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m evaluation.ghosts", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("workspace", type=Path)
    parser.add_argument("site", type=Path)
    parser.add_argument("depths", type=Path)
    parser.add_argument("--things", type=int, default=40)
    parser.add_argument("--out", type=Path)
    args = parser.parse_args(arguments)
    try:
        found = ghosts(args.workspace, args.site, args.depths, args.things, args.out)
    except CuReconError as error:
        print(f"{error.message}\n{error.remedy}", file=sys.stderr)
        return error.exit_code
    for name, value in found.items():
        print(f"{name:14} {value:.2f} %")
    return 0


if __name__ == "__main__":
    sys.exit(main())
