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
class Wishes:
    """How it is to be flown: `pixel` millimetres on the building; overlaps of a photo with the one before and with the
    neighbouring line, 0 to 1; least distance to anything (`clearance`), greatest height above take-off (`ceiling`) and
    the place of take-off, in metres; `above` is the height of grids above the building, in place of the one that
    `pixel` gives; `kept_back` is the share of a battery that is not flown."""

    pixel: float = 10.0
    forward: float = 0.8
    side: float = 0.7
    clearance: float = 5.0
    ceiling: float = 120.0
    takeoff: tuple[float, float, float] = (0.0, 0.0, 0.0)
    above: float | None = None
    kept_back: float = 0.3

    @property
    def top(self) -> float:
        """The greatest height that may be flown, above the ground at the building."""
        return self.takeoff[2] + self.ceiling


@dataclass(frozen=True, kw_only=True)
class Leg:
    """Photos of one kind in the order in which they are taken: `places` (N,3), `headings` (N,), `pitches` (N,), and
    `distance` in metres to what they show."""

    name: str
    places: np.ndarray
    headings: np.ndarray
    pitches: np.ndarray
    distance: float

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
    """What is flown on one battery and in one mission of the app, without the way from take-off and back, which the
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
