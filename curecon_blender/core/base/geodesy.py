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
SAME_ALTITUDE = 0.001  # metres


def geodetic_to_enu(positions: np.ndarray, origin: GeoPosition) -> np.ndarray:
    """(N,3) latitude, longitude (degrees), altitude (metres) on WGS84 -> (N,3) metres east, north, up of `origin`.

    Altitudes count from the origin's own datum: over a site the geoid is as good as parallel to the ellipsoid. Those of
    an origin without one count from 0.
    """
    rotation, centre = enu_from_ecef(origin)
    return (_ecef(positions) - centre) @ rotation.T


def enu_to_geodetic(enu: np.ndarray, origin: GeoPosition) -> np.ndarray:
    """The inverse of `geodetic_to_enu`: (N,3) metres -> (N,3) degrees, degrees, metres."""
    rotation, centre = enu_from_ecef(origin)
    return ecef_to_geodetic(enu @ rotation + centre)


def enu_from_ecef(origin: GeoPosition) -> tuple[np.ndarray, np.ndarray]:
    """`rotation` (3,3) and `centre` (3,) such that places (N,3) in earth-centred metres are `(places - centre) @
    rotation.T` in metres east, north and up of `origin`."""
    reference = np.array([[origin.latitude, origin.longitude, origin.altitude or 0.0]])
    return _enu_from_ecef(origin), _ecef(reference)[0]


def ecef_to_geodetic(places: np.ndarray) -> np.ndarray:
    """(N,3) earth-centred metres -> (N,3) latitude, longitude in degrees, metres above the ellipsoid, on WGS84."""
    x, y, z = places.T
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
    """Camera positions (N,3) in metres east, north, up of their median; every photo must have GPS.

    A photo without an altitude counts as high as the median. The median's altitude is None where no photo has one, and
    of unknown datum where the photos' data differ.
    """
    places = [photo.gps for photo in photos if photo.gps is not None]
    known = [place for place in places if place.altitude is not None]
    altitude = float(np.median([place.altitude for place in known])) if known else None
    positions = np.array([
        [place.latitude, place.longitude, (altitude or 0.0) if place.altitude is None else place.altitude]
        for place in places
    ])
    first = positions[0, 1]  # the longitudes may lie on both sides of 180 degrees
    longitude = first + float(np.median(_within_180(positions[:, 1] - first)))
    data = {place.altitude_datum for place in known}
    origin = GeoPosition(
        latitude=float(np.median(positions[:, 0])), longitude=float(_within_180(longitude)), altitude=altitude,
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


def altitudes_tell(photos: Sequence[Photo]) -> np.ndarray:
    """Whether each photo's altitude (N,) tells its height. None does where it is the same in different places: that was
    written by something else than a receiver."""
    told = np.array([photo.gps is not None and photo.gps.altitude is not None for photo in photos], bool)
    places = {(photo.gps.latitude, photo.gps.longitude): photo.gps.altitude for photo in photos
              if photo.gps is not None and photo.gps.altitude is not None}
    constant = len(places) >= 3 and float(np.ptp(list(places.values()))) < SAME_ALTITUDE
    return np.zeros_like(told) if constant else told


def _within_180(degrees: np.ndarray | float) -> np.ndarray:
    return np.asarray((np.asarray(degrees) + 180) % 360 - 180)


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
