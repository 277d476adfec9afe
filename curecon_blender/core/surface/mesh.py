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
from ..base.ply import Field, column, read_ply, row_type, table, write_ply
from ..base.reading import FARTHEST, is_file_name
from .triangles import triangle_areas

_VERTEX = row_type([
    ("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1"),
    ("distance", "<f4"), ("views", "u1"),
])
_FACE_FIELDS: list[Field] = [("vertex_indices", "<i4", 3), ("filled", "u1")]
_FACE = row_type(_FACE_FIELDS)
_TEXTURED_FACE = row_type([*_FACE_FIELDS, ("texcoord", "<f4", 6), ("texnumber", "<i4")])
_LISTS = {"vertex_indices": 3, "texcoord": 6}
_PAGE = "TextureFile "  # a comment, one a page
_REMEDY = "Run Build Mesh again."


class MeshError(SurfaceError):
    """No surface can be made of this cloud with these options."""


@dataclass(frozen=True, kw_only=True)
class Mesh:
    """Triangles in the component's world frame (Z up), with what supports them.

    `vertices` (N,3) float32; `faces` (M,3) int32, counter-clockwise seen from outside; `colours` (N,3) uint8 sRGB;
    `distance` (N,) float32, how far the nearest measured point is, in world units; `views` (N,) uint8, how many photos
    confirm what was measured there, 0 where nothing was; `filled` (M,) bool, faces that no photo measured.
    A textured mesh has `uv` (M,3,2) float32, each corner's place on its page, v upwards from 0 at the bottom,
    `page` (M,) int32 and `pages`, the pages' picture files, relative to the mesh's own file.
    """

    vertices: np.ndarray
    faces: np.ndarray
    colours: np.ndarray
    distance: np.ndarray
    views: np.ndarray
    filled: np.ndarray
    uv: np.ndarray | None = None
    page: np.ndarray | None = None
    pages: tuple[str, ...] = ()

    def with_texture(self, uv: np.ndarray, page: np.ndarray, pages: tuple[str, ...]) -> Mesh:
        """The same surface with UVs, page numbers and the pages' files."""
        return replace(self, uv=uv, page=page, pages=pages)

    @property
    def areas(self) -> np.ndarray:
        """Areas (M,) of the faces in square world units."""
        return triangle_areas(self.vertices[self.faces])


def filled_share(meshes: Iterable[Mesh]) -> float:
    """The share, 0 to 1, of the meshes' area together that no photo measured."""
    filled = total = 0.0
    for mesh in meshes:
        areas = mesh.areas
        filled, total = filled + float(areas[mesh.filled].sum()), total + float(areas.sum())
    return filled / max(total, 1e-12)


def mesh_file(index: int) -> str:
    """A component's mesh, relative to its workspace."""
    return f"mesh_{index}.ply" if index else "mesh.ply"


def textured_folder(index: int) -> str:
    """The folder, relative to the workspace, of a component's textured mesh: mesh.ply and its pages."""
    return f"textured_{index}" if index else "textured"


def write_mesh(path: Path, mesh: Mesh) -> None:
    """Write a mesh as PLY; the file appears under its name only when it is whole. Raises WorkspaceError."""
    vertices = table(_VERTEX, {
        "x y z": mesh.vertices, "red green blue": mesh.colours, "distance": mesh.distance, "views": mesh.views,
    })
    columns = {"vertex_indices": mesh.faces, "filled": mesh.filled}
    if mesh.uv is not None and mesh.page is not None:
        faces = table(_TEXTURED_FACE, {**columns, "texcoord": mesh.uv.reshape(-1, 6), "texnumber": mesh.page})
    else:
        faces = table(_FACE, columns)
    write_ply(path, {"vertex": vertices, "face": faces}, ["CU-Recon", *(_PAGE + page for page in mesh.pages)])


def read_mesh(path: Path) -> Mesh:
    """Read a mesh that `write_mesh` wrote. Raises WorkspaceError for a file that is missing, cut short or of another
    kind."""
    try:
        header, rows = read_ply(path, ["vertex", "face"], _LISTS)
        pages = tuple(line.removeprefix(_PAGE) for line in header.comments if line.startswith(_PAGE))
        vertices, faces = rows["vertex"], rows["face"]
        textured = faces.dtype == _TEXTURED_FACE
        if vertices.dtype != _VERTEX or not (textured or faces.dtype == _FACE) or not all(map(is_file_name, pages)):
            raise ValueError("it is no mesh of CU-Recon")
        mesh = Mesh(
            vertices=column(vertices, "x y z"), faces=faces["vertex_indices"].copy(),
            colours=column(vertices, "red green blue"), distance=vertices["distance"].copy(),
            views=vertices["views"].copy(), filled=faces["filled"].astype(bool), pages=pages,
            uv=faces["texcoord"].reshape(-1, 3, 2).copy() if textured else None,
            page=faces["texnumber"].copy() if textured else None,
        )
        _check(mesh)
    except FileNotFoundError as error:
        raise WorkspaceError(f"{path} does not exist.", remedy=_REMEDY, path=path) from error
    except OSError as error:
        raise WorkspaceError(f"{path} cannot be read ({error.strerror}).", remedy=_REMEDY, path=path) from error
    except ValueError as error:
        raise WorkspaceError(f"{path} is damaged: {error}.", remedy=_REMEDY, path=path) from error
    return mesh


def _check(mesh: Mesh) -> None:
    """Raises ValueError for what a mesh by `write_mesh` never holds."""
    numbers = [mesh.vertices, mesh.distance, *([mesh.uv] if mesh.uv is not None else [])]
    if not all((np.abs(values) < FARTHEST).all() for values in numbers):
        raise ValueError("it holds what is no number")
    if mesh.faces.size and (mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices)):
        raise ValueError("a face names a vertex that is not there")
