# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a drone was while it filmed: the subtitles (.SRT) that DJI writes beside a video or into it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..base.errors import PhotoError
from ..base.images import shown
from ..base.language import Text
from ..base.reading import read_bytes

MOST_BYTES = 200_000_000  # an hour of 60 frames a second is 60 MB
_SPAN = re.compile(r"(\d+):(\d+):(\d+)[,.](\d+)\s*-->")
_NUMBER = r"\s*[:=]?\s*\(?\s*([-+]?\d+(?:\.\d+)?)"
_LATITUDE = re.compile(r"\blat\w*" + _NUMBER, re.IGNORECASE)
_LONGITUDE = re.compile(r"\blong?t?i?t?u?d?e?" + _NUMBER, re.IGNORECASE)
_GPS = re.compile(r"\bGPS\s*\(\s*([-+]?\d+\.\d+)\s*,\s*([-+]?\d+\.\d+)", re.IGNORECASE)  # longitude first
_ABSOLUTE = re.compile(r"\babs_alt" + _NUMBER)
_RELATIVE = re.compile(r"(?:\brel_alt|\bBAROMETER|\bH)" + _NUMBER)
_FOCAL = re.compile(r"\bfocal_len" + _NUMBER)
_CLOCK = re.compile(r"\b(\d{4})[-./](\d\d?)[-./](\d\d?)[ T](\d\d?):(\d\d):(\d\d)")


@dataclass(frozen=True)
class Telemetry:
    """What was told at `seconds` (N,) of the video. `values` (N,4): latitude, longitude in degrees, altitude and height
    above take-off in metres, nan where it is not told. `clocks` are EXIF times, or "". `focal` is the 35 mm equivalent
    in millimetres, where it is told."""

    seconds: np.ndarray
    values: np.ndarray
    clocks: tuple[str, ...]
    focal: float | None

    def at(self, second: float) -> tuple[np.ndarray, str]:
        """The values (4,), interpolated, and the clock of the entry before; nan outside of what was told by more than
        a second."""
        place = int(np.clip(np.searchsorted(self.seconds, second, side="right") - 1, 0, len(self.seconds) - 1))
        if not self.seconds[0] - 1 <= second <= self.seconds[-1] + 1:
            return np.full(4, np.nan), ""
        found = np.array([np.interp(second, self.seconds, column) for column in self.values.T])
        return found, self.clocks[place]


def read_subtitles(path: Path) -> Telemetry | None:
    """What a video's subtitles tell of positions; None where they tell none. Raises PhotoError for a file that cannot
    be read."""
    try:
        text = read_bytes(path, MOST_BYTES).decode("utf-8", errors="replace")
    except (OSError, ValueError) as error:
        raise PhotoError(Text("{} cannot be read ({}).", shown(path), Text(str(error))),
                         remedy="Copy it from the drone again.",
                         path=path) from error
    return telemetry(text)


def telemetry(text: str) -> Telemetry | None:
    """What the text of an .SRT tells of positions; None where it tells none."""
    seconds, values, clocks, focal = [], [], [], None
    for block in re.split(r"\n\s*\n", text.replace("\r", "")):
        if (span := _SPAN.search(block)) is None:
            continue
        hours, minutes, whole, part = (float(number) for number in span.groups())
        latitude, longitude = _number(_LATITUDE, block), _number(_LONGITUDE, block)
        if (gps := _GPS.search(block)) is not None:
            longitude, latitude = float(gps[1]), float(gps[2])
        if not (abs(latitude) <= 90 and abs(longitude) <= 180) or (latitude == 0 and longitude == 0):
            continue
        seconds.append(3600 * hours + 60 * minutes + whole + part / 10 ** len(span[4]))
        values.append([latitude, longitude, _number(_ABSOLUTE, block), _number(_RELATIVE, block)])
        clock = _CLOCK.search(block)
        year, month, day, hour, minute, second = clock.groups() if clock else ("",) * 6
        clocks.append(f"{year}:{month:0>2}:{day:0>2} {hour:0>2}:{minute}:{second}" if clock else "")
        told = _number(_FOCAL, block)
        focal = focal or next((length for length in (told, told / 10) if 10 <= length <= 200), None)
    if len(seconds) < 2:
        return None
    order = np.argsort(seconds, kind="stable")
    return Telemetry(np.array(seconds)[order], np.array(values)[order], tuple(clocks[n] for n in order), focal)


def _number(pattern: re.Pattern[str], text: str) -> float:
    found = pattern.search(text)
    return float(found[1]) if found else float("nan")
