# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether heights can be trusted: a dome against what is known of the heights of cameras and control points, and a
focal length that the flight leaves open."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..base.records import Photo
from .record import Dome

GPS, RELATIVE_ALTITUDE = "the photos' GPS", "the photos' height above take-off"
CONTROL = "the control points"
FEWEST, FEWEST_POINTS = 8, 5  # photos, and control points, that can show a dome
NARROWEST = 0.1  # spread across a flight over that along it; a narrower one shows none
# Metres up to which a receiver without RTK, or a barometer during one flight, may bend what is level; and of the height
# above the ground.
_GPS_LIMIT, _BAROMETER_LIMIT, _LIMIT_SHARE = 0.1, 0.3, 0.01
_DRIFT = 2.0  # by which errors that change slowly from photo to photo make a dome likelier than their scatter says
_SURE = 3.0  # sigmas
_SINGULAR = 1e6  # condition from where on points tell no dome
_LIKELY = 2.0  # sigmas: what a person takes "up to" for
_TOLD = 3.0  # stated sigmas, at least pixels on the ground, up to which points and positions may bend what is level
DOUBTFUL_SHARE = 0.01  # of heights; a focal length that is less sure makes them doubtful
REMEDY = "Photos that look askew from all sides, a second flight height, or control points settle it."


def domes(photos: Sequence[Photo], centres: np.ndarray, gps_heights: np.ndarray, above: float) -> tuple[Dome, ...]:
    """What the cameras' `centres` (N,3) in the frame tell of a dome against their GPS, whose heights `gps_heights` (N,)
    in the frame are nan where it tells none, and against their height above take-off; `above` is their usual height
    above the ground, all in metres."""
    stated, limit = [photo.gps_sigmas[1] for photo in photos if photo.gps_sigmas is not None], _GPS_LIMIT
    if len(stated) > len(photos) / 2:  # the others' heights may count from another level
        limit = _TOLD * float(np.median(stated))
        gps_heights = np.where([photo.gps_sigmas is None for photo in photos], np.nan, gps_heights)
    relative = np.array([np.nan if p.relative_altitude is None else p.relative_altitude for p in photos], float)
    found = (
        _dome(GPS, centres, gps_heights, limit),
        _dome(RELATIVE_ALTITUDE, centres, relative, max(_BAROMETER_LIMIT, _LIMIT_SHARE * above)),
    )
    return tuple(dome for dome in found if dome is not None)


def control_dome(plan: np.ndarray, off: np.ndarray, sigmas: np.ndarray, pixel: float) -> Dome | None:
    """What control points at `plan` (C,2) tell of a dome, whose heights, known to `sigmas` (C,), the model has `off`
    (C,); `pixel` is a photo's on the ground, all in metres. Each counts by its sigma: of so few, none can be called an
    outlier."""
    design = _paraboloid(plan) if len(off) >= FEWEST_POINTS else None
    if design is None:
        return None
    sigmas = np.maximum(sigmas, pixel)
    system = design.T @ (sigmas[:, None] ** -2 * design)
    if np.linalg.cond(system) > _SINGULAR:  # all of them lie equally far from the middle
        return None
    inverse = np.linalg.inv(system)
    bend = inverse @ design.T @ (sigmas**-2 * off)
    return Dome(source=CONTROL, bend=float(bend[3]), sigma=float(np.sqrt(inverse[3, 3])),
                limit=_TOLD * float(np.median(sigmas)))


def _paraboloid(plan: np.ndarray) -> np.ndarray | None:
    """(N,4) of places in plan (N,2): level, two slopes, and the square of the distance from their middle, 1 at their
    edge. None where they lie in a line."""
    plan = plan - np.median(plan, axis=0)
    spread = np.linalg.svd(plan - plan.mean(axis=0), compute_uv=False)
    squared = (plan**2).sum(axis=1)
    if not spread[1] > NARROWEST * spread[0]:
        return None
    return np.column_stack([np.ones(len(plan)), plan / np.sqrt(squared.max()), squared / squared.max()])


def _dome(source: str, centres: np.ndarray, heights: np.ndarray, limit: float) -> Dome | None:
    """The quadratic term of the cameras' heights over what they are known to be, by the distance from the middle."""
    known = np.isfinite(heights)
    design = _paraboloid(centres[known, :2]) if known.sum() >= FEWEST else None
    if design is None:
        return None
    off = centres[known, 2] - heights[known]
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


def doubt(found: Sequence[Dome], focal_sigma: float | None, scale_sigma: float = 0.0) -> str:
    """Why heights are doubtful, in one sentence for the user; empty where they are not. `focal_sigma` is the share by
    which the adjustment leaves a focal length open, and the cameras' height with it; where it does, that of the site's
    scale, `scale_sigma`, adds to it."""
    bent = max((dome for dome in found if is_bent(dome)), key=lambda dome: abs(dome.bend), default=None)
    if bent is not None:
        way = "raised" if bent.bend < 0 else "lowered"
        return (f"Heights are doubtful: the model's middle is {way} against its edge by {abs(bent.bend):.2f} m, by "
                f"{bent.source}.")
    share = math.hypot(focal_sigma or 0.0, scale_sigma)
    if focal_sigma is not None and focal_sigma > DOUBTFUL_SHARE / 2 and share > DOUBTFUL_SHARE:
        return (f"Heights are doubtful: those above the ground may be off by up to {100 * _LIKELY * share:.0f} %, "
                "since these photos do not tell the focal length from the height.")
    return ""
