# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Places on Earth: geodetic positions on WGS84, and metres east, north and up of one of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .records import UNKNOWN, GeoPosition, Photo

_WGS84_A = 6378137.0
_FLATTENING = 1 / 298.257223563
_WGS84_E2 = _FLATTENING * (2 - _FLATTENING)
# Transverse Mercator by Krueger's series in the third flattening, whose error is below a micrometre within a UTM zone.
_N = _FLATTENING / (2 - _FLATTENING)
_RADIUS = _WGS84_A / (1 + _N) * (1 + _N**2 / 4 + _N**4 / 64)  # of the rectified meridian
_TO_GRID = (
    _N / 2 - 2 / 3 * _N**2 + 5 / 16 * _N**3 + 41 / 180 * _N**4, 13 / 48 * _N**2 - 3 / 5 * _N**3 + 557 / 1440 * _N**4,
    61 / 240 * _N**3 - 103 / 140 * _N**4, 49561 / 161280 * _N**4,
)
_FROM_GRID = (
    _N / 2 - 2 / 3 * _N**2 + 37 / 96 * _N**3 - 1 / 360 * _N**4, _N**2 / 48 + _N**3 / 15 - 437 / 1440 * _N**4,
    17 / 480 * _N**3 - 37 / 840 * _N**4, 4397 / 161280 * _N**4,
)
_UTM_SCALE, _UTM_EASTING, _UTM_SOUTHING = 0.9996, 500_000.0, 10_000_000.0


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


def utm_zone(longitude: float) -> int:
    """The UTM zone, 1 to 60, of a longitude in degrees; the exceptions of Norway and Svalbard are not made."""
    return int((longitude + 180) // 6) % 60 + 1


def geodetic_to_utm(positions: np.ndarray, zone: int, *, south: bool) -> np.ndarray:
    """(N,2) latitude and longitude in degrees on WGS84 -> (N,2) easting and northing in metres."""
    latitude = np.radians(positions[:, 0])
    longitude = np.radians(positions[:, 1] - (6 * zone - 183))
    e = np.sqrt(_WGS84_E2)
    conformal = np.sinh(np.arctanh(np.sin(latitude)) - e * np.arctanh(e * np.sin(latitude)))
    xi = np.arctan2(conformal, np.cos(longitude))
    eta = np.arcsinh(np.sin(longitude) / np.hypot(conformal, np.cos(longitude)))
    north, east = _series(xi, eta, _TO_GRID)
    return np.stack([
        _UTM_EASTING + _UTM_SCALE * _RADIUS * east,
        _UTM_SCALE * _RADIUS * north + (_UTM_SOUTHING if south else 0.0),
    ], axis=1)


def utm_to_geodetic(positions: np.ndarray, zone: int, *, south: bool) -> np.ndarray:
    """The inverse of `geodetic_to_utm`."""
    north = (positions[:, 1] - (_UTM_SOUTHING if south else 0.0)) / (_UTM_SCALE * _RADIUS)
    east = (positions[:, 0] - _UTM_EASTING) / (_UTM_SCALE * _RADIUS)
    xi, eta = _series(north, east, tuple(-term for term in _FROM_GRID))
    isometric = np.arcsinh(np.sin(xi) / np.hypot(np.sinh(eta), np.cos(xi)))
    e, latitude = np.sqrt(_WGS84_E2), np.arctan(np.sinh(isometric))
    for _ in range(6):  # converges by a factor of about 150 a step
        latitude = np.arctan(np.sinh(isometric + e * np.arctanh(e * np.sin(latitude))))
    longitude = np.degrees(np.arctan2(np.sinh(eta), np.cos(xi))) + (6 * zone - 183)
    return np.stack([np.degrees(latitude), (longitude + 180) % 360 - 180], axis=1)


def _series(xi: np.ndarray, eta: np.ndarray, terms: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    north, east = xi.copy(), eta.copy()
    for j, term in enumerate(terms, start=1):
        north += term * np.sin(2 * j * xi) * np.cosh(2 * j * eta)
        east += term * np.cos(2 * j * xi) * np.sinh(2 * j * eta)
    return north, east


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
