# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the photos were taken and what ground they show, by their metadata alone: a first look at a flight, before
anything is matched.

The ground is taken for a plane at take-off height.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..base import rotations
from ..base.geodesy import gps_enu
from ..base.records import Photo

LOWEST = 12.0  # degrees below the horizon: a corner that looks flatter is drawn as far away as this one would be


def describe(photos: tuple[Photo, ...]) -> list[dict[str, Any]]:
    """Of each photo with GPS, in the order of capture: its name, its `place` (3,) in metres east and north of the
    photos' middle and above take-off (above the lowest photo where that is not told), and the four corners of its
    `ground` as eight numbers, None where the metadata do not tell or it looks at the sky."""
    with_gps = [photo for photo in photos if photo.gps is not None]
    placed = sorted(with_gps, key=lambda photo: (photo.time or "", photo.name))
    if not placed:
        return []
    positions, _ = gps_enu(placed)
    lowest = positions[:, 2].min()
    found = []
    for photo, (east, north, up) in zip(placed, positions, strict=True):
        height = photo.relative_altitude or 0.0
        ground = _ground(photo)
        found.append({
            "name": photo.name,
            "place": [round(float(number), 2) for number in (east, north, height if height > 0 else up - lowest)],
            "ground": None if ground is None else
            [round(float(number), 2) for number in (ground + (east, north)).ravel()],
        })
    return found


def _ground(photo: Photo) -> np.ndarray | None:
    """The ground (4,2) that its corners see, in metres east and north of the photo."""
    height = photo.relative_altitude or 0.0
    if photo.gimbal is None or not photo.focal_px or height <= 0:
        return None
    x, y = 0.5 * photo.width / photo.focal_px, 0.5 * photo.height / photo.focal_px
    rotation = rotations.from_gimbal(photo.gimbal)
    if rotation[2, 2] > -np.sin(np.radians(LOWEST)):  # its middle looks level, or up
        return None
    rays = np.array([[-x, -y, 1.0], [x, -y, 1.0], [x, y, 1.0], [-x, y, 1.0]]) @ rotation.T
    level = np.linalg.norm(rays[:, :2], axis=1)
    down = np.maximum(-rays[:, 2], level * np.tan(np.radians(LOWEST)))
    ground: np.ndarray = rays[:, :2] * (height / down)[:, None]
    return ground
