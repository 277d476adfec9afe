# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a photo was taken and where its camera looked, as EXIF and the makers' XMP tell it.

A position comes from one source as a whole: a place of one and an altitude of another may be of two data, or of two
moments. A place without an altitude is a position, too.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from PIL import ExifTags

from ..base.records import ELLIPSOID, SEA_LEVEL, UNKNOWN, GeoPosition, Gimbal
from .values import number, text
from .xmp import Xmp

_RTK_FIXED = 50  # DJI's RtkFlag of a fixed solution; 16 is a single point, 34 a floating one
_XMP_ANGLE = re.compile(r"(\d{1,3}),(\d{1,2}(?:\.\d{1,15})?)(?:,(\d{1,2}(?:\.\d{1,15})?))?([NSEW])", re.ASCII)
_WRAP = 1 << 32  # is added to a fraction's upper half where a negative one is written as if it had no sign
_DENOMINATORS = (1, 10, 100, 1000, 10_000)
_LOWEST, _HIGHEST = -500, 10_000  # metres, where a drone can be
# Yaw, pitch and roll in the order of trust, as the makers name them: DJI and Autel, Parrot, Skydio.
_ANGLES = ("Gimbal{}Degree", "Camera{}Degree", "CameraOrientationNED/{}")


@dataclass(frozen=True, kw_only=True)
class _Source:
    latitude: float | None
    longitude: float | None
    altitude: float | None
    datum: str

    @property
    def has_place(self) -> bool:
        if self.latitude is None or self.longitude is None or abs(self.latitude) > 90 or abs(self.longitude) > 180:
            return False
        return abs(self.latitude) > 1e-6 or abs(self.longitude) > 1e-6  # 0, 0 is what a receiver without a fix writes


def position(tags: Mapping[int, Any], exif: Mapping[int, Any], xmp: Xmp) -> GeoPosition | None:
    """The position that EXIF's GPS tags, the drone's XMP or XMP's copy of EXIF tells, whichever first tells it whole;
    else the first place without an altitude; None where there is none."""
    told = [source for source in (_of_exif(tags, exif, xmp), _of_drone(exif, xmp), _of_xmp(exif, xmp))
            if source.has_place]
    source = next((source for source in told if source.altitude is not None), told[0] if told else None)
    if source is None or source.latitude is None or source.longitude is None:
        return None
    return GeoPosition(
        latitude=source.latitude, longitude=source.longitude, altitude=source.altitude,
        altitude_datum=UNKNOWN if source.altitude is None else source.datum,
    )


def _of_exif(tags: Mapping[int, Any], exif: Mapping[int, Any], xmp: Xmp) -> _Source:
    void = text(tags.get(ExifTags.GPS.GPSStatus)).upper().startswith("V")
    reference = _altitude_reference(tags.get(ExifTags.GPS.GPSAltitudeRef))
    flat = text(tags.get(ExifTags.GPS.GPSMeasureMode)).startswith("2")  # a fix of two dimensions
    return _Source(
        latitude=_angle(tags.get(ExifTags.GPS.GPSLatitude), tags.get(ExifTags.GPS.GPSLatitudeRef), "NS"),
        longitude=None if void else _angle(
            tags.get(ExifTags.GPS.GPSLongitude), tags.get(ExifTags.GPS.GPSLongitudeRef), "EW"
        ),
        altitude=None if flat else _altitude(tags.get(ExifTags.GPS.GPSAltitude), reference),
        datum=_altitude_datum(reference, exif, xmp.drone),
    )


def _of_drone(exif: Mapping[int, Any], xmp: Xmp) -> _Source:
    drone = xmp.drone
    longitude = drone.get("GpsLongitude", drone.get("GpsLongtitude"))  # DJI's own misspelling, for years
    return _Source(
        latitude=number(drone.get("GpsLatitude", drone.get("Latitude"))),
        longitude=number(drone.get("Longitude") if longitude is None else longitude),
        altitude=_altitude(drone.get("AbsoluteAltitude"), None), datum=_altitude_datum(None, exif, drone),
    )


def _of_xmp(exif: Mapping[int, Any], xmp: Xmp) -> _Source:
    latitude, longitude = (_xmp_angle(xmp.tags.get(f"exif:GPS{name}", "")) for name in ("Latitude", "Longitude"))
    reference = _altitude_reference(xmp.tags.get("exif:GPSAltitudeRef"))
    return _Source(
        latitude=latitude, longitude=longitude, altitude=_altitude(xmp.tags.get("exif:GPSAltitude"), reference),
        datum=_altitude_datum(reference, exif, xmp.drone),
    )


def _angle(value: Any, reference: Any, letters: str) -> float | None:
    """Degrees from EXIF's (degrees, minutes, seconds) and its N, S, E or W, or a word; None unless both are sound."""
    letter = text(reference).upper()[:1]
    if not letter or letter not in letters or not isinstance(value, tuple) or len(value) != 3:
        return None
    parts = [number(part) for part in value]
    if any(part is None or part < 0 for part in parts):
        return None
    degrees, minutes, seconds = (part or 0.0 for part in parts)
    angle = degrees + minutes / 60 + seconds / 3600
    return -angle if letter == letters[1] else angle


def _xmp_angle(value: str) -> float | None:
    """Degrees from XMP's "24,39.5226N" or "24,39,31N"."""
    match = _XMP_ANGLE.fullmatch(value.strip())
    if match is None:
        return None
    angle = float(match[1]) + float(match[2]) / 60 + float(match[3] or 0) / 3600
    return -angle if match[4] in "SW" else angle


def _altitude(value: Any, reference: int | None) -> float | None:
    """Metres; None for what no receiver measures: exactly 0 is what it writes without an altitude."""
    altitude = number(value)
    if altitude is None:
        return None
    signed = (altitude - _WRAP / denominator for denominator in _DENOMINATORS)
    altitude = next((told for told in signed if _LOWEST < told < 0), altitude)
    return height(-abs(altitude) if reference in (1, 3) else altitude) or None


def _altitude_reference(value: Any) -> int | None:
    """EXIF's 0 to 3 (1 and 3 below), also where it was written as a digit or in words."""
    if isinstance(value, bytes) and len(value) == 1 and value[0] <= 3:
        return value[0]
    if isinstance(value, int):
        return value if 0 <= value <= 3 else None
    words = text(value).casefold()
    if words in ("0", "1", "2", "3"):
        return int(words)
    return 1 if "below" in words else 0 if "above" in words else None


def _altitude_datum(reference: int | None, exif: Mapping[int, Any], drone: Mapping[str, str]) -> str:
    """What the altitude is counted from. An RTK receiver tells the height above the ellipsoid, and DJI writes it into
    EXIF as it is, with the reference of the sea level. `reference` is None for an altitude that is not EXIF's."""
    if named := drone.get("VertCS"):
        return ELLIPSOID if "ellipsoid" in named.casefold() else SEA_LEVEL
    flag = number(drone.get("RtkFlag"))
    if flag == _RTK_FIXED or drone.get("AltitudeType") == "RtkAlt":
        return ELLIPSOID
    if flag or reference is None:
        return UNKNOWN
    # 0 and 1 were above and below sea level until EXIF 3.0 made them of the ellipsoid, and 2 and 3 of the sea level.
    since_3 = text(exif.get(ExifTags.Base.ExifVersion)) >= "0300"
    return ELLIPSOID if since_3 and reference in (0, 1) else SEA_LEVEL


def height(value: Any) -> float | None:
    """Metres, where a drone can be."""
    told = number(value)
    return told if told is not None and _LOWEST < told < _HIGHEST else None


def relative_altitude(xmp: Xmp) -> float | None:
    """Metres above take-off, or above the ground where only that is told."""
    return height(xmp.drone.get("RelativeAltitude", xmp.drone.get("AboveGroundAltitude")))


def gimbal(xmp: Xmp) -> Gimbal | None:
    """The camera's angles; three zeros are what a drone without a gimbal writes."""
    drone = xmp.drone
    for names in _ANGLES:
        if (found := _gimbal(*(drone.get(names.format(axis)) for axis in ("Yaw", "Pitch", "Roll")))) is not None:
            return found
    # Pix4D's pitch counts from the nadir.
    yaw, pitch, roll = (number(xmp.tags.get(f"Camera:{axis}")) for axis in ("Yaw", "Pitch", "Roll"))
    return None if pitch is None or (yaw, pitch, roll) == (0, 0, 0) else _gimbal(yaw, pitch - 90, roll)


def _gimbal(*angles: Any) -> Gimbal | None:
    yaw, pitch, roll = map(number, angles)
    if yaw is None or pitch is None or roll is None or max(abs(yaw), abs(pitch), abs(roll)) > 360:
        return None
    return Gimbal(yaw=yaw, pitch=pitch, roll=roll)
