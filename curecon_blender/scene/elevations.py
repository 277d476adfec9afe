# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Four façades and the roof plan: an orthographic render each, then a sheet of paper each."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import datetime
from math import ceil, degrees
from pathlib import Path

import bpy
import numpy as np
from bpy.app.translations import pgettext_n as n_

from ..core.adjust.record import read_accuracy, rms
from ..core.present import marks, sheet, sheet_files
from ..core.present.marks import Hatching
from ..core.present.sheet import Drawing, Mark
from ..core.site.measuring import SHOWN
from . import ground, render_scene, site, surface
from .frame import Part
from .lettering import letters_but

BARE = 0.1  # share of a drawing with anything on it, below which its side counts as not measured
AROUND = 1.04  # of the box's size: what a drawing shows
FACTS_PER_MM = 4  # pixels on the paper: as fine as hatching and lines need it
UP = np.array([0.0, 0.0, 1.0])
SIDES = ("Front", "Right", "Back", "Left")  # where north is unknown


@dataclass(frozen=True, kw_only=True)
class Elevation:
    """A render to be made and what its sheet will say; `north` as Drawing has it. `facts` is the render of what is
    known of the surface, where it is one."""

    shot: render_scene.Shot
    facts: render_scene.Shot | None
    name: str
    orientation: str
    north: float | None


@dataclass(frozen=True, kw_only=True)
class Plan:
    """All five drawings. `scale` is the denominator, None where the scale is unknown; `round` says that the building
    has no sides of its own; a pixel is `pixel` scene units wide; `lines` says that edges are drawn."""

    elevations: tuple[Elevation, ...]
    round: bool
    scale: int | None
    pixels_per_mm: int
    pixel: float
    lines: bool

    @property
    def shots(self) -> list[render_scene.Shot]:
        """All renders in their order."""
        return [shot for elevation in self.elevations for shot in (elevation.shot, elevation.facts) if shot is not None]


def plan(scene: bpy.types.Scene, stage: bpy.types.Scene, folder: Path) -> Plan:
    """Put a camera square to each side of the building, and one above it, in the stage. Raises SurfaceError."""
    present = scene.curecon.present
    about = site.box(scene, present.facade_turn)
    pixels_per_mm = render_scene.QUALITIES[present.quality].sheet_pixels_per_mm
    known = site.known(scene)
    scale = int(present.sheet_scale) if known.metres else None
    ground.leave_out(stage)
    has_facts = render_scene.add_facts(stage)
    render_scene.show_fronts_only(stage)
    surface.light(stage, by_scene=present.sheet_light == "SCENE")
    if present.sheet_light == "PHOTO":
        stage.world = None  # a misty one would veil the photos' colours
    x, y = about.axis(0), about.axis(1)
    views = [(side, np.array([np.cross(UP, out), UP, out])) for side, out in zip(SIDES, (-y, x, y, -x), strict=True)]
    views.append((n_("Roof plan"), np.array([x, y, UP])))
    sizes = [AROUND * 2 * np.abs(axes[:2] @ np.array([x, y, UP]).T) @ about.half for _, axes in views]
    # Of unknown scale: as large as an A3 takes the largest.
    fit = min(min(np.array(sheet.room("A3", upright=False)) / size) for size in sizes)
    mm_per_unit = 1000 / scale / known.metre if scale else fit
    made = []
    for number, ((side, axes), size) in enumerate(zip(views, sizes, strict=True), start=1):
        is_plan = number == len(views)
        sheet.paper_for(*(size * mm_per_unit))
        # A whole number of the pixels of the facts, which are coarser.
        coarse = max(1, pixels_per_mm // FACTS_PER_MM)
        across, down = (ceil(length * mm_per_unit * pixels_per_mm / coarse) for length in size)
        pixels = across * coarse, down * coarse
        shown = pixels[0] / pixels_per_mm / mm_per_unit, pixels[1] / pixels_per_mm / mm_per_unit
        name, orientation, north = _words(side, axes, is_plan=is_plan, has_north=known.north)
        file = folder / f"{number}_{name.lower().replace(' ', '_')}.png"
        camera = render_scene.add_square(stage, name, about, axes, shown)
        shot = render_scene.Shot(name=name, file=file, camera=camera, size=pixels, clear=True)
        facts = replace(shot, file=file.with_suffix(".exr"), size=(across, down), facts=True) if has_facts else None
        made.append(Elevation(
            shot=shot, facts=facts, name=name, orientation=orientation, north=north,
        ))
    return Plan(elevations=tuple(made), round=about.round, scale=scale, pixels_per_mm=pixels_per_mm,
                pixel=1 / (mm_per_unit * pixels_per_mm), lines=present.sheet_lines)


def notes(scene: bpy.types.Scene, times: dict[str, datetime]) -> str:
    """What the sheets of a site rest on, in one line: when its photos were taken (`times`), by whom and under which
    licence, its axes, and how exact it is."""
    properties, known, part = scene.curecon, site.known(scene), site.part(scene)
    days = sorted({f"{time:%Y-%m-%d}" for time in times.values()})
    said = [f"Photos of {days[0]}" + (f" to {days[-1]}" if len(days) > 1 else "") if days else "Photos without a date"]
    if properties.credit:
        said.append(" ".join(f"Surveyed by {properties.credit}".split()))
    if properties.licence:
        said.append(properties.licence)
    said.append(f"Axes of the site: {'Y north' if known.north else 'Y free'}, Z up")
    if part is not None:
        said.append(_exactness(part))
    if known.doubt:
        said.append("Heights doubtful")
    return "  ·  ".join(said)


def _exactness(part: Part) -> str:
    """By check points where there are any, else by what the scale rests on."""
    if (accuracy := read_accuracy(part.folder)) is not None and (check := accuracy.check):
        plan, height = (1000 * off for off in rms(check))
        points = "1 check point" if len(check) == 1 else f"{len(check)} check points"
        return f"{points}: {plan:.0f} mm in plan and {height:.0f} mm in height (rms)"
    if not part.scale_source:
        return "Scale unknown"
    sigma = part.scale_sigma
    return f"Scale from {part.scale_source}" + (f", ± {SHOWN * 100 * sigma:.2g} %" if sigma is not None else "")


def write_sheets(made: Plan, folder: Path, title: str, date: str, noted: str = "") -> list[str]:
    """Turn each render into its sheet, in its place, and write all as one PDF; returns the names of those on which
    there is next to nothing. Raises WorkspaceError."""
    sheets, bare = [], []
    for elevation in made.elevations:
        pixels = render_scene.read_pixels(elevation.shot.file)
        if np.any(pixels < 255, axis=2).mean() < BARE:
            bare.append(elevation.name)
        legend: tuple[Mark, ...] = ()
        if elevation.facts is not None:
            pixels, legend = _marked(pixels, elevation.facts, made)
        drawing = Drawing(
            pixels=pixels, legend=legend, pixels_per_mm=made.pixels_per_mm, title=title,
            name=elevation.name, date=date, scale=made.scale, orientation=elevation.orientation, north=elevation.north,
            notes=noted,
        )
        sheets.append(sheet.lay_out(drawing, letters_but(title)))
        sheet_files.write_png(elevation.shot.file, sheets[-1], made.pixels_per_mm)
    sheet_files.write_pdf(folder / "elevations.pdf", sheets, title)
    return bare


def _marked(pixels: np.ndarray, shot: render_scene.Shot, made: Plan) -> tuple[np.ndarray, tuple[Mark, ...]]:
    """A drawing with its edges, where they are asked for, and hatched where nothing was measured; and what its legend
    tells."""
    coarse = pixels.shape[1] // shot.size[0]
    facts = render_scene.read_facts(shot, coarse * made.pixel)

    def fine(mark: np.ndarray) -> np.ndarray:
        return mark.repeat(coarse, axis=0).repeat(coarse, axis=1)

    hatched = marks.hatching(facts, made.pixels_per_mm / coarse)
    pixels = marks.hatch(pixels, Hatching(fine(hatched.unmeasured), fine(hatched.unseen)), made.pixels_per_mm)
    if made.lines:
        pixels = marks.draw_edges(pixels, fine(marks.edges(facts, made.pixels_per_mm / coarse)))
    told = ((hatched.unmeasured, 1, n_("Not measured: filled in, or a gap")),
            (hatched.unseen, -1, n_("Colour seen by no photo")))
    return pixels, tuple(Mark(slope=slope, words=words) for mark, slope, words in told if mark.any())


def _words(side: str, axes: np.ndarray, *, is_plan: bool, has_north: bool) -> tuple[str, str, float | None]:
    """The drawing's name, its orientation in words, and where north is on a plan."""
    if not has_north:
        return (side if is_plan else f"{side} elevation"), "North unknown", None
    if is_plan:
        return side, "North as the arrow", degrees(np.arctan2(axes[0, 1], axes[1, 1]))
    azimuth = degrees(np.arctan2(axes[2, 0], axes[2, 1])) % 360
    return f"{sheet.compass(azimuth)} elevation", f"Faces {azimuth:.0f}° from north", None
