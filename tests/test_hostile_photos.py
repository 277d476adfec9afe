# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures and metadata that a stranger made to do harm, and what the pictures that we make tell of a place."""

from __future__ import annotations

import os
import struct
import sys
import time
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hostile import refused
from PIL import Image

from curecon_blender.core.base import images
from curecon_blender.core.base.errors import PhotoError
from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.photos.check import check_photos
from curecon_blender.core.photos.metadata import read_metadata
from curecon_blender.core.photos.record import read_photos, write_photos
from tests.fuzz import photo_targets


def png(width: int, height: int) -> bytes:
    """A black picture of one bit a pixel, packed as tightly as it goes."""
    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    rows = bytes((1 + -(-width // 8)) * height)
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">2I5B", width, height, 1, 0, 0, 0, 0))
            + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))


@pytest.mark.parametrize(("width", "height"), [(20_000, 20_000), (2_000_000, 100), (1_000_000_000, 1_000_000_000)])
def test_a_picture_that_unpacks_to_gigabytes(tmp_path: Path, width: int, height: int) -> None:
    path = tmp_path / "bomb.png"
    path.write_bytes(png(width, min(height, 20_000)) if width < 1e9 else png(8, 8).replace(
        struct.pack(">2I", 8, 8), struct.pack(">2I", width, height)))
    refused(PhotoError, path, lambda: images.read_rgb(path))


def test_a_jpeg_of_endless_scans(tmp_path: Path) -> None:
    path = tmp_path / "scans.jpg"
    Image.new("RGB", (3000, 2000)).save(path, progressive=True)
    content = path.read_bytes()
    last = content.rindex(b"\xff\xda")
    path.write_bytes(content[:last] + content[last:-2] * 5000 + content[-2:])
    refused(PhotoError, path, lambda: images.read_rgb(path))


def jpeg(path: Path, *, exif: bytes = b"", xmp: bytes = b"") -> Path:
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (240, 320, 3), np.uint8)).save(path)
    content = path.read_bytes()
    for block in ((b"Exif\0\0" + exif if exif else b""), (b"http://ns.adobe.com/xap/1.0/\0" + xmp if xmp else b"")):
        if block:
            content = photo_targets.with_block(content, 0xE1, block)
    path.write_bytes(content)
    return path


def tiff(*directories: list[tuple[int, int, int, int]], following: int = 0) -> bytes:
    """Directories of entries (tag, type, count, value); each is followed by the one at `following`."""
    block = b"II*\0\x08\0\0\0"
    for entries in directories:
        block += struct.pack("<H", len(entries)) + b"".join(struct.pack("<HHII", *entry) for entry in entries)
        block += struct.pack("<I", following)
    return block


@pytest.mark.parametrize("exif", [
    tiff([(0x8769, 4, 1, 8), (0x8825, 4, 1, 8)], following=8),  # directories in a circle
    tiff([(0x8825, 4, 1, 0xFFFFFFF0)]), tiff([(0x010F, 2, 0xFFFFFFFF, 8)]), b"II*\0\x08\0\0\0\xff\xff",
    b"MM", b"II*\0" * 9,
    tiff([(0x920A, 5, 1, 8), (0xA405, 3, 1, 0)]), tiff([(0x0112, 3, 1, 60_000)]),
    tiff([(0x8825, 4, 1, 26)], [(1, 2, 2, ord("N")), (2, 5, 3, 200), (3, 2, 2, ord("E")), (4, 5, 3, 200)]),
], ids=range(9))
def test_exif_that_leads_nowhere_loses_only_itself(tmp_path: Path, exif: bytes) -> None:
    told = read_metadata(jpeg(tmp_path / "x.jpg", exif=exif))
    assert told.gps is None and told.focal_px is None
    assert images.read_rgb(tmp_path / "x.jpg").size == 240 * 320 * 3


LAUGHS = ('<!DOCTYPE x [<!ENTITY a "ha">' + "".join(
    f'<!ENTITY {chr(98 + i)} "{f"&{chr(97 + i)};" * 10}">' for i in range(9)) + "]>")


@pytest.mark.parametrize("spoil", [
    lambda text: text.replace("<x:xmpmeta", LAUGHS + "<x:xmpmeta").replace("+349.58", "&j;"),
    lambda text: LAUGHS + text.replace("x:xmpmeta", "y").replace("+349.58", "&j;"),
    lambda text: '<!DOCTYPE y [<!ENTITY j SYSTEM "file:///etc/passwd">]>' + text.replace("x:xmpmeta", "y"),
    lambda text: "<a>" * 20_000, lambda text: text.replace("+349.58", "1e999").replace("+44.47", "nan"),
    lambda text: text.replace("45.03", "-1e308").replace("349", "9" * 60),
])
def test_xmp_that_expands_or_counts_beyond_reach_tells_nothing(tmp_path: Path, spoil: Callable[[str], str]) -> None:
    started = time.process_time()
    told = read_metadata(jpeg(tmp_path / "x.jpg", xmp=spoil(photo_targets.XMP).encode()))
    assert told.gps is None or told.gps.altitude is None
    assert told.relative_altitude is None or told.relative_altitude == 44.47
    assert time.process_time() - started < 5


@pytest.mark.parametrize(("tag", "value"), [(0x9011, "+99:99"), (0x9003, "0001:01:01 00:00:00")])
def test_a_cameras_clock_that_was_never_set(tmp_path: Path, tag: int, value: str) -> None:
    exif = Image.Exif()
    exif.get_ifd(0x8769).update({0x9003: "2026:01:26 13:50:17", tag: value})
    Image.new("RGB", (320, 240)).save(tmp_path / "x.jpg", exif=exif)
    told = read_metadata(tmp_path / "x.jpg")
    assert told.time == (None if tag == 0x9003 else "2026-01-26T13:50:17")


def test_a_camera_named_in_control_characters(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif.update({0x010F: "D\x1b[2J\x07JI" + "x" * 10_000})
    Image.new("RGB", (320, 240)).save(tmp_path / "x.jpg", exif=exif)
    camera = read_metadata(tmp_path / "x.jpg").camera
    assert camera.startswith("D[2JJIxx") and len(camera) == 100


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has names that are no text")
def test_a_photo_whose_name_is_no_text_is_left_out(tmp_path: Path) -> None:
    folder = tmp_path / "photos"
    folder.mkdir()
    for number in range(3):
        pixels = np.random.default_rng(number).integers(0, 255, (240, 320, 3), np.uint8)
        Image.fromarray(pixels).save(folder / f"{number}.jpg")
    os.rename(os.fsencode(folder) + b"/2.jpg", os.fsencode(folder) + b"/\xff\xfe.jpg")
    (folder / "3.jpg").write_bytes((folder / "0.jpg").read_bytes() + b"x")
    pixels = np.random.default_rng(9).integers(0, 255, (240, 320, 3), np.uint8)
    Image.fromarray(pixels).save(folder / "4.jpg")
    Image.fromarray(pixels[::-1]).save(folder / "5.jpg")
    photo_set = check_photos(folder, Reporter())
    assert len(photo_set.photos) == 4
    assert any("no text" in skip.reason for skip in photo_set.skipped)
    write_photos(tmp_path, photo_set)
    assert read_photos(tmp_path) == photo_set


def test_pictures_that_the_stages_make_carry_no_metadata(tmp_path: Path) -> None:
    tags = Image.Exif()
    tags.get_ifd(0x8825).update({1: "N", 2: (24.0, 39.0, 29.9), 3: "E", 4: (117.0, 3.0, 7.5)})
    photo, made = tmp_path / "photo.jpg", tmp_path / "made.jpg"
    Image.new("RGB", (320, 240)).save(photo, exif=tags, xmp=photo_targets.XMP.encode())
    images.write_jpeg(made, images.read_rgb(photo))
    with Image.open(made) as image:
        assert not image.getexif() and not {"exif", "xmp", "comment", "icc_profile"} & set(image.info)
