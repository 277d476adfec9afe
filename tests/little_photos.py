# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Small photos with detail and a drone's metadata, made for the tests of the photo check."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image

from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.base.records import PhotoSet
from curecon_blender.core.photos.check import check_photos

WIDTH, HEIGHT = 320, 240


def scene(seed: int, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    """(height, width, 3) uint8 with detail at all scales, as ground seen from above has it."""
    rng = np.random.default_rng(seed)
    grids = [rng.random((2 + height // step, 2 + width // step, 3)) for step in (64, 8, 1)]
    layers = [cv2.resize(grid, (width, height)) for grid in grids]
    return np.asarray(255 * np.mean(layers, axis=0), np.uint8)


def exif(
    *, main: dict[int, Any] | None = None, camera: dict[int, Any] | None = None, gps: dict[int, Any] | None = None
) -> Image.Exif:
    """EXIF of a drone's photo; the arguments override tags of its three directories, or take them away with None."""
    tags = Image.Exif()
    settings = {0x9003: "2026:01:26 13:50:17", 0x920A: 8.8, 0xA405: 24, **(camera or {})}
    for directory, values in (
        (tags, {0x010F: "DJI", 0x0110: "FC9999", **(main or {})}), (tags.get_ifd(0x8769), settings),
        (tags.get_ifd(0x8825), gps or {}),
    ):
        directory.update({tag: value for tag, value in values.items() if value is not None})
    return tags


def save(path: Path, seed: int, **options: Any) -> Path:
    Image.fromarray(scene(seed)).save(path, **options)
    return path


def sound_folder(parent: Path) -> Path:
    """A folder of three sound photos."""
    folder = parent / "photos"
    folder.mkdir()
    for number in range(3):
        save(folder / f"DJI_{number}.JPG", number, exif=exif())
    return folder


def check(folder: Path) -> tuple[PhotoSet, list[str]]:
    reporter = Reporter()
    return check_photos(folder, reporter), reporter.warnings
