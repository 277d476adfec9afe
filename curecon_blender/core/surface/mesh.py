# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The surface as triangles, with what is known of each, and its file: a binary PLY, read and written with numpy alone.

A textured mesh's PLY holds UVs and pages as MeshLab has them (face properties texcoord and texnumber, and comments
TextureFile), so that other programs open it as it is.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..base.errors import SurfaceError, WorkspaceError
from ..base.language import Text
from ..base.ply import Field, column, read_ply, row_type, table, write_ply
from ..base.reading import FARTHEST, is_file_name
from .triangles import triangle_areas

_VERTEX = row_type([
    ("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1"),
    ("distance", "<f4"), ("views", "u1"),
])
_MARKS = "filled", "weak", "unseen"
_TEXTURE: list[Field] = [("texcoord", "<f4", 6), ("texnumber", "<i4")]
_LISTS = {"vertex_indices": 3, "texcoord": 6}
_PAGE, _NORMAL_PAGE = "TextureFile ", "NormalFile "  # comments, one a page
SHARP_ANGLE = 45.0  # degrees between faces: corners of buildings stay sharp, the noise of measured walls is smoothed
_REMEDY = "Run Build Mesh again."


class MeshError(SurfaceError):
    """No surface can be made of this cloud with these options."""


@dataclass(frozen=True, kw_only=True)
class Mesh:
    """Triangles in the component's world frame (Z up), with what supports them.

    `vertices` (N,3) float32; `faces` (M,3) int32, counter-clockwise seen from outside; `colours` (N,3) uint8 sRGB;
    `distance` (N,) float32, how far the nearest measured point is, in world units; `views` (N,) uint8, how many photos
    confirm what was measured there, 0 where nothing was; `filled` (M,) bool, faces that no photo measured;
    `weak` (M,) bool, faces that one photo alone measured (None where that is not known);
    `unseen` (M,) bool, apart from that, faces whose colour no photo shows (None before they are painted).
    A textured mesh has `uv` (M,3,2) float32, each corner's place on its page, v upwards from 0 at the bottom,
    `page` (M,) int32 and `pages`, the pages' picture files, relative to the mesh's own file; with a normal map,
    `normal_pages` too, one for each page.
    """

    vertices: np.ndarray
    faces: np.ndarray
    colours: np.ndarray
    distance: np.ndarray
    views: np.ndarray
    filled: np.ndarray
    weak: np.ndarray | None = None
    unseen: np.ndarray | None = None
    uv: np.ndarray | None = None
    page: np.ndarray | None = None
    pages: tuple[str, ...] = ()
    normal_pages: tuple[str, ...] = ()

    def with_texture(self, uv: np.ndarray, page: np.ndarray, pages: tuple[str, ...]) -> Mesh:
        """The same surface with UVs, page numbers and the pages' files, without a normal map."""
        return replace(self, uv=uv, page=page, pages=pages, normal_pages=())

    @property
    def recorded(self) -> np.ndarray:
        """Faces (M,) bool that photos measured and, where the mesh is painted, show."""
        return ~self.filled if self.unseen is None else ~(self.filled | self.unseen)

    @property
    def areas(self) -> np.ndarray:
        """Areas (M,) of the faces in square world units."""
        return triangle_areas(self.vertices[self.faces])


def filled_share(meshes: Iterable[Mesh]) -> float:
    """The share, 0 to 1, of the meshes' area together that no photo measured."""
    return _share((mesh, mesh.filled) for mesh in meshes)


def weak_share(meshes: Iterable[Mesh]) -> float:
    """The share, 0 to 1, of the meshes' area together that one photo alone measured."""
    return _share((mesh, mesh.weak) for mesh in meshes)


def unseen_share(meshes: Iterable[Mesh]) -> float:
    """The share, 0 to 1, of the meshes' area together whose colour no photo shows; 0 where none is painted."""
    return _share((mesh, mesh.unseen) for mesh in meshes)


def _share(marked: Iterable[tuple[Mesh, np.ndarray | None]]) -> float:
    part = total = 0.0
    for mesh, which in marked:
        areas = mesh.areas
        part, total = part + (0.0 if which is None else float(areas[which].sum())), total + float(areas.sum())
    return part / max(total, 1e-12)


def mesh_file(index: int) -> str:
    """A component's mesh, relative to its workspace."""
    return f"mesh_{index}.ply" if index else "mesh.ply"


def textured_folder(index: int) -> str:
    """The folder, relative to the workspace, of a component's textured mesh: mesh.ply and its pages."""
    return f"textured_{index}" if index else "textured"


def detail_folder(index: int, level: str) -> str:
    """The folder, relative to the workspace, of a component's textured mesh at a level of options.DETAILS."""
    return f"detail_{index}/{level}" if index else f"detail/{level}"


def write_mesh(path: Path, mesh: Mesh) -> None:
    """Write a mesh as PLY; the file appears under its name only when it is whole. Raises WorkspaceError."""
    vertices = table(_VERTEX, {
        "x y z": mesh.vertices, "red green blue": mesh.colours, "distance": mesh.distance, "views": mesh.views,
    })
    marks = {mark: known for mark in _MARKS if (known := getattr(mesh, mark)) is not None}
    columns = {"vertex_indices": mesh.faces, **marks}
    if mesh.uv is not None and mesh.page is not None:
        columns |= {"texcoord": mesh.uv.reshape(-1, 6), "texnumber": mesh.page}
    faces = table(_face(marks, "texcoord" in columns), columns)
    files = [*(_PAGE + page for page in mesh.pages), *(_NORMAL_PAGE + page for page in mesh.normal_pages)]
    write_ply(path, {"vertex": vertices, "face": faces}, ["CU-Recon", *files])


def read_mesh(path: Path) -> Mesh:
    """Read a mesh that `write_mesh` wrote. Raises WorkspaceError for a file that is missing, cut short or of another
    kind."""
    try:
        header, rows = read_ply(path, ["vertex", "face"], _LISTS)
        pages, normal_pages = (
            tuple(line.removeprefix(kind) for line in header.comments if line.startswith(kind))
            for kind in (_PAGE, _NORMAL_PAGE))
        vertices, faces = rows["vertex"], rows["face"]
        names = faces.dtype.names or ()
        marks, textured = [mark for mark in _MARKS if mark in names], "texcoord" in names
        ours = "filled" in marks and faces.dtype == _face(marks, textured) and vertices.dtype == _VERTEX
        if not ours or not all(map(is_file_name, pages + normal_pages)):
            raise ValueError("it is no mesh of CU-Recon")
        mesh = Mesh(
            vertices=column(vertices, "x y z"), faces=faces["vertex_indices"].copy(),
            colours=column(vertices, "red green blue"), distance=vertices["distance"].copy(),
            views=vertices["views"].copy(), pages=pages, normal_pages=normal_pages,
            **{mark: faces[mark].astype(bool) for mark in marks},
            uv=faces["texcoord"].reshape(-1, 3, 2).copy() if textured else None,
            page=faces["texnumber"].copy() if textured else None,
        )
        _check(mesh)
        if normal_pages and len(normal_pages) != len(pages):
            raise ValueError("it has a normal map for some of its pages alone")
    except FileNotFoundError as error:
        raise WorkspaceError(Text("{} does not exist.", path), remedy=_REMEDY, path=path) from error
    except OSError as error:
        raise WorkspaceError(Text("{} cannot be read ({}).", path, error.strerror),
                             remedy=_REMEDY, path=path) from error
    except ValueError as error:
        raise WorkspaceError(Text("{} is damaged: {}.", path, Text(str(error))), remedy=_REMEDY, path=path) from error
    return mesh


def _face(marks: Iterable[str], textured: bool) -> np.dtype:
    """A row of the file's faces."""
    return row_type([("vertex_indices", "<i4", 3), *((mark, "u1") for mark in marks), *(_TEXTURE if textured else [])])


def _check(mesh: Mesh) -> None:
    """Raises ValueError for what a mesh by `write_mesh` never holds."""
    numbers = [mesh.vertices, mesh.distance, *([mesh.uv] if mesh.uv is not None else [])]
    if not all((np.abs(values) < FARTHEST).all() for values in numbers):
        raise ValueError("it holds what is no number")
    if mesh.faces.size and (mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices)):
        raise ValueError("a face names a vertex that is not there")
