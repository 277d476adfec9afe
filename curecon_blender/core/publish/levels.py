# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Levels of detail of a surface: itself, and coarser ones that take its texture."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ..base.files import scratch_folder
from ..base.messages import Reporter
from ..deliver.ortho import read_pages
from ..surface.detail import simplified
from ..surface.mesh import Mesh
from ..surface.triangles import triangle_areas
from ..texture.texture import TextureOptions
from ..texture.transfer import transfer_texture
from .octree import Cell, around

COARSEST = 12_000  # faces: with its texture it is the first thing that a visitor waits for
_FEW = 10  # times so many faces need no level in between
_PAGE = 1024  # pixels a side of a page
_MOST_CHARTED = 15_000  # faces on a page
_MARGIN = 0.2  # of a part's size
_CONFIDENT = 0.95  # of a surface lies nearer to its coarser level than what that level is said to be off
_SAMPLE = 50_000  # vertices that tell it
_NEAR = 8  # faces whose middles are nearest to a place: among them, nearly always, the nearest face


@dataclass(frozen=True)
class Level:
    """A surface with its texture's pages (P,S,S,3), none for vertex colours; `error` is how far it is off, or how wide
    one of its texels is, in the mesh's unit."""

    mesh: Mesh
    pages: np.ndarray
    error: float


def coarser(mesh: Mesh, folder: Path, scratch: Path, reporter: Reporter) -> list[Level]:
    """Levels coarser than a mesh whose texture's pages are in `folder`, the coarsest first; none for a small mesh.
    `scratch` is where a folder for files that are deleted again is made. Raises SurfaceError, WorkspaceError,
    Cancelled."""
    counts = [*_counts(len(mesh.faces))]
    levels: list[Level] = []
    finer = mesh
    with scratch_folder(scratch / "levels") as place:
        for number, count in enumerate(counts):
            finer = simplified(finer, count, place, reporter)
            reporter.progress(2 * number + 1, 2 * len(counts))
            levels.append(_painted(mesh, finer, [folder / page for page in mesh.pages], place, reporter))
            reporter.progress(2 * number + 2, 2 * len(counts))
    return levels[::-1]


def _counts(faces: int) -> Iterator[int]:
    """Of the coarser levels, the finest first."""
    if faces > _FEW * COARSEST:
        yield int(np.sqrt(faces * COARSEST))
    if faces > 2 * COARSEST:
        yield COARSEST


def _painted(fine: Mesh, coarse: Mesh, files: list[Path], place: Path, reporter: Reporter) -> Level:
    """A coarse mesh with the texture of the fine one, whose pages are `files`: cut into parts of a page each, since the
    time that charts take grows faster than the faces."""
    pages = np.zeros((0, 1, 1, 3), np.uint8)
    if fine.uv is not None and files:
        fine = replace(fine, unseen=np.zeros(len(fine.faces), bool) if fine.unseen is None else fine.unseen)
        middles, finer = (one.vertices[one.faces].mean(axis=1) for one in (coarse, fine))
        parts = [*_parts(around(middles), middles, np.arange(len(middles)))]
        uv, page = np.zeros((len(middles), 3, 2), np.float32), np.zeros(len(middles), np.int32)
        unseen = np.zeros(len(middles), bool)
        pages = np.zeros((len(parts), _PAGE, _PAGE, 3), np.uint8)
        for number, members in enumerate(parts):
            reporter.check_cancelled()
            part = _some(coarse, members)
            # What of the fine surface may be nearest to it.
            low, high = part.vertices.min(axis=0), part.vertices.max(axis=0)
            margin = _MARGIN * float((high - low).max())
            near = ((finer > low - margin) & (finer < high + margin)).all(axis=1)
            beside = _some(fine, np.flatnonzero(near if near.any() else ~near))
            quiet = Reporter(cancelled=reporter.cancelled)  # a part's own progress would be none of the whole's
            part = transfer_texture(part, beside, files, TextureOptions(page_size=_PAGE), place / "pages", quiet)
            pages[number] = read_pages(place / "pages", part.pages)[0]
            uv[members], unseen[members], page[members] = part.uv, part.unseen, number
        coarse = replace(coarse, unseen=unseen).with_texture(uv, page, tuple(map(str, range(len(parts)))))
    return Level(coarse, pages, max(_distance(fine, coarse), texel(coarse, pages)))


def _parts(cell: Cell, middles: np.ndarray, members: np.ndarray) -> Iterator[np.ndarray]:
    if len(members) <= _MOST_CHARTED or cell.deepest:
        yield members
        return
    for part, (inside,) in cell.parts([middles], [members]):
        yield from _parts(part, middles, inside)


def _some(mesh: Mesh, members: np.ndarray) -> Mesh:
    """Some faces of a mesh, with their vertices alone."""
    used, index = np.unique(mesh.faces[members], return_inverse=True)
    of_faces: dict[str, Any] = {name: value[members] for name in ("filled", "unseen", "uv", "page")
                                if (value := getattr(mesh, name)) is not None}
    return replace(mesh, vertices=mesh.vertices[used], faces=index.reshape(-1, 3).astype(np.int32),
                   colours=mesh.colours[used], distance=mesh.distance[used], views=mesh.views[used], **of_faces)


def texel(mesh: Mesh, pages: np.ndarray) -> float:
    """How wide a texel is on the surface; 0 without a texture."""
    if mesh.uv is None or not len(pages):
        return 0.0
    texels = float(triangle_areas(mesh.uv * pages.shape[1]).sum())
    return float(np.sqrt(mesh.areas.sum() / max(texels, 1.0)))


def _distance(fine: Mesh, coarse: Mesh) -> float:
    """How far the fine mesh's vertices lie from the coarse one, but for the farthest few."""
    places = fine.vertices[:: max(len(fine.vertices) // _SAMPLE, 1)].astype(np.float64)
    corners = coarse.vertices[coarse.faces].astype(np.float64)
    near = cKDTree(corners.mean(axis=1)).query(places, k=min(_NEAR, len(corners)))[1].reshape(len(places), -1)
    nearest = np.full(len(places), np.inf)
    for column in near.T:
        nearest = np.minimum(nearest, _to_triangles(places, corners[column]))
    return float(np.quantile(nearest, _CONFIDENT))


def _to_triangles(places: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Distances (N,) of places (N,3) from triangles (N,3,3)."""
    best = np.full(len(places), np.inf)
    for k in range(3):
        start, along = corners[:, k], corners[:, (k + 1) % 3] - corners[:, k]
        share = np.einsum("nc,nc->n", places - start, along) / np.maximum((along**2).sum(axis=1), 1e-30)
        best = np.minimum(best, np.linalg.norm(places - start - np.clip(share, 0, 1)[:, None] * along, axis=1))
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.maximum(np.linalg.norm(normal, axis=1), 1e-30)
    inside = np.ones(len(places), bool)
    for k in range(3):
        edge = np.cross(corners[:, (k + 1) % 3] - corners[:, k], places - corners[:, k])
        inside &= np.einsum("nc,nc->n", edge, normal) >= 0
    off = np.abs(np.einsum("nc,nc->n", places - corners[:, 0], normal)) / length
    return np.where(inside, np.minimum(best, off), best)
