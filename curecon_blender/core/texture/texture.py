# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A texture for a mesh from the photos: the mean of those that show a place well and alike, on pages.

1. Every photo, one at a time, says which faces it sees and how well (visibility.py, candidates.py).
2. The photos' exposures and their lenses' falloffs are told from faces that several photos show (levelling.py). Each
   face chooses the photos that colour it, without outliers, and one that it is laid out by, so that patches are large
   (labelling.py).
3. Patches become charts, laid out as their photos see them, and are packed into pages (charts.py).
4. Photos count for a texel by how well they show it, gradually (blending.py). Colours of vertices are made first: they
   spread to what no photo shows (diffusion.py).
5. Every photo, again one at a time and at full size, adds its colours to the texels of its faces (baking.py).
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from ..base import images
from ..base.errors import SurfaceError
from ..base.files import atomic_write
from ..base.language import Text
from ..base.messages import Reporter
from ..base.records import Component
from ..base.sampling import sample
from ..surface.mesh import Mesh
from ..surface.triangles import face_neighbours
from .baking import Bake, bake
from .blending import Shares
from .candidates import Candidates, add_candidates
from .charts import Layout, lay_out
from .diffusion import diffuse
from .falloff import off_axis, write_cameras
from .labelling import choose_photos
from .levelling import Levelling, find_levelling
from .photo_sources import Source, find_sources
from .visibility import in_camera, project, smooth_normals

PAGE_SIZES = (256, 8192)  # pixels a side: below, padding takes most of a page; above, graphics cards give up
COLOUR, NORMAL = "texture", "normal"  # kinds of pages, as their files are named
_PASSES = 3  # over the photos: candidates, levelling, baking


class TextureError(SurfaceError):
    """A mesh cannot be textured: it has no faces, no photo is left, or its texture fits no page."""


@dataclass(frozen=True, kw_only=True)
class TextureOptions:
    """What a texture depends on. Sizes in pixels; `image_size` is the longest side at which photos are used (None:
    their own); `exclude` names views that must not be used; `memory_gib` bounds the pages held at once."""

    page_size: int = 4096
    max_pages: int = 4
    image_size: int | None = None
    jpeg: bool = False
    level: bool = True
    memory_gib: float = 1.0
    exclude: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Labelling:
    """Each face's photo `label` (M,) int16, -1 for none; `shares`, how much each photo counts for it; `levelling`,
    what photos' sRGB values are multiplied by."""

    label: np.ndarray
    shares: Shares
    levelling: Levelling


def texture_mesh(
    mesh: Mesh, component: Component, workspace: Path, options: TextureOptions, folder: Path, reporter: Reporter
) -> Mesh:
    """Write texture_0.png (or .jpg), texture_1... and falloff.json into `folder` and return the mesh with UVs, pages
    and new colours.

    Photos come from their original files, undistorted at full size through the component's sparse model; where that
    is gone, from the workspace's undistorted picture, with a warning. A face that no photo shows whole is coloured
    from its surroundings and marked `unseen`. Files appear, and earlier ones go, only when all is made.
    Raises TextureError (no faces, wrong sizes, no photo left, too few pages, memory) and WorkspaceError (full disk).
    """
    _check(mesh, options)
    sources = _sources(component, workspace, options, reporter)
    neighbours = face_neighbours(mesh.faces)
    labelling = _label(mesh, sources, neighbours, options, reporter)
    layout = _lay_out(mesh, labelling, neighbours, sources, options)
    colours = _colours(mesh, sources, labelling, reporter)
    plan = Bake(vertices=mesh.vertices, faces=mesh.faces, shares=labelling.shares,
                layout=layout, levelling=labelling.levelling, colours=colours)
    names = _write(folder, _encoded_pages(plan, sources, options, reporter), options)
    write_cameras(folder, [source.view for source in sources], labelling.levelling.lens)
    uv = layout.corners / layout.size
    uv[..., 1] = 1 - uv[..., 1]
    return replace(mesh, colours=colours, unseen=~labelling.shares.seen).with_texture(
        uv, layout.page, names
    )


def colour_vertices(mesh: Mesh, component: Component, workspace: Path, reporter: Reporter) -> Mesh:
    """The mesh with vertex colours from the photos, without UVs: the light alternative to a texture.

    Photos are labelling and levelled as for a texture, and taken from the workspace's undistorted pictures. Faces that
    no photo shows are coloured from their surroundings and marked `unseen`. Raises TextureError.
    """
    options = TextureOptions()
    _check(mesh, options)
    sources = _sources(component, workspace, options, reporter)
    labelling = _label(mesh, sources, face_neighbours(mesh.faces), options, reporter)
    colours = _colours(mesh, sources, labelling, reporter)
    reporter.progress(100, 100)
    return replace(mesh, colours=colours, unseen=~labelling.shares.seen, uv=None, page=None, pages=())


def _check(mesh: Mesh, options: TextureOptions) -> None:
    if not PAGE_SIZES[0] <= options.page_size <= PAGE_SIZES[1]:
        raise TextureError(
            Text("A texture page cannot have {} pixels a side.", options.page_size),
            remedy=Text("Choose between {} and {}: larger ones do not load on many computers.", PAGE_SIZES[0],
                        PAGE_SIZES[1]),
        )
    if options.max_pages < 1:
        raise TextureError("A texture needs at least one page.", remedy="Allow one page or more.")
    if options.image_size is not None and options.image_size < 1:
        raise TextureError(
            Text("Photos cannot be used at {} pixels.", options.image_size),
            remedy="Leave the size out for full resolution."
        )
    if not len(mesh.faces):
        raise TextureError(
            "The mesh has no faces to texture.", remedy="Build the mesh again, with a larger region or more faces."
        )
    if not np.isfinite(mesh.vertices).all():
        raise TextureError("The mesh has vertices that are not at any place (NaN).", remedy="Build the mesh again.")


def _sources(
    component: Component, workspace: Path, options: TextureOptions, reporter: Reporter
) -> list[Source]:
    sources = find_sources(component, workspace, options.image_size, options.exclude, reporter)
    if not sources:
        raise TextureError(
            "No photo is left to texture the mesh from.",
            remedy="Put the photos back, or run Reconstruct again: it makes the undistorted pictures anew.",
            path=workspace,
        )
    return sources


def _progress(reporter: Reporter, share: tuple[float, float], done: int, total: int) -> None:
    """Progress in percent: `share` is (passes before this one, its length in passes)."""
    reporter.progress(round(100 * (share[0] + share[1] * done / total) / _PASSES), 100)


def _label(
    mesh: Mesh, sources: list[Source], neighbours: np.ndarray, options: TextureOptions, reporter: Reporter
) -> _Labelling:
    """Steps 1 and 2. Raises TextureError when no photo shows a face."""
    candidates = Candidates.empty(len(mesh.faces))
    normals = smooth_normals(mesh.vertices, mesh.faces)
    for number, source in enumerate(sources):
        _progress(reporter, (0, 1), number, len(sources))
        add_candidates(candidates, number, source, mesh, normals, reporter)
    if not (candidates.quality > 0).any():
        raise TextureError(
            "No photo shows any face of the mesh.",
            remedy="Make sure that the mesh belongs to this reconstruction, or build it again.",
        )
    centroids, views = mesh.vertices[mesh.faces].mean(axis=1), [source.view for source in sources]
    levelling = find_levelling(candidates, centroids, views)
    levelling.apply(candidates, centroids, views)
    anchor = mesh.colours[mesh.faces].mean(axis=1).astype(np.uint8)
    label, weight = choose_photos(candidates, anchor, ~mesh.filled, neighbours)
    shares = Shares(candidates.view, weight, mesh.faces, len(mesh.vertices))
    return _Labelling(label, shares, levelling if options.level else Levelling.none(len(sources)))


def _lay_out(
    mesh: Mesh, labelling: _Labelling, neighbours: np.ndarray, sources: list[Source], options: TextureOptions
) -> Layout:
    """Step 3. Raises TextureError when the charts fit no pages."""
    views = tuple(source.full for source in sources)
    layout = lay_out(
        mesh.vertices, mesh.faces, labelling.label, neighbours, views, options.page_size, options.max_pages
    )
    if layout is None:
        raise TextureError(
            Text("The texture does not fit on {} page(s) of {} pixels.", options.max_pages, options.page_size),
            remedy="Choose larger pages or more of them, or build the mesh with fewer faces.",
        )
    return layout


def _colours(mesh: Mesh, sources: list[Source], labelling: _Labelling, reporter: Reporter) -> np.ndarray:
    """Step 4: colours (N,3) uint8 of all vertices, as the photos show them or else as what is around them."""
    total = np.zeros((len(mesh.vertices), 4), np.float32)
    for number, source in enumerate(sources):
        _progress(reporter, (1, 1), number, len(sources))
        face, weight = labelling.shares.of(number)
        if not len(face):
            continue
        picture = cv2.GaussianBlur(images.read_rgb(source.picture), (3, 3), 0)
        corner = mesh.faces[face].ravel()
        vertex, first = np.unique(corner, return_index=True)
        points = in_camera(mesh.vertices[vertex], source.view)
        pixels = project(points, source.view.K)
        colour = sample(picture, *pixels.T) * labelling.levelling.factors(number, off_axis(points))
        total[vertex] += weight.ravel()[first, None] * np.column_stack([colour, np.ones(len(vertex))])
    seen = np.zeros(len(mesh.vertices), bool)
    seen[mesh.faces[labelling.shares.seen]] = True
    seen &= total[:, 3] > 0
    mean = total[:, :3] / np.maximum(total[:, 3:], np.finfo(np.float32).tiny)
    colours = diffuse(mesh.vertices, mesh.faces, mean, seen, mesh.colours)
    return np.clip(np.rint(colours), 0, 255).astype(np.uint8)


def _encoded_pages(plan: Bake, sources: list[Source], options: TextureOptions, reporter: Reporter) -> list[np.ndarray]:
    """Step 5: the pages' files (bytes,), as many pages at once as memory allows. Raises TextureError."""
    layout = plan.layout
    at_once = int(options.memory_gib * 2**30 // (plan.bytes_per_texel * layout.size**2))
    if at_once < 1:
        raise TextureError(
            Text("A page of {} pixels does not fit into {:g} GiB of memory.", layout.size, options.memory_gib),
            remedy="Choose smaller pages or a larger memory budget.",
        )
    encoded = []
    for start in range(0, layout.pages, at_once):
        numbers = range(start, min(start + at_once, layout.pages))
        share = _PASSES - 1 + start / layout.pages, len(numbers) / layout.pages
        for page in bake(plan, sources, numbers, reporter, partial(_progress, reporter, share, total=len(sources))):
            encoded.append(_encode(page, options))
    return encoded


def write_pages(
    folder: Path, pages: list[np.ndarray], options: TextureOptions, kind: str = COLOUR
) -> tuple[str, ...]:
    """Write pages (S,S,3) uint8, all or none, in place of earlier ones of that kind; returns the files' names. Raises
    WorkspaceError."""
    return _write(folder, [_encode(page, options, kind) for page in pages], options, kind)


def _encode(page: np.ndarray, options: TextureOptions, kind: str = COLOUR) -> np.ndarray:
    settings = [cv2.IMWRITE_PNG_COMPRESSION, 3]
    if options.jpeg:
        settings = [cv2.IMWRITE_JPEG_QUALITY, 93]
        if kind == NORMAL:  # it has no colour that the eye would not miss
            settings += [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
    return np.asarray(cv2.imencode(_suffix(options), page[..., ::-1], settings)[1])


def _suffix(options: TextureOptions) -> str:
    return ".jpg" if options.jpeg else ".png"


def _write(
    folder: Path, encoded: list[np.ndarray], options: TextureOptions, kind: str = COLOUR
) -> tuple[str, ...]:
    """All pages or none; then pages of an earlier texture that are not among them go. The files' names."""
    names = tuple(f"{kind}_{number}{_suffix(options)}" for number in range(len(encoded)))
    with ExitStack() as stack:
        files = [stack.enter_context(atomic_write(folder / name)) for name in names]
        for file, content in zip(files, encoded, strict=True):
            file.write(content.tobytes())
            file.flush()
    for old in (*folder.glob(f"{kind}_*.png"), *folder.glob(f"{kind}_*.jpg")):
        if old.name not in names and old.stem.removeprefix(f"{kind}_").isdigit():
            old.unlink(missing_ok=True)
    return names
