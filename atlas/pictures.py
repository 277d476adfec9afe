# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of strangers: what their bytes say they are, no larger than a page shows, and without metadata that nobody
asked for. Sizes are read from the header before anything is unpacked."""

from __future__ import annotations

import io
import struct
import threading

from PIL import Image

from curecon_blender.core.base.language import Text

MOST_PICTURE = 8 << 20  # bytes
_SIDE, _PIXELS = 8192, 1 << 24
_SMALL, _MOST_PACKED = 1 << 20, 250  # pixels; of larger JPEG, pixels a byte
# JPEG: what comes between a picture's start and its data. Pictures that *Publish* writes have JFIF alone; EXIF, XMP and
# IPTC are APP1 and APP13, comments COM.
_FRAMES = {0xC0, 0xC1, 0xC2}
_PLAIN = {0xC4, 0xDA, 0xDB, 0xDD, 0xE0, 0xEE}  # tables, scan, JFIF, Adobe's colour transform
_METADATA = {0xE1: "EXIF or XMP", 0xE2: Text("a colour profile or others' data"), 0xED: "IPTC", 0xFE: Text("a comment")}
_OTHERS = Text("others' data")
_SCANS = 200
_WEBP = {b"VP8 ", b"VP8L", b"VP8X", b"ALPH"}
_at_once = threading.Semaphore(2)


def jpeg(content: bytes, *, metadata: bool) -> int:
    """The pixels of a JPEG; it has EXIF, XMP or a comment only where `metadata` may be. Raises ValueError."""
    if content[:3] != b"\xff\xd8\xff":
        raise ValueError("no JPEG")
    position, size, scans = 2, None, 0
    while True:
        position = _marker(content, position)
        marker = content[position]
        position += 1
        if marker == 0xD9:
            break
        (length,) = struct.unpack_from(">H", content, position)
        if length < 2 or position + length > len(content):
            raise ValueError("it is cut short")
        if marker in _FRAMES:
            height, width = struct.unpack_from(">HH", content, position + 3)
            size = width, height
        elif marker in _METADATA or marker >= 0xE0:
            if not (metadata or marker in _PLAIN):
                raise ValueError(Text("it carries {}, which may tell the place", _METADATA.get(marker, _OTHERS)))
        elif marker not in _PLAIN:
            raise ValueError("a kind of JPEG that browsers do not show")
        position += length
        if marker == 0xDA:
            scans += 1
            if scans > _SCANS:
                raise ValueError("more scans than any picture has")
            position = _past_scan(content, position)
    if position != len(content):
        raise ValueError("bytes behind the picture's end")
    if size and size[0] * size[1] > max(_SMALL, _MOST_PACKED * len(content)):
        raise ValueError("far fewer bytes than a picture of that size has")
    return _unpacked(content, size, "JPEG")


def _marker(content: bytes, position: int) -> int:
    """Where the next marker's kind stands."""
    if position + 1 >= len(content) or content[position] != 0xFF:
        raise ValueError("it is cut short, or damaged")
    return position + 1


def _past_scan(content: bytes, position: int) -> int:
    while True:
        position = content.find(b"\xff", position)
        if position < 0 or position + 1 >= len(content):
            raise ValueError("it is cut short")
        if content[position + 1] not in (0, *range(0xD0, 0xD8)):
            return position
        position += 2


def webp(content: bytes) -> int:
    """The pixels of a WebP without metadata, as a tile's texture is. Raises ValueError."""
    if (
        content[:4] != b"RIFF"
        or content[8:12] != b"WEBP"
        or struct.unpack_from("<I", content, 4)[0] + 8 != len(content)
    ):
        raise ValueError("a texture that is no WebP")
    position = 12
    while position < len(content):
        if position + 8 > len(content):
            raise ValueError("a texture that is cut short")
        kind, length = struct.unpack_from("<4sI", content, position)
        if kind not in _WEBP:
            raise ValueError("a texture with metadata or others' data")
        position += 8 + length + length % 2
    if position != len(content):
        raise ValueError("a texture that is cut short")
    return _unpacked(content, None, "WEBP")


def _unpacked(content: bytes, size: tuple[int, int] | None, kind: str) -> int:
    """The pixels of the one picture that the decoder finds in it: no more than there may be, and of `size` where that
    is known."""
    try:
        with _at_once, Image.open(io.BytesIO(content), formats=[kind]) as image:  # reads the header alone
            width, height = image.size
            if not (0 < width <= _SIDE and 0 < height <= _SIDE and width * height <= _PIXELS):
                raise ValueError(Text("it has {} x {} pixels; {} a side are the most", width, height, _SIDE))
            if (size and size != image.size) or getattr(image, "n_frames", 1) != 1:
                raise ValueError("it is not the picture that its header tells of")
            image.load()
            return int(width * height)
    except (OSError, SyntaxError, Image.DecompressionBombError) as error:
        raise ValueError("it cannot be opened") from error
