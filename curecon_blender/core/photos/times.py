# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""When a photo was taken: the camera's clock, and how far it is from UTC, as GPS or the camera tells."""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta, timezone
from typing import Any

from PIL import ExifTags

from .capture import FIRST_YEAR, LAST_YEAR
from .values import number, text
from .xmp import Xmp

_OFFSET = re.compile(r"[+-](0\d|1[0-4]):[0-5]\d", re.ASCII)
_XMP_TIME = re.compile(r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)(?:\.\d{1,9})?(Z|[+-]\d\d:\d\d)?", re.ASCII)
_QUARTER = timedelta(minutes=15)  # zones lie whole ones apart
_CLOCK_ERROR = timedelta(minutes=1)  # of a clock that is right
_FARTHEST_ZONES = timedelta(hours=-13), timedelta(hours=15)  # with an hour for a clock that is not


def time(main: Mapping[int, Any], exif: Mapping[int, Any], gps: Mapping[int, Any], xmp: Xmp) -> str | None:
    """ISO 8601 by the camera's clock, with its offset from UTC where that is told: by GPS's date and time, else by the
    camera. UTC itself where GPS says that the clock was never set."""
    utc = _gps_time(gps) or _xmp_time(xmp.drone.get("UTCAtExposure", ""))[0]
    local, offset = _camera_time(main, exif, xmp)
    if utc is None:
        return None if local is None else local.isoformat() + offset
    ahead = None if local is None else local - utc
    if local is None or ahead is None or not _FARTHEST_ZONES[0] < ahead < _FARTHEST_ZONES[1]:
        return utc.replace(tzinfo=UTC).isoformat()
    zone = round(ahead / _QUARTER) * _QUARTER
    if abs(ahead - zone) > _CLOCK_ERROR:
        zone = timedelta(minutes=round(ahead / timedelta(minutes=1)))
    return local.replace(tzinfo=timezone(zone)).isoformat()


def _gps_time(tags: Mapping[int, Any]) -> datetime | None:
    """UTC of the receiver's last fix, without a zone, in whole seconds."""
    stamp = tags.get(ExifTags.GPS.GPSTimeStamp)
    date = re.fullmatch(r"(\d{4})[:-](\d\d)[:-](\d\d)", text(tags.get(ExifTags.GPS.GPSDateStamp)), re.ASCII)
    if date is None or not isinstance(stamp, tuple) or len(stamp) != 3:
        return None
    hours, minutes, seconds = map(number, stamp)
    if hours is None or minutes is None or seconds is None:
        return None
    try:
        day = datetime.strptime("-".join(date.groups()), "%Y-%m-%d")
        time = day + timedelta(hours=hours, minutes=minutes, seconds=round(seconds))
    except (ValueError, OverflowError):
        return None
    within = FIRST_YEAR <= time.year <= LAST_YEAR and 0 <= (time - day).total_seconds() <= 86_400
    return time if within else None


def _camera_time(main: Mapping[int, Any], exif: Mapping[int, Any], xmp: Xmp) -> tuple[datetime | None, str]:
    """The camera's clock without a zone, and its offset from UTC as the camera has it ("+08:00"), "" unknown."""
    offsets = [text(exif.get(tag)) for tag in (
        ExifTags.Base.OffsetTimeOriginal, ExifTags.Base.OffsetTimeDigitized, ExifTags.Base.OffsetTime,
    )]
    offset = next((found for found in offsets if _OFFSET.fullmatch(found)), "")
    written = [_xmp_time(xmp.tags.get(key, "")) for key in ("exif:DateTimeOriginal", "xmp:CreateDate")]
    for value in (exif.get(ExifTags.Base.DateTimeOriginal), main.get(ExifTags.Base.DateTime)):
        try:
            time = datetime.strptime(text(value), "%Y:%m:%d %H:%M:%S")
        except ValueError:
            continue
        if FIRST_YEAR <= time.year <= LAST_YEAR:
            return time, offset or next((zone for when, zone in written if when == time), "")
    return next(((when, zone) for when, zone in written if when is not None), (None, ""))


def _xmp_time(value: str) -> tuple[datetime | None, str]:
    match = _XMP_TIME.fullmatch(value)
    try:
        time = datetime.fromisoformat(match[1]) if match else None
    except ValueError:
        time = None
    if match is None or time is None or not FIRST_YEAR <= time.year <= LAST_YEAR:
        return None, ""
    zone = "+00:00" if match[2] == "Z" else match[2] or ""
    return time, zone if _OFFSET.fullmatch(zone) else ""
