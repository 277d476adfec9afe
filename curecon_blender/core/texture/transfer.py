# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The texture of a mesh for a simplified one: each texel takes the colour of the nearest place of the finer surface,
and on a normal map its direction.

Photos cannot give it: they see few of the large faces whole, and where those stray from the true surface, each photo
would show them something else.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import xatlas
from scipy.spatial import cKDTree

from ..base import images
from ..base.messages import Reporter
from ..base.sampling import sample
from ..surface.mesh import Mesh
from ..surface.triangles import face_normals, triangle_areas
from .baking import fill_gaps
from .charts import PADDING
from .normal_map import FLAT, corner_normals, frames
from .rasterise import scan_convert
from .texture import COLOUR, NORMAL, TextureOptions, write_pages

_NEAREST = 4  # faces of the finer mesh that a texel is compared with
_BACK = 9.0  # times the squared distance that the back of a face counts for


def transfer_texture(
    coarse: Mesh, fine: Mesh, pages: list[Path], options: TextureOptions, folder: Path, reporter: Reporter, *,
    normal_map: bool = False,
) -> Mesh:
    """Write texture_0.png (or .jpg) of at most `options.page_size` texels a side into `folder`, with `normal_map` also
    normal_0, and return the coarse mesh with its UVs. `fine` is the textured mesh that it was made of, and `pages` its
    pages' files.

    xatlas cuts and packs the charts. A face is `unseen` where most of the finer surface nearest to it is. Raises
    PhotoError for a page that cannot be read, and WorkspaceError for a full disk.
    """
    reporter.progress(0, 100)
    uv = _unwrapped(coarse)
    size = options.page_size
    corners = uv * np.float32(size)
    uv[..., 1] = 1 - uv[..., 1]
    coarse = coarse.with_texture(uv, np.zeros(len(uv), np.int32), ())
    finer = _Finer(fine, pages, float(triangle_areas(corners).sum()))
    relief = _Relief(coarse, fine) if normal_map else None
    facing = face_normals(coarse.vertices, coarse.faces)
    page, covered = np.zeros((size * size, 3), np.uint8), np.zeros(size * size, np.uint8)
    bumps = np.full((size * size, 3), FLAT, np.uint8) if normal_map else page[:0]
    unseen, count = np.zeros(len(coarse.faces)), np.zeros(len(coarse.faces))
    for face, pixel, weights in scan_convert(corners, size, size):
        points = np.einsum("nk,nkc->nc", weights, coarse.vertices[coarse.faces[face]])
        place = finer.nearest(points, facing[face])
        page[pixel], covered[pixel] = finer.colours(*place), 1
        if relief is not None:
            bumps[pixel] = relief.texels(face, weights, *place)
        unseen += np.bincount(face, finer.unseen[place[0]], len(unseen))
        count += np.bincount(face, minlength=len(count))
        reporter.progress(5 + 85 * (int(face.max()) + 1) // len(coarse.faces), 100)
    small = np.flatnonzero(count == 0)  # they have the texel that they lie in, if no other has
    place = finer.nearest(coarse.vertices[coarse.faces[small]].mean(axis=1), facing[small])
    x, y = np.clip(corners[small].mean(axis=1), 0, size - 1).T.astype(np.int64)
    free = covered[y * size + x] == 0
    page[(y * size + x)[free]], covered[y * size + x] = finer.colours(*place)[free], 1
    unseen[small], count[small] = finer.unseen[place[0]], 1
    names = [
        write_pages(folder, [fill_gaps(texels.reshape(size, size, 3), covered.reshape(size, size).copy())],
                    options, kind)
        for kind, texels in ((COLOUR, page), (NORMAL, bumps)) if len(texels)
    ]
    reporter.progress(100, 100)
    return replace(coarse, unseen=2 * unseen > count, pages=names[0], normal_pages=names[1] if normal_map else ())


class _Relief:
    """The finer surface's directions, told in the coarse one's frames."""

    def __init__(self, coarse: Mesh, fine: Mesh) -> None:
        self._frames, self._normals = frames(coarse), corner_normals(fine)

    def texels(self, face: np.ndarray, weights: np.ndarray, theirs: np.ndarray, place: np.ndarray) -> np.ndarray:
        """Of a normal map (n,3) uint8 at places `weights` (n,3) on coarse faces (n,), for `place` on `theirs`."""
        return self._frames.encode(face, weights, np.einsum("nk,nkc->nc", place, self._normals[theirs]))


class _Finer:
    """The finer surface: where it is nearest to given points, and its colour there at about `texels` on the whole;
    `unseen` (M,) bool, its faces that no photo shows."""

    def __init__(self, mesh: Mesh, pages: list[Path], texels: float) -> None:
        assert mesh.uv is not None and mesh.page is not None and mesh.unseen is not None
        self._mesh, self._uv, self._page, self.unseen = mesh, mesh.uv, mesh.page, mesh.unseen
        self._normals = face_normals(mesh.vertices, mesh.faces)
        self._tree = cKDTree(mesh.vertices[mesh.faces].mean(axis=1))
        self._pages = [images.read_rgb(path) for path in pages]
        finer = float(triangle_areas(mesh.uv).sum()) * self._pages[0].shape[0] ** 2
        halvings = round(0.5 * np.log2(max(finer / max(texels, 1), 1)))
        if halvings > 0:  # several of its texels fall on one of the coarse mesh's
            self._pages = [cv2.resize(page, None, fx=0.5**halvings, fy=0.5**halvings, interpolation=cv2.INTER_AREA)
                           for page in self._pages]

    def nearest(self, points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The face (n,) and barycentric place (n,3) on it nearest to each of `points` (n,3), among faces that look
        about as `normals` (n,3) do."""
        if not len(points):
            return np.zeros(0, np.int64), np.zeros((0, 3))
        candidates = self._tree.query(points, min(_NEAREST, self._tree.n))[1].reshape(len(points), -1)
        best, face = np.full(len(points), np.inf), candidates[:, 0].copy()
        weights = np.zeros((len(points), 3))
        for candidate in candidates.T:
            corners = self._mesh.vertices[self._mesh.faces[candidate]].astype(np.float64)
            share = _on_triangle(points, corners)
            off = ((np.einsum("nk,nkc->nc", share, corners) - points) ** 2).sum(axis=1)
            back = np.einsum("nc,nc->n", self._normals[candidate], normals) < 0
            off = np.where(back, _BACK * off, off)
            better = off < best
            best[better], face[better], weights[better] = off[better], candidate[better], share[better]
        return face, weights

    def colours(self, face: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Colours (n,3) uint8 at such places."""
        place = np.einsum("nk,nkc->nc", weights, self._uv[face])
        colours = np.zeros((len(face), 3), np.uint8)
        for number, page in enumerate(self._pages):
            here = np.flatnonzero(self._page[face] == number)
            colours[here] = sample(page, place[here, 0] * page.shape[1], (1 - place[here, 1]) * page.shape[0])
        return colours


def _on_triangle(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Barycentric coordinates (n,3), none negative, of about the nearest place of triangles (n,3,3) to points (n,3)."""
    a, b, p = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], points - corners[:, 0]
    aa, ab, bb = (np.einsum("nc,nc->n", u, v) for u, v in ((a, a), (a, b), (b, b)))
    ap, bp = np.einsum("nc,nc->n", a, p), np.einsum("nc,nc->n", b, p)
    area = np.maximum(aa * bb - ab * ab, np.finfo(np.float64).tiny)
    second, third = (bb * ap - ab * bp) / area, (aa * bp - ab * ap) / area
    share = np.clip(np.stack([1 - second - third, second, third], axis=1), 0, 1)
    result: np.ndarray = share / share.sum(axis=1, keepdims=True)
    return result


def _unwrapped(mesh: Mesh) -> np.ndarray:
    """Corners (M,3,2) float32 of the faces on a page of side 1, from its top left."""
    atlas = xatlas.Atlas()
    atlas.add_mesh(mesh.vertices, mesh.faces.astype(np.uint32))
    options = xatlas.PackOptions()
    options.padding, options.bruteForce = PADDING, False
    atlas.generate(xatlas.ChartOptions(), options)
    _, index, uv = atlas.get_mesh(0)
    scale = np.array([atlas.width, atlas.height], np.float32) / max(atlas.width, atlas.height)
    corners: np.ndarray = (uv * scale)[index]
    return corners
