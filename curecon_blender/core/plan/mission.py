# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""From a building and wishes to a plan: the legs for its kind, kept clear of everything, cut into flights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..base.errors import PlanError
from ..base.language import Text
from . import forms
from .drones import Drone
from .obstacles import along
from .outlines import area, hull
from .records import Building, Flight, Leg, Plan, Waypoint
from .wishes import Wishes

SPEED = 5.0  # metres a second between photos
HOLD = 2.5  # seconds for a photo: to stop, hang still and go on
CLIMB = 3.0  # metres a second, up and down
CLOSEST = 0.5  # metres between two waypoints
LEAST_SIZE = 2.0  # metres across, of an outline
RAISED_BY = 0.5  # metres, until a photo's place is clear
MOST_LATITUDE = 85.0  # headings mean little nearer to a pole

Form = Callable[[Building, Drone, Wishes], list[Leg]]


def _building(building: Building, drone: Drone, wishes: Wishes) -> list[Leg]:
    distance = drone.distance_for(wishes.pixel)
    view = drone.footprint(distance)[1]
    high = max(building.eaves, forms.LOWEST) + 2
    low = high if high < 0.5 * view else min(max(forms.LOWEST, 0.4 * view), high)
    return [*forms.orbits(building, drone, wishes, low, high), forms.high_orbit(building, drone, wishes),
            forms.grid(building, drone, wishes)]


def _tower(building: Building, drone: Drone, wishes: Wishes) -> list[Leg]:
    distance = drone.distance_for(wishes.pixel)
    low = max(forms.LOWEST, 0.4 * drone.footprint(distance)[1])
    return [*forms.orbits(building, drone, wishes, min(low, building.height), building.height),
            forms.high_orbit(building, drone, wishes, aim=building.height), forms.grid(building, drone, wishes)]


def _helix(building: Building, drone: Drone, wishes: Wishes) -> list[Leg]:
    return [forms.helix(building, drone, wishes, forms.LOWEST + 2, building.height),
            forms.high_orbit(building, drone, wishes, aim=building.height)]


def _crossed(building: Building, drone: Drone, wishes: Wishes) -> list[Leg]:
    direction = forms.longest_direction(building.outline)
    return [forms.grid(building, drone, wishes, direction=direction),
            forms.grid(building, drone, wishes, direction=direction + 90, name="Straight down, crossing")]


def _tulou(building: Building, drone: Drone, wishes: Wishes) -> list[Leg]:
    if building.court is None:
        raise PlanError("A ring needs its court.", remedy="Draw the court's outline too, or choose another kind of "
                        "building.")
    return [*_building(building, drone, wishes), *forms.court(building, drone, wishes)]


# By the word that a person chooses, as in wishes.KINDS.
FORMS: dict[str, Form] = {
    "building": _building,
    "tulou": _tulou,
    "tower": _tower,
    "facade": lambda building, drone, wishes: [*forms.facade(building, drone, wishes),
                                               forms.grid(building, drone, wishes)],
    "courtyard": lambda building, drone, wishes: [
        forms.grid(building, drone, wishes), *forms.oblique_grids(building, drone, wishes)],
    "ruin": lambda building, drone, wishes: [
        *forms.oblique_grids(building, drone, wishes), *forms.facade(building, drone, wishes)],
    "grid": lambda building, drone, wishes: [forms.grid(building, drone, wishes)],
    "crossed": _crossed,
    "orbit": lambda building, drone, wishes: [
        forms.orbit(building, drone, wishes, max(building.height, forms.LOWEST) + wishes.clearance)],
    "helix": _helix,
}


def plan(kind: str, building: Building, drone: Drone, wishes: Wishes) -> Plan:
    """The whole plan.

    Raises PlanError where the building is no area, the ceiling leaves no room, the battery does not reach, or so many
    photos would be needed that a number must be wrong.
    """
    _check(building, wishes)
    notes: list[str] = []
    legs = []
    for leg in FORMS[kind](building, drone, wishes):
        legs.append(_clear(_within_gimbal(leg, drone, notes), building, wishes, notes))
    coarse = [leg for leg in legs if drone.pixel_at(leg.distance) > 1.5 * wishes.pixel]
    for leg in coarse:
        notes.append(f"{leg.name}: a pixel covers {drone.pixel_at(leg.distance):.0f} mm there, since the drone cannot "
                     "come nearer.")
    return of_legs(kind, legs, building, drone, wishes, notes)


def of_legs(kind: str, legs: list[Leg], building: Building, drone: Drone, wishes: Wishes, notes: list[str]) -> Plan:
    """The plan that flies legs whose photos are taken clear of everything, as they are.

    Raises PlanError where a battery does not reach.
    """
    if wishes.takeoff[2]:
        notes.append(f"Heights in the files count from take-off, which lies {abs(wishes.takeoff[2]):.1f} m "
                     f"{'above' if wishes.takeoff[2] > 0 else 'below'} the ground at the building.")
    else:
        notes.append("Heights in the files count from take-off. Take off from ground as high as the building's.")
    return Plan(kind=kind, drone=drone, building=building, wishes=wishes, legs=tuple(legs),
                flights=_flights(legs, building, drone, wishes), speed=SPEED, notes=tuple(notes))


def _check(building: Building, wishes: Wishes) -> None:
    corners = hull(building.outline) if len(building.outline) >= 3 else building.outline
    if len(corners) < 3 or abs(area(corners)) < LEAST_SIZE**2:
        raise PlanError("The outline is no area.", remedy=Text("Draw it around the building, {:.0f} m across or "
                                                               "more.", LEAST_SIZE))
    if building.origin is not None and abs(building.origin.latitude) > MOST_LATITUDE:
        raise PlanError(Text("The site lies at latitude {:.1f}, too near to a pole for headings.",
                             building.origin.latitude),
                        remedy="Check the position; latitude comes first.")
    room = wishes.top - building.obstacles.highest
    if room < wishes.clearance:
        raise PlanError(
            Text("The ceiling of {:.0f} m above take-off leaves {:.0f} m above the highest thing on the site, less "
                 "than the clearance of {:.0f} m.", wishes.ceiling, max(room, 0), wishes.clearance),
            remedy="Raise the ceiling if the law allows it, take off from higher ground, or allow less clearance.")


def _within_gimbal(leg: Leg, drone: Drone, notes: list[str]) -> Leg:
    pitches = np.clip(leg.pitches, *drone.pitch)
    turned = float(np.abs(pitches - leg.pitches).max(initial=0.0))
    if turned > 0.5:
        notes.append(f"{leg.name}: the gimbal stops {turned:.0f} degrees before the angle that is best.")
    return replace(leg, pitches=pitches)


def _clear(leg: Leg, building: Building, wishes: Wishes, notes: list[str]) -> Leg:
    """A leg whose photos are all taken clear of everything: places are raised, and look at the same spot from there."""
    places, pitches = leg.places.copy(), leg.pitches.copy()
    near = building.obstacles.clearance(places, wishes.clearance) < wishes.clearance - 1e-6
    raised = near.copy()
    while near.any():
        places[near, 2] += RAISED_BY
        near &= places[:, 2] <= wishes.top
        near[near] = building.obstacles.clearance(places[near], wishes.clearance) < wishes.clearance - 1e-6
    fits = places[:, 2] <= wishes.top + 1e-6
    if not fits.any():
        raise PlanError(Text("{}: no photo of it can be taken {:.0f} m clear of everything and below {:.0f} m.",
                             Text(leg.name), wishes.clearance, wishes.ceiling),
                             remedy="Raise the ceiling or allow less clearance.")
    if raised.any():
        slant = leg.distance * np.cos(np.radians(pitches))
        drop = -leg.distance * np.sin(np.radians(pitches)) + places[:, 2] - leg.places[:, 2]
        pitches = np.where(raised, -np.degrees(np.arctan2(drop, slant)), pitches)
        notes.append(f"{leg.name}: {int((raised & fits).sum())} of {len(leg)} photos are taken from higher up to stay "
                     "clear"
                     + (f", and {int((~fits).sum())} are left out" if not fits.all() else "") + ".")
    return replace(leg, places=places[fits], headings=leg.headings[fits], pitches=pitches[fits])


def _flights(legs: list[Leg], building: Building, drone: Drone, wishes: Wishes) -> tuple[Flight, ...]:
    """The legs one after the other, cut where a battery or the app's list of waypoints is full."""
    cruise = min(max(building.obstacles.highest + wishes.clearance, *(leg.places[:, 2].max() for leg in legs)),
                 wishes.top)
    home = np.array([wishes.takeoff[0], wishes.takeoff[1], cruise])
    usable = drone.minutes * (1 - wishes.kept_back)
    stops = [Waypoint(place=tuple(place), heading=float(heading), pitch=float(pitch), photo=True, leg=leg.name)
             for leg in legs for place, heading, pitch in zip(leg.places, leg.headings, leg.pitches, strict=True)]
    flights, current = [], list[Waypoint]()
    for stop in stops:
        tried = [*current, *_way(current[-1] if current else None, stop, home, cruise, building, wishes), stop]
        flight = _flown([*tried, *_back(stop, home, cruise)], home, wishes, drone)
        if current and (flight.minutes > usable or len(flight.waypoints) > drone.waypoints):
            flights.append(_flown([*current, *_back(current[-1], home, cruise)], home, wishes, drone))
            tried = [*_way(None, stop, home, cruise, building, wishes), stop]
            flight = _flown([*tried, *_back(stop, home, cruise)], home, wishes, drone)
        if flight.minutes > usable:
            raise PlanError(Text("One battery of this drone does not reach {} and come back.", Text(stop.leg)),
                            remedy="Take off nearer to the building.")
        if len(flight.waypoints) > drone.waypoints:
            raise PlanError(Text("{}: one photo alone takes {} waypoints, more than the {} of the app.", Text(stop.leg),
                                 len(flight.waypoints), drone.waypoints),
                            remedy="Raise the number of waypoints, or fly by hand.")
        current = tried
    flights.append(_flown([*current, *_back(current[-1], home, cruise)], home, wishes, drone))
    return tuple(flights)


def _way(before: Waypoint | None, stop: Waypoint, home: np.ndarray, cruise: float, building: Building,
         wishes: Wishes) -> list[Waypoint]:
    """Waypoints without a photo that lead to a stop: none where the straight way is clear."""
    there = np.array(stop.place)
    if before is not None:
        here = np.array(before.place)
        if building.obstacles.clearance(along(here, there), wishes.clearance).min() >= 0.95 * wishes.clearance:
            return []
        high = [np.array([x, y, cruise]) for x, y, _ in (here, there)]
        high = [place for place in high if not _same(place, here)]
    else:
        high = [home, np.array([there[0], there[1], cruise])]
    return [_passing(place, stop) for place in high if not _same(place, there)]


def _back(last: Waypoint, home: np.ndarray, cruise: float) -> list[Waypoint]:
    above = np.array([last.place[0], last.place[1], cruise])
    return [*([] if _same(above, np.array(last.place)) else [_passing(above, last)]), _passing(home, last)]


def _same(first: np.ndarray, second: np.ndarray) -> bool:
    """Whether two waypoints lie so near to each other that apps refuse them."""
    return bool(np.linalg.norm(first - second) < CLOSEST)


def _passing(place: np.ndarray, stop: Waypoint) -> Waypoint:
    x, y, z = (float(value) for value in place)
    return replace(stop, place=(x, y, z), photo=False)


def _flown(waypoints: list[Waypoint], home: np.ndarray, wishes: Wishes, drone: Drone) -> Flight:
    """A flight with its length and minutes, the climb from take-off and the landing among them."""
    places = np.array([waypoint.place for waypoint in waypoints])
    step = np.diff(places, axis=0)
    metres = float(np.linalg.norm(step, axis=1).sum()) + 2 * (home[2] - wishes.takeoff[2])
    seconds = float(np.maximum(np.linalg.norm(step[:, :2], axis=1) / SPEED, np.abs(step[:, 2]) / CLIMB).sum())
    seconds += 2 * (home[2] - wishes.takeoff[2]) / CLIMB
    seconds += sum(waypoint.photo for waypoint in waypoints) * max(HOLD, drone.interval)
    return Flight(waypoints=tuple(waypoints), metres=metres, minutes=seconds / 60)
