# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Photos and their metadata, spoiled."""

from __future__ import annotations

import io
import json
import struct
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
from hypothesis import strategies as st
from PIL import Image, PngImagePlugin

from ..dng import write_dng
from .mutations import exif_blocks, spoiled_bytes, spoiled_words
from .target import PHOTO
from .workspace_targets import check_times

RAW = "DJI_0001.dng"
XMP = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    '<rdf:Description xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" drone-dji:AbsoluteAltitude="+349.58" '
    'drone-dji:RelativeAltitude="+44.47" drone-dji:GpsLatitude="45.03" drone-dji:GpsLongitude="-7.62" '
    'drone-dji:GimbalRollDegree="+0.10" drone-dji:GimbalYawDegree="-106.80" drone-dji:GimbalPitchDegree="-89.90" '
    'drone-dji:CalibratedFocalLength="200" drone-dji:DewarpData="2022;197,195,-1,-1,-0.4,0.3,0,0,-0.2"/>'
    "</rdf:RDF></x:xmpmeta>"
)
TAGS = (0x010F, 0x0110, 0x0112, 0x0132, 0x8769, 0x8825, 0x9003, 0x9011, 0x920A, 0xA002, 0xA003, 0xA005, 0xA20E, 0xA210,
        0xA404, 0xA405, 0xA431, 0xA434, 0x829A, 0x9010, 0x9012, 0x9286, 0, 1, 2, 3, 4, 5, 6, 7, 9, 10, 29, 0x02BC,
        0x8773, 0x0100, 0x0101, 0x0111, 0x0117)


def _exif() -> Image.Exif:
    tags = Image.Exif()
    tags.update({0x010F: "DJI", 0x0110: "FC6310", 0x0112: 1})
    tags.get_ifd(0x8769).update({0x9003: "2026:01:26 13:50:17", 0x9011: "+08:00", 0x920A: 8.8, 0xA405: 24})
    tags.get_ifd(0x8825).update({1: "S", 2: (33.0, 51.0, 21.6), 3: "W", 4: (70.0, 30.0, 9.0), 5: b"\0", 6: 349.5})
    return tags


def _picture(form: str) -> bytes:
    """A small photo with EXIF and XMP."""
    pixels = np.random.default_rng(0).integers(0, 255, (14, 16, 3), np.uint8)
    picture = Image.fromarray(pixels).resize((256, 224))
    made = io.BytesIO()
    if form == "PNG":
        text = PngImagePlugin.PngInfo()
        text.add_itxt("XML:com.adobe.xmp", XMP)
        picture.save(made, "PNG", exif=_exif(), pnginfo=text)
    elif form == "TIFF":
        picture.save(made, "TIFF", exif=_exif(), tiffinfo={700: XMP.encode()}, compression="tiff_adobe_deflate")
    else:
        picture.save(made, "JPEG", exif=_exif(), xmp=XMP.encode(), progressive=form == "progressive")
    return made.getvalue()


def with_block(jpeg: bytes, kind: int, payload: bytes) -> bytes:
    """A JPEG with one more segment at its start."""
    payload = payload[:65533]
    return jpeg[:2] + b"\xff" + bytes([kind]) + struct.pack(">H", len(payload) + 2) + payload + jpeg[2:]


def _png_chunk(png: bytes, kind: bytes, payload: bytes) -> bytes:
    """A PNG with one more chunk behind its header, its checksum right."""
    chunk = struct.pack(">I", len(payload)) + kind + payload + struct.pack(">I", zlib.crc32(kind + payload))
    return png[:33] + chunk + png[33:]


def picture_cases(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
    plain = io.BytesIO()
    Image.new("RGB", (256, 224), (90, 120, 30)).save(plain, "JPEG")
    png = _picture("PNG")
    exif = exif_blocks(TAGS)
    return st.tuples(st.just(PHOTO), st.one_of(
        *[spoiled_bytes(_picture(form)) for form in ("JPEG", "progressive", "PNG", "TIFF")],
        exif.map(lambda block: with_block(plain.getvalue(), 0xE1, b"Exif\0\0" + block)),
        exif.map(lambda block: _png_chunk(png, b"eXIf", block)),
        exif,
        st.one_of(spoiled_words(XMP.encode()), spoiled_bytes(XMP.encode())).map(
            lambda text: with_block(plain.getvalue(), 0xE1, b"http://ns.adobe.com/xap/1.0/\0" + text)),
        spoiled_bytes(png[16:29]).map(lambda header: png[:16] + header[:13] + struct.pack(
            ">I", zlib.crc32(png[12:16] + header[:13])) + png[33:]),
        st.binary(max_size=200),
    ))


def make_picture(folder: Path) -> None:
    (folder / PHOTO).write_bytes(_picture("JPEG"))


def make_raw(folder: Path) -> None:
    pixels = np.random.default_rng(0).integers(0, 255, (64, 64, 3), np.uint8)
    write_dng(folder / RAW, pixels.repeat(4, 0).repeat(4, 1), camera={0x9003: (2, "2026:01:26 13:50:17")})


def raw_cases(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
    sound = (folder / RAW).read_bytes()
    return st.tuples(st.just(RAW), st.one_of(
        spoiled_bytes(sound[:700]).map(lambda head: head + sound[len(head) :]), spoiled_bytes(sound),
        exif_blocks(TAGS)))


def check_raw(folder: Path) -> None:
    from curecon_blender.core.photos import check as photos

    photos._examine(folder / RAW)


def check_picture(folder: Path) -> None:
    from curecon_blender.core.base.records import Photo, PhotoSet
    from curecon_blender.core.photos import check as photos
    from curecon_blender.core.photos.record import read_photos, write_photos

    photo = photos._examine(folder / PHOTO)
    if isinstance(photo, Photo):
        photo_set = PhotoSet(photos=tuple(replace(photo, name=f"{i}.jpg") for i in range(3)))
        json.dumps(photos.describe(photo_set), allow_nan=False)
        write_photos(folder, photo_set)
        assert read_photos(folder) == photo_set
        check_times(folder)
