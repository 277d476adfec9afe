# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Raw photos are developed alike, upright and with their metadata; what cannot be is named."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from dng import write_dng
from little_photos import HEIGHT, WIDTH, check, exif, save, scene, sound_folder
from PIL import Image

from curecon_blender.core.base import images

CAMERA = {0x9003: (2, "2026:01:26 13:50:17"), 0x920A: (5, [(88, 10)]), 0xA405: (3, [24])}
GPS = {1: (2, "N"), 2: (5, [(24, 1), (39, 1), (30, 1)]), 3: (2, "E"), 4: (5, [(117, 1), (3, 1), (6, 1)]),
       5: (1, [0]), 6: (5, [(520, 1)])}


def smooth(seed: int = 0) -> np.ndarray:
    """(HEIGHT,WIDTH,3) uint8 without detail that a mosaic loses."""
    return np.asarray(cv2.GaussianBlur(scene(seed), (0, 0), 6))


@pytest.mark.parametrize("bits", [10, 16])
@pytest.mark.parametrize("linear", [False, True])
def test_a_raw_photo_has_the_colours_of_the_scene(tmp_path: Path, bits: int, linear: bool) -> None:
    path = write_dng(tmp_path / "x.dng", smooth(), bits=bits, linear=linear)
    difference = np.abs(images.read_rgb(path).astype(int) - smooth())[8:-8, 8:-8]
    assert difference.mean() < 3 and difference.max() < 16


@pytest.mark.parametrize("turn", [1, 3, 6, 8])
def test_a_raw_photo_is_turned_upright(tmp_path: Path, turn: int) -> None:
    upright = np.ascontiguousarray(np.rot90(smooth(), {1: 0, 3: 2, 6: 3, 8: 1}[turn]))
    path = write_dng(tmp_path / "x.DNG", smooth(), orientation=turn)
    found = images.read_rgb(path)
    assert found.shape == upright.shape
    assert np.abs(found.astype(int) - upright)[8:-8, 8:-8].mean() < 4
    small = images.read_rgb(path, WIDTH // 4)  # developed at half its size
    assert max(small.shape) == WIDTH // 4
    assert np.abs(small.astype(int) - cv2.resize(upright, small.shape[1::-1], interpolation=cv2.INTER_AREA))[
        2:-2, 2:-2].mean() < 4


def test_raw_photos_are_exposed_alike(tmp_path: Path) -> None:
    dark = write_dng(tmp_path / "x.dng", smooth() // 2)
    assert np.abs(images.read_rgb(dark).astype(int) - smooth() // 2)[8:-8, 8:-8].mean() < 3


def test_the_photo_check_takes_raw_photos_with_what_they_tell(tmp_path: Path) -> None:
    for number in range(3):
        write_dng(tmp_path / f"DJI_{number}.DNG", scene(number), camera=CAMERA, gps=GPS)
    photos = check(tmp_path)[0].photos
    assert [photo.name for photo in photos] == ["DJI_0.DNG", "DJI_1.DNG", "DJI_2.DNG"]
    assert photos[0].focal_px == pytest.approx(24 / np.hypot(36, 24) * np.hypot(WIDTH, HEIGHT), rel=0.02)
    assert photos[0].gps is not None and photos[0].gps.latitude == pytest.approx(24.65833, abs=1e-4)
    assert photos[0].time is not None and photos[0].time.startswith("2026-01-26T13:50:17")
    assert not any(photo.blurred or photo.underexposed for photo in photos)


def test_a_raw_beside_the_cameras_own_jpeg_is_the_same_photo(tmp_path: Path) -> None:
    folder = sound_folder(tmp_path)
    for number in (0, 1, 7):
        write_dng(folder / f"DJI_{number}.DNG", scene(number), camera=CAMERA)
    save(folder / "DJI_8.heic", 8, exif=exif())
    write_dng(folder / "DJI_8.dng", scene(8), camera=CAMERA)
    photo_set, warnings = check(folder)
    assert [photo.name for photo in photo_set.photos] == [
        "DJI_0.JPG", "DJI_1.JPG", "DJI_2.JPG", "DJI_7.DNG", "DJI_8.heic"]
    assert not photo_set.skipped and not warnings


def test_what_is_no_raw_photo_or_cut_short_is_left_out_by_its_name(tmp_path: Path) -> None:
    folder = sound_folder(tmp_path)
    (folder / "odd.NEF").write_bytes(b"II*\0" + bytes(5000))
    Image.fromarray(scene(3)).save(folder / "picture.tif")
    (folder / "picture.tif").rename(folder / "picture.ARW")
    write_dng(folder / "short.dng", scene(4), camera=CAMERA, keep=0.6)
    photo_set, warnings = check(folder)
    assert [photo.name for photo in photo_set.photos] == ["DJI_0.JPG", "DJI_1.JPG", "DJI_2.JPG"]
    reasons = {skip.path.name: skip.reason for skip in photo_set.skipped}
    for name in ("odd.NEF", "picture.ARW"):
        assert reasons[name] == f"{name} is no raw photo, or of a camera that is not known here."
    assert "short.dng is damaged or cut short" in reasons["short.dng"]
    assert len(warnings) == 1
    assert "3 raw files that cannot be developed here: odd.NEF, picture.ARW, short.dng. Export" in warnings[0]
    for name in ("odd.NEF", "short.dng"):
        (folder / name).unlink()
    assert check(folder)[1] == [f"Left out: {reasons['picture.ARW']}"]
