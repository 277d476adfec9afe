# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""UV charts of a mesh whose faces have chosen their photos, packed into pages by xatlas.

A chart is a connected patch of faces with one photo, laid out as that photo sees it. A texel then is a pixel of the
photo (or a fixed number of them), so nothing is stretched or sampled twice, every part of the surface gets as many
texels as the photos have of it, and a patch needs no cut inside. xatlas's own segmentation knows nothing of the
photos: its charts cross patches and cut them, and its packing is what is used here. Faces that no photo shows are
laid out along the axis that they face most, coarsely: they hold no detail. The faces of charts of a few texels only
become dots on a square of their own: with a gutter each they would take more room than what they show.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xatlas

from ..base.records import View
from ..surface.triangles import face_normals, triangle_areas
from .labelling import patches
from .visibility import in_camera, project, smooth_normals

PADDING = 2  # texels around a chart, on each page
_LEAST_CHART = 8.0  # texels: the faces of a smaller one are dots, of one colour each
_CELL = 3  # texels a side for each dot
_UNSEEN_DENSITY = 0.25  # of the texels that photos give a face of the same size
_FULL = 0.7  # share of a page that packed charts fill, about
_TRIES = 8
_STEP = 64  # texels: pages are a multiple of it, so that mipmaps divide evenly for long
_SPARE = 1.02  # of the side that charts need on one page: on several they fit less well
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
    areas = np.bincount(chart, triangle_areas(flat))
    dots = np.flatnonzero((areas < _LEAST_CHART)[chart])[: (size // (2 * _CELL)) ** 2]
    charted = np.setdiff1d(np.arange(len(faces)), dots, assume_unique=True)
    shapes = _shapes(flat[charted], faces[charted], chart[charted])
    packed = _pack(shapes, len(dots), size, max_pages)
    if packed is None:
        return None
    corners, page = np.empty((len(faces), 3, 2), np.float32), np.empty(len(faces), np.int32)
    corners[charted] = _on_pixels(packed.corners, flat[charted] * packed.scale, shapes.chart)
    corners[dots], page[charted], page[dots] = packed.dots, packed.page, packed.dots_page
    border = ((neighbours < 0) | (chart[neighbours] != chart[:, None])).any(axis=1)
    use = float(triangle_areas(corners).sum() / (packed.pages * packed.size**2))
    return Layout(corners, page, border, packed.pages, packed.size, packed.scale, use)


def _on_pixels(corners: np.ndarray, flat: np.ndarray, chart: np.ndarray) -> np.ndarray:
    """Corners (M,3,2), each chart moved by less than a texel so that texels lie on the pixels of its photo, where the
    corners are `flat` (M,3,2), and take their colours without interpolation."""
    order = np.argsort(-triangle_areas(flat), kind="stable")
    best = order[np.unique(chart[order], return_index=True)[1]]  # the largest face of each chart
    here, there = corners[best].astype(np.float64), np.concatenate([flat[best], -flat[best]], axis=2)
    edges, turned = here[:, 1:] - here[:, :1], there[:, 1:] - there[:, :1]
    # Charts are turned by quarters: which of x, y, -x and -y goes along each axis of the page?
    axis = np.abs(edges[..., None] - turned[:, :, None]).sum(axis=1).argmin(axis=2)  # (charts, 2)
    shift = here[:, 0] - np.take_along_axis(there[:, 0], axis, axis=1)
    result: np.ndarray = corners + (np.rint(shift) - shift)[chart, None].astype(np.float32)
    return result


@dataclass(frozen=True)
class _Shapes:
    """Charts of m faces as xatlas takes them: `points` (n,2) float32, each chart from its own low corner; `index`
    (m,3); `chart` (m,) from 0."""

    points: np.ndarray
    index: np.ndarray
    chart: np.ndarray


@dataclass(frozen=True)
class _Packed:
    """Charts on pages: `corners` (m,3,2) in texels and `page` (m,) of their faces; the `dots` (d,3,2) on `dots_page`;
    `pages` of `size` texels a side; `scale`, texels a pixel."""

    corners: np.ndarray
    page: np.ndarray
    dots: np.ndarray
    dots_page: int
    pages: int
    size: int
    scale: float


def _shapes(flat: np.ndarray, faces: np.ndarray, chart: np.ndarray) -> _Shapes:
    """Of faces (m,3) with corners (m,3,2) in pixels."""
    chart = np.unique(chart, return_inverse=True)[1].reshape(-1)
    # One point for each vertex of each chart.
    key = chart[:, None].astype(np.int64) * (int(faces.max(initial=0)) + 1) + faces
    _, first, index = np.unique(key, return_index=True, return_inverse=True)
    points = flat.reshape(-1, 2)[first]
    # xatlas works in single precision, and lets no chart be wider than a page.
    of = chart.repeat(3)[first]
    low = np.full((int(chart.max(initial=0)) + 1, 2), np.inf)
    np.minimum.at(low, of, points)
    return _Shapes((points - low[of]).astype(np.float32), index.reshape(-1, 3), chart)


def _pack(shapes: _Shapes, dots: int, size: int, max_pages: int) -> _Packed | None:
    widest = float(shapes.points.max(initial=1))
    # Padding takes its share too: about half of it around the outline of each chart.
    areas = triangle_areas(shapes.points[shapes.index])
    outline = 4 * np.sqrt(np.bincount(shapes.chart, areas)) * PADDING / 2 + PADDING**2
    room = max_pages * size**2 * _FULL
    scale = min(1.0, float(np.sqrt(room / max(areas.sum() + outline.sum(), 1))))
    for _ in range(_TRIES):
        scale = min(scale, (size - 2 * PADDING - 2) / widest)
        atlas = _atlas(shapes, dots, scale, 0)  # on one page, as large as it takes
        side = _side(max(atlas.width, atlas.height))
        if side > size:
            # On several, of a size by which the last one is as full as the others.
            pages = int(np.ceil(side**2 / size**2))
            least = _side(widest * scale + 2 * PADDING + 2)
            side = min(max(_side(_SPARE * side / np.sqrt(pages)), least), size)
            atlas = _atlas(shapes, dots, scale, side)
            if atlas.atlas_count > pages and side < size:
                side = size
                atlas = _atlas(shapes, dots, scale, side)
        if 0 < atlas.atlas_count <= max_pages:
            return _placed(atlas, dots, scale, side)
        scale *= 0.93 if atlas.atlas_count <= max_pages + 1 else 0.8
    return None


def _side(least: float) -> int:
    """A page's side in texels: a multiple of _STEP that is at least `least`."""
    return int(np.ceil(least / _STEP) * _STEP)


def _palette(dots: int) -> int:
    """Dots along each side of the square of texels that holds them all."""
    return int(np.ceil(np.sqrt(dots)))


def _placed(atlas: xatlas.Atlas, dots: int, scale: float, side: int) -> _Packed:
    _, index, uv = atlas.get_mesh(0)
    corners = (uv * np.array([atlas.width, atlas.height], np.float32))[index]
    page = atlas.get_mesh_vertex_assignment(0)[0].view(np.int32)[index]
    # xatlas leaves corners of faces without area in no chart: they shrink to a corner that has a place.
    placed = page >= 0
    best = placed.argmax(axis=1)
    rows = np.arange(len(page))
    corners = np.where(placed.all(axis=1)[:, None, None], corners, corners[rows, best][:, None])
    page = np.maximum(page[rows, best], 0)
    low = np.rint(corners[-2:].min(axis=(0, 1)))  # of the square for the dots
    cell = np.stack(np.divmod(np.arange(dots), max(_palette(dots), 1))[::-1], axis=1)
    middle = low + _CELL * (cell + 0.5)
    triangle = np.array([[-0.3, -0.2], [0.3, -0.2], [0.0, 0.4]])
    return _Packed(corners[:-2], page[:-2], (middle[:, None] + triangle).astype(np.float32), int(page[-1]),
                   atlas.atlas_count, side, scale)


def _atlas(shapes: _Shapes, dots: int, scale: float, side: int) -> xatlas.Atlas:
    """The charts at `scale`, and a square for the dots as one more: its two faces are the last."""
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32) * max(_CELL * _palette(dots), 1)
    count = len(shapes.points)
    faces = np.array([[count, count + 1, count + 2], [count, count + 2, count + 3]])
    last = int(shapes.chart.max(initial=-1)) + 1
    atlas = xatlas.Atlas()
    # The chart's number as material: charts of two photos may lie at the same place without being one.
    atlas.add_uv_mesh(
        np.concatenate([shapes.points * np.float32(scale), square]),
        np.concatenate([shapes.index, faces]).astype(np.uint32),
        np.append(shapes.chart, [last, last]).astype(np.uint32)[:, None],
    )
    options = xatlas.PackOptions()
    options.resolution, options.texels_per_unit, options.padding = side, 1.0, PADDING
    options.rotate_charts_to_axis = False  # an odd angle would cost sharpness; quarter turns do not
    options.bruteForce = False
    atlas.generate(xatlas.ChartOptions(), options)
    return atlas


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
