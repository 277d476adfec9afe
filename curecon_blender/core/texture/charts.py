# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""UV charts of a mesh whose faces have chosen their photos, packed into pages by xatlas.

A chart is a connected patch of faces with one photo, laid out as that photo sees it. A texel then is a pixel of the
photo (or a fixed number of them), so nothing is stretched or sampled twice, every part of the surface gets as many
texels as the photos have of it, and a patch needs no cut inside. xatlas's own segmentation knows nothing of the
photos: its charts cross patches and cut them, and its packing is what is used here. Faces that no photo shows are
laid out along the axis that they face most, coarsely: they hold no detail.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xatlas

from ..base.records import View
from ..surface.triangles import face_normals, triangle_areas
from .labelling import patches
from .visibility import in_camera, project, smooth_normals

PADDING = 3  # texels around a chart, on each page
_UNSEEN_DENSITY = 0.25  # of the texels that photos give a face of the same size
_FULL = 0.7  # share of a page that packed charts fill, about
_TRIES = 8
_STEP = 256  # texels: pages are a multiple of it, so that mipmaps divide evenly for long
_SMALL_PATCH = 500  # faces: an unseen patch below it becomes one chart, whatever its shape
_WORTH = 0.85  # of the scale may be given up to save a whole page


@dataclass(frozen=True)
class Layout:
    """Where faces lie on the pages. `corners` (M,3,2) float32 texels from the page's top left; `page` (M,) int32;
    `pages` and `size` (texels a side); `scale`, texels per pixel of a photo at full size; `use`, the share of the
    pages' area that charts cover."""

    corners: np.ndarray
    page: np.ndarray
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

    # One point for each vertex of each chart.
    key = chart[:, None].astype(np.int64) * len(vertices) + faces
    _, first, index = np.unique(key, return_index=True, return_inverse=True)
    points = flat.reshape(-1, 2)[first]
    index = index.reshape(-1, 3)
    # xatlas works in single precision, and lets no chart be wider than a page.
    of = chart.repeat(3)[first]
    low = np.full((chart.max() + 1, 2), np.inf)
    np.minimum.at(low, of, points)
    points = (points - low[of]).astype(np.float32)
    return _pack(points, index, chart, size, max_pages)


def _pack(points: np.ndarray, index: np.ndarray, chart: np.ndarray, size: int, max_pages: int) -> Layout | None:
    corners = points[index]
    areas = triangle_areas(corners)
    # Padding takes its share too: about half of it around the outline of each chart.
    outline = 4 * np.sqrt(np.bincount(chart, areas)) * PADDING / 2 + PADDING**2
    room = max_pages * size**2 * _FULL
    scale = min(1.0, float(np.sqrt(room / max(areas.sum() + outline.sum(), 1))))
    widest = float(points.max(initial=1))
    for _ in range(_TRIES):
        scale = min(scale, (size - 2 * PADDING - 2) / widest)
        needed = (areas.sum() * scale**2 + outline.sum() * scale) / _FULL
        side = _side(max(np.sqrt(needed), widest * scale + 2 * PADDING + 2), size)
        atlas = _packed(points, index, chart, scale, side)
        while atlas.atlas_count > 1 and side < size:
            side = _side(1.1 * side, size)
            atlas = _packed(points, index, chart, scale, side)
        if 0 < atlas.atlas_count <= max_pages and (atlas.atlas_count == 1 or atlas.width == size):
            return _with_one_page_less(_layout(atlas, scale), atlas, points, index, chart)
        scale *= 0.93 if atlas.atlas_count <= max_pages + 1 else 0.8
    return None


def _side(least: float, most: int) -> int:
    """A page's side in texels: a multiple of _STEP that is at least `least`, as far as `most` allows."""
    return int(min(np.ceil(least / _STEP) * _STEP, most))


def _with_one_page_less(
    layout: Layout, atlas: xatlas.Atlas, points: np.ndarray, index: np.ndarray, chart: np.ndarray
) -> Layout:
    """The layout on one page less, if the last page holds so little that texels need to grow by little for it."""
    shares = np.array([atlas.get_utilization(page) for page in range(layout.pages)])
    shrink = 0.95 * float(np.sqrt(1 - shares[-1] / max(shares.sum(), 1e-9)))
    if layout.pages == 1 or shrink < _WORTH:
        return layout
    smaller = _packed(points, index, chart, layout.scale * shrink, layout.size)
    return _layout(smaller, layout.scale * shrink) if 0 < smaller.atlas_count < layout.pages else layout


def _layout(atlas: xatlas.Atlas, scale: float) -> Layout:
    _, index, uv = atlas.get_mesh(0)
    corners = (uv * np.array([atlas.width, atlas.height], np.float32))[index]
    page = atlas.get_mesh_vertex_assignment(0)[0].view(np.int32)[index]
    # xatlas leaves corners of faces without area in no chart: they shrink to a corner that has a place.
    placed = page >= 0
    best = placed.argmax(axis=1)
    rows = np.arange(len(page))
    corners = np.where(placed.all(axis=1)[:, None, None], corners, corners[rows, best][:, None])
    page = np.maximum(page[rows, best], 0)
    use = float(triangle_areas(corners).sum() / (atlas.atlas_count * atlas.width * atlas.height))
    return Layout(corners, page, atlas.atlas_count, atlas.width, scale, use)


def _packed(points: np.ndarray, index: np.ndarray, chart: np.ndarray, scale: float, side: int) -> xatlas.Atlas:
    atlas = xatlas.Atlas()
    # The chart's number as material: charts of two photos may lie at the same place without being one.
    atlas.add_uv_mesh(points, index.astype(np.uint32), chart.astype(np.uint32)[:, None])
    options = xatlas.PackOptions()
    options.resolution, options.texels_per_unit, options.padding = side, scale, PADDING
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
