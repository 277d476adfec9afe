# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the public is told of where a site lies; chosen before anything is written. Needs numpy alone: the dialog in
Blender shows it beforehand.

`exact` tells the coordinates. `cell` tells a square of 1 km on the UTM grid, the same for every site that lies in it,
so that nothing can be made of where in it a site lies. `hidden` tells no place. Below exact, what is published is made
of the site's own coordinates alone, which count from its middle; the frame's origin, altitude and time of day, the
photos' names and files that were not made for this are left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..base.geodesy import geodetic_to_utm, utm_to_geodetic, utm_zone
from ..base.options import EXACT, HIDDEN
from ..base.records import Frame

SIDE = 1000  # metres, of a cell
_PLACES = 6  # decimals of a degree: 0.1 m


@dataclass(frozen=True)
class Shown:
    """What is shown of a site's place: a GeoJSON `geometry`, None for none, and sentences for who publishes it, each a
    text with {} and what goes there."""

    location: str
    geometry: dict[str, Any] | None
    sentences: tuple[tuple[str, str], ...]

    @property
    def box(self) -> list[float] | None:
        """West, south, east, north in degrees."""
        if self.geometry is None:
            return None
        places = np.array(self.geometry["coordinates"]).reshape(-1, 2)
        return [*places.min(axis=0).tolist(), *places.max(axis=0).tolist()]


def shown(frame: Frame, location: str) -> Shown:
    """What `location`, one of LOCATIONS, shows of a site whose frame as adjusted this is."""
    if location == HIDDEN:
        nowhere = ("Nobody can read from the pages where the site is. It is in the list, and not on the map.", "")
        return Shown(location, None, (nowhere, _LEFT_OUT))
    if frame.origin is None:
        unknown = ("The place of the site is not known. It is in the list, and not on the map.", "")
        return Shown(location, None, (unknown, _ALL if location == EXACT else _LEFT_OUT))
    latitude, longitude = frame.origin.latitude, frame.origin.longitude
    if location == EXACT:
        place = [round(longitude, _PLACES), round(latitude, _PLACES)]
        return Shown(location, {"type": "Point", "coordinates": place}, (
            ("Everybody can read the exact place: {}", f"{latitude:.5f}, {longitude:.5f}"), _ALL))
    name, ring = _cell(latitude, longitude)
    return Shown(location, {"type": "Polygon", "coordinates": [ring]}, (
        ("The map shows a square of 1 km, somewhere in which the site is: {}", name), _LEFT_OUT))


_ALL = ("The full accuracy report and drawing sheets are published, with the photos' names and times.", "")
_LEFT_OUT = ("Coordinates, altitude, time of day, photo names, the full report and drawing sheets are left out.", "")


def _cell(latitude: float, longitude: float) -> tuple[str, list[list[float]]]:
    """The cell that a place lies in: its name and its corners, longitude and latitude, anticlockwise and closed."""
    zone, south = utm_zone(longitude), latitude < 0
    east, north = np.floor(geodetic_to_utm(np.array([[latitude, longitude]]), zone, south=south)[0] / SIDE)
    corners = SIDE * np.array([(east, north), (east + 1, north), (east + 1, north + 1), (east, north + 1)])
    ring = [[round(float(x), _PLACES), round(float(y), _PLACES)]
            for y, x in utm_to_geodetic(corners, zone, south=south)]
    return f"UTM {zone}{'S' if south else 'N'} {east:.0f} {north:.0f} km", [*ring, ring[0]]
