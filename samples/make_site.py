# SPDX-License-Identifier: GPL-3.0-or-later
"""Make the sample site: `python samples/make_site.py photos|depth|cloud|looks|nadir [--out DIR] [--photos 1 2 ...]`.

photos  renders the drone photos and writes the true poses (default: samples/tulou)
depth   writes each photo's exact z-depth as DIR/NAME.npz: key `depth`, (H, W) float32 metres, 0 in the sky
cloud   rebuilds truth/cloud.npz from depth maps (DIR as made by `depth`; made in a temporary folder if left out)
looks   renders truth/looks, the views that no photo has, for evaluation.looks
nadir   renders the second flight, straight down with targets on the ground to DIR
nadir-small  makes the samples/tulou_nadir that is kept, two thirds as large, of the second flight in DIR
nadir-depth  writes the z-depth of its pinhole pictures, as `depth` does (see tulou/README.md)

Needs Python 3.11 with bpy 4.5, numpy and pillow; the second flight also scipy, opencv and pycolmap.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from datetime import datetime
from pathlib import Path

import bpy
import numpy as np
from nadir_flight import (
    LENS,
    PINHOLE_FOCAL,
    PINHOLE_HEIGHT,
    PINHOLE_WIDTH,
    nadir_flight,
    photograph,
)
from PIL import Image
from site_flight import LATITUDE, LONGITUDE, TAKE_OFF, UTC_OFFSET, Shot, develop, flight, save_photo
from site_looks import FOCAL as LOOKS_FOCAL
from site_looks import HEIGHT as LOOKS_HEIGHT
from site_looks import UNIT, looks, packed, write_picture
from site_looks import WIDTH as LOOKS_WIDTH
from site_scene import (
    FOCAL,
    HEIGHT,
    WIDTH,
    aim,
    build_scene,
    set_camera,
    set_depth_renderer,
    set_photo_renderer,
    sun_direction,
)
from site_targets import add_targets, marks, shrink_targets, write_targets
from site_truth import make_cloud, write_model

SMALL = 2 / 3  # of the second flight's photos, as it is kept with the sample
TULOU = Path(__file__).resolve().parent / "tulou"


def make_scene(time: datetime = TAKE_OFF) -> bpy.types.Scene:
    return build_scene(sun_direction(LATITUDE, LONGITUDE, time - UTC_OFFSET))


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


def render_nadir(chosen: set[int], out: Path, samples: int) -> None:
    """Render the second flight to out: photos and photos_rtk (the same pictures), targets and truth."""
    recorded = nadir_flight()
    shots = recorded["standard"]
    scene = make_scene(shots[0].time)
    points = add_targets(scene)
    write_targets(points, marks(scene, points, shots), out / "targets")
    write_model(shots, f"OPENCV {WIDTH} {HEIGHT} {LENS.colmap()}", out / "truth")
    set_photo_renderer(scene, samples)
    set_camera(scene, PINHOLE_FOCAL, PINHOLE_WIDTH, PINHOLE_HEIGHT)
    folders = {"standard": out / "photos", "rtk": out / "photos_rtk"}
    for folder in folders.values():
        folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        for i in sorted(chosen or range(1, len(shots) + 1)):
            start, shot = time.monotonic(), shots[i - 1]
            aim(scene, shot.cam_from_world)
            scene.render.filepath = f"{scratch}/render.png"
            bpy.ops.render.render(write_still=True)
            picture = photograph(np.asarray(Image.open(scene.render.filepath).convert("RGB")))
            picture = develop(picture, shot)
            for kind, folder in folders.items():
                save_photo(picture, recorded[kind][i - 1], folder / shot.name)
            print(f"{shot.name}: {time.monotonic() - start:.1f} s", flush=True)


def shrink_nadir(folder: Path, out: Path) -> None:
    """Make the second flight in `folder` SMALL as large: photos, targets with their marks, truth."""
    (out / "photos").mkdir(parents=True, exist_ok=True)
    shots, small = nadir_flight()["standard"], (round(WIDTH * SMALL), round(HEIGHT * SMALL))
    for shot in shots:
        picture = Image.open(folder / "photos" / shot.name).resize(small, Image.Resampling.LANCZOS)
        save_photo(np.asarray(picture), shot, out / "photos" / shot.name)
    write_model(shots, f"OPENCV {small[0]} {small[1]} {LENS.scaled(SMALL).colmap()}", out / "truth")
    shrink_targets(folder / "targets", out / "targets", SMALL)


def render_depths(
    shots: list[Shot], out: Path, focal: float = FOCAL, width: int = WIDTH, height: int = HEIGHT, targets: bool = False
) -> None:
    """Write the depth maps of shots to out."""
    out.mkdir(parents=True, exist_ok=True)
    scene = make_scene()
    if targets:
        add_targets(scene)
    set_depth_renderer(scene)
    set_camera(scene, focal, width, height)
    with tempfile.TemporaryDirectory() as scratch:
        for shot in shots:
            aim(scene, shot.cam_from_world)
            scene.render.filepath = f"{scratch}/{shot.name}.exr"
            bpy.ops.render.render(write_still=True)
        for shot in shots:  # in a second round: loading an image makes Cycles build its scene anew
            depth = read_exr(f"{scratch}/{shot.name}.exr", width, height)
            np.savez_compressed(out / f"{Path(shot.name).stem}.npz", depth=depth)


def read_exr(path: str, width: int, height: int) -> np.ndarray:
    """The first channel (H, W) float32 of an EXR, row 0 at the top."""
    image = bpy.data.images.load(path)
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(height, width, 4)[::-1, :, 0]


def render_looks(out: Path) -> None:
    """Render the views that no photo has: out/NN.jpg, and their exact depth and poses in out/looks.npz."""
    out.mkdir(parents=True, exist_ok=True)
    poses = looks()
    scene = make_scene()
    with tempfile.TemporaryDirectory() as scratch:
        for kind, suffix in ((lambda: set_photo_renderer(scene, 4), "png"), (lambda: set_depth_renderer(scene), "exr")):
            kind()
            set_camera(scene, LOOKS_FOCAL, LOOKS_WIDTH, LOOKS_HEIGHT)
            for number, cam_from_world in enumerate(poses):
                aim(scene, cam_from_world)
                scene.render.filepath = f"{scratch}/{number}.{suffix}"
                bpy.ops.render.render(write_still=True)
        depths = []
        for number, cam_from_world in enumerate(poses):
            write_picture(f"{scratch}/{number}.png", str(out / f"{number + 1:02d}.jpg"))
            depths.append(packed(read_exr(f"{scratch}/{number}.exr", LOOKS_WIDTH, LOOKS_HEIGHT), cam_from_world))
    np.savez_compressed(out / "looks.npz", depth=np.stack(depths), unit=np.float64(UNIT), cam_from_world=poses,
                        focal=np.float64(LOOKS_FOCAL))


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
    parser.add_argument("what", choices=("photos", "depth", "cloud", "looks", "nadir", "nadir-small", "nadir-depth"))
    parser.add_argument("--out", type=Path, help="photos: the site's folder; depth and cloud: that of the depth maps")
    parser.add_argument("--photos", type=int, nargs="+", help="numbers of the photos to render (default: all)")
    parser.add_argument("--samples", type=int, default=4, help="rays a pixel of the photos (default: 4)")
    arguments = parser.parse_args()
    shots = flight()
    chosen = [shot for i, shot in enumerate(shots, 1) if not arguments.photos or i in arguments.photos]
    if arguments.what == "photos":
        out = arguments.out or TULOU
        lens = f"PINHOLE {WIDTH} {HEIGHT} {FOCAL} {FOCAL} {WIDTH / 2} {HEIGHT / 2}"
        write_model(shots, lens, out / "truth")
        render_photos(chosen, out, arguments.samples)
    elif arguments.what == "looks":
        render_looks(arguments.out or TULOU / "truth" / "looks")
    elif arguments.what != "cloud":
        if arguments.out is None:
            parser.error(f"{arguments.what} needs --out")
        if arguments.what == "depth":
            render_depths(chosen, arguments.out)
        elif arguments.what == "nadir":
            render_nadir(set(arguments.photos or ()), arguments.out, arguments.samples)
        elif arguments.what == "nadir-small":
            shrink_nadir(arguments.out, TULOU.with_name("tulou_nadir"))
        else:
            shots = [s for i, s in enumerate(nadir_flight()["rtk"], 1) if not arguments.photos or i in arguments.photos]
            render_depths(shots, arguments.out, PINHOLE_FOCAL, PINHOLE_WIDTH, PINHOLE_HEIGHT, targets=True)
    else:
        with tempfile.TemporaryDirectory() as scratch:
            folder = arguments.out or Path(scratch)
            if arguments.out is None:
                render_depths(shots, folder)
            build_cloud(shots, folder, TULOU / "truth" / "cloud.npz")


if __name__ == "__main__":
    main()
