# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""One deliverable of one component, by its format's name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from ..base.files import atomic_write
from ..base.messages import Reporter
from ..surface.mesh import Mesh
from . import systems
from .drawings import Drawing, Stroke, write_dxf, write_svg
from .laz import CloudSource, write_laz
from .lines import contours, mesh_of_lines, middle_cuts, plan_cut, vertical_cut
from .placement import Placement
from .rasters import Surface, facade_axes, measured_mesh, surface_of_cloud, surface_of_mesh, write_facade, write_raster

_PLAN_HEIGHT = 1.5  # metres above the site's zero, where nobody says how high


@dataclass(frozen=True, kw_only=True)
class Choices:
    """`pixel`: side of a pixel; `interval`: between contours; `plans`: heights of level cuts above the site's zero;
    `sections`: upright cuts, x0, y0, x1, y1 each, in the site frame; `turn`: radians, anticlockwise from x, of the
    building's plan (None: as its walls say). None, or nothing, is what suits the site. In metres."""

    pixel: float | None = None
    interval: float | None = None
    plans: tuple[float, ...] = ()
    sections: tuple[tuple[float, float, float, float], ...] = ()
    turn: float | None = None
    licence: str = ""
    credit: str = ""


@dataclass(frozen=True, kw_only=True)
class Site:
    """A component to be delivered. `mesh` is its mesh's file, a textured one with its pages beside it, None where there
    is none; `turn` is the direction of its walls in the site frame. `folder` and `suffix` place and tell its files."""

    cloud: Path
    mesh: Path | None
    placement: Placement
    choices: Choices
    turn_of: Callable[[Mesh | None, np.ndarray], float]
    folder: Path
    suffix: str = ""

    @cached_property
    def words(self) -> list[str]:
        """What every file says of itself."""
        said = ["Made by CU-Recon.", *systems.words(self.placement)]
        for name in ("credit", "licence"):
            if text := " ".join(getattr(self.choices, name).split()):
                said.append(f"{name.capitalize()}: {text}")
        return said

    @cached_property
    def points(self) -> CloudSource:
        return CloudSource(path=self.cloud, placement=self.placement, words=self.words)

    @cached_property
    def read_mesh(self) -> Mesh | None:
        """Raises as `measured_mesh`."""
        return None if self.mesh is None else measured_mesh(self.mesh)

    def surface(self, *, in_site: bool) -> Surface:
        """The mesh, or the cloud where there is none, in the site frame or where the deliverable has it."""
        place = self.placement.to_site if in_site else self.placement.to_output
        mesh = self.read_mesh
        if mesh is None or self.mesh is None:
            return surface_of_cloud(self.points, place)
        return surface_of_mesh(mesh, self.mesh.parent, place)

    def turn(self, mesh: Mesh | None, places: np.ndarray) -> float:
        return self.choices.turn if self.choices.turn is not None else self.turn_of(mesh, places)

    def file(self, name: str) -> Path:
        stem, dot, ending = name.partition(".")
        return self.folder / f"{stem}{self.suffix}{dot}{ending}"

    @property
    def made_of(self) -> str:
        """Of rasters, for their descriptions."""
        return "the cloud: there is no mesh" if self.mesh is None else "the mesh"


def write(site: Site, name: str, reporter: Reporter) -> list[tuple[Path, str]]:
    """The files of a format, each with a sentence on it. Raises DeliverError, WorkspaceError, SetupError, Cancelled."""
    return _FORMATS[name](site, reporter)


def _laz(site: Site, reporter: Reporter) -> list[tuple[Path, str]]:
    path = site.file("cloud.laz")
    return [(path, f"{write_laz(path, site.points, reporter):,} points")]


def _copc(site: Site, reporter: Reporter) -> list[tuple[Path, str]]:
    from .copc import write_copc

    path = site.file("cloud.copc.laz")
    return [(path, f"{write_copc(path, site.points, reporter):,} points")]


def _e57(site: Site, reporter: Reporter) -> list[tuple[Path, str]]:
    from .e57 import write_e57

    path = site.file("cloud.e57")
    return [(path, f"{write_e57(path, site.points, reporter):,} points")]


def _orthomosaic(site: Site, reporter: Reporter) -> list[tuple[Path, str]]:
    return _from_above(site, "orthomosaic.tif", "Orthomosaic", reporter, colour=True)


def _dsm(site: Site, reporter: Reporter) -> list[tuple[Path, str]]:
    return _from_above(site, "surface_model.tif", "Surface model: heights of what is topmost", reporter, colour=False)


def _from_above(site: Site, name: str, what: str, reporter: Reporter, *, colour: bool) -> list[tuple[Path, str]]:
    path, words = site.file(name), [f"{what}, of {site.made_of}.", *site.words]
    grid = write_raster(path, site.surface(in_site=False), np.eye(3), site.choices.pixel,
                        systems.geokeys(site.placement, heights=not colour), "\n".join(words), reporter, colour=colour)
    return [(path, _size(site, grid.width, grid.height, grid.pixel))]


def _facades(site: Site, reporter: Reporter) -> list[tuple[Path, str]]:
    surface, made = site.surface(in_site=True), []
    axes = facade_axes(site.turn(surface.mesh, surface.places), site.placement.frame.north)
    for side, plane in axes.items():
        path = site.file(f"facade_{side}.tif")
        words = [f"True orthophoto of the {side} facade, of {site.made_of}: x along it to the right, y up.",
                 *site.words]
        grid = write_facade(path, surface, site.placement, side, plane, site.choices.pixel, words, reporter)
        made.append((path, _size(site, grid.width, grid.height, grid.pixel)))
    return made


def _size(site: Site, width: int, height: int, pixel: float) -> str:
    return f"{width} x {height} pixels of {pixel:g} {site.placement.unit}".rstrip() + f", of {site.made_of}"


def _contours(site: Site, reporter: Reporter) -> list[tuple[Path, str]]:
    mesh = mesh_of_lines(site.read_mesh)
    strokes, step = contours(mesh, site.placement.to_output(mesh.vertices), site.choices.interval, reporter)
    said = f"Contours every {step:g} {site.placement.unit}".rstrip()
    return _draw(site, "contours", strokes, [f"{said}; layer CONTOUR_FILLED: no photo measured it.", *site.words], said)


def _sections(site: Site, reporter: Reporter) -> list[tuple[Path, str]]:
    mesh = mesh_of_lines(site.read_mesh)
    places, output = site.placement.to_site(mesh.vertices), site.placement.to_output(mesh.vertices)
    choices, filled, made = site.choices, "layer CUT_FILLED: no photo measured it.", []
    # The site's zero in the deliverable's heights.
    zero = float(np.median(output[:, 2] - places[:, 2]))
    middle = _PLAN_HEIGHT if site.placement.unit else float(np.median(places[:, 2]))
    for height in choices.plans or (() if choices.sections else (middle,)):
        said = f"Level cut at {height:g} {site.placement.unit}".rstrip() + " above the site's zero"
        made += _draw(site, f"plan_{height:.2f}".replace(".", "_"), plan_cut(mesh, output, height + zero),
                      [f"{said}; {filled}", *site.words], said)
    cuts = [(np.array(ends[:2]), np.array(ends[2:])) for ends in choices.sections]
    if not cuts and not choices.plans:
        cuts = middle_cuts(places, site.turn(mesh, places))
    for number, (start, end) in enumerate(cuts, start=1):
        said = f"Upright cut from {start[0]:.2f}, {start[1]:.2f} to {end[0]:.2f}, {end[1]:.2f}"
        made += _draw(site, f"section_{number}", vertical_cut(mesh, places, start, end),
                      [f"{said} of the site frame: x along it, y up; {filled}", *site.words], said)
        reporter.progress(number, len(cuts))
    return made


def _draw(
    site: Site, name: str, strokes: Sequence[Stroke], words: list[str], said: str
) -> list[tuple[Path, str]]:
    drawing = Drawing(strokes=strokes, words=words, unit=site.placement.unit)
    paths = site.file(f"{name}.dxf"), site.file(f"{name}.svg")
    write_dxf(paths[0], drawing)
    write_svg(paths[1], drawing)
    lines = "1 line" if len(strokes) == 1 else f"{len(strokes):,} lines"
    return [(path, f"{said}, {lines}") for path in paths]


def write_words(path: Path, words: Sequence[str]) -> None:
    """Sentences as a text file, for who opens the folder. Raises WorkspaceError."""
    with atomic_write(path) as file:
        file.write("".join(f"{line}\n" for line in words).encode())


_FORMATS: dict[str, Callable[[Site, Reporter], list[tuple[Path, str]]]] = {
    "laz": _laz, "copc": _copc, "e57": _e57, "orthomosaic": _orthomosaic, "dsm": _dsm, "facades": _facades,
    "contours": _contours, "sections": _sections,
}
