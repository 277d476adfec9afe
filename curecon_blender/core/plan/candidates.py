# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Places that further photos of a building may be taken from: around it, above it and in its court, all clear of it.
NumPy alone; the frame of records.py."""

from __future__ import annotations

import numpy as np

from .coverage import Eyes, eyes_of
from .drones import Drone
from .forms import LOWEST
from .obstacles import inside
from .outlines import area, around, headings_of, hull, middle
from .records import Building, Leg
from .wishes import Wishes

_NEAR = 0.6  # of the distance that photos were taken from: nearer ones see below eaves
_RAYS_APART = 12.0  # degrees between places around the building
_AROUND, _LOW, _HIGH = (-30.0, 0.0, 30.0), (15.0, 0.0, -20.0), (-20.0, -45.0)  # degrees beside straight on, and up
_ABOVE = (-15.0, -35.0, -60.0)
_ROOF = 10.0  # metres between places above the building
_DIRECTIONS = np.arange(0.0, 360.0, 45.0)


def candidates(building: Building, drone: Drone, wishes: Wishes, distance: float) -> Leg:
    """All places and directions in no order, `distance` being that from which photos were taken so far."""
    found: list[np.ndarray] = []

    def add(places: np.ndarray, headings: np.ndarray, pitch: float) -> None:
        found.append(np.c_[places, headings % 360, np.full(len(places), pitch)])

    top = building.height
    for away in (distance, _NEAR * distance):
        away = max(away, wishes.clearance)
        places, looks = around(building.outline, away, away, _RAYS_APART)
        facing = headings_of(looks)
        for height in (LOWEST, 0.5 * top, top + 1, top + 0.4 * away, top + 0.8 * away):
            level = np.c_[places, np.full(len(places), max(height, LOWEST))]
            for turn in _AROUND:
                for pitch in _LOW if height <= top else _HIGH:
                    add(level, facing + turn, pitch)
    for over, heights in ((building.outline, (top + wishes.clearance, top + 0.6 * distance)),
                          (building.court, (LOWEST + wishes.clearance, 0.6 * top + wishes.clearance))):
        for height in heights if over is not None else ():
            assert over is not None
            places = _within(over, height)
            add(places, np.zeros(len(places)), -90.0)
            for heading in _DIRECTIONS:
                for pitch in _ABOVE:
                    add(places, np.full(len(places), heading), pitch)
    rows = np.concatenate(found)
    rows = rows[(rows[:, 4] >= drone.pitch[0]) & (rows[:, 4] <= drone.pitch[1]) & (rows[:, 2] <= wishes.top)]
    eyes, index = np.unique(rows[:, :3], axis=0, return_inverse=True)
    clear = building.obstacles.clearance(eyes, wishes.clearance) >= wishes.clearance - 1e-6
    rows = rows[clear[index.ravel()]]
    return Leg(name="Gaps", places=rows[:, :3], headings=rows[:, 3], pitches=rows[:, 4], distance=distance)


def seeing(leg: Leg, drone: Drone) -> Eyes:
    return eyes_of(drone, leg.places, leg.headings, leg.pitches)


def _within(outline: np.ndarray, height: float) -> np.ndarray:
    """Places (N,3) in a polygon, its middle among them."""
    corners, centre = hull(outline), middle(hull(outline))
    reach = float(np.sqrt(abs(area(corners))))
    steps = np.arange(-np.ceil(reach / _ROOF), np.ceil(reach / _ROOF) + 1) * _ROOF
    x, y = np.meshgrid(steps, steps)
    places = centre + np.stack([x.ravel(), y.ravel()], axis=1)
    places = places[inside(places, corners)]
    return np.c_[places, np.full(len(places), height)]
