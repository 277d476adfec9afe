# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a photo's EXIF and the drone's XMP say of its camera, place and attitude. A bad tag loses only that tag."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from PIL import ExifTags, Image

from ..base.images import exif_tags, open_image, oriented_size
from ..base.records import ELLIPSOID, SEA_LEVEL, UNKNOWN, GeoPosition, Gimbal, Lens
from .capture import FIRST_YEAR, LAST_YEAR

_MOST_XMP = 1 << 20  # bytes; drones write some 4 kB
_MOST_TEXT = 100  # characters of a tag
_NAMESPACES = ("{http://www.dji.com/drone-dji/1.0/}", "{http://pix4d.com/camera/1.0/}", "{http://pix4d.com/camera/1.0}")
_RTK_FIXED = 50  # DJI's RtkFlag of a fixed solution; 16 is a single point, 34 a floating one
_FILM_DIAGONAL = math.hypot(36, 24)  # mm
_FOCAL_PLANE_UNITS = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}  # EXIF FocalPlaneResolutionUnit, in mm
# Sensor widths in mm of the drone cameras whose files carry no 35 mm equivalent (makers' specifications).
_SENSOR_WIDTHS = {
    "FC220": 6.17, "FC300C": 6.17, "FC300S": 6.17, "FC300X": 6.17, "FC330": 6.17, "FC350": 6.17, "FC550": 17.3,
    "FC6310": 13.2, "FC6310R": 13.2, "FC6310S": 13.2, "FC6510": 13.2, "FC6520": 17.3, "FC7203": 6.17, "FC7303": 6.17,
    "L1D-20c": 13.2,
}


@dataclass(frozen=True, kw_only=True)
class Metadata:
    """See Photo in base/records.py for units; every field is None (or empty) where the photo does not tell."""

    camera: str  # make, model, focal length and serial number: photos with the same share intrinsics
    focal_px: float | None
    lens: Lens | None
    gps_sigmas: tuple[float, float] | None
    gps: GeoPosition | None
    gimbal: Gimbal | None
    relative_altitude: float | None
    time: str | None


def read_metadata(path: Path) -> Metadata:
    """The metadata of a photo. Raises PhotoError when the file is missing or not a picture."""
    with open_image(path) as image:
        return from_image(image)


def from_image(image: Image.Image) -> Metadata:
    """The metadata of an image that is open and not yet decoded."""
    main = exif_tags(image)
    exif = exif_tags(image, ExifTags.IFD.Exif)
    xmp = _xmp_tags(image.info.get("xmp"))
    model = _text(main.get(ExifTags.Base.Model))
    focal_px = _focal_px(exif, xmp, model, *oriented_size(image))
    return Metadata(
        camera=_camera(main, exif, model),
        focal_px=focal_px,
        lens=_lens(xmp, focal_px, image.size) if main.get(ExifTags.Base.Orientation, 1) == 1 else None,
        gps_sigmas=_gps_sigmas(xmp),
        gps=_position(exif_tags(image, ExifTags.IFD.GPSInfo), exif, xmp),
        gimbal=_gimbal(xmp),
        relative_altitude=_height(xmp.get("RelativeAltitude")),
        time=_time(main, exif),
    )


def _camera(main: Mapping[int, Any], exif: Mapping[int, Any], model: str) -> str:
    make = _text(main.get(ExifTags.Base.Make))
    parts = [make if make and not model.startswith(make) else "", model]
    focal = _number(exif.get(ExifTags.Base.FocalLength))
    serial = _text(exif.get(ExifTags.Base.BodySerialNumber))
    if focal:
        parts.append(f"{focal:g} mm")
    if serial:
        parts.append(f"no. {serial}")
    return " ".join(part for part in parts if part)


def _focal_px(exif: Mapping[int, Any], dji: Mapping[str, str], model: str, width: int, height: int) -> float | None:
    """Focal length in pixels of this picture: the drone's own calibration, else EXIF's 35 mm equivalent, else the
    focal length over the sensor's width."""
    longest, shortest = max(width, height), min(width, height)
    # The picture as the camera took it, for tags that count its pixels: it may have been scaled down since.
    taken = max(_number(exif.get(tag)) or 0.0 for tag in (ExifTags.Base.ExifImageWidth, ExifTags.Base.ExifImageHeight))
    equivalent = None
    if film := _positive(exif.get(ExifTags.Base.FocalLengthIn35mmFilm)):
        # Makers give the equivalent by the diagonal of the whole sensor. Pictures at 16:9 are cropped from sensors
        # of 4:3 at full width, and their tag stays that of the whole sensor.
        sensor_height = 0.75 * longest if longest > 1.6 * shortest else shortest
        equivalent = film * math.hypot(longest, sensor_height) / _FILM_DIAGONAL

    calibrated = _calibrated_focal(dji, longest, taken)
    if calibrated and equivalent and not 0.8 < calibrated / equivalent < 1.25:
        calibrated = None  # another lens's or zoom's, or the picture was cropped
    candidates = [calibrated, equivalent]
    if focal := _positive(exif.get(ExifTags.Base.FocalLength)):
        resolution = _positive(exif.get(ExifTags.Base.FocalPlaneXResolution))
        unit = _FOCAL_PLANE_UNITS.get(exif.get(ExifTags.Base.FocalPlaneResolutionUnit, 2))
        if resolution and unit:
            candidates.append(focal * resolution / unit * longest / (taken or longest))
        if model in _SENSOR_WIDTHS:
            candidates.append(focal * longest / _SENSOR_WIDTHS[model])
    # Beyond these (127 degrees of view, a 360 mm equivalent) it is a tag gone wrong.
    plausible = (f for f in candidates if f is not None and 0.25 < f / longest < 10)
    return next(plausible, None)


def _calibrated_focal(dji: Mapping[str, str], longest: int, taken: float) -> float | None:
    """The drone's calibration, in pixels of the picture as taken, brought to this picture's size."""
    if centre := _positive(dji.get("CalibratedOpticalCenterX")):
        taken = 2 * centre
    scale = longest / taken if taken else 1.0
    dewarp = dji.get("DewarpData", "").partition(";")[2].split(",")  # date; fx, fy, cx, cy, k1...
    if len(dewarp) >= 9 and (fx := _positive(dewarp[0])) and (fy := _positive(dewarp[1])):
        return scale * math.sqrt(fx * fy)
    calibrated = _positive(dji.get("CalibratedFocalLength"))
    return scale * calibrated if calibrated else None


def _lens(dji: Mapping[str, str], focal_px: float | None, size: tuple[int, int]) -> Lens | None:
    """The calibration that DJI writes into every photo of a camera (DewarpData), brought to this picture's size; None
    for a picture that was straightened already or cropped, or whose focal length says otherwise."""
    told = [_number(text) for text in dji.get("DewarpData", "").partition(";")[2].split(",")]
    numbers = [number for number in told if number is not None]
    half_width, half_height = (_positive(dji.get(f"CalibratedOpticalCenter{axis}")) for axis in "XY")
    if len(told) != 9 or len(numbers) != 9 or not half_width or not half_height or _number(dji.get("DewarpFlag")) == 1:
        return None
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = numbers
    width, height = size
    scale = 0.5 * width / half_width
    if not abs(0.5 * height / half_height / scale - 1) < 0.01:
        return None
    if not (fx > 0 and 0.9 < fy / fx < 1.1 and focal_px and abs(scale * math.sqrt(fx * fy) / focal_px - 1) < 0.01):
        return None
    if not (abs(cx) < half_width / 4 and abs(cy) < half_height / 4
            and max(abs(k1), abs(k2), abs(k3)) < 5 and max(abs(p1), abs(p2)) < 0.5):
        return None
    return Lens(f=scale * fx, aspect=fy / fx, cx=0.5 * width + scale * cx, cy=0.5 * height + scale * cy,
                k1=k1, k2=k2, p1=p1, p2=p2, k3=k3)


def _gps_sigmas(dji: Mapping[str, str]) -> tuple[float, float] | None:
    """Sigmas in plan and height (metres) of a position that RTK has fixed; None where the receiver states none."""
    longitude, latitude, height = (_positive(dji.get(f"RtkStd{name}")) for name in ("Lon", "Lat", "Hgt"))
    if _number(dji.get("RtkFlag")) != 50 or longitude is None or latitude is None or height is None:
        return None
    plan = max(longitude, latitude)
    return (plan, height) if 1e-3 <= plan < 100 and 1e-3 <= height < 100 else None


def _position(tags: Mapping[int, Any], exif: Mapping[int, Any], dji: Mapping[str, str]) -> GeoPosition | None:
    latitude = _angle(tags.get(ExifTags.GPS.GPSLatitude), tags.get(ExifTags.GPS.GPSLatitudeRef), "NS")
    longitude = _angle(tags.get(ExifTags.GPS.GPSLongitude), tags.get(ExifTags.GPS.GPSLongitudeRef), "EW")
    if not _is_place(latitude, longitude) or _text(tags.get(ExifTags.GPS.GPSStatus)) == "V":
        latitude = _number(dji.get("GpsLatitude"))
        longitude = _number(dji.get("GpsLongitude", dji.get("GpsLongtitude")))  # DJI's own misspelling, for years
    altitudes = (_altitude(tags), _height(dji.get("AbsoluteAltitude")))
    altitude = next((a for a in altitudes if a is not None), None)
    if latitude is None or longitude is None or altitude is None or not _is_place(latitude, longitude):
        return None
    datum = _altitude_datum(tags if altitudes[0] is not None else {}, exif, dji)
    return GeoPosition(latitude=latitude, longitude=longitude, altitude=altitude, altitude_datum=datum)


def _is_place(latitude: float | None, longitude: float | None) -> bool:
    if latitude is None or longitude is None or abs(latitude) > 90 or abs(longitude) > 180:
        return False
    return abs(latitude) > 1e-6 or abs(longitude) > 1e-6  # 0, 0 is what a receiver without a fix writes


def _angle(value: Any, reference: Any, letters: str) -> float | None:
    """Degrees from EXIF's (degrees, minutes, seconds) and its N, S, E or W; None unless both are sound."""
    letter = _text(reference).upper()[:1]
    if not letter or letter not in letters or not isinstance(value, tuple) or len(value) != 3:
        return None
    parts = [_number(part) for part in value]
    if any(part is None or part < 0 for part in parts):
        return None
    degrees, minutes, seconds = (part or 0.0 for part in parts)
    angle = degrees + minutes / 60 + seconds / 3600
    return -angle if letter == letters[1] else angle


def _altitude(tags: Mapping[int, Any]) -> float | None:
    altitude = _number(tags.get(ExifTags.GPS.GPSAltitude))
    below = _altitude_reference(tags) in (1, 3)
    return _height(-altitude if altitude is not None and below else altitude)


def _altitude_reference(tags: Mapping[int, Any]) -> int | None:
    value = tags.get(ExifTags.GPS.GPSAltitudeRef)
    if isinstance(value, bytes):
        value = value[0] if len(value) == 1 else None
    return value if isinstance(value, int) and 0 <= value <= 3 else None


def _altitude_datum(tags: Mapping[int, Any], exif: Mapping[int, Any], xmp: Mapping[str, str]) -> str:
    """What the altitude is counted from. An RTK receiver tells the height above the ellipsoid, and DJI writes it into
    EXIF as it is, with the reference of the sea level. `tags` are empty for an altitude that is not EXIF's."""
    if named := xmp.get("VertCS"):
        return ELLIPSOID if "ellipsoid" in named.casefold() else SEA_LEVEL
    flag = _number(xmp.get("RtkFlag"))
    if flag == _RTK_FIXED or xmp.get("AltitudeType") == "RtkAlt":
        return ELLIPSOID
    reference = _altitude_reference(tags)
    if flag or reference is None:
        return UNKNOWN
    # 0 and 1 were above and below sea level until EXIF 3.0 made them of the ellipsoid, and 2 and 3 of the sea level.
    since_3 = _text(exif.get(ExifTags.Base.ExifVersion)) >= "0300"
    return ELLIPSOID if since_3 and reference in (0, 1) else SEA_LEVEL


def _height(value: Any) -> float | None:
    """Metres, where a drone can be."""
    height = _number(value)
    return height if height is not None and -500 < height < 10_000 else None


def _gimbal(dji: Mapping[str, str]) -> Gimbal | None:
    yaw, pitch, roll = (_number(dji.get(f"Gimbal{axis}Degree")) for axis in ("Yaw", "Pitch", "Roll"))
    if yaw is None or pitch is None or roll is None or max(abs(yaw), abs(pitch), abs(roll)) > 360:
        return None
    return Gimbal(yaw=yaw, pitch=pitch, roll=roll)


def _time(main: Mapping[int, Any], exif: Mapping[int, Any]) -> str | None:
    offset = _text(exif.get(ExifTags.Base.OffsetTimeOriginal))
    for value in (exif.get(ExifTags.Base.DateTimeOriginal), main.get(ExifTags.Base.DateTime)):
        try:
            time = datetime.strptime(_text(value), "%Y:%m:%d %H:%M:%S")
        except ValueError:
            continue
        if FIRST_YEAR <= time.year <= LAST_YEAR:
            known = re.fullmatch(r"[+-](0\d|1[0-4]):[0-5]\d", offset, re.ASCII)
            return time.isoformat() + (offset if known else "")
    return None


def _xmp_tags(packet: bytes | str | None) -> dict[str, str]:
    """DJI's and Pix4D's values in an XMP packet, by name, whether written as attributes or as elements."""
    if not isinstance(packet, bytes | str) or len(packet) > _MOST_XMP:
        return {}
    text = packet.decode("utf-8", "replace") if isinstance(packet, bytes) else packet
    # The packet's wrapper may be padded; a document type, which XMP has no use for, could define entities.
    start, end = text.find("<x:xmpmeta"), text.rfind("</x:xmpmeta>")
    if start >= 0 and end >= 0:
        text = text[start : end + len("</x:xmpmeta>")]
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        return {}
    try:
        root = ElementTree.fromstring(text.strip("\x00 \r\n\t\ufeff"))
    except ElementTree.ParseError:
        return {}
    tags = {}
    for element in root.iter():
        for key, value in (*element.attrib.items(), (element.tag, element.text)):
            namespace, _, name = key.rpartition("}")
            if f"{namespace}}}" in _NAMESPACES and value and value.strip():
                tags[name] = value.strip()
    return tags


def _number(value: Any) -> float | None:
    """A finite float, or None for whatever else a tag may hold."""
    try:
        number = float(value)
    except (TypeError, ValueError, ArithmeticError):
        return None
    return number if math.isfinite(number) else None


def _positive(value: Any) -> float | None:
    number = _number(value)
    return number if number is not None and number > 0 else None


def _text(value: Any) -> str:
    """A tag's text up to its first NUL, on one line, without control characters."""
    if isinstance(value, bytes):
        value = value.decode("ascii", "replace")
    if not isinstance(value, str):
        return ""
    words = " ".join(value.split("\x00", 1)[0].split())
    return "".join(letter for letter in words if letter.isprintable())[:_MOST_TEXT]
