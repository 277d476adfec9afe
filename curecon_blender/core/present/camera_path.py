# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera moves: for each frame a place (3,) and a world_from_camera quaternion (w, x, y, z).

Cameras look along their -z with y up, as Blender's do. Places are in the scene's units; angles in degrees, clockwise
from +Y as a compass has them. Quaternions keep their sign from frame to frame, so that they can be interpolated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..base.rotations import to_quaternions

FINE = 4000  # samples of a flight before it is cut into frames
SMOOTHING = 1.2  # standard deviation, in mean distances between photos
STEEP = 0.5  # of a normal's z: what is steeper is a wall
DIRECTIONS = 24  # from which a building is looked at
CLEARLY = 0.8  # of the wall that shows from the best side: with so much, the preferred one stays
SLOWEST = 0.5  # a turn counts as half the way that the flight covers, on average, while it turns as far


@dataclass(frozen=True, kw_only=True)
class CameraPath:
    """`places` (F,3) and `rotations` (F,4), one a frame."""

    places: np.ndarray
    rotations: np.ndarray


def walled_side(
    places: np.ndarray, normals: np.ndarray, areas: np.ndarray, middle: np.ndarray, preferred: float
) -> float:
    """From which azimuth about `middle` (3,) most outer wall shows, of faces at `places` (n,3) with unit `normals`
    (n,3) and `areas` (n,); the preferred one where another shows hardly more."""
    outer = ((places - middle)[:, :2] * normals[:, :2]).sum(axis=1) > 0
    wall = outer & (np.abs(normals[:, 2]) < STEEP)
    azimuths = preferred + 360 / DIRECTIONS * np.arange(DIRECTIONS)
    towards = np.stack([np.sin(np.radians(azimuths)), np.cos(np.radians(azimuths))])
    shown = areas[wall] @ np.maximum(normals[wall, :2] @ towards, 0)
    best = int(shown.argmax())
    return float(azimuths[0 if shown[0] >= CLEARLY * shown[best] else best] % 360)


def orbit(
    centre: np.ndarray, distance: float, height: float, start: float, frames: int
) -> CameraPath:
    """Once around `centre` (3,), clockwise from above, `height` above it; its last frame is one step before its first,
    so that the film loops."""
    angles = np.radians(start + 360 * np.arange(frames) / frames)
    places = centre + np.stack([distance * np.sin(angles), distance * np.cos(angles), np.full(frames, height)], axis=1)
    return CameraPath(places=places, rotations=look_at(places, centre))


def crane(
    centre: np.ndarray, distance: float, low: float, high: float, start: float, frames: int
) -> CameraPath:
    """Up on one side of `centre` (3,), from `low` to `high` above it, always looking at it; begins and ends gently."""
    eased = np.linspace(0, 1, frames)
    eased = eased * eased * (3 - 2 * eased)
    side = np.radians(start)
    heights = low + (high - low) * eased
    places = centre + np.stack(
        [np.full(frames, distance * np.sin(side)), np.full(frames, distance * np.cos(side)), heights], axis=1
    )
    return CameraPath(places=places, rotations=look_at(places, centre))


def fly_through(places: np.ndarray, rotations: np.ndarray, frames: int) -> CameraPath:
    """A smooth flight along cameras `places` (N,3), `rotations` (N,4), N > 1, from the first to the last.

    The speed is the same all along, except where the view turns more than twice as fast as on average: there the
    flight slows down, and where it turns on the spot it waits. Raises ValueError when all cameras are one.
    """
    rotations = continuous(rotations / np.linalg.norm(rotations, axis=1, keepdims=True))
    steps, turns = _steps(places, rotations)
    if steps.sum() <= 0:
        raise ValueError("the cameras do not move")
    even = _resample(np.column_stack([places, rotations]), _pace(steps, turns), FINE)
    sigma = SMOOTHING * FINE / max(len(places) - 1, 1)
    smooth = _smoothed(even, min(sigma, FINE / 6))
    smooth[:, 3:] /= np.linalg.norm(smooth[:, 3:], axis=1, keepdims=True)
    result = _resample(smooth, _pace(*_steps(smooth[:, :3], smooth[:, 3:])), frames)
    return CameraPath(
        places=result[:, :3], rotations=result[:, 3:] / np.linalg.norm(result[:, 3:], axis=1, keepdims=True)
    )


def look_at(places: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Quaternions (F,4) of level cameras at `places` (F,3) that look at `target`; straight down, +Y is up."""
    back = places - target
    back = back / np.linalg.norm(back, axis=1, keepdims=True)
    right = np.cross([0.0, 0.0, 1.0], back)
    length = np.linalg.norm(right, axis=1, keepdims=True)
    right = np.where(length > 1e-6, right / np.maximum(length, 1e-6), [1.0, 0.0, 0.0])
    return continuous(to_quaternions(np.stack([right, np.cross(back, right), back], axis=2)))


def continuous(rotations: np.ndarray) -> np.ndarray:
    """The same rotations (F,4), each with the sign that is nearer to the one before."""
    flips = np.sum(rotations[1:] * rotations[:-1], axis=1) < 0
    signs = np.concatenate([[1.0], np.cumprod(np.where(flips, -1.0, 1.0))])
    result: np.ndarray = rotations * signs[:, None]
    return result


def _steps(places: np.ndarray, rotations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances and angles (N-1,) from each camera to the next."""
    cosines = np.abs(np.sum(rotations[1:] * rotations[:-1], axis=1)).clip(0, 1)
    return np.linalg.norm(np.diff(places, axis=0), axis=1), 2 * np.arccos(cosines)


def _pace(steps: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """When (N,), from 0 to 1, a flight at constant speed comes to each camera, with time for its turns."""
    worth = SLOWEST * steps.sum() / turns.sum() if turns.sum() > 1e-9 else 0.0
    times = np.concatenate([[0.0], np.cumsum(np.maximum(steps, worth * turns))])
    result: np.ndarray = times / times[-1]
    return result


def _resample(rows: np.ndarray, times: np.ndarray, count: int) -> np.ndarray:
    """`rows` (N,C), at `times` (N,) from 0 to 1, at `count` even times."""
    even = np.linspace(0, 1, count)
    return np.stack([np.interp(even, times, column) for column in rows.T], axis=1)


def _smoothed(rows: np.ndarray, sigma: float) -> np.ndarray:
    """Gaussian along the rows; beyond its ends the path goes on as its mirror image, so that they stay in place."""
    reach = min(int(3 * sigma), len(rows) - 1)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    kernel /= kernel.sum()
    ahead, behind = 2 * rows[0] - rows[reach:0:-1], 2 * rows[-1] - rows[-2 : -reach - 2 : -1]
    padded = np.concatenate([ahead, rows, behind])
    return np.stack([np.convolve(column, kernel, mode="valid") for column in padded.T], axis=1)
