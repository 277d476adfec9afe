# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The subtitles inside an MP4 or MOV (ISO/IEC 14496-12, timed text 3GPP TS 26.245), in the words of an .SRT."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

MOST_INDEX = 200_000_000  # bytes of a video's index: an hour of 60 frames a second has 10 MB
MOST_SAMPLES, MOST_TEXT = 2_000_000, 200_000_000  # subtitles, and bytes of all of them
_HANDLERS = (b"sbtl", b"text", b"subt")
_HEADER = struct.Struct(">I4s")


class _Damaged(ValueError):
    """A box is missing, or goes beyond what holds it: the track tells nothing."""


def read_track(path: Path) -> str | None:
    """The video's first track of subtitles as the text of an .SRT; None where it has none that can be read."""
    try:
        with open(path, "rb") as file:
            index = _index(file)
            for track in _all(index, b"trak"):
                media = _one(track, b"mdia")
                if _one(media, b"hdlr")[8:12] in _HANDLERS:
                    return _text(file, media)
    except (OSError, ValueError, struct.error, IndexError):
        return None
    return None


def _index(file: BinaryIO) -> bytes:
    """The box `moov` of a file."""
    end, place = file.seek(0, 2), 0
    while place + 8 <= end:
        file.seek(place)
        size, kind = _HEADER.unpack(file.read(8))
        header = 8
        if size == 1:
            header, size = 16, struct.unpack(">Q", file.read(8))[0]
        size = size or end - place
        if size < header or place + size > end:
            break
        if kind == b"moov":
            if size > MOST_INDEX:
                break
            return file.read(size - header)
        place += size
    raise _Damaged


def _boxes(content: bytes) -> Iterator[tuple[bytes, bytes]]:
    place = 0
    while place + 8 <= len(content):
        size, kind = _HEADER.unpack_from(content, place)
        if size < 8 or place + size > len(content):
            raise _Damaged
        yield kind, content[place + 8 : place + size]
        place += size


def _all(content: bytes, kind: bytes) -> list[bytes]:
    return [box for name, box in _boxes(content) if name == kind]


def _one(content: bytes, *kinds: bytes) -> bytes:
    """The box of the first of these kinds that is there."""
    for kind in kinds:
        if found := _all(content, kind):
            return found[0]
    raise _Damaged


def _text(file: BinaryIO, media: bytes) -> str:
    clock = _one(media, b"mdhd")
    scale = struct.unpack_from(">I", clock, 20 if clock[0] else 12)[0]
    table = _one(_one(media, b"minf"), b"stbl")
    sizes = _sizes(_one(table, b"stsz"))
    durations = _runs(_one(table, b"stts"), 2)
    counts = np.minimum(durations[:, 0], MOST_SAMPLES)
    if not scale or not len(sizes) <= counts.sum() <= 2 * MOST_SAMPLES:
        raise _Damaged
    lasting = np.repeat(durations[:, 1], counts)[: len(sizes)].astype(np.float64) / scale
    ends = np.cumsum(lasting)
    places = _places(table, sizes)
    lines = []
    for number, (place, size) in enumerate(zip(places, sizes, strict=True)):
        file.seek(int(place))
        content = file.read(int(size))
        length = struct.unpack_from(">H", content)[0] if len(content) >= 2 else 0
        said = content[2 : 2 + length].decode("utf-8", errors="replace").replace("\r", "")
        said = "\n".join(line for line in said.split("\n") if line.strip())
        if said:
            span = f"{_clock(ends[number] - lasting[number])} --> {_clock(ends[number])}"
            lines.append(f"{number + 1}\n{span}\n{said}\n")
    return "\n".join(lines)


def _clock(seconds: float) -> str:
    thousandths = round(1000 * seconds)
    return (f"{thousandths // 3_600_000:02d}:{thousandths // 60_000 % 60:02d}:{thousandths // 1000 % 60:02d},"
            f"{thousandths % 1000:03d}")


def _runs(box: bytes, columns: int) -> np.ndarray:
    """A table (N,columns) int64 behind its version and count."""
    count = struct.unpack_from(">I", box, 4)[0]
    if count > MOST_SAMPLES or 8 + 4 * columns * count > len(box):
        raise _Damaged
    return np.frombuffer(box, ">u4", columns * count, 8).reshape(count, columns).astype(np.int64)


def _sizes(box: bytes) -> np.ndarray:
    same, count = struct.unpack_from(">II", box, 4)
    if count > MOST_SAMPLES or (not same and 12 + 4 * count > len(box)):
        raise _Damaged
    sizes = np.full(count, same, np.int64) if same else np.frombuffer(box, ">u4", count, 12).astype(np.int64)
    if sizes.sum() > MOST_TEXT:
        raise _Damaged
    return sizes


def _places(table: bytes, sizes: np.ndarray) -> np.ndarray:
    """Where each subtitle (N,) begins in the file."""
    if _all(table, b"co64"):
        box = _one(table, b"co64")
        count = struct.unpack_from(">I", box, 4)[0]
        if 8 + 8 * count > len(box):
            raise _Damaged
        chunks = np.frombuffer(box, ">u8", count, 8).astype(np.int64)
    else:
        chunks = _runs(_one(table, b"stco"), 1)[:, 0]
    runs = _runs(_one(table, b"stsc"), 3)
    first = np.append(runs[:, 0] - 1, len(chunks))
    if not len(runs) or (np.diff(first) < 0).any() or first[0] != 0:
        raise _Damaged
    held = np.repeat(runs[:, 1], np.diff(first))
    held = np.minimum(held, len(sizes))
    if held.sum() > 2 * MOST_SAMPLES or held.sum() < len(sizes):
        raise _Damaged
    chunk = np.repeat(np.arange(len(chunks)), held)[: len(sizes)]
    before = np.cumsum(sizes) - sizes
    begins = np.searchsorted(chunk, np.arange(len(chunks)))
    return np.asarray(chunks[chunk] + before - before[begins[chunk]])
