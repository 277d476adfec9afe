# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Seconds and peak memory of every stage against the number of photos, and against their size.

    python -m benchmarks.scale flights --assets DIR --out DIR [--counts 30 60 120 240] [--seed 1]
    python -m benchmarks.scale megapixels --photos DIR --out DIR [--megapixels 48 100] [--quality standard]
    python -m benchmarks.scale fusion --workspace DIR --out DIR [--megapixels 48] [--memory 2 6]

`flights` draws flights of the training scenes that differ in their size alone: a grid of strips flown twice, crosswise,
at one height and overlap, so that twice the photos see twice the ground. `megapixels` enlarges a few photos. Both write
JPEGs with a drone's EXIF and XMP and run the worker as a user would; the figures are the worker's own summary. `fusion`
enlarges a finished workspace's depth maps and fuses them with several memory budgets: what that takes without the hours
of the depth stage.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image

from curecon_blender.core.base.allocator import release, use_large_pages
from curecon_blender.core.base.images import read_rgb, write_jpeg
from curecon_blender.core.base.memory import budget
from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.base.options import Options
from curecon_blender.core.base.records import Component
from curecon_blender.core.cloud import fuse as fusion
from curecon_blender.core.depth.maps import read_depth, write_depth
from curecon_blender.core.run.peak_memory import PeakMemory
from curecon_blender.core.views import record as views_record
from samples.site_flight import TAKE_OFF, Shot, geodetic, pose, save_photo

SIZE = (768, 576)  # pixels of a drawn photo
FIELD_OF_VIEW = 72.0  # degrees over the longer side
CLEARANCE = 22.0  # metres of the flight above the tallest building
FORWARD, SIDE = 0.8, 0.7  # overlap
PITCH = -72.0  # degrees: walls are seen too
GPS_ERROR = 0.3  # metres


def grid(count: int, height: float, seed: int) -> list[Shot]:
    """A flight of `count` photos, half in strips to the north and south, half to the east and west; metres, Z up."""
    rng = np.random.default_rng(seed)
    across = 2 * height * np.tan(np.radians(FIELD_OF_VIEW / 2))
    step_along, step_across = (1 - FORWARD) * across * SIZE[1] / SIZE[0], (1 - SIDE) * across
    each = (count + 1) // 2
    strips = max(1, round(np.sqrt(each * step_along / step_across)))
    eyes, yaws = [], []
    for number in range(count):
        cross, place = divmod(number, each)
        strip, along = divmod(place, -(-each // strips))
        back = strip % 2 == 1
        x = (strip - (strips - 1) / 2) * step_across
        y = (along - (each / strips - 1) / 2) * step_along * (-1 if back else 1)
        eyes.append([y, -x, height] if cross else [x, y, height])
        yaws.append(90.0 * cross + 180.0 * back)
    flown = np.array(eyes) + rng.normal(0, 0.25, (count, 3))
    told = geodetic(flown + rng.normal(0, GPS_ERROR, (count, 3)))
    shots = []
    for i, eye in enumerate(flown):
        yaw, pitch, roll = yaws[i] + rng.normal(0, 1.0), PITCH + rng.normal(0, 0.6), rng.normal(0, 0.5)
        shots.append(Shot(
            name=f"DJI_{i + 1:04d}.JPG", cam_from_world=pose(eye, yaw, pitch, roll), yaw=yaw, pitch=pitch, roll=roll,
            time=TAKE_OFF + timedelta(seconds=3 * i), latitude=told[i, 0], longitude=told[i, 1], altitude=told[i, 2],
        ))
    return shots


def draw(assets: Path, counts: list[int], seed: int, out: Path) -> None:
    """A folder of photos for every count that has none yet, `out/COUNT/photos`."""
    from training.assets import Assets, Material
    from training.generator import photograph
    from training.renderer import Renderer
    from training.scene import compose

    if all((out / str(count) / "photos").is_dir() for count in counts):
        return
    loaded = Assets(assets)
    rng = np.random.default_rng([seed, 2])
    world = compose(loaded, rng, False)
    # Ground that repeats every few metres would join photos of different places: aerial photos, each laid out once.
    aerial = [name for name in loaded.names("texture") if "uav_" in name]
    first, *others = (str(name) for name in rng.choice(aerial, 3, replace=False))
    ground = Material(first, blend=(others[0], others[1]), tiles=(140.0, 170.0, 120.0))
    terrain = replace(world.instances[-1], meshes=(world.terrain.mesh(ground),))
    world = replace(world, instances=(*world.instances[:-1], terrain), detail=replace(world.detail, strength=0.15))
    renderer = Renderer(loaded)
    renderer.upload(world)
    focal = SIZE[0] / 2 / np.tan(np.radians(FIELD_OF_VIEW / 2))
    K = np.array([[focal, 0, SIZE[0] / 2], [0, focal, SIZE[1] / 2], [0, 0, 1]])
    middle = world.site.centre
    for count in counts:
        folder = out / str(count) / "photos"
        if folder.is_dir():
            continue
        shots = grid(count, world.site.height + CLEARANCE, seed)
        drawn = []
        for shot in shots:
            from_flight = shot.cam_from_world[:3]
            moved = np.column_stack([from_flight[:, :3], from_flight[:, 3] - from_flight[:, :3] @ middle])
            drawn.append(renderer.render(K, moved, SIZE)[0][..., :3])
        folder.mkdir(parents=True)
        for shot, picture in zip(shots, photograph(np.random.default_rng(seed), drawn), strict=True):
            save_photo(picture, shot, folder / shot.name)
            _set_focal(folder / shot.name, focal)


def _set_focal(photo: Path, focal: float) -> None:
    """Write the drawn lens into a photo's EXIF: the 35 mm equivalent over the diagonal."""
    with Image.open(photo) as image:
        exif, xmp = image.getexif(), image.info["xmp"]
        exif.get_ifd(0x8769)[41989] = round(focal / np.hypot(*image.size) * np.hypot(36, 24))
        image.save(photo, quality="keep", exif=exif, xmp=xmp)


def enlarge(photos: Path, megapixels: float, folder: Path) -> None:
    """The photos of a folder at so many megapixels, with their EXIF and XMP, the size in it made true."""
    folder.mkdir(parents=True)
    for path in sorted(photos.iterdir()):
        with Image.open(path) as image:
            exif, xmp = image.getexif(), image.info.get("xmp", b"")
            scale = np.sqrt(megapixels * 1e6 / (image.width * image.height))
            size = round(image.width * scale), round(image.height * scale)
            exif.get_ifd(0x8769).update({40962: size[0], 40963: size[1]})
            larger = cv2.resize(np.asarray(image.convert("RGB")), size, interpolation=cv2.INTER_CUBIC)
            Image.fromarray(larger).save(folder / path.name, quality=90, exif=exif, xmp=xmp)


def run(folder: Path, quality: str, until: str) -> dict[str, Any]:
    """The worker's summary of a job over `folder/photos` in `folder/workspace`."""
    done = subprocess.run(
        [sys.executable, "-m", "curecon_blender.core", "reconstruct", str(folder / "photos"), "--workspace",
         str(folder / "workspace"), "--quality", quality, "--until", until, "--json"],
        stdout=subprocess.PIPE, text=True, check=True,
    )
    summary: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    return summary


def enlarge_depth(workspace: Path, megapixels: float, out: Path) -> Component:
    """The first component of a finished workspace in `out`, its depth maps and pictures at so many megapixels."""
    component = views_record.read(workspace)[0]
    (out / "undistorted").mkdir(parents=True)
    views = []
    for view in component.views:
        scale = np.sqrt(megapixels * 1e6 / (view.width * view.height))
        width, height = round(view.width * scale), round(view.height * scale)
        K = view.K * [[width / view.width], [height / view.height], [1]]
        larger = replace(view, width=width, height=height, K=K)
        depth, confidence = (cv2.resize(values.astype(np.float32), (width, height)) for values in
                             read_depth(workspace, view))
        write_depth(out, larger, depth, confidence)
        write_jpeg(out / view.image, cv2.resize(read_rgb(workspace / view.image), (width, height)))
        views.append(larger)
    component = replace(component, cloud="cloud.ply", views=tuple(views))
    views_record.write(out, [component])
    return component


def time_fusion(component: Component, workspace: Path, memory: float) -> str:
    """A line of a Markdown table: budget, bands of the first photo, points, seconds, GiB, and GiB predicted."""
    options = Options(photos=None, workspace=workspace, memory_gib=memory)
    sizes = [view.width * view.height for view in component.views]
    bands = -(-sizes[0] // fusion.plan(sizes, budget(options)).band)
    release()
    with PeakMemory() as before:
        pass
    with PeakMemory() as peak:
        started = time.perf_counter()
        points = fusion.fuse(component, workspace, options, Reporter())
        seconds = time.perf_counter() - started
    predicted = fusion.peak_bytes(sizes, budget(options)) / 2**30
    took = (peak.bytes - before.bytes) / 2**30
    return f"| {memory:g} | {bands} | {points:,} | {seconds:.0f} | {took:.2f} | {predicted:.2f} |"


def row(name: str, summary: dict[str, Any]) -> str:
    """A line of a Markdown table: photos placed, points, seconds / GiB of each stage, GiB on disk."""
    stages = [f"{seconds:.0f} / {summary['peak_memory_gib'][stage]:.2f}"
              for stage, seconds in summary["seconds"].items()]
    cells = [name, f"{summary['registered']} of {summary['photos']}", f"{summary['points']:,}", *stages,
             f"{summary['workspace_gib']:.2f}"]
    return f"| {' | '.join(cells)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description="Seconds and memory of every stage by the photos' number and size.")
    commands = parser.add_subparsers(dest="command", required=True)
    flights = commands.add_parser("flights", help="30 to 240 drawn photos")
    flights.add_argument("--assets", type=Path, required=True, help="folder of the training scenes' assets")
    flights.add_argument("--counts", type=int, nargs="+", default=[30, 60, 120, 240])
    flights.add_argument("--seed", type=int, default=1)
    sizes = commands.add_parser("megapixels", help="a few photos, enlarged")
    sizes.add_argument("--photos", type=Path, required=True, help="folder of the photos to enlarge")
    sizes.add_argument("--megapixels", type=float, nargs="+", default=[48, 100])
    fusing = commands.add_parser("fusion", help="a finished workspace's depth maps, enlarged")
    fusing.add_argument("--workspace", type=Path, required=True, help="a finished workspace")
    fusing.add_argument("--out", type=Path, required=True)
    fusing.add_argument("--megapixels", type=float, default=48)
    fusing.add_argument("--memory", type=float, nargs="+", default=[2, 6], help="budgets in GiB")
    for command, until in ((flights, "fusion"), (sizes, "texture")):
        command.add_argument("--out", type=Path, required=True)
        command.add_argument("--quality", default="preview")
        command.add_argument("--until", default=until)
    options = parser.parse_args()
    if options.command == "fusion":
        component = enlarge_depth(options.workspace, options.megapixels, options.out)
        for memory in options.memory:
            print(time_fusion(component, options.out, memory), flush=True)
        return
    if options.command == "flights":
        draw(options.assets, options.counts, options.seed, options.out)
        names = [str(count) for count in options.counts]
    else:
        names = [f"{megapixels:g}" for megapixels in options.megapixels]
        for name, megapixels in zip(names, options.megapixels, strict=True):
            if not (options.out / name / "photos").is_dir():
                enlarge(options.photos, megapixels, options.out / name / "photos")
    for name in names:
        print(row(name, run(options.out / name, options.quality, options.until)), flush=True)


if __name__ == "__main__":
    use_large_pages()
    main()
