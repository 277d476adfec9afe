# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""3D Tiles 1.1 of a surface and of a cloud, each with its tileset.json.

A surface's levels are cut by one octree: a tile's cell holds the cells of the tiles that take its place from near by.
A tile's `geometricError` is how far it is off or how wide its texels are, whichever is more; that of the finest tiles
is what the grid of their coordinates is off. So a viewer that wants an error of one pixel shows neither in the large.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..base.files import atomic_write, write_json
from ..base.messages import Reporter
from ..base.reading import read_json
from . import atlas, glb
from .levels import Level
from .octree import Cell, around

TILESET, EARTH = "tileset.json", "earth.json"
LARGEST_TILE = 2_000_000  # bytes
FIRST_TILE = 700_000  # bytes, of what shows the whole site
MOST_FACES = 48_000  # of a tile: with its texture it is about as large as it may be, and its indices have 16 bits
MOST_POINTS = 40_000
_ENOUGH_FACES = 2_000  # a tile of so few is not cut: its picture is made smaller
_SMALLER, _LEAST_SHARE = 0.8, 0.05


@dataclass(frozen=True)
class Tiles:
    """What was written: its number of tiles, their bytes, and those of the first one."""

    count: int
    bytes: int
    first: int


@dataclass(frozen=True, kw_only=True)
class Destination:
    """Where tiles go: `place` takes (N,3) to the site frame, whose unit is `unit` of the mesh's; `copyright` stands in
    each."""

    folder: Path
    place: Callable[[np.ndarray], np.ndarray]
    unit: float = 1.0
    copyright: str = ""

    def write(self, name: str, content: bytes) -> None:
        with atomic_write(self.folder / name) as file:
            file.write(content)


class _Tree:
    """The tiles of a site as they are written."""

    def __init__(self, to: Destination, reporter: Reporter, total: int) -> None:
        self._to, self._reporter, self._total, self._done = to, reporter, total, 0
        self.sizes: list[int] = []

    def put(self, content: bytes, items: int) -> dict[str, str]:
        """Write a tile that holds so many faces or points; the tileset's word for it."""
        name = f"{len(self.sizes)}.glb"
        self._to.write(name, content)
        self.sizes.append(len(content))
        self._done += items
        self._reporter.progress(self._done, self._total)
        return {"uri": name}

    def finish(self, root: dict[str, Any]) -> Tiles:
        # Until anything is shown, the whole of it is missing.
        whole = 2 * float(np.linalg.norm([root["boundingVolume"]["box"][k] for k in (3, 7, 11)]))
        write_json(self._to.folder / TILESET, {
            "asset": {"version": "1.1"}, "geometricError": max(whole, root["geometricError"]), "root": root,
        })
        return Tiles(len(self.sizes), sum(self.sizes), self.sizes[0])


def write_surface(levels: list[Level], to: Destination, reporter: Reporter) -> Tiles:
    """Write the tiles of a surface's levels, the coarsest first, and their tileset. Raises WorkspaceError,
    Cancelled."""
    cuts = [_Cut(level, to) for level in levels]
    tree = _Tree(to, reporter, sum(len(cut.middles) for cut in cuts))
    members = [np.arange(len(cut.middles)) for cut in cuts]
    cell = around(np.concatenate([cut.middles for cut in cuts]))
    return tree.finish(_tile(cuts, cell, members, to, tree, cuts[0].tile(members[0], to.copyright, FIRST_TILE)))


class _Cut:
    """A level where it is cut: `places` (N,3) in the site frame, `middles` (M,3) of its faces, `error` in its unit."""

    def __init__(self, level: Level, to: Destination) -> None:
        self.mesh, self._pages = level.mesh, level.pages
        self.places = to.place(self.mesh.vertices)
        self.middles = self.places[self.mesh.faces].mean(axis=1)
        self.error = level.error * to.unit
        # Of what is both, that it was not measured is said.
        unseen = False if self.mesh.unseen is None else self.mesh.unseen
        self._material = np.where(self.mesh.filled, 1, np.where(unseen, 2, 0))

    def tile(self, members: np.ndarray, copyright: str, most: int = LARGEST_TILE) -> bytes:
        """The tile of some faces. The picture is made smaller where the tile has more bytes than `most`, and few faces
        or all of the site."""
        mesh = self.mesh
        if mesh.uv is None or mesh.page is None or not len(self._pages):
            used, index = np.unique(mesh.faces[members], return_inverse=True)
            return glb.mesh_tile(self.places[used], index.reshape(-1, 3), self._material[members], copyright,
                                 colours=mesh.colours[used])
        side = self._pages.shape[1]
        texels = np.clip(mesh.uv[members].reshape(-1, 2), 0, 1) * np.float32(side)
        texels[:, 1] = side - texels[:, 1]
        key = np.column_stack([mesh.faces[members].ravel(), mesh.page[members].repeat(3), texels.view(np.int32)])
        corners, first, index = np.unique(key, axis=0, return_index=True, return_inverse=True)
        index = index.reshape(-1, 3)
        uv, picture = atlas.cut(texels[first].astype(np.float64), index, mesh.page[members], self._pages)
        share = 1.0
        while True:
            tile = glb.mesh_tile(self.places[corners[:, 0]], index, self._material[members], copyright, uv=uv,
                                 picture=atlas.encoded(picture, share))
            cuttable = len(members) > _ENOUGH_FACES and most == LARGEST_TILE
            if len(tile) <= most or cuttable or share < _LEAST_SHARE:
                return tile
            share *= _SMALLER


def _tile(
    cuts: list[_Cut], cell: Cell, members: list[np.ndarray], to: Destination, tree: _Tree, content: bytes
) -> dict[str, Any]:
    """Write a tile of the first of some levels, and below it those of the others: the tileset's entry. `members` are
    each level's faces in the cell."""
    corners = [cut.places[np.unique(cut.mesh.faces[inside])] for cut, inside in zip(cuts, members, strict=True)]
    entry: dict[str, Any] = {"boundingVolume": {"box": _box(np.concatenate(corners))}, "refine": "REPLACE",
                             "geometricError": cuts[0].error if len(cuts) > 1 else glb.most_off(corners[0])}
    if content:
        entry["content"] = tree.put(content, len(members[0]))
    if len(cuts) > 1 and (children := _tiles(cuts[1:], cell, members[1:], to, tree)):
        entry["children"] = children
    return entry


def _tiles(
    cuts: list[_Cut], cell: Cell, members: list[np.ndarray], to: Destination, tree: _Tree
) -> list[dict[str, Any]]:
    """Write the tiles of the first of some levels in a cell, as many as are needed for none to be too large."""
    if not any(map(len, members)):
        return []
    content, many = b"", len(members[0]) > MOST_FACES
    if len(members[0]) and not many:
        content = cuts[0].tile(members[0], to.copyright)
        many = len(content) > LARGEST_TILE
    if not many or cell.deepest:
        return [_tile(cuts, cell, members, to, tree, content or cuts[0].tile(members[0], to.copyright)
                      if len(members[0]) else b"")]
    return [entry for part, inside in cell.parts([cut.middles for cut in cuts], members)
            for entry in _tiles(cuts, part, inside, to, tree)]


def _box(places: np.ndarray) -> list[float]:
    """The upright box about places (N,3), as a tileset has it: its middle and its half axes."""
    low, high = places.min(axis=0), places.max(axis=0)
    half = np.maximum((high - low) / 2, 1e-3)  # a little about the edge: coordinates in tiles are rounded
    return [round(float(value), 4) for value in (*(low + high) / 2, *np.diag(half + 1e-3).ravel())]


def write_cloud(places: np.ndarray, colours: np.ndarray, to: Destination, reporter: Reporter) -> Tiles:
    """Write points (N,3) of the site frame with colours (N,3) uint8 as tiles of which each adds to those above it, and
    their tileset. Raises WorkspaceError, Cancelled."""
    tree = _Tree(to, reporter, len(places))
    order = np.random.default_rng(0).permutation(len(places))  # any first part of a cell's points is spread over it
    cell = around(places)
    return tree.finish(_points(places, colours, cell, order, to, tree))


def _points(
    places: np.ndarray, colours: np.ndarray, cell: Cell, members: np.ndarray, to: Destination, tree: _Tree
) -> dict[str, Any]:
    if cell.deepest:
        members = members[: MOST_POINTS]
    own, rest = members[: MOST_POINTS], members[MOST_POINTS :]
    extent = np.sort(np.ptp(places[members], axis=0))
    # As wide as a point's share of the cell's area: what is seen between the points until there are more.
    spacing = float(np.sqrt(max(extent[2] * extent[1], 1e-12) / len(own)))
    entry: dict[str, Any] = {"boundingVolume": {"box": _box(places[members])}, "refine": "ADD",
                             "geometricError": spacing if len(rest) else glb.most_off(places[own])}
    entry["content"] = tree.put(glb.point_tile(places[own], colours[own], to.copyright), len(own))
    if len(rest):
        entry["children"] = [_points(places, colours, part, inside, to, tree)
                             for part, (inside,) in cell.parts([places], [rest])]
    return entry


def write_earth(folder: Path, rotation: np.ndarray, centre: np.ndarray) -> None:
    """Write `earth.json` beside a tileset, which puts it in its place on Earth: `rotation` (3,3) takes earth-centred
    axes to the site's, `centre` (3,) is its origin. Raises WorkspaceError."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation.T, centre
    tileset = read_json(folder / TILESET)
    root = {name: tileset["root"][name] for name in ("boundingVolume", "geometricError", "refine")}
    write_json(folder / EARTH, {**tileset, "root": {**root, "transform": matrix.T.ravel().tolist(),
                                                    "content": {"uri": TILESET}}})
