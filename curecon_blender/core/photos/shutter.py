# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Photos that moved while they were read out: a rolling shutter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..base.records import Photo

# Seconds in which a picture is read out row by row, by what the camera's name holds, as users have measured them; none
# for those that take all rows at once (a mechanical or global shutter).
_READOUTS = {
    "MAVIC2-ENTERPRISE-ADVANCED": 0.031, "L2D-20C": 0.0166, "L1D-20C": 0.056, "FC300": 0.033, "FC330": 0.033,
    "FC350": 0.030, "FC3170": 0.027, "FC3411": 0.032, "FC3582": 0.026, "FC3682": 0.023, "FC7203": 0.020,
    "FC8482": 0.016,
    "FC6310": 0.0, "FC6360": 0.0, "FC6510": 0.0, "FC6520": 0.0, "FC550": 0.0, "M3E": 0.0, "ZENMUSEP1": 0.0,
}
_USUAL_READOUT = 0.030
_LARGE, _LARGE_READOUT = 30e6, 0.060  # pixels of a picture of the FC3582 from where on its readout takes longer
MOST_SHIFT = 1.0  # pixels
# Seconds between two photos: fewer, EXIF's whole seconds tell no speed; in more, a drone may have stopped for each.
LEAST_INTERVAL, MOST_INTERVAL = 1.0, 3.0


def speeds(photos: Sequence[Photo], centres: np.ndarray) -> list[float | None]:
    """Metres a second of the drone at each photo: as it tells, else from the places `centres` (N,3), metres, of the
    photos before and after it, where these follow so fast that it cannot have stopped; None where nothing tells."""
    times = {n: time for n, photo in enumerate(photos) if (time := photo.clock) is not None}
    order = sorted(times, key=times.__getitem__)
    found = [photo.speed for photo in photos]
    for before, n, after in zip(order, order[1:], order[2:], strict=False):
        seconds = (times[after] - times[before]).total_seconds()
        if found[n] is None and LEAST_INTERVAL <= seconds / 2 <= MOST_INTERVAL:
            found[n] = float(np.linalg.norm(centres[after] - centres[before])) / seconds
    return found


def shutter_shift(
    photos: Sequence[Photo], centres: np.ndarray, focal: np.ndarray, above: np.ndarray
) -> float | None:
    """Pixels (median) by which the ground moved in the photos between their first and last row; None where no speed is
    known. `centres` (N,3) in metres, `focal` (N,) in pixels, `above` (N,) metres from the cameras to what they see."""
    shifts = []
    for photo, speed, f, distance in zip(photos, speeds(photos, centres), focal, above, strict=True):
        if speed is not None and distance > 0:
            shifts.append(speed * _readout(photo) * f / distance)
    return float(np.median(shifts)) if shifts else None


def _readout(photo: Photo) -> float:
    """Seconds."""
    name = next((name for name in _READOUTS if name in photo.camera.upper()), "")
    if name == "FC3582" and photo.width * photo.height > _LARGE:
        return _LARGE_READOUT
    return _READOUTS.get(name, _USUAL_READOUT)
