# SPDX-License-Identifier: GPL-3.0-or-later
"""Make the sample site: `python samples/make_site.py photos|depth|cloud [--out DIR] [--photos 1 2 ...]`.

photos  renders the drone photos and writes the true poses (default: samples/tulou)
depth   writes each photo's exact z-depth as DIR/NAME.npz: key `depth`, (H, W) float32 metres, 0 in the sky
cloud   rebuilds truth/cloud.npz from depth maps (DIR as made by `depth`; made in a temporary folder if left out)

Needs Python 3.11 with bpy 4.5, numpy and pillow.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import bpy
import numpy as np
from PIL import Image
from site_flight import LATITUDE, LONGITUDE, TAKE_OFF, UTC_OFFSET, Shot, develop, flight, save_photo
from site_scene import FOCAL, HEIGHT, WIDTH, aim, build_scene, set_depth_renderer, set_photo_renderer, sun_direction
from site_truth import make_cloud, write_model

TULOU = Path(__file__).resolve().parent / "tulou"


def make_scene() -> bpy.types.Scene:
    return build_scene(sun_direction(LATITUDE, LONGITUDE, TAKE_OFF - UTC_OFFSET))


def render_photos(shots: list[Shot], out: Path, samples: int) -> None:
    """Render shots to out/photos, `samples` rays a pixel."""
    (out / "photos").mkdir(parents=True, exist_ok=True)
    scene = make_scene()
    set_photo_renderer(scene, samples)
    with tempfile.TemporaryDirectory() as scratch:
        for shot in shots:
            start = time.monotonic()
            aim(scene, shot.cam_from_world)
            scene.render.filepath = f"{scratch}/render.png"
            bpy.ops.render.render(write_still=True)
            render = np.asarray(Image.open(scene.render.filepath).convert("RGB"))
            save_photo(develop(render, shot), shot, out / "photos" / shot.name)
            print(f"{shot.name}: {time.monotonic() - start:.1f} s", flush=True)


def render_depths(shots: list[Shot], out: Path) -> None:
    """Write the depth maps of shots to out."""
    out.mkdir(parents=True, exist_ok=True)
    scene = make_scene()
    set_depth_renderer(scene)
    with tempfile.TemporaryDirectory() as scratch:
        for shot in shots:
            aim(scene, shot.cam_from_world)
            scene.render.filepath = f"{scratch}/{shot.name}.exr"
            bpy.ops.render.render(write_still=True)
        for shot in shots:  # in a second round: loading an image makes Cycles build its scene anew
            image = bpy.data.images.load(f"{scratch}/{shot.name}.exr")
            pixels = np.empty(WIDTH * HEIGHT * 4, np.float32)
            image.pixels.foreach_get(pixels)
            bpy.data.images.remove(image)
            depth = pixels.reshape(HEIGHT, WIDTH, 4)[::-1, :, 0]
            np.savez_compressed(out / f"{Path(shot.name).stem}.npz", depth=depth)


def build_cloud(shots: list[Shot], depth_folder: Path, path: Path) -> None:
    """Write the truth cloud from the depth maps of shots."""
    depths = []
    for shot in shots:
        with np.load(depth_folder / f"{Path(shot.name).stem}.npz") as data:
            depths.append(data["depth"])
    cloud = make_cloud(shots, depths, FOCAL)
    np.savez_compressed(path, **cloud)
    print(f"{len(cloud['views'])} points, {path.stat().st_size / 1e6:.2f} MB")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("photos", "depth", "cloud"))
    parser.add_argument("--out", type=Path, help="photos: the site's folder; depth and cloud: that of the depth maps")
    parser.add_argument("--photos", type=int, nargs="+", help="numbers of the photos to render (default: all)")
    parser.add_argument("--samples", type=int, default=4, help="rays a pixel of the photos (default: 4)")
    arguments = parser.parse_args()
    shots = flight()
    chosen = [shot for i, shot in enumerate(shots, 1) if not arguments.photos or i in arguments.photos]
    if arguments.what == "photos":
        out = arguments.out or TULOU
        write_model(shots, WIDTH, HEIGHT, FOCAL, out / "truth")
        render_photos(chosen, out, arguments.samples)
    elif arguments.what == "depth":
        if arguments.out is None:
            parser.error("depth needs --out")
        render_depths(chosen, arguments.out)
    else:
        with tempfile.TemporaryDirectory() as scratch:
            folder = arguments.out or Path(scratch)
            if arguments.out is None:
                render_depths(shots, folder)
            build_cloud(shots, folder, TULOU / "truth" / "cloud.npz")


if __name__ == "__main__":
    main()
