# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a flight is planned from, and what a plan is. The frame is local: metres east, north and up, 0 on the ground at
the building; headings in degrees clockwise from north, pitch -90 straight down."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..base.records import GeoPosition
from .drones import Drone
from .obstacles import Heights
from .wishes import Wishes


@dataclass(frozen=True, kw_only=True)
class Building:
    """What is to be recorded. `outline` (N,2) and `court` (M,2), if there is one, are simple polygons, `height` is
    that of its highest part and `eaves` that of its walls, in metres above the ground. `origin` is where 0, 0 lies on
    Earth, if that is known. `obstacles` are heights of all that stands there, the building among them."""

    outline: np.ndarray
    height: float
    eaves: float
    obstacles: Heights
    court: np.ndarray | None = None
    origin: GeoPosition | None = None


@dataclass(frozen=True, kw_only=True)
class Leg:
    """Photos of one kind in the order in which they are taken: `places` (N,3), `headings` (N,), `pitches` (N,), and
    `distance` in metres to what they show. `words` say in a sentence where each is taken, where that was asked for."""

    name: str
    places: np.ndarray
    headings: np.ndarray
    pitches: np.ndarray
    distance: float
    words: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.places)


@dataclass(frozen=True, kw_only=True)
class Waypoint:
    """A place on the way, with a photo or without."""

    place: tuple[float, float, float]
    heading: float
    pitch: float
    photo: bool
    leg: str


@dataclass(frozen=True, kw_only=True)
class Flight:
    """What is flown in one mission of the app, on one battery, without the way from take-off and back, which the
    minutes and metres include."""

    waypoints: tuple[Waypoint, ...]
    metres: float
    minutes: float

    @property
    def photos(self) -> int:
        return sum(waypoint.photo for waypoint in self.waypoints)


@dataclass(frozen=True, kw_only=True)
class Plan:
    """A planned record of a building: its legs, the flights that they are flown in, and what a person must know."""

    kind: str
    drone: Drone
    building: Building
    wishes: Wishes
    legs: tuple[Leg, ...]
    flights: tuple[Flight, ...]
    speed: float  # metres a second
    notes: tuple[str, ...] = field(default_factory=tuple)

    @property
    def photos(self) -> int:
        return sum(len(leg) for leg in self.legs)

    @property
    def batteries(self) -> int:
        """That the flights take one after the other: short ones share one."""
        usable, count, left = self.drone.minutes * (1 - self.wishes.kept_back), 0, 0.0
        for flight in self.flights:
            if flight.minutes > left:
                count, left = count + 1, usable
            left -= flight.minutes
        return count
