# SPDX-License-Identifier: GPL-3.0-or-later
"""A picture of some scenes, to look at: one row a scene, colours and depth of a few views.

python -m training.contact_sheet --assets DIR --out sheet.png --count 8 --start-seed 0
"""

import argparse
from pathlib import Path

import cv2
import numpy as np

from training.generator import Generator, Scene


def row(scene: Scene, columns: int) -> np.ndarray:
    """(H, 2*columns*W, 3) uint8: `columns` views, each its colours with the sparse points' depth map beside it."""
    parts = []
    views = np.linspace(0, len(scene.images) - 1, columns).round().astype(int)
    for v in views:
        depth = scene.depth[v]
        near, far = np.percentile(depth[depth > 0], [1, 98])
        level = np.clip((1 / np.maximum(depth, 1e-3) - 1 / far) / (1 / near - 1 / far), 0, 1)
        colours = cv2.applyColorMap((255 * level).astype(np.uint8), cv2.COLORMAP_TURBO)[..., ::-1]
        parts += [scene.images[v], np.where(depth[..., None] > 0, colours, 0)]
    return np.concatenate(parts, axis=1)


def main() -> None:
    parser = argparse.ArgumentParser(description="Write a contact sheet of scenes.")
    parser.add_argument("--assets", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--count", type=int, default=8)
    parser.add_argument("--start-seed", type=int, default=0)
    parser.add_argument("--columns", type=int, default=2, help="views shown of each scene")
    parser.add_argument("--size", default="384x288", help="WIDTHxHEIGHT in pixels")
    parser.add_argument("--held-out", action="store_true")
    options = parser.parse_args()
    width, height = (int(n) for n in options.size.split("x"))
    generator = Generator(options.assets)
    rows = []
    for seed in range(options.start_seed, options.start_seed + options.count):
        scene = generator.generate(seed, (width, height), held_out=options.held_out)
        near = scene.depth[scene.depth > 0].min()
        print(
            f"seed {seed}: {scene.kind}, nearest {near:.1f} m, {len(scene.points)} points, "
            f"track length {scene.visible.sum() / len(scene.points):.1f}"
        )
        rows.append(row(scene, options.columns))
    cv2.imwrite(str(options.out), np.concatenate(rows)[..., ::-1])


if __name__ == "__main__":
    main()
