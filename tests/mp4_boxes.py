# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Videos whose index is changed, as no writer here can make them: with a track of subtitles, or of a varying rate."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path


def boxes(content: bytes) -> list[tuple[bytes, bytes]]:
    found, place = [], 0
    while place < len(content):
        size, kind = struct.unpack_from(">I4s", content, place)
        found.append((kind, content[place + 8 : place + size]))
        place += size
    return found


def box(kind: bytes, *content: bytes) -> bytes:
    joined = b"".join(content)
    return struct.pack(">I4s", 8 + len(joined), kind) + joined


def changed(content: bytes, path: tuple[bytes, ...], change: Callable[[bytes], bytes]) -> bytes:
    """The boxes of `content`, those at `path` with other content."""
    return b"".join(box(kind, inner if kind != path[0] else change(inner) if len(path) == 1 else
                        changed(inner, path[1:], change)) for kind, inner in boxes(content))


def table(*numbers: int) -> bytes:
    return struct.pack(f">{len(numbers)}I", *numbers)


def with_track(video: Path, texts: list[str], handler: bytes = b"sbtl") -> None:
    """Put a track of timed text into a video, one text a second: at the file's end, so that nothing else moves."""
    content = video.read_bytes()
    assert boxes(content)[-1][0] == b"moov"
    samples = [struct.pack(">H", len(text.encode())) + text.encode() for text in texts]
    index = content.rindex(b"moov") - 4
    data = content[:index] + box(b"mdat", *samples)
    first = index + 8
    kind = box(b"stsd", table(0, 1), box(b"tx3g", bytes(7), b"\1", bytes(30)))
    stbl = box(b"stbl", kind, box(b"stts", table(0, 1, len(texts), 1000)),
               box(b"stsc", table(0, 1, 1, len(texts), 1)), box(b"stsz", table(0, 0, len(texts), *map(len, samples))),
               box(b"stco", table(0, 1, first)))
    media = box(b"mdia", box(b"mdhd", table(0, 0, 0, 1000, 1000 * len(texts), 0)),
                box(b"hdlr", table(0, 0), handler, bytes(13)), box(b"minf", stbl))
    moov = boxes(content)[-1][1] + box(b"trak", media)
    video.write_bytes(data + box(b"moov", moov))
