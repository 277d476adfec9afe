# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""True orthographic pictures and heights of a site, tile by tile: of its mesh with its texture, or of its cloud.

Every pixel shows what lies nearest to the viewer there, as it would be seen square to the plane. Where that was not
measured (a filled face, the back of a surface, nothing at all) the pixel is empty.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numba import njit

from ..base.errors import PhotoError
from ..base.images import read_rgb
from ..base.language import Text
from ..base.messages import Reporter
from ..surface.mesh import Mesh
from ..texture.rasterise import nearest_faces
from .geotiff import NO_HEIGHT, TILE
from .placement import DeliverError

SAMPLES = 2  # a side of a pixel, of colours: a picture finer than the texture has steps, a coarser one would flicker
MOST_PIXELS = 20_000  # a side, where the size of a pixel is ours to choose
LARGEST = 100_000  # pixels a side that anybody may ask for
_compiled: Any = njit(nogil=True, error_model="numpy")


@dataclass(frozen=True, kw_only=True)
class Grid:
    """A plane's pixels. `axes` (3,3): rows right, up and towards the viewer, in the coordinates of the points that are
    drawn; `left` and `top` are the upper left corner along the first two; `pixel` is the side of one."""

    axes: np.ndarray
    left: float
    top: float
    pixel: float
    width: int
    height: int

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points (N,3) in pixels (N,2), x right and y down, and how near (N,) to the viewer they are."""
        along = points @ self.axes.T
        pixels = np.column_stack([along[:, 0] - self.left, self.top - along[:, 1]]) / self.pixel
        return pixels, along[:, 2]


def grid_of(points: np.ndarray, axes: np.ndarray, pixel: float, *, chosen: bool) -> Grid:
    """The grid that holds points (N,3), its lines at whole pixels from zero. A pixel that nobody has `chosen` grows
    until MOST_PIXELS are enough. Raises DeliverError for more than LARGEST pixels a side."""
    along = points @ axes[:2].T
    low, high = along.min(axis=0), along.max(axis=0)
    if not chosen:
        pixel = max(round_down(pixel), round_up(float((high - low).max()) / MOST_PIXELS))
    first, last = np.floor(low / pixel), np.ceil(high / pixel)
    width, height = (int(count) for count in np.maximum(last - first, 1))
    if max(width, height) > LARGEST:
        raise DeliverError(
            Text("Pixels of {:g} make a picture of {} x {}; {} a side are the most.", pixel, width, height, LARGEST),
            remedy=Text("Choose pixels of {:g} or more.", round_up(pixel * max(width, height) / LARGEST)),
        )
    return Grid(axes=axes, left=float(first[0] * pixel), top=float(last[1] * pixel), pixel=pixel, width=width,
                height=height)


def round_up(length: float) -> float:
    """To 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(max(length, 1e-12)))
    return float(next(step * power for step in (1, 2, 5, 10) if step * power >= length * (1 - 1e-9)))


def round_down(length: float) -> float:
    """To 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(max(length, 1e-12)))
    return float(next(step * power for step in (5, 2, 1) if step * power <= length * (1 + 1e-9)))


class View(Protocol):
    """Something drawn on a grid."""

    def strip(self, top: int, bottom: int) -> None:
        """The rows that the tiles to come lie in."""

    def colours(self, top: int, left: int, height: int, width: int) -> np.ndarray:
        """A tile (H,W,4) uint8."""

    def heights(self, top: int, left: int, height: int, width: int) -> np.ndarray:
        """A tile (H,W) float32: along the grid's third axis, NO_HEIGHT where nothing is."""


def strips(view: View, grid: Grid, *, colour: bool, reporter: Reporter) -> Iterator[np.ndarray]:
    """The picture in strips of TILE rows. Raises Cancelled."""
    for top in range(0, grid.height, TILE):
        height = min(TILE, grid.height - top)
        view.strip(top, top + height)
        tiles = []
        for left in range(0, grid.width, TILE):
            width = min(TILE, grid.width - left)
            tiles.append((view.colours if colour else view.heights)(top, left, height, width))
            reporter.check_cancelled()
        reporter.progress(top, grid.height)
        yield np.concatenate(tiles, axis=1)


class MeshView:
    """A mesh on a grid. `places` (N,3) are its vertices; `pages` (P,S,S,3) its texture, empty for vertex colours;
    `shown` (M,) bool, the faces that may be drawn."""

    def __init__(self, mesh: Mesh, places: np.ndarray, pages: np.ndarray, grid: Grid, shown: np.ndarray) -> None:
        pixels, nearness = grid.project(places)
        self._corners = pixels[mesh.faces]
        self._base = float(np.median(nearness))  # single precision is for what is left
        self._nearness = (nearness - self._base).astype(np.float32)[mesh.faces]
        side, other = self._corners[:, 1] - self._corners[:, 0], self._corners[:, 2] - self._corners[:, 0]
        self._hidden = ~shown | (side[:, 0] * other[:, 1] - side[:, 1] * other[:, 0] >= 0)
        self._low, self._high = self._corners.min(axis=1), self._corners.max(axis=1)
        self._in_strip = np.arange(0)
        self._mesh, self._pages = mesh, pages

    def strip(self, top: int, bottom: int) -> None:
        self._in_strip = np.flatnonzero((self._high[:, 1] >= top) & (self._low[:, 1] <= bottom))

    def colours(self, top: int, left: int, height: int, width: int) -> np.ndarray:
        face, weights, number = self._nearest(top, left, height, width, SAMPLES)
        mesh, tile = self._mesh, np.empty((height, width, 4), np.uint8)
        if len(self._pages):
            assert mesh.uv is not None and mesh.page is not None
            _texture(face, weights, mesh.uv[number], mesh.page[number], self._pages, SAMPLES, tile)
        else:
            _blend(face, weights, mesh.colours[mesh.faces[number]], SAMPLES, tile)
        return tile

    def heights(self, top: int, left: int, height: int, width: int) -> np.ndarray:
        face, weights, number = self._nearest(top, left, height, width, 1)
        there = face >= 0
        heights = np.full(face.shape, NO_HEIGHT, np.float32)
        near = self._nearness[number[face[there]]].astype(np.float64)
        heights[there] = self._base + (near * weights[there]).sum(axis=1)
        return heights

    def _nearest(
        self, top: int, left: int, height: int, width: int, samples: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The face at each sample, its place on it, and the faces' numbers in the mesh."""
        low, high = self._low[self._in_strip, 0], self._high[self._in_strip, 0]
        number = self._in_strip[(high >= left) & (low <= left + width)]
        corners = (self._corners[number] - [left, top]) * samples
        face, weights = nearest_faces(corners, self._nearness[number], width * samples, height * samples)
        unseen = np.append(self._hidden[number], False)  # the last one is for -1
        face[unseen[face]] = -1
        return face, weights, number


class CloudView:
    """A cloud on a grid: each of its points (N,3), with colours (N,3), is a square as wide as `spacing`."""

    def __init__(self, points: np.ndarray, colours: np.ndarray, spacing: float, grid: Grid) -> None:
        pixels, nearness = grid.project(points)
        self._pixels = pixels.astype(np.float32)
        self._base = float(np.median(nearness))
        self._nearness, self._colours = (nearness - self._base).astype(np.float32), colours
        self._reach = max(spacing / grid.pixel / 2, 0.5)
        self._in_strip = np.arange(0)

    def strip(self, top: int, bottom: int) -> None:
        rows = self._pixels[:, 1]
        self._in_strip = np.flatnonzero((rows >= top - self._reach) & (rows <= bottom + self._reach))

    def colours(self, top: int, left: int, height: int, width: int) -> np.ndarray:
        point = self._nearest(top, left, height, width)
        tile = np.zeros((height, width, 4), np.uint8)
        there = point >= 0
        tile[there, :3], tile[there, 3] = self._colours[point[there]], 255
        return tile

    def heights(self, top: int, left: int, height: int, width: int) -> np.ndarray:
        point = self._nearest(top, left, height, width)
        there = point >= 0
        heights = np.full(point.shape, NO_HEIGHT, np.float32)
        heights[there] = self._base + self._nearness[point[there]].astype(np.float64)
        return heights

    def _nearest(self, top: int, left: int, height: int, width: int) -> np.ndarray:
        columns = self._pixels[self._in_strip, 0]
        number = self._in_strip[(columns >= left - self._reach) & (columns <= left + width + self._reach)]
        point = np.full((height, width), -1, np.int64)
        nearest = np.full((height, width), -np.inf, np.float32)
        pixels = self._pixels[number] - np.array([left, top], np.float32)
        _splat(pixels, self._nearness[number], number, self._reach, point, nearest)
        return point


def read_pages(folder: Path, names: tuple[str, ...]) -> np.ndarray:
    """A texture's pages (P,S,S,3) uint8. Raises DeliverError when one is missing, damaged, or of another size."""
    pages = []
    for name in names:
        try:
            pages.append(read_rgb(folder / name))
        except PhotoError as error:
            raise DeliverError(Text("A page of the texture cannot be read: {}", error.message),
                               remedy="Run Texture again.", path=folder / name) from error
        if pages[-1].shape != pages[0].shape:
            raise DeliverError(Text("{} has another size than the texture's first page.", folder / name),
                               remedy="Run Texture again.", path=folder / name)
    return np.stack(pages) if pages else np.zeros((0, 1, 1, 3), np.uint8)


@_compiled
def _texture(face, weights, uv, page, pages, samples, tile):  # type: ignore[no-untyped-def]
    """Colour a tile (H,W,4) from `samples` x `samples` places a pixel; most must be there."""
    height, width = pages.shape[1], pages.shape[2]
    total = np.zeros(3)
    for row in range(tile.shape[0]):
        for column in range(tile.shape[1]):
            total[:], count = 0.0, 0
            for y in range(row * samples, (row + 1) * samples):
                for x in range(column * samples, (column + 1) * samples):
                    f = face[y, x]
                    if f < 0 or page[f] < 0 or page[f] >= len(pages):
                        continue
                    u = v = 0.0
                    for k in range(3):
                        u += weights[y, x, k] * uv[f, k, 0]
                        v += weights[y, x, k] * uv[f, k, 1]
                    u = min(max(u * width - 0.5, 0.0), width - 1.0)
                    v = min(max((1 - v) * height - 0.5, 0.0), height - 1.0)
                    left, top = int(u), int(v)
                    right, bottom = min(left + 1, width - 1), min(top + 1, height - 1)
                    u, v = u - left, v - top
                    picture = pages[page[f]]
                    for c in range(3):
                        total[c] += (1 - v) * ((1 - u) * picture[top, left, c] + u * picture[top, right, c]) + v * (
                            (1 - u) * picture[bottom, left, c] + u * picture[bottom, right, c])
                    count += 1
            _put(tile[row, column], total, count, samples)


@_compiled
def _blend(face, weights, colours, samples, tile):  # type: ignore[no-untyped-def]
    """As `_texture`, from colours (M,3,3) of the faces' corners."""
    total = np.zeros(3)
    for row in range(tile.shape[0]):
        for column in range(tile.shape[1]):
            total[:], count = 0.0, 0
            for y in range(row * samples, (row + 1) * samples):
                for x in range(column * samples, (column + 1) * samples):
                    f = face[y, x]
                    if f < 0:
                        continue
                    for c in range(3):
                        for k in range(3):
                            total[c] += weights[y, x, k] * colours[f, k, c]
                    count += 1
            _put(tile[row, column], total, count, samples)


@_compiled
def _put(pixel, total, count, samples):  # type: ignore[no-untyped-def]
    pixel[:] = 0
    if 2 * count >= samples * samples:
        for c in range(3):
            pixel[c] = np.uint8(min(max(np.rint(total[c] / count), 0.0), 255.0))
        pixel[3] = 255


@_compiled
def _splat(pixels, nearness, number, reach, point, nearest):  # type: ignore[no-untyped-def]
    height, width = point.shape
    for i in range(len(pixels)):
        u, v = pixels[i]
        first_column, end_column = max(int(np.ceil(u - reach - 0.5)), 0), min(int(np.ceil(u + reach - 0.5)), width)
        first_row, end_row = max(int(np.ceil(v - reach - 0.5)), 0), min(int(np.ceil(v + reach - 0.5)), height)
        for row in range(first_row, end_row):
            for column in range(first_column, end_column):
                if nearness[i] > nearest[row, column]:
                    nearest[row, column], point[row, column] = nearness[i], number[i]
