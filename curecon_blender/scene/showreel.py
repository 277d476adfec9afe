# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Stills from four sides and from above, a film, and a contact sheet of the stills."""

from __future__ import annotations

from math import degrees
from pathlib import Path

import bpy
from bpy.app.translations import pgettext_n as n_

from ..core.present import sheet, sheet_files
from . import flight, render_scene, site
from .lettering import letters_but

FROM_ABOVE = 2.0  # times the box's radius: the height of the still that looks down steeply
CONTACT_PIXELS_PER_MM = 8


def shots(scene: bpy.types.Scene, stage: bpy.types.Scene, folder: Path) -> list[render_scene.Shot]:
    """Put the cameras of the stills and of the film in the stage; where this Blender can make no film, for
    the stills alone. Raises SurfaceError."""
    present, about, middle = scene.curecon.present, site.box(scene), site.box(scene, strays=flight.FRINGE)
    size = render_scene.film_size(scene)
    has_north = site.known(scene).north
    height = (present.height - 0.5) * middle.height
    made = []
    for number in range(1, 6):
        azimuth = (degrees(present.start_angle) + 90 * (number - 1)) % 360
        side = f"From the {sheet.compass(azimuth).lower()}" if has_north else f"View {number}"
        name, shown, high, steepest = (
            (side, middle, height, flight.STEEPEST) if number < 5
            else (n_("From above"), about, FROM_ABOVE * about.radius, 90.0)
        )
        camera = render_scene.add_still(stage, name, shown, azimuth, high, steepest)
        made.append(render_scene.Shot(name=name, file=folder / f"still_{number}.png", camera=camera, size=size))
    if not render_scene.can_film():
        return made
    if flight.is_move(scene.camera):
        film, frames = render_scene.add_own(stage, scene.camera), flight.frames_of(scene.camera)
    else:
        frames = flight.frame_count(scene)
        film = render_scene.add_orbit(stage, about, flight.around(about, "ORBIT", present, frames))
    made.append(render_scene.Shot(name=n_("Film"), file=folder / "film.mp4", camera=film, size=size, frames=frames))
    return made


def write_contact_sheet(stills: list[render_scene.Shot], folder: Path, title: str, date: str) -> None:
    """The stills on one page, as PNG and PDF. Raises WorkspaceError."""
    pictures = [(shot.name, render_scene.read_pixels(shot.file)) for shot in stills]
    page = sheet.contact_sheet(pictures, title, date, letters_but(title, date))
    sheet_files.write_png(folder / "contact_sheet.png", page, CONTACT_PIXELS_PER_MM)
    sheet_files.write_pdf(folder / "contact_sheet.pdf", [page], title)
