# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How much neighbouring photos overlap, as far as their metadata tells, before anything has been matched.

The site is taken for a plane at take-off height. What a photo shares with another is the part of its picture whose
ground the other sees too, from a direction near enough to be matched; for photos taken straight down that is the
overlap of their footprints.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..base import rotations
from ..base.geodesy import gps_enu
from ..base.records import Photo

WEAK = 0.6  # below it a photo shares too little with its best neighbour for a point to be seen three times
NEIGHBOURS = 24  # nearest photos that one is compared with
TOLD_BY = 0.9  # share of the photos whose metadata must tell: the others' gaps would pass for gaps in the flight
LOWEST = 10.0  # degrees below the horizon: flatter rays meet the ground far behind the site
ON_GROUND = 0.25  # share of a photo that must see the ground for it to be compared
WIDEST_ANGLE = 35.0  # degrees between the rays to a point beyond which features seldom match
ACROSS = 0.5  # cosine: a neighbour lies to the side when it stands at more than 60 degrees to the line of flight
_GRID = 20, 15  # rays a photo


@dataclass(frozen=True, kw_only=True)
class Overlap:
    """Shares in [0, 1], medians over the photos; None where they are unknown, for the reason in `unknown`."""

    forward: float | None = None  # with the photo taken before or after, whichever shares more
    side: float | None = None  # with the best photo to the side of the line of flight; None for a single line, too
    weak: tuple[str, ...] = ()  # photos that share less than WEAK with every other
    unknown: str = ""  # what the metadata does not tell, in words


def estimate(photos: tuple[Photo, ...]) -> Overlap:
    """The overlap of photos in any order, from their GPS, height above take-off, gimbal angles and focal lengths."""
    missing = {
        "GPS": sum(photo.gps is None for photo in photos),
        "the height above take-off": sum((photo.relative_altitude or 0) <= 0 for photo in photos),
        "the camera's angles": sum(photo.gimbal is None for photo in photos),
        "the focal length": sum(photo.focal_px is None for photo in photos),
    }
    if lacking := [what for what, count in missing.items() if count > (1 - TOLD_BY) * len(photos)]:
        return Overlap(unknown=" and ".join([", ".join(lacking[:-1]), lacking[-1]] if lacking[1:] else lacking))
    in_order = sorted(photos, key=lambda photo: photo.time or "")
    footprints = [footprint for photo in in_order if (footprint := _Footprint.of(photo))]
    if len(footprints) < 2:
        return Overlap(unknown="photos that see the ground")
    positions, _ = gps_enu([footprint.photo for footprint in footprints])
    for footprint, position in zip(footprints, positions, strict=True):
        footprint.place(position)
    return _summary(footprints, positions)


def _summary(footprints: list[_Footprint], positions: np.ndarray) -> Overlap:
    count = len(footprints)
    order = np.arange(count)
    heading = positions[np.minimum(order + 1, count - 1), :2] - positions[np.maximum(order - 1, 0), :2]
    forward, side, weak = [], [], []
    for i, footprint in enumerate(footprints):
        apart = positions[:, :2] - positions[i, :2]
        distances = np.linalg.norm(apart, axis=1)
        beside = {j for j in (i - 1, i + 1) if 0 <= j < count}
        near = {int(j) for j in np.argsort(distances)[: NEIGHBOURS + 1] if j != i} | beside
        shares = {j: footprint.shared_with(footprints[j]) for j in near}
        forward.append(max(shares[j] for j in beside))
        lengths = distances * np.linalg.norm(heading[i])
        across = [shares[j] for j in near - beside if abs(apart[j] @ heading[i]) < ACROSS * lengths[j]]
        side.append(max(across, default=0.0))
        if max(shares.values()) < WEAK:
            weak.append(footprint.photo.name)
    beside_others = [share for share in side if share > 0]
    return Overlap(
        forward=float(np.median(forward)),
        side=float(np.median(beside_others)) if len(beside_others) > count / 2 else None, weak=tuple(sorted(weak)),
    )


class _Footprint:
    """A photo with the ground that it sees: `ground` (G,3) where its rays meet the plane of the take-off."""

    def __init__(self, photo: Photo, focal: float, height: float, rotation: np.ndarray, rays: np.ndarray) -> None:
        self.photo, self._focal, self._height, self._rotation, self._rays = photo, focal, height, rotation, rays

    @classmethod
    def of(cls, photo: Photo) -> _Footprint | None:
        """None where the metadata does not tell, or the photo hardly sees the ground."""
        if photo.gps is None or photo.gimbal is None or not photo.focal_px or (photo.relative_altitude or 0) <= 0:
            return None
        columns, rows = _GRID
        x = (np.arange(columns) + 0.5) / columns - 0.5
        y = (np.arange(rows) + 0.5) / rows - 0.5
        u, v = np.meshgrid(x * photo.width / photo.focal_px, y * photo.height / photo.focal_px)
        rotation = rotations.from_gimbal(photo.gimbal)
        rays = np.stack([u.ravel(), v.ravel(), np.ones(u.size)], axis=1) @ rotation.T
        down = -rays[:, 2] > np.sin(np.radians(LOWEST)) * np.linalg.norm(rays, axis=1)
        if down.mean() < ON_GROUND:
            return None
        return cls(photo, photo.focal_px, photo.relative_altitude or 0.0, rotation, rays[down])

    def place(self, position: np.ndarray) -> None:
        """Stand it at `position` (3,), of which only east and north count: the height is that above take-off."""
        self._centre = np.array([position[0], position[1], self._height])
        self.ground = self._centre + self._rays * (self._height / -self._rays[:, 2])[:, None]

    def shared_with(self, other: _Footprint) -> float:
        """The share of this photo's ground that the other sees from much the same direction."""
        rays = self.ground - other._centre
        x, y, z = (rays @ other._rotation).T
        lengths = np.linalg.norm(rays, axis=1) * np.linalg.norm(self._rays, axis=1)
        alike = (rays * self._rays).sum(axis=1) > np.cos(np.radians(WIDEST_ANGLE)) * lengths
        half = 0.5 * other.photo.width / other._focal, 0.5 * other.photo.height / other._focal
        seen = alike & (z > 0) & (np.abs(x) < half[0] * z) & (np.abs(y) < half[1] * z)
        return float(seen.mean())
