# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The systems that surveyed coordinates come in: local metres, WGS84, UTM, and by pyproj the grids of countries.

A system is named LOCAL, WGS84, "UTM 50N", "EPSG:2180", or by a PROJ string. Coordinates are east, north in metres; on
WGS84 latitude, longitude in degrees.
"""

from __future__ import annotations

import re

import numpy as np

from ..base.errors import ControlError
from ..base.geodesy import geodetic_to_enu, geodetic_to_utm, utm_to_geodetic, utm_zone
from ..base.language import Text
from ..base.records import GeoPosition

LOCAL, WGS84 = "local", "WGS84"
FARTHEST_LOCAL = 10_000.0  # metres; a cloud in single precision has millimetres there and no more
WIDEST_DEGREES = 0.2  # a site in degrees is narrower, and one in metres is wider
NEAR = 50_000.0  # metres from the photos, within which a guess of the system counts as right
_UTM = re.compile(r"(?:wgs\s*84|etrs\s*89)?[\s/]*utm\s*(?:zone)?\s*(\d{1,2})\s*([ns])", re.IGNORECASE)
_GEOGRAPHIC = {4326, 4979, 4258, 4937, 4269}  # WGS84, ETRS89 and NAD83: within two metres of each other


def system_named(text: str) -> str | None:
    """The system that a text names, or None: "local", "WGS84", "WGS84 UTM 16N", "EPSG:32650", a PROJ string."""
    text = " ".join(text.split())
    if text.casefold() in ("local", "metres", "meters"):
        return LOCAL
    if text.casefold() in ("wgs84", "wgs 84") or re.match(r"\+proj=(longlat|latlong)\b", text):
        return WGS84
    if found := _UTM.fullmatch(text):
        return _utm(int(found[1]), south=found[2].casefold() == "s")
    if re.match(r"\+proj=utm\b", text) and (zone := re.search(r"\+zone=(\d{1,2})\b", text)):
        return _utm(int(zone[1]), south="+south" in text)
    if found := re.fullmatch(r"epsg:?\s*(\d{3,6})", text, re.IGNORECASE):
        return _of_epsg(int(found[1]))
    if text.startswith("+") and "+proj=" in text:
        return text
    return None


def _of_epsg(code: int) -> str | None:
    if code in _GEOGRAPHIC:
        return WGS84
    # UTM on WGS84, ETRS89 and NAD83
    for first, last, base, south in ((32601, 32660, 32600, False), (32701, 32760, 32700, True),
                                     (25828, 25838, 25800, False), (26901, 26923, 26900, False)):
        if first <= code <= last:
            return _utm(code - base, south=south)
    return f"EPSG:{code}"


def _utm(zone: int, *, south: bool) -> str | None:
    return f"UTM {zone}{'S' if south else 'N'}" if 1 <= zone <= 60 else None


def to_places(system: str, given: np.ndarray) -> np.ndarray:
    """(N,3) coordinates in a system to latitude, longitude, altitude, or in LOCAL as they are; heights may be NaN.

    Raises ControlError where pyproj is needed and missing, or does not know the system.
    """
    if system in (LOCAL, WGS84):
        return given
    if found := _UTM.fullmatch(system):
        plan = utm_to_geodetic(given[:, :2], int(found[1]), south=found[2] == "S")
        return np.column_stack([plan, given[:, 2]])
    return _by_pyproj(system, given)


def _by_pyproj(system: str, given: np.ndarray) -> np.ndarray:
    try:
        from pyproj import CRS, Transformer
        from pyproj.exceptions import CRSError, ProjError
    except ImportError as error:
        raise ControlError(
            Text("Coordinates in {} need the library pyproj, which this Python does not have.", system),
            remedy="Convert them to latitude and longitude or to UTM; or install pyproj in the Worker Python (pip "
            "install pyproj) and import the file there: python -m curecon_blender.core control WORKSPACE --import FILE",
        ) from error
    try:
        grid = CRS.from_user_input(system)
        transform = Transformer.from_crs(grid, CRS.from_epsg(4326), always_xy=True)
        longitude, latitude = transform.transform(given[:, 0], given[:, 1], errcheck=True)
    except (CRSError, ProjError) as error:
        raise ControlError(
            Text("The coordinates cannot be read in {} ({}).", system, Text(str(error).splitlines()[0])),
            remedy="Check the name of the system, such as EPSG:2180, and the order of the columns: east, then north.",
        ) from error
    # A grid in feet has its heights in feet, too.
    unit = next((axis.unit_conversion_factor for axis in grid.axis_info), 1.0) if grid.is_projected else 1.0
    return np.column_stack([latitude, longitude, given[:, 2] * unit])


def guess_system(plan: np.ndarray, *, by_axes: bool, middle: GeoPosition | None) -> str:
    """The system that coordinates (N,2) of a file that does not say are in.

    They are in the order in which they stand; `by_axes` is the order east, north, which in degrees is longitude,
    latitude. `middle` is where the photos were taken. A guess that puts points far from the photos is left for the
    check against them. Raises ControlError where nothing fits.
    """
    degrees = plan[:, ::-1] if by_axes else plan
    if middle is not None:
        for system, _ in _candidates(middle):
            if _near(system, degrees if system == WGS84 else plan, middle):
                return system
    if (np.abs(plan) <= 180).all() and (np.ptp(plan, axis=0) <= WIDEST_DEGREES).all():
        return WGS84
    if (np.abs(plan) <= FARTHEST_LOCAL).all():
        return LOCAL
    if middle is not None:
        for system, said in _candidates(middle):
            if _near(system, (degrees if system == WGS84 else plan)[:, ::-1], middle):
                raise ControlError(Text("East and north, or latitude and longitude, are exchanged: {}.", Text(said)),
                                   remedy="Exchange the two columns, or name them in a first line.")
    there = [] if middle is None else [said for _, said in _candidates(middle)[:2]]
    expected = f" The photos lie at {' or '.join(there)}." if there else ""
    raise ControlError(
        Text("The system of the coordinates cannot be told ({:.2f}, {:.2f}).{}", plan[0, 0], plan[0, 1],
             Text(expected)),
        remedy="Name it, such as UTM 50N, EPSG:2180 or local: in the import's System, with --system, or alone in the "
        "file's first line. Local coordinates must lie within 10 km of their origin.",
    )


def _candidates(middle: GeoPosition) -> list[tuple[str, str]]:
    """WGS84 and the UTM zones about a place, each with what its coordinates are there, in words."""
    south, home = middle.latitude < 0, utm_zone(middle.longitude)
    found = [(WGS84, f"latitude {middle.latitude:.5f}, longitude {middle.longitude:.5f}")]
    for zone in (home, home % 60 + 1, (home - 2) % 60 + 1):
        name = f"UTM {zone}{'S' if south else 'N'}"
        east, north = geodetic_to_utm(np.array([[middle.latitude, middle.longitude]]), zone, south=south)[0]
        found.append((name, f"{name} east {east:.0f}, north {north:.0f}"))
    return found


def _near(system: str, plan: np.ndarray, middle: GeoPosition) -> bool:
    """Whether half of the coordinates (N,2) lie near a place, read in a system."""
    with np.errstate(all="ignore"):
        places = to_places(system, np.column_stack([plan, np.full(len(plan), middle.altitude or 0.0)]))
        if not np.isfinite(places).all() or np.abs(np.median(places[:, 0])) > 90:
            return False
        off = np.linalg.norm(geodetic_to_enu(places, middle)[:, :2], axis=1)
    return bool(np.median(off) < NEAR)


def mistaken_for(given: tuple[float, float, float | None], system: str, middle: GeoPosition) -> str:
    """A remedy for a point that lies far from the photos, where another reading puts it near them; else nothing."""
    plan = np.array([given[:2]])
    if system != LOCAL and _near_quietly(system, plan[:, ::-1], middle):
        if system == WGS84:
            return "Latitude and longitude look exchanged: latitude comes first, unless a first line names the columns."
        return "East and north look exchanged: east comes first."
    for other, said in _candidates(middle):
        if other != system and (_near(other, plan, middle) or _near(other, plan[:, ::-1], middle)):
            return f"The coordinates look like {said}: name that system in place of {system}."
    return ""


def _near_quietly(system: str, plan: np.ndarray, middle: GeoPosition) -> bool:
    try:
        return _near(system, plan, middle)
    except ControlError:
        return False
