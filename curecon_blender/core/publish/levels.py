# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Levels of detail of a surface: itself, and coarser ones that are textured anew from the photos."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from ..base.errors import SurfaceError
from ..base.files import scratch_folder
from ..base.language import Text
from ..base.messages import Reporter
from ..base.records import Component
from ..deliver.ortho import read_pages
from ..surface.detail import simplified
from ..surface.mesh import Mesh
from ..surface.triangles import triangle_areas
from ..texture.texture import TextureOptions, texture_mesh

COARSEST = 12_000  # faces: with its texture it is the first thing that a visitor waits for
_FEW = 10  # times so many faces need no level in between
_PAGE, _PHOTO = 2048, 800  # pixels a side of the coarsest texture's page, and of the photos that it is made from
_MOST_PAGE = 4096
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


def coarser(
    mesh: Mesh, component: Component, workspace: Path, scratch: Path, reporter: Reporter
) -> list[Level]:
    """Levels coarser than a mesh, the coarsest first; none for a small mesh. `scratch` is where a folder for files that
    are deleted again is made. Raises SurfaceError, WorkspaceError, Cancelled."""
    counts = [*_counts(len(mesh.faces))]
    levels: list[Level] = []
    finer = mesh
    with scratch_folder(scratch / "levels") as folder:
        for number, count in enumerate(counts):
            finer = simplified(finer, count, folder, reporter)
            reporter.progress(2 * number + 1, 2 * len(counts))
            scale = 2 ** (len(counts) - 1 - number)
            levels.append(_painted(mesh, finer, component, workspace, folder, scale, reporter))
            reporter.progress(2 * number + 2, 2 * len(counts))
    return levels[::-1]


def _counts(faces: int) -> Iterator[int]:
    """Of the coarser levels, the finest first."""
    if faces > _FEW * COARSEST:
        yield int(np.sqrt(faces * COARSEST))
    if faces > 2 * COARSEST:
        yield COARSEST


def _painted(
    fine: Mesh, coarse: Mesh, component: Component, workspace: Path, folder: Path, scale: int, reporter: Reporter
) -> Level:
    """A coarse mesh with a texture of its own, `scale` times as fine as the coarsest one's, where the fine one has
    any."""
    pages = np.zeros((0, 1, 1, 3), np.uint8)
    if fine.pages:
        options = TextureOptions(page_size=min(_PAGE * scale, _MOST_PAGE), max_pages=1, image_size=_PHOTO * scale)
        quiet = Reporter(cancelled=reporter.cancelled)  # a stage's own progress would be none of the whole's
        try:
            coarse = texture_mesh(coarse, component, workspace, options, folder, quiet)
            pages = read_pages(folder, coarse.pages)
        except SurfaceError as error:
            reporter.warning(Text("From afar the surface shows the colours of its vertices: {}", error.message))
        if quiet.warnings:
            reporter.log(f"{quiet.warnings[0]} ({len(quiet.warnings)} such warnings)")
    if fine.unseen is not None:
        # Few photos show a large face whole, which says nothing of the fine ones in its place.
        nearest = cKDTree(fine.vertices[fine.faces].mean(axis=1)).query(coarse.vertices[coarse.faces].mean(axis=1))[1]
        coarse = replace(coarse, unseen=fine.unseen[nearest])
    return Level(coarse, pages, max(_distance(fine, coarse), texel(coarse, pages)))


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
