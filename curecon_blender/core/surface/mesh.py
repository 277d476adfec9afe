# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The surface as triangles, with what is known of each, and its file: a binary PLY, read and written with numpy alone.

A textured mesh's PLY holds UVs and pages as MeshLab has them (face properties texcoord and texnumber, and comments
TextureFile), so that other programs open it as it is.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..base import reading
from ..base.errors import WorkspaceError
from ..base.files import atomic_write

_VERTEX = np.dtype([
    ("position", "<f4", 3), ("colour", "u1", 3), ("distance", "<f4"), ("views", "u1"),
])
_FACE = np.dtype([("corners", "u1"), ("vertices", "<i4", 3), ("filled", "u1")])
_TEXTURED_FACE = np.dtype([*_FACE.descr, ("numbers", "u1"), ("uv", "<f4", (3, 2)), ("page", "<i4")])
_VERTEX_LINES = (
    "property float x", "property float y", "property float z", "property uchar red", "property uchar green",
    "property uchar blue", "property float distance", "property uchar views",
)
_FACE_LINES = ("property list uchar int vertex_indices", "property uchar filled")
_TEXTURED_LINES = ("property list uchar float texcoord", "property int texnumber")
_PAGE_COMMENT = "comment TextureFile "
_ELEMENT = re.compile(r"element (?:vertex|face) (\d{1,12})", re.ASCII)


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


def triangle_areas(corners: np.ndarray) -> np.ndarray:
    """Areas (M,) of triangles in space (M,3,3) or on a plane (M,3,2)."""
    ab, ac = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    if corners.shape[2] == 2:
        twice = np.abs(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])
    else:
        twice = np.linalg.norm(np.cross(ab, ac), axis=1)
    areas: np.ndarray = twice / 2
    return areas


def mesh_file(index: int) -> str:
    """A component's mesh, relative to its workspace."""
    return f"mesh_{index}.ply" if index else "mesh.ply"


def textured_folder(index: int) -> str:
    """The folder, relative to the workspace, of a component's textured mesh: mesh.ply and its pages."""
    return f"textured_{index}" if index else "textured"


def write_mesh(path: Path, mesh: Mesh) -> None:
    """Write a mesh as PLY; the file appears under its name only when it is whole. Raises WorkspaceError."""
    vertices = np.zeros(len(mesh.vertices), _VERTEX)
    vertices["position"], vertices["colour"] = mesh.vertices, mesh.colours
    vertices["distance"], vertices["views"] = mesh.distance, mesh.views
    textured = mesh.uv is not None
    faces = np.zeros(len(mesh.faces), _TEXTURED_FACE if textured else _FACE)
    faces["corners"], faces["vertices"], faces["filled"] = 3, mesh.faces, mesh.filled
    if textured:
        faces["numbers"], faces["uv"], faces["page"] = 6, mesh.uv, mesh.page
    with atomic_write(path) as file:
        file.write(_header(mesh).encode("ascii"))
        file.write(vertices.tobytes())
        file.write(faces.tobytes())


def read_mesh(path: Path) -> Mesh:
    """Read a mesh that `write_mesh` wrote. Raises WorkspaceError for a file that is missing, cut short or of another
    kind."""
    remedy = "Run Build Mesh again."
    try:
        with open(path, "rb") as file:
            lines = []
            while (line := file.readline(200).decode("ascii", "replace").rstrip("\n")) != "end_header":
                lines.append(line)
                if not line or len(lines) > 100:
                    raise WorkspaceError(f"{path} is not a mesh of CU-Recon.", remedy=remedy, path=path)
            counts = [int(found[1]) for line in lines if (found := _ELEMENT.fullmatch(line))]
            pages = tuple(line.removeprefix(_PAGE_COMMENT) for line in lines if line.startswith(_PAGE_COMMENT))
            textured = _TEXTURED_LINES[1] in lines
            expected = [line for line in lines if line.startswith("property")]
            if (len(counts) != 2 or not all(map(reading.is_file_name, pages))
                    or expected != [*_VERTEX_LINES, *_FACE_LINES, *(_TEXTURED_LINES if textured else ())]):
                raise WorkspaceError(f"{path} is not a mesh of CU-Recon.", remedy=remedy, path=path)
            face = _TEXTURED_FACE if textured else _FACE
            if counts[0] * _VERTEX.itemsize + counts[1] * face.itemsize > reading.left_bytes(path, file.tell()):
                raise WorkspaceError(f"{path} is cut short.", remedy=remedy, path=path)
            vertices, faces = np.fromfile(file, _VERTEX, counts[0]), np.fromfile(file, face, counts[1])
    except FileNotFoundError as error:
        raise WorkspaceError(f"{path} does not exist.", remedy=remedy, path=path) from error
    except OSError as error:
        raise WorkspaceError(f"{path} cannot be read ({error.strerror}).", remedy=remedy, path=path) from error
    numbers = [vertices["position"], vertices["distance"], *([faces["uv"]] if textured else ())]
    if not all((np.abs(values) < reading.FARTHEST).all() for values in numbers):
        raise WorkspaceError(f"{path} is damaged: it holds what is no number.", remedy=remedy, path=path)
    corners = faces["vertices"]
    if len(faces) and (corners.min() < 0 or corners.max() >= len(vertices)):
        raise WorkspaceError(f"{path} is damaged: a face names a vertex that is not there.", remedy=remedy, path=path)
    return Mesh(
        vertices=vertices["position"].copy(), faces=faces["vertices"].copy(), colours=vertices["colour"].copy(),
        distance=vertices["distance"].copy(), views=vertices["views"].copy(), filled=faces["filled"].astype(bool),
        uv=faces["uv"].copy() if textured else None, page=faces["page"].copy() if textured else None, pages=pages,
    )


def _header(mesh: Mesh) -> str:
    lines = ["ply", "format binary_little_endian 1.0", "comment CU-Recon"]
    lines += [_PAGE_COMMENT + page for page in mesh.pages]
    lines += [f"element vertex {len(mesh.vertices)}", *_VERTEX_LINES]
    lines += [f"element face {len(mesh.faces)}", *_FACE_LINES]
    lines += _TEXTURED_LINES if mesh.uv is not None else ()
    return "\n".join([*lines, "end_header"]) + "\n"
