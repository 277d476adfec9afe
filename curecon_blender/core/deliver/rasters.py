# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The orthomosaic, the surface model and the façades' orthophotos of a site, as files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..base.files import atomic_write
from ..base.messages import Reporter
from ..surface.mesh import Mesh, read_mesh
from ..surface.support import median_spacing
from ..surface.triangles import triangle_areas
from .geotiff import Raster, write_cog
from .laz import CloudSource, extent_of
from .ortho import CloudView, Grid, MeshView, View, grid_of, read_pages, strips
from .placement import DeliverError, Placement
from .systems import GeoKeys, facade_geokeys

UP = np.array([0.0, 0.0, 1.0])
_MOST_SPACING = 2_000_000  # points that tell a cloud's spacing


@dataclass(frozen=True, kw_only=True)
class Surface:
    """What rasters are made of: `places` (N,3), in the deliverable's coordinates or, for façades, in the site's, and
    the mesh whose vertices they are; without one the cloud's points with their `colours`. `folder` holds the mesh's
    pages; `spacing` is the finest detail of heights, `texel` of colours."""

    places: np.ndarray
    colours: np.ndarray
    mesh: Mesh | None
    folder: Path
    spacing: float
    texel: float

    @property
    def measured(self) -> np.ndarray:
        """The places that a raster must hold."""
        if self.mesh is None:
            return self.places
        return self.places[np.unique(self.mesh.faces[~self.mesh.filled])]

    def view(self, grid: Grid, *, colour: bool) -> View:
        """Raises DeliverError for a texture that cannot be read."""
        if self.mesh is None:
            return CloudView(self.places, self.colours, self.spacing, grid)
        pages = read_pages(self.folder, self.mesh.pages if colour else ())
        shown = self.mesh.recorded if colour else ~self.mesh.filled
        return MeshView(self.mesh, self.places, pages, grid, shown)


def measured_mesh(path: Path) -> Mesh:
    """A mesh's file. Raises DeliverError for one without a measured face, WorkspaceError."""
    mesh = read_mesh(path)
    if mesh.filled.all():
        raise DeliverError("No face of the mesh was measured.", remedy="Build Mesh again.", path=path)
    return mesh


def surface_of_mesh(mesh: Mesh, folder: Path, place: Callable[[np.ndarray], np.ndarray]) -> Surface:
    """A mesh whose vertices `place` takes to where they are drawn; its texture's pages are in `folder`."""
    places = place(mesh.vertices)
    measured = ~mesh.filled
    corners = places[mesh.faces[measured]]
    areas = triangle_areas(corners)
    area, spacing = float(areas.sum()), np.sqrt(float(np.median(areas)))
    texel = spacing
    if mesh.uv is not None and len(mesh.pages):
        side = len(read_pages(folder, mesh.pages[:1])[0])
        a, b = ((mesh.uv[measured][:, k] - mesh.uv[measured][:, 0]).astype(np.float64) * side for k in (1, 2))
        texels = float(np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum())
        texel = min(texel, np.sqrt(area / max(texels / 2, 1.0)))
    return Surface(places=places, colours=mesh.colours, mesh=mesh, folder=folder, spacing=float(spacing),
                   texel=float(texel))


def surface_of_cloud(source: CloudSource, place: Callable[[np.ndarray], np.ndarray]) -> Surface:
    """A cloud whose points `place` takes to where they are drawn. Raises DeliverError, WorkspaceError."""
    count = extent_of(source).count
    places, colours = np.empty((count, 3), np.float64), np.empty((count, 3), np.uint8)
    done = 0
    for block, _ in source.blocks():
        places[done : done + len(block)] = place(block.points)
        colours[done : done + len(block)] = block.colours
        done += len(block)
    some = max(count // _MOST_SPACING, 1)
    spacing = median_spacing(places[::some]) / np.sqrt(some)
    return Surface(places=places, colours=colours, mesh=None, folder=source.path.parent, spacing=spacing,
                   texel=spacing)


def write_raster(
    path: Path, surface: Surface, axes: np.ndarray, pixel: float | None, keys: GeoKeys, description: str,
    reporter: Reporter, *, colour: bool
) -> Grid:
    """Draw a surface square to a plane, `axes` (3,3) as Grid has them; `pixel` None is the surface's own detail. Raises
    DeliverError, WorkspaceError, Cancelled."""
    own = surface.texel if colour else surface.spacing
    grid = grid_of(surface.measured, axes, pixel or own, chosen=pixel is not None)
    raster = Raster(width=grid.width, height=grid.height, colour=colour, left=grid.left, top=grid.top,
                    pixel=grid.pixel, keys=keys, description=description)
    write_cog(path, raster, strips(surface.view(grid, colour=colour), grid, colour=colour, reporter=reporter))
    return grid


def facade_axes(turn: float, north: bool) -> dict[str, np.ndarray]:
    """The axes of the four façades of a building whose plan's axes are turned by `turn` (radians, anticlockwise from
    x), each by the side that it faces: north, east, south, west, or front, right, back, left."""
    found = {}
    for number, facing in enumerate(("front", "right", "back", "left")):
        angle = turn - np.pi / 2 + number * np.pi / 2
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        if north:
            facing = ("east", "north", "west", "south")[round(angle / (np.pi / 2)) % 4]
        found[facing] = np.array([np.cross(UP, out), UP, out])
    return found


def write_facade(
    path: Path, surface: Surface, placement: Placement, side: str, axes: np.ndarray, pixel: float | None,
    words: list[str], reporter: Reporter,
) -> Grid:
    """An orthophoto of one façade, with its world file beside it. Raises as `write_raster`."""
    keys = facade_geokeys(placement, side)
    grid = write_raster(path, surface, axes, pixel, keys, "\n".join(words), reporter, colour=True)
    half = grid.pixel / 2
    with atomic_write(path.with_suffix(".tfw")) as file:
        lines = (grid.pixel, 0.0, 0.0, -grid.pixel, grid.left + half, grid.top - half)
        file.write("".join(f"{number:.9f}\n" for number in lines).encode())
    return grid
