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
from ..base.images import DECODING_BYTES
from ..base.language import Text
from ..base.options import Options
from ..base.records import View
from ..network.model import MAX_HYPOTHESES, MIN_HYPOTHESES, MULTIPLE

TILE_OVERLAP = 64  # pixels that neighbouring tiles share; half of it on each side is thrown away
SOURCE_MARGIN = 32  # pixels of context kept around what a tile can see in a source
# Peak memory of one tile, measured on a CPU (benchmarks/depth.py): fixed, per pixel of the tile, and per pixel of
# each of its sources.
BASE_BYTES = 500 << 20
# Per pixel of the whole photo: it is decoded for each of its regions, and its depth and confidence are kept.
PHOTO_BYTES, PHOTO_SHARE = DECODING_BYTES + 6, 0.25  # but no more than this share of a small budget
LEAST_BUDGET = BASE_BYTES + (400 << 20)  # of the whole stage: one small tile
BYTES_PER_HYPOTHESIS = 60  # and pixel of the photo
BYTES_PER_SOURCE_PIXEL = 64
MORE_TILES = 1.2  # times as many are tried next
SMALL_ENOUGH = 0.25  # of the budget for the tile itself: smaller tiles leave hardly more for its sources
FEWEST_SOURCES = 2  # that a tile is computed with where it can see so many, if smaller tiles help


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


@dataclass(frozen=True)
class TilePlan:
    """A tile, and what of each source it is computed with: None of one that is left out for want of memory."""

    tile: Tile
    seen: tuple[Tile | None, ...]


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


def plan_tiles(view: View, sources: list[View], hypotheses: int, budget: int) -> list[TilePlan]:
    """Few equal tiles of a view, about square, that each fit `budget` bytes with so many hypotheses at the coarsest
    level and what they see of the sources. `sources` are by falling score: where all are too much even for a small
    tile, it goes without the last of them that do not fit. Raises DeviceError when not even a small tile fits."""
    plans: list[TilePlan] = []
    left = budget - BASE_BYTES - min(PHOTO_BYTES * view.width * view.height, int(PHOTO_SHARE * budget))
    for tiles in _divisions(view.width, view.height):
        own = _area(tiles[0]) * bytes_per_pixel(hypotheses)
        pixels = (left - own) // BYTES_PER_SOURCE_PIXEL  # that are left for sources
        if pixels < len(sources) * _area(tiles[0]):
            continue
        whole = [TilePlan(tile, tuple(seen_regions(view, tile, sources))) for tile in tiles]
        plans = [TilePlan(plan.tile, _within(plan.seen, pixels)) for plan in whole]
        fewest = min(len(sources) - plan.seen.count(None) for plan in plans)
        if plans == whole or (own < SMALL_ENOUGH * budget and fewest >= min(FEWEST_SOURCES, len(sources))):
            break
    if not plans:
        raise DeviceError(
            Text("A memory budget of {:.2f} GiB is too small for even one tile of a depth map.", budget / 2**30),
            remedy=Text("Give it at least {:.1f} GiB, or close other programs.", LEAST_BUDGET / 2**30),
        )
    return plans


def _within(regions: tuple[Tile | None, ...], pixels: int) -> tuple[Tile | None, ...]:
    """The regions, without those that are more than what the ones before leave of so many pixels."""
    kept: list[Tile | None] = []
    for region in regions:
        fits = region is not None and _area(region) <= pixels
        pixels -= _area(region) if region is not None and fits else 0
        kept.append(region if fits else None)
    return tuple(kept)


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
    """What a tile can see of a source between near and far, with some context."""
    xs = np.linspace(tile.x0, tile.x1, 9)
    ys = np.linspace(tile.y0, tile.y1, 9)
    pixels = np.stack([*np.meshgrid(xs, ys), np.ones((9, 9))]).reshape(3, -1)
    rays = source.K @ source.cam_from_world[:, :3] @ view.cam_from_world[:, :3].T @ np.linalg.inv(view.K) @ pixels
    start = source.K @ (source.cam_from_world[:, :3] @ view.centre + source.cam_from_world[:, 3])
    nearest, farthest = start[:, None] + view.near * rays, start[:, None] + view.far * rays
    # Each ray is a line in the source, between two points; it ends where it goes past the camera's side, and where it
    # leaves the picture: conditions that are linear in homogeneous coordinates.
    first, last = np.zeros(rays.shape[1]), np.ones(rays.shape[1])
    edge = max(tile.size) / 8  # a ray that passes so close has neighbours inside
    right, bottom = source.width + edge, source.height + edge
    for condition in ([0, 0, 1], [1, 0, edge], [-1, 0, right], [0, 1, edge], [0, -1, bottom]):
        a, b = condition @ nearest - 1e-9, condition @ farthest - 1e-9
        crossing = a / np.where(a == b, 1, a - b)
        first = np.where(a < 0, np.where(b < 0, 2.0, np.maximum(first, crossing)), first)
        last = np.where((b < 0) & (a >= 0), np.minimum(last, crossing), last)
    seen = first <= last
    if not seen.any():
        return Tile(0, 0, min(MULTIPLE, source.width), min(MULTIPLE, source.height))
    ends = np.hstack([(nearest + share * (farthest - nearest))[:, seen] for share in (first, last)])
    u, v = ends[:2] / ends[2]
    x0, x1 = _clipped(u, source.width)
    y0, y1 = _clipped(v, source.height)
    return Tile(x0, y0, x1, y1)


def _clipped(values: np.ndarray, length: int) -> tuple[int, int]:
    """First and last pixel of a span within a picture, with the margin, never narrower than MULTIPLE."""
    first = int(np.clip(values.min() - SOURCE_MARGIN, 0, max(0, length - MULTIPLE)))
    last = int(np.clip(values.max() + SOURCE_MARGIN, first + MULTIPLE, max(length, first + MULTIPLE)))
    return first, min(last, length)
