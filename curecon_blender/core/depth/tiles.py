# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How a photo is cut into tiles whose depth fits a memory budget, and what a tile can see of a source view."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
import torch

from ..base import memory
from ..base.errors import DeviceError
from ..base.options import Options
from ..base.records import View
from ..network.model import MAX_HYPOTHESES, MIN_HYPOTHESES, MULTIPLE

TILE_OVERLAP = 64  # pixels that neighbouring tiles share; half of it on each side is thrown away
SOURCE_MARGIN = 32  # pixels of context kept around what a tile can see in a source
# Peak memory of one tile, measured on a CPU (benchmarks/depth.py): fixed, per pixel of the tile, and per pixel of
# each of its sources.
BASE_BYTES = 500 << 20
LEAST_BUDGET = BASE_BYTES + (400 << 20)  # of the whole stage: one small tile
BYTES_PER_HYPOTHESIS = 60  # and pixel of the photo
BYTES_PER_SOURCE_PIXEL = 80
MORE_TILES = 1.2  # times as many are tried next
MOST_FOR_SOURCES = 2  # times as many as need least, after which no more are tried


@dataclass(frozen=True)
class Tile:
    """A rectangle of a picture, [x0, x1) x [y0, y1) in pixels."""

    x0: int
    y0: int
    x1: int
    y1: int

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        return self.x1 - self.x0, self.y1 - self.y0


def memory_budget(options: Options, device: torch.device) -> int:
    """Bytes that the depth stage may use: the option, or 60 % of what the device has free; or half of that."""
    if device.type != "cuda" or options.memory_gib is not None:
        return memory.budget(options)
    return int(memory.SHARE * torch.cuda.mem_get_info(device)[0] * (0.5 if options.half_memory else 1.0))


def bytes_per_pixel(hypotheses: int) -> int:
    """Peak memory for each pixel of a tile, with so many hypotheses at the coarsest level (a sixteenth of the pixels,
    where the middle one has 16 for a quarter and the finest 8 for all of them)."""
    return BYTES_PER_HYPOTHESIS * (8 + 4 + hypotheses // 16)


def typical_hypotheses(size: int) -> int:
    """What the coarsest level wants of a photo of so many pixels on its longer side, before its sources are known:
    between two photos of an orbit, things move by half a photo's width at most."""
    return min(max(size // 8, MIN_HYPOTHESES), MAX_HYPOTHESES)


def plan_tiles(view: View, sources: list[View], hypotheses: int, budget: int) -> list[Tile]:
    """Few equal tiles of a view, about square, that each fit `budget` bytes with so many hypotheses at the coarsest
    level and what they see of the sources. Raises DeviceError when not even a small tile fits."""
    least: tuple[float, list[Tile]] = (np.inf, [])
    for tiles in _divisions(view.width, view.height):
        own = BASE_BYTES + _area(tiles[0]) * bytes_per_pixel(hypotheses)
        if own + len(sources) * _area(tiles[0]) * BYTES_PER_SOURCE_PIXEL > budget:
            continue
        seen = max(sum(map(_area, seen_regions(view, tile, sources))) for tile in tiles)
        peak = own + seen * BYTES_PER_SOURCE_PIXEL
        least = min(least, (peak, tiles), key=lambda found: found[0])
        # Of a source that goes past the camera's side, the smallest tile may see all: more tiles do not help then.
        if peak <= budget or len(tiles) > MOST_FOR_SOURCES * len(least[1]):
            break
    if not least[1]:
        raise DeviceError(
            f"A memory budget of {budget / 2**30:.2f} GiB is too small for even one tile of a depth map.",
            remedy=f"Give it at least {LEAST_BUDGET / 2**30:.1f} GiB, or close other programs.",
        )
    return least[1]


def _divisions(width: int, height: int) -> Iterator[list[Tile]]:
    """A picture in ever more equal tiles: whole, then about square and by some tenths more each time."""
    last = 0.0
    for columns, rows in sorted(product(range(1, 65), repeat=2), key=lambda n: (n[0] * n[1], abs(n[0] - n[1]))):
        tile_width, tile_height = _tile_side(width, columns), _tile_side(height, rows)
        square = max(tile_width, tile_height) <= 2 * min(tile_width, tile_height)
        if columns * rows > 1 and not (square and columns * rows > MORE_TILES * last):
            continue
        last = columns * rows
        yield [
            Tile(x, y, min(x + tile_width, width), min(y + tile_height, height))
            for y in _starts(height, tile_height, rows) for x in _starts(width, tile_width, columns)
        ]
        if tile_width <= 2 * TILE_OVERLAP and tile_height <= 2 * TILE_OVERLAP:
            return


def seen_regions(view: View, tile: Tile, sources: list[View]) -> list[Tile]:
    """What of each source a tile is computed with: all of it for the whole photo, else what it can see of it."""
    if tile.size == (view.width, view.height):
        return [Tile(0, 0, source.width, source.height) for source in sources]
    return [visible_region(view, tile, source) for source in sources]


def _area(tile: Tile) -> int:
    return tile.size[0] * tile.size[1]


def _tile_side(length: int, count: int) -> int:
    side = -(-(length + (count - 1) * TILE_OVERLAP) // count)
    return -(-side // MULTIPLE) * MULTIPLE


def _starts(length: int, side: int, count: int) -> list[int]:
    if count == 1:
        return [0]
    return [round(i * (length - side) / (count - 1)) for i in range(count)]


def kept_part(tile: Tile, view: View) -> Tile:
    """The part of a tile that is kept, in the photo's pixels: without the margins, except at the photo's own edges."""
    half = TILE_OVERLAP // 2
    return Tile(tile.x0 + half * (tile.x0 > 0), tile.y0 + half * (tile.y0 > 0),
                tile.x1 - half * (tile.x1 < view.width), tile.y1 - half * (tile.y1 < view.height))


def visible_region(view: View, tile: Tile, source: View) -> Tile:
    """What a tile can see of a source between near and far, with some context; the whole source when in doubt."""
    xs = np.linspace(tile.x0, tile.x1, 9)
    ys = np.linspace(tile.y0, tile.y1, 9)
    pixels = np.stack([*np.meshgrid(xs, ys), np.ones((9, 9))]).reshape(3, -1)
    rays = np.linalg.inv(view.K) @ pixels
    inverse_depths = np.linspace(1 / view.far, 1 / view.near, 16)
    camera = np.concatenate([rays / w for w in inverse_depths], axis=1)
    world = view.cam_from_world[:, :3].T @ (camera - view.cam_from_world[:, 3:])
    seen = source.K @ (source.cam_from_world[:, :3] @ world + source.cam_from_world[:, 3:])
    if (seen[2] <= 0).any():
        return Tile(0, 0, source.width, source.height)
    u, v = seen[:2] / seen[2]
    x0, x1 = _clipped(u, source.width)
    y0, y1 = _clipped(v, source.height)
    return Tile(x0, y0, x1, y1)


def _clipped(values: np.ndarray, length: int) -> tuple[int, int]:
    """First and last pixel of a span within a picture, with the margin, never narrower than MULTIPLE."""
    first = int(np.clip(values.min() - SOURCE_MARGIN, 0, max(0, length - MULTIPLE)))
    last = int(np.clip(values.max() + SOURCE_MARGIN, first + MULTIPLE, max(length, first + MULTIPLE)))
    return first, min(last, length)
