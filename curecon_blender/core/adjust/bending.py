# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether heights can be trusted: a dome against what is known of the cameras' heights, a focal length that the flight
leaves open, and photos that moved while they were read out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..base.records import Photo
from .record import Dome

GPS, RELATIVE_ALTITUDE = "GPS", "height above take-off"
FEWEST = 8  # photos that can show a dome
NARROWEST = 0.1  # spread across a flight over that along it; a narrower one shows none
# Metres up to which a receiver without RTK, or a barometer during one flight, may bend what is level; and of the height
# above the ground.
_GPS_LIMIT, _BAROMETER_LIMIT, _LIMIT_SHARE = 0.1, 0.3, 0.01
_DRIFT = 2.0  # by which errors that change slowly from photo to photo make a dome likelier than their scatter says
_SURE = 3.0  # sigmas
DOUBTFUL_SHARE = 0.01  # of heights; a focal length that is less sure makes them doubtful
REMEDY = "Photos that look askew from all sides, a second flight height, or control points settle it."
# Seconds in which a picture is read out row by row, by what the camera's name holds; none for those that take all rows
# at once (a mechanical or global shutter).
_READOUTS = {
    "MAVIC2-ENTERPRISE-ADVANCED": 0.031, "L2D-20C": 0.0166, "FC3682": 0.023, "FC8482": 0.016,
    "FC6310": 0.0, "FC6360": 0.0, "FC6510": 0.0, "FC6520": 0.0, "FC550": 0.0, "M3E": 0.0, "ZENMUSEP1": 0.0,
}
_USUAL_READOUT = 0.030
MOST_SHIFT = 1.0  # pixels


def domes(photos: Sequence[Photo], centres: np.ndarray, gps_heights: np.ndarray, above: float) -> tuple[Dome, ...]:
    """What the cameras' `centres` (N,3) in the frame tell of a dome against their GPS, whose heights `gps_heights` (N,)
    in the frame are nan where it tells none, and against their height above take-off; `above` is their usual height
    above the ground, all in metres."""
    stated = [photo.gps_sigmas[1] for photo in photos if photo.gps_sigmas is not None]
    limit = 3 * float(np.median(stated)) if len(stated) > len(photos) / 2 else _GPS_LIMIT
    relative = np.array([np.nan if p.relative_altitude is None else p.relative_altitude for p in photos], float)
    found = (
        _dome(GPS, centres, gps_heights, limit),
        _dome(RELATIVE_ALTITUDE, centres, relative, max(_BAROMETER_LIMIT, _LIMIT_SHARE * above)),
    )
    return tuple(dome for dome in found if dome is not None)


def _dome(source: str, centres: np.ndarray, heights: np.ndarray, limit: float) -> Dome | None:
    """The quadratic term of the cameras' heights over what they are known to be, by the distance from the middle."""
    known = np.isfinite(heights)
    if known.sum() < FEWEST:
        return None
    plan = centres[known, :2] - np.median(centres[known, :2], axis=0)
    spread = np.linalg.svd(plan - plan.mean(axis=0), compute_uv=False)
    squared = (plan**2).sum(axis=1)
    if not spread[1] > NARROWEST * spread[0]:
        return None
    off = centres[known, 2] - heights[known]
    design = np.column_stack([np.ones(len(off)), plan / np.sqrt(squared.max()), squared / squared.max()])
    weights, scatter = np.ones(len(off)), 0.0
    for _ in range(10):
        system = design.T @ (weights[:, None] * design) + 1e-9 * np.eye(4)
        bend = np.linalg.solve(system, design.T @ (weights * off))
        left = off - design @ bend
        scatter = max(1.4826 * float(np.median(np.abs(left))), 1e-6) * np.sqrt(len(off) / (len(off) - 4))
        weights = 1 / (1 + (left / (2 * scatter)) ** 2)
    sigma = _DRIFT * scatter * float(np.sqrt(np.linalg.inv(system)[3, 3]))
    return Dome(source=source, bend=float(bend[3]), sigma=sigma, limit=limit)


def is_bent(dome: Dome) -> bool:
    """Whether a dome is there for sure, and larger than what it is measured against may be off."""
    return abs(dome.bend) > _SURE * dome.sigma and abs(dome.bend) > dome.limit


def doubt(found: Sequence[Dome], focal_sigma: float | None) -> str:
    """Why heights are doubtful, in one sentence for the user; empty where they are not. `focal_sigma` is the share by
    which the adjustment leaves a focal length open."""
    bent = max((dome for dome in found if is_bent(dome)), key=lambda dome: abs(dome.bend), default=None)
    if bent is not None:
        way = "raised" if bent.bend < 0 else "lowered"
        return (f"Heights are doubtful: the model's middle is {way} against its edge by {abs(bent.bend):.2f} m, by the "
                f"photos' {bent.source}.")
    if focal_sigma is not None and focal_sigma > DOUBTFUL_SHARE:
        return (f"Heights are doubtful: those above the ground may be off by {100 * focal_sigma:.0f} %, since these "
                "photos do not tell the focal length from the height.")
    return ""


def shutter_shift(photos: Sequence[Photo], focal: np.ndarray, above: np.ndarray) -> float | None:
    """Pixels (median) by which the ground moved in the photos between their first and last row; None where no speed is
    known. `focal` (N,) in pixels, `above` (N,) metres from the cameras to what they see."""
    shifts = []
    for photo, f, distance in zip(photos, focal, above, strict=True):
        readout = next((seconds for name, seconds in _READOUTS.items() if name in photo.camera.upper()), _USUAL_READOUT)
        if photo.speed is not None and distance > 0:
            shifts.append(photo.speed * readout * f / distance)
    return float(np.median(shifts)) if shifts else None
