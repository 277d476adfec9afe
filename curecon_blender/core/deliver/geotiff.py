# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures and height models as cloud-optimised GeoTIFF: tiled, with overviews, written as they come from above.

No library writes this layout from rows that come one after another: GDAL's driver copies from a finished file and would
add 40 MB to each package. The file has its directories first, then the smallest overview's tiles, the full picture's
last, as COG wants it.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..base.files import atomic_write, disk_errors, scratch_folder
from .systems import GeoKeys

TILE = 512  # pixels a side
NO_HEIGHT = -9999.0
_SHORT, _LONG, _DOUBLE, _ASCII, _LONG8 = 3, 4, 12, 2, 16  # TIFF's types
_PACK = {_SHORT: "H", _LONG: "I", _DOUBLE: "d", _LONG8: "Q"}
_DEFLATE, _HORIZONTAL, _FLOATING = 8, 2, 3  # compression, and what it is prepared with
_LEVEL = 6  # zlib's
_COPY = 1 << 22


@dataclass(frozen=True, kw_only=True)
class Raster:
    """A picture (H,W,4) uint8 sRGB with its alpha, or a height model (H,W) float32 with NO_HEIGHT where nothing was
    measured. `left` and `top` are the place of its upper left corner, `pixel` the side of a pixel."""

    width: int
    height: int
    colour: bool
    left: float
    top: float
    pixel: float
    keys: GeoKeys
    description: str


def write_cog(path: Path, raster: Raster, strips: Iterable[np.ndarray]) -> None:
    """Write a raster that comes in strips of TILE rows, the last one of what is left. Raises WorkspaceError."""
    with disk_errors(path), scratch_folder(path.with_name(f"{path.name}.tiles")) as scratch, ExitStack() as files:
        levels: list[_Level] = []  # the full picture first
        for number, (width, height) in reversed([*enumerate(_sizes(raster))]):
            file = files.enter_context(open(scratch / str(number), "w+b"))
            levels.insert(0, _Level(width, height, file, levels[0] if levels else None))
        for strip in strips:
            levels[0].add(strip)
        levels[0].finish()
        with atomic_write(path) as out:
            _assemble(out, raster, levels)


def _sizes(raster: Raster) -> list[tuple[int, int]]:
    """Of the picture and of its overviews, down to a single tile."""
    sizes = [(raster.width, raster.height)]
    while max(sizes[-1]) > TILE:
        sizes.append((-(-sizes[-1][0] // 2), -(-sizes[-1][1] // 2)))
    return sizes


@dataclass
class _Level:
    """The full picture, or an overview of half the size of the level before, being written into a scratch file."""

    width: int
    height: int
    file: BinaryIO
    coarser: _Level | None
    sizes: list[int] = field(default_factory=list)  # bytes of each tile
    waiting: list[np.ndarray] = field(default_factory=list)

    def add(self, rows: np.ndarray) -> None:
        """The next rows; TILE of them are a row of tiles."""
        self.waiting.append(rows)
        if sum(map(len, self.waiting)) >= TILE:
            self._write_tiles()

    def finish(self) -> None:
        """All rows have come."""
        if self.waiting:
            self._write_tiles()
        if self.coarser is not None:
            self.coarser.finish()

    def _write_tiles(self) -> None:
        strip = np.concatenate(self.waiting)
        self.waiting = []
        for left in range(0, self.width, TILE):
            part = strip[:TILE, left : left + TILE]
            fill = NO_HEIGHT if part.ndim == 2 else 0
            tile = np.full((TILE, TILE, *part.shape[2:]), fill, part.dtype)
            tile[: part.shape[0], : part.shape[1]] = part
            packed = zlib.compress(_differences(tile), _LEVEL)
            self.file.write(packed)
            self.sizes.append(len(packed))
        if self.coarser is not None:
            self.coarser.add(_halved(strip))


def _differences(tile: np.ndarray) -> bytes:
    """A tile prepared for compression: each value as its difference from the one to the left. Those of floats come
    apart into their bytes first, the highest ones together."""
    if tile.dtype == np.uint8:
        prepared = tile.copy()
        prepared[:, 1:] -= tile[:, :-1]
        return prepared.tobytes()
    planes = tile.astype(">f4").view(np.uint8).reshape(*tile.shape, 4).transpose(0, 2, 1).reshape(len(tile), -1)
    prepared = planes.copy()
    prepared[:, 1:] -= planes[:, :-1]
    return prepared.tobytes()


def _halved(strip: np.ndarray) -> np.ndarray:
    """Half the size: the mean of what is there of each four pixels."""
    rows, columns = len(strip) % 2, strip.shape[1] % 2
    if strip.ndim == 2:
        quads = _quads(np.pad(strip, ((0, rows), (0, columns)), constant_values=NO_HEIGHT))
        there = quads != NO_HEIGHT
        count = there.sum(axis=0)
        total = np.where(there, quads, 0).sum(axis=0, dtype=np.float64)
        return np.where(count, total / np.maximum(count, 1), NO_HEIGHT).astype(np.float32)
    quads = _quads(np.pad(strip, ((0, rows), (0, columns), (0, 0))))
    there = quads[..., 3] > 0
    count = np.maximum(there.sum(axis=0), 1)[..., None]
    halved = ((quads * there[..., None]).sum(axis=0, dtype=np.uint16) + count // 2) // count
    return halved.astype(np.uint8)


def _quads(values: np.ndarray) -> np.ndarray:
    return np.stack([values[y::2, x::2] for y in (0, 1) for x in (0, 1)])


def _assemble(file: BinaryIO, raster: Raster, levels: Sequence[_Level]) -> None:
    """Directories, then tiles, the coarsest level's first."""
    data = sum(sum(level.sizes) for level in levels)
    tiles = sum(len(level.sizes) for level in levels)
    big = data + 16 * tiles + 65_536 * len(levels) > 0xFFFFFFFF - (1 << 20)
    size = len(_directories(raster, levels, [0] * len(levels), big))
    starts = [0] * len(levels)
    at = size
    for number in reversed(range(len(levels))):
        starts[number] = at
        at += sum(levels[number].sizes)
    file.write(_directories(raster, levels, starts, big))
    for level in reversed(levels):
        level.file.seek(0)
        while block := level.file.read(_COPY):
            file.write(block)


def _directories(raster: Raster, levels: Sequence[_Level], starts: Sequence[int], big: bool) -> bytes:
    """The file's header and a directory each; `starts` are where the levels' tiles begin."""
    out = bytearray(struct.pack("<2sHHHQ", b"II", 43, 8, 0, 16) if big else struct.pack("<2sHI", b"II", 42, 8))
    for number, (level, start) in enumerate(zip(levels, starts, strict=True)):
        places = (start + np.cumsum([0, *level.sizes[:-1]])).tolist()
        tags = _tags(raster, level, places, big, full=number == 0)
        out += _directory(tags, len(out), big, last=number == len(levels) - 1)
    return bytes(out)


Tag = tuple[int, int, Sequence[int] | Sequence[float] | bytes]


def _tags(raster: Raster, level: _Level, places: list[int], big: bool, *, full: bool) -> list[Tag]:
    bands = 4 if raster.colour else 1
    long = _LONG8 if big else _LONG
    tags: list[Tag] = [
        (254, _LONG, [0 if full else 1]), (256, _LONG, [level.width]), (257, _LONG, [level.height]),
        (258, _SHORT, [8 if raster.colour else 32] * bands), (259, _SHORT, [_DEFLATE]),
        (262, _SHORT, [2 if raster.colour else 1]), (277, _SHORT, [bands]), (284, _SHORT, [1]),
        (317, _SHORT, [_HORIZONTAL if raster.colour else _FLOATING]), (322, _LONG, [TILE]), (323, _LONG, [TILE]),
        (324, long, places), (325, _LONG, level.sizes), (339, _SHORT, [1 if raster.colour else 3] * bands),
    ]
    if raster.colour:
        tags.append((338, _SHORT, [2]))  # the fourth band is alpha
    else:
        tags.append((42113, _ASCII, f"{NO_HEIGHT:g}".encode() + b"\0"))
    if full:
        tags.append((270, _ASCII, raster.description.encode("ascii", "replace") + b"\0"))
        tags.append((33550, _DOUBLE, [raster.pixel, raster.pixel, 0.0]))
        tags.append((33922, _DOUBLE, [0.0, 0.0, 0.0, raster.left, raster.top, 0.0]))
        tags += _geo_tags(raster.keys)
    return sorted(tags, key=lambda tag: tag[0])


def _geo_tags(keys: GeoKeys) -> list[Tag]:
    """GeoTIFF's keys: a table of shorts, which names the numbers and texts of two other tags."""
    table, text = [1, 1, 1, len(keys)], ""
    doubles: list[float] = []
    for key, value in sorted(keys.items()):
        if isinstance(value, int):
            table += [key, 0, 1, value]
        elif isinstance(value, float):
            table += [key, 34736, 1, len(doubles)]
            doubles.append(value)
        else:
            table += [key, 34737, len(value) + 1, len(text)]
            text += value + "|"
    tags: list[Tag] = [(34735, _SHORT, table)]
    if doubles:
        tags.append((34736, _DOUBLE, doubles))
    if text:
        tags.append((34737, _ASCII, text.encode("ascii", "replace") + b"\0"))
    return tags


def _directory(tags: Sequence[Tag], place: int, big: bool, *, last: bool) -> bytes:
    """A directory that stands at `place`, with the values that do not fit into its entries behind it; the next one
    follows."""
    count, entry, offset, inline = ("<Q", "<HHQ", "<Q", 8) if big else ("<H", "<HHI", "<I", 4)
    width = struct.calcsize(entry) + inline
    behind = place + struct.calcsize(count) + width * len(tags) + struct.calcsize(offset)
    entries, values = bytearray(), bytearray()
    for number, kind, value in tags:
        packed = value if isinstance(value, bytes) else struct.pack(f"<{len(value)}{_PACK[kind]}", *value)
        entries += struct.pack(entry, number, kind, len(value))
        if len(packed) <= inline:
            entries += packed.ljust(inline, b"\0")
        else:
            values += b"\0" * (-(behind + len(values)) % 8)
            entries += struct.pack(offset, behind + len(values))
            values += packed
    values += b"\0" * (-(behind + len(values)) % 8)
    following = 0 if last else behind + len(values)
    return struct.pack(count, len(tags)) + bytes(entries) + struct.pack(offset, following) + bytes(values)
