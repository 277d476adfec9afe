# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A little site whose measures are known, and readers of what is delivered of it that did not write it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import ezdxf
import numpy as np
import rasterio
from PIL import Image

from curecon_blender.core.base.records import SEA_LEVEL, Frame, GeoPosition
from curecon_blender.core.cloud.ply import Cloud, CloudWriter
from curecon_blender.core.deliver.placement import Placement
from curecon_blender.core.deliver.write import Choices, Site
from curecon_blender.core.surface.mesh import Mesh, write_mesh

FRAME = Frame(scale="metres", up="gps", north=True, origin=GeoPosition(
    latitude=24.65, longitude=117.05, altitude=520.0, altitude_datum=SEA_LEVEL))
SLOPE = 0.1  # of the little site's ground, upwards to the east
CREDIT = 'A "Surveyor" <a@b> & Søns / 福建\\..\n'


def little_site(folder: Path, *, frame: str = "local", choices: Choices | None = None, **changes: object) -> Site:
    """Ground of 8 x 6 m that rises to the east, red in the north west and blue elsewhere, with a hole that was filled,
    and a green wall 3 m high that faces south at y = -2."""
    x, y = np.meshgrid(np.linspace(-4, 4, 9), np.linspace(-3, 3, 7))
    ground = np.column_stack([x.ravel(), y.ravel(), SLOPE * x.ravel()])
    cell = np.arange(9 * 7).reshape(7, 9)
    a, b, c, d = (part.ravel() for part in (cell[:-1, :-1], cell[:-1, 1:], cell[1:, 1:], cell[1:, :-1]))
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    wall = np.array([(-2, -2, 0), (2, -2, 0), (2, -2, 3), (-2, -2, 3)], float)
    vertices = np.concatenate([ground, wall]).astype(np.float32)
    faces = np.concatenate([faces, np.array([(0, 1, 2), (0, 2, 3)]) + len(ground)]).astype(np.int32)
    middle = vertices[faces].mean(axis=1)
    corner = np.array([[0.125, 0.875], [0.13, 0.875], [0.125, 0.87]])  # three places within one colour of the page
    shift = np.zeros((len(faces), 1, 2))
    shift[(middle[:, 0] > 0) | (middle[:, 1] < 0), 0] = [0.5, 0]
    shift[-2:, 0] = [0, -0.5]
    mesh = Mesh(
        vertices=vertices, faces=faces, colours=np.full((len(vertices), 3), 90, np.uint8),
        distance=np.zeros(len(vertices), np.float32), views=np.full(len(vertices), 5, np.uint8),
        filled=(np.abs(middle[:, :2] - [3, 2]).max(axis=1) < 1) & (middle[:, 2] < 1),
    ).with_texture((corner + shift).astype(np.float32), np.zeros(len(faces), np.int32), ("texture_0.png",))
    page = np.zeros((64, 64, 3), np.uint8)
    page[:32, :32], page[:32, 32:], page[32:, :32] = (200, 0, 0), (0, 0, 200), (0, 200, 0)
    (folder / "w").mkdir()
    (folder / "out").mkdir()
    Image.fromarray(page).save(folder / "w" / "texture_0.png")
    write_mesh(folder / "w" / "mesh.ply", mesh)
    points = np.random.default_rng(0).uniform([-4, -3, 0], [4, 3, 0], (4000, 3)).astype(np.float32)
    points[:, 2] = SLOPE * points[:, 0]
    with CloudWriter(folder / "w" / "cloud.ply") as out:
        out.write(Cloud(points, np.full((4000, 3), 90, np.uint8), np.tile(np.float32([0, 0, 1]), (4000, 1)),
                        np.ones(4000, np.float32), np.full(4000, 3, np.uint8)))
    site = Site(cloud=folder / "w" / "cloud.ply", mesh=folder / "w" / "mesh.ply", folder=folder / "out",
                placement=Placement(kind=frame, frame=FRAME, matrix=np.eye(4)), turn_of=lambda mesh, places: 0.0,
                choices=choices or Choices())
    return replace(site, **changes)  # type: ignore[arg-type]


def read(path: Path) -> tuple[np.ndarray, Callable[[float, float], tuple[int, int]]]:
    """A raster's bands (H,W) or (H,W,4), and its pixel at a place."""
    with rasterio.open(path) as file:
        bands = file.read()
        return (bands[0] if len(bands) == 1 else np.moveaxis(bands, 0, 2)), file.index


def drawn(path: Path) -> list[tuple[str, np.ndarray]]:
    """A DXF's polylines by their layers, as ezdxf reads them."""
    file = ezdxf.readfile(path)
    audit = file.audit()
    assert not audit.errors, audit.errors
    return [(line.dxf.layer, np.array([vertex.dxf.location for vertex in line.vertices]))
            for line in file.modelspace().query("POLYLINE")]
