# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Places on Earth: geodetic positions on WGS84, and metres east, north and up of one of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .records import UNKNOWN, GeoPosition, Photo

_WGS84_A = 6378137.0
_WGS84_E2 = (1 / 298.257223563) * (2 - 1 / 298.257223563)


def geodetic_to_enu(positions: np.ndarray, origin: GeoPosition) -> np.ndarray:
    """(N,3) latitude, longitude (degrees), altitude (metres) on WGS84 -> (N,3) metres east, north, up of `origin`.

    Altitudes count from the origin's own datum: over a site the geoid is as good as parallel to the ellipsoid.
    """
    reference = np.array([[origin.latitude, origin.longitude, origin.altitude]])
    return (_ecef(positions) - _ecef(reference)) @ _enu_from_ecef(origin).T


def enu_to_geodetic(enu: np.ndarray, origin: GeoPosition) -> np.ndarray:
    """The inverse of `geodetic_to_enu`: (N,3) metres -> (N,3) degrees, degrees, metres."""
    reference = np.array([[origin.latitude, origin.longitude, origin.altitude]])
    x, y, z = (enu @ _enu_from_ecef(origin) + _ecef(reference)).T
    across = np.hypot(x, y)
    latitude = np.arctan2(z, across * (1 - _WGS84_E2))
    for _ in range(6):  # converges by a factor of about 300 a step: nanometres after four
        normal = _WGS84_A / np.sqrt(1 - _WGS84_E2 * np.sin(latitude) ** 2)
        latitude = np.arctan2(z + _WGS84_E2 * normal * np.sin(latitude), across)
    normal = _WGS84_A / np.sqrt(1 - _WGS84_E2 * np.sin(latitude) ** 2)
    # Height along the normal, in the form that holds at the poles too.
    altitude = across * np.cos(latitude) + z * np.sin(latitude) - _WGS84_A**2 / normal
    return np.stack([np.degrees(latitude), np.degrees(np.arctan2(y, x)), altitude], axis=1)


def gps_enu(photos: Sequence[Photo]) -> tuple[np.ndarray, GeoPosition]:
    """Camera positions (N,3) in metres east, north, up of their median; every photo must have GPS. The median's
    altitude is of unknown datum where the photos' data differ."""
    places = [photo.gps for photo in photos if photo.gps is not None]
    positions = np.array([[place.latitude, place.longitude, place.altitude] for place in places])
    latitude, longitude, altitude = np.median(positions, axis=0).tolist()
    data = {place.altitude_datum for place in places}
    origin = GeoPosition(
        latitude=latitude, longitude=longitude, altitude=altitude,
        altitude_datum=data.pop() if len(data) == 1 else UNKNOWN,
    )
    return geodetic_to_enu(positions, origin), origin


def _ecef(positions: np.ndarray) -> np.ndarray:
    latitude, longitude = np.radians(positions[:, 0]), np.radians(positions[:, 1])
    normal = _WGS84_A / np.sqrt(1 - _WGS84_E2 * np.sin(latitude) ** 2)
    across = (normal + positions[:, 2]) * np.cos(latitude)
    up = (normal * (1 - _WGS84_E2) + positions[:, 2]) * np.sin(latitude)
    return np.stack([across * np.cos(longitude), across * np.sin(longitude), up], axis=1)


def _enu_from_ecef(origin: GeoPosition) -> np.ndarray:
    sin_lat, cos_lat = np.sin(np.radians(origin.latitude)), np.cos(np.radians(origin.latitude))
    sin_lon, cos_lon = np.sin(np.radians(origin.longitude)), np.cos(np.radians(origin.longitude))
    return np.array([
        [-sin_lon, cos_lon, 0.0],
        [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat],
        [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat],
    ])
