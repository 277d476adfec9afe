# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the sun stands."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np

_J2000 = datetime(2000, 1, 1, 12, tzinfo=UTC)


def position(utc: datetime, latitude: float, longitude: float) -> tuple[float, float]:
    """Azimuth (clockwise from north, in [0, 360)) and altitude above the horizon of the sun's middle, in degrees.

    `utc` is an aware time; latitude and longitude in degrees, north and east positive. The Astronomical Almanac's
    low-precision formulas: within 0.02 degrees from 1950 to 2050, without refraction (0.5 degrees at the horizon,
    less than 0.1 above 10 degrees).
    """
    days = (utc - _J2000).total_seconds() / 86400
    anomaly = np.radians(357.528 + 0.9856003 * days)
    ecliptic = np.radians(280.460 + 0.9856474 * days + 1.915 * np.sin(anomaly) + 0.020 * np.sin(2 * anomaly))
    obliquity = np.radians(23.439 - 4e-7 * days)
    ascension = np.arctan2(np.cos(obliquity) * np.sin(ecliptic), np.cos(ecliptic))
    declination = np.arcsin(np.sin(obliquity) * np.sin(ecliptic))
    sidereal = np.radians(15 * (18.697374558 + 24.06570982441908 * days) + longitude)
    hour, place = sidereal - ascension, np.radians(latitude)
    east = -np.cos(declination) * np.sin(hour)
    north = np.sin(declination) * np.cos(place) - np.cos(declination) * np.cos(hour) * np.sin(place)
    up = np.sin(declination) * np.sin(place) + np.cos(declination) * np.cos(hour) * np.cos(place)
    return float(np.degrees(np.arctan2(east, north)) % 360), float(np.degrees(np.arcsin(up)))


def direction(azimuth: float, altitude: float, north: float = 0.0) -> np.ndarray:
    """Unit vector (3,) towards the sun in a frame with Z up whose north lies `north` degrees clockwise from +Y."""
    turn, rise = np.radians(azimuth + north), np.radians(altitude)
    vector: np.ndarray = np.array([np.sin(turn) * np.cos(rise), np.cos(turn) * np.cos(rise), np.sin(rise)])
    return vector
