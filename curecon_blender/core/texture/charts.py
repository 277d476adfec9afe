# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""UV charts of a mesh whose faces have chosen their photos, packed into pages.

A chart is a connected patch of faces with one photo, laid out as that photo sees it. A texel then is a pixel of the
photo (or a fixed number of them), so nothing is stretched or sampled twice, every part of the surface gets as many
texels as the photos have of it, and a patch needs no cut inside. Faces that no photo shows are laid out along the axis
that they face most, coarsely: they hold no detail. The faces of charts of a few texels only become dots in what is left
of the pages: with a gutter each they would take more room than what they show.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..base.records import View
from ..surface.triangles import face_normals, triangle_areas
from .labelling import patches
from .packing import Pages, shape
from .visibility import in_camera, project, smooth_normals

PADDING = 2  # texels around a chart, on each page
_LEAST_CHART = 8.0  # texels: the faces of a smaller one are dots, of one colour each
_MOST_DOTS = 5  # faces: the dots of more would take more room than their chart does
_CELL = 3  # texels a side for each dot
_DOT = np.array([[-0.3, -0.2], [0.3, -0.2], [0.0, 0.4]], np.float32)  # about the middle of its cell
_UNSEEN_DENSITY = 0.25  # of the texels that photos give a face of the same size
_FULL = 0.96  # share of a page that packed charts fill with their gutters, at most
_LARGER = 1.01  # times its side: the next page that is tried
_TRIES = 8
_STEP = 16  # texels: pages are a multiple of it, so that mipmaps divide evenly for long
_SMALL_PATCH = 500  # faces: an unseen patch below it becomes one chart, whatever its shape


@dataclass(frozen=True)
class Layout:
    """Where faces lie on the pages. `corners` (M,3,2) float32 texels from the page's top left; `page` (M,) int32;
    `border` (M,) bool, faces at the edge of a chart; `pages` and `size` (texels a side); `scale`, texels per pixel of a
    photo at full size; `use`, the share of the pages' area that charts cover."""

    corners: np.ndarray
    page: np.ndarray
    border: np.ndarray
    pages: int
    size: int
    scale: float
    use: float


def lay_out(
    vertices: np.ndarray, faces: np.ndarray, label: np.ndarray, neighbours: np.ndarray, views: tuple[View, ...],
    size: int, max_pages: int,
) -> Layout | None:
    """Charts of the faces (M,3) by their photos `label` (M,), on at most `max_pages` pages of at most `size` texels.

    `views` are the photos at the size that they are sampled at. Texels are the photos' pixels where that fits, larger
    ones where it does not; one page that would stay partly empty is made smaller. None when the charts fit no page.
    """
    group = label.astype(np.int32)
    unseen = np.flatnonzero(label < 0)
    group[unseen] = len(views) + _facing(vertices, faces, unseen, label, neighbours)
    chart = patches(group, neighbours)
    flat = _flatten(vertices, faces, group, views)
    areas, counts = np.bincount(chart, triangle_areas(flat)), np.bincount(chart)
    dotted = (areas < _LEAST_CHART) & (counts <= _MOST_DOTS)
    dots = np.flatnonzero(dotted[chart])[: (size // (2 * _CELL)) ** 2]
    charted = np.setdiff1d(np.arange(len(faces)), dots, assume_unique=True)
    charted = charted[np.argsort(chart[charted], kind="stable")]
    _, starts, number = np.unique(chart[charted], return_index=True, return_inverse=True)
    packed = _pack(np.split(flat[charted], starts[1:]) if len(charted) else [], len(dots), size, max_pages)
    if packed is None:
        return None
    corners, page = np.empty((len(faces), 3, 2), np.float32), np.empty(len(faces), np.int32)
    corners[charted], page[charted] = packed.corners(flat[charted], number), packed.page[number]
    corners[dots], page[dots] = packed.dots[:, None, :2] + _CELL / 2 + _DOT, packed.dots[:, 2]
    border = ((neighbours < 0) | (chart[neighbours] != chart[:, None])).any(axis=1)
    use = float(triangle_areas(corners).sum() / (packed.pages * packed.size**2))
    return Layout(corners, page, border, packed.pages, packed.size, packed.scale, use)


@dataclass(frozen=True)
class _Packed:
    """`low` and `place` (c,2) of c charts in their photos and on the page, in whole texels, their `turns` by quarters
    (c,), `sizes` (c,2), and `page` (c,); `dots` (d,3) columns, rows and pages of their cells; `pages` of `size` texels
    a side; `scale`, texels a pixel."""

    low: np.ndarray
    sizes: np.ndarray
    place: np.ndarray
    turns: np.ndarray
    page: np.ndarray
    dots: np.ndarray
    pages: int
    size: int
    scale: float

    def corners(self, flat: np.ndarray, chart: np.ndarray) -> np.ndarray:
        """On their pages, (m,3,2) float32 of faces (m,3,2) in pixels of charts (m,)."""
        x, y = (flat * self.scale - self.low[chart, None]).transpose(2, 0, 1)
        width, height = self.sizes[chart, :, None].transpose(1, 0, 2)
        turned = np.stack([np.choose(self.turns[chart, None], [x, y, width - x, height - y]),
                           np.choose(self.turns[chart, None], [y, width - x, height - y, x])], axis=2)
        return (turned + self.place[chart, None]).astype(np.float32)


def _pack(parts: list[np.ndarray], dots: int, size: int, max_pages: int) -> _Packed | None:
    """Charts of faces `parts` (n,3,2) in pixels, and cells for so many dots, on the fewest and smallest pages."""
    widest = max((float(np.ptp(part, axis=(0, 1)).max()) for part in parts), default=0.0)
    scale = min(1.0, (size - 2 * PADDING - 2) / max(widest, 1e-9))
    for _ in range(_TRIES):
        shapes = [shape(part * scale, PADDING) for part in parts]
        texels = sum(one.texels for one in shapes) + dots * _CELL**2
        if texels > max_pages * size**2:
            scale *= 0.99 * float(np.sqrt(max_pages * size**2 * _FULL / texels))
            continue
        least = max((max(one.size) for one in shapes), default=_CELL)
        for count, side in _page_sizes(texels, least, size, max_pages):
            pages = Pages(side, count)
            if (placed := pages.place(shapes)) and (cells := pages.cells(dots, _CELL)) is not None:
                places, turns = placed
                low, sizes = (np.array(of).reshape(-1, 2) for of in ([s.low for s in shapes], [s.size for s in shapes]))
                return _Packed(low, sizes, places[:, :2], turns, places[:, 2], cells, count, side, scale)
        scale *= 0.93
    return None


def _page_sizes(texels: int, least: int, size: int, max_pages: int) -> Iterator[tuple[int, int]]:
    """How many pages and of what side to try, from as few as so many texels just fit on."""
    for count in range(max(int(np.ceil(texels / size**2)), 1), max_pages + 1):
        side = max(int(np.sqrt(texels / _FULL / count)), least)
        while side < size:
            side = int(np.ceil(side / _STEP) * _STEP)
            yield count, min(side, size)
            side = int(side * _LARGER) + 1
        yield count, size


def _facing(
    vertices: np.ndarray, faces: np.ndarray, unseen: np.ndarray, label: np.ndarray, neighbours: np.ndarray
) -> np.ndarray:
    """Which of the six axis directions (n,) each of the faces `unseen` (n,) is laid out along: the one that it faces
    most, or, so that there are few charts, the one that the small patch that it belongs to faces most."""
    patch = patches(label, neighbours)[unseen]
    _, patch, size = np.unique(patch, return_inverse=True, return_counts=True)
    normal = face_normals(vertices.astype(np.float64), faces[unseen])
    whole = np.stack([np.bincount(patch, normal[:, axis], len(size)) for axis in range(3)], axis=1)
    smooth = smooth_normals(vertices, faces)[unseen]
    normal = np.where((size < _SMALL_PATCH)[patch, None], whole[patch], smooth)
    axis = np.abs(normal).argmax(axis=1)
    positive = np.take_along_axis(normal, axis[:, None], axis=1)[:, 0] > 0
    result: np.ndarray = 2 * axis + positive
    return result


def _flatten(vertices: np.ndarray, faces: np.ndarray, group: np.ndarray, views: tuple[View, ...]) -> np.ndarray:
    """Corners (M,3,2) float64 in pixels of each face's photo; of faces of no photo, at a coarse scale."""
    flat = np.zeros((len(faces), 3, 2))
    order = np.argsort(group, kind="stable")
    ends = np.searchsorted(group[order], np.arange(len(views) + 7))
    for number, view in enumerate(views):
        face = order[ends[number] : ends[number + 1]]
        flat[face] = project(in_camera(vertices[faces[face]].reshape(-1, 3), view), view.K).reshape(-1, 3, 2)
    seen = order[: ends[len(views)]]
    rest = order[ends[len(views)] :]
    density = 1.0
    if len(seen):
        density = np.sqrt(triangle_areas(flat[seen]).sum() / max(triangle_areas(vertices[faces[seen]]).sum(), 1e-30))
    elif len(rest):
        density = 1024 / max(float(np.ptp(vertices, axis=0).max()), 1e-30)
    for axis in range(3):
        plane = [k for k in range(3) if k != axis]
        face = rest[(group[rest] - len(views)) // 2 == axis]
        flat[face] = vertices[faces[face]][..., plane] * (density * _UNSEEN_DENSITY)
    return flat
