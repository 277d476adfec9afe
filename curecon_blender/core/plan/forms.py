# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The forms that flights are made of: grid, orbit, helix, façade lines, court. Each gives one leg or several."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .drones import Drone
from .outlines import around, heading_vector, headings_of, hull, lines, middle
from .records import Building, Leg
from .wishes import Wishes

MOST_TURN = 12.0  # degrees between neighbouring photos of an orbit: matching fails beyond about 35, and three must see
LOWEST = 3.0  # metres above the ground
OBLIQUE = -45.0
SIDEWARD = 25.0  # degrees that façade lines are turned by, for niches and reveals


def grid(building: Building, drone: Drone, wishes: Wishes, *, direction: float | None = None,
         pitch: float = -90.0, name: str = "Straight down") -> Leg:
    """Lines over the building and what lies about it, the pixel being that on its highest part.

    With a pitch above -90 the camera looks along `direction` (degrees), and the lines lie as far back as it looks
    ahead. Lines run along the building's longer side where no direction is given.
    """
    distance = wishes.above if wishes.above is not None else drone.distance_for(wishes.pixel)
    lean = np.radians(90 + pitch)
    up = max(min(distance * np.cos(lean), wishes.top - building.height), wishes.clearance)
    distance = up / float(np.cos(lean))
    if direction is None:
        direction = longest_direction(building.outline)
    width, depth = drone.footprint(distance)
    heading = heading_vector(direction)
    margin = max(0.5 * building.height, 0.5 * (1 - wishes.side) * width)
    back = (up + building.height / 2) * np.tan(lean)  # from the eye to what is in the picture's middle, half way up
    depth /= np.cos(lean)  # a leaning camera shows a longer strip of the ground
    places = lines(building.outline, direction, (1 - wishes.side) * width, (1 - wishes.forward) * depth, margin)
    places = places - back * heading
    if pitch > -90:
        headings = np.full(len(places), direction % 360)
    else:
        headings = headings_of(np.gradient(places, axis=0)) if len(places) > 1 else np.full(1, direction % 360)
    return Leg(name=name, places=np.c_[places, np.full(len(places), building.height + up)], headings=headings,
               pitches=np.full(len(places), pitch), distance=distance)


def oblique_grids(building: Building, drone: Drone, wishes: Wishes) -> list[Leg]:
    """Four grids that look at the building from four sides, 45 degrees down."""
    first = longest_direction(building.outline)
    return [grid(building, drone, wishes, direction=first + turn, pitch=OBLIQUE, name=f"Leaning, from the {side}")
            for turn, side in ((turn, compass((first + turn + 180) % 360)) for turn in (0, 90, 180, 270))]


def orbit(building: Building, drone: Drone, wishes: Wishes, height: float, *, aim: float | None = None,
          name: str = "Orbit") -> Leg:
    """Around the building at `height` metres, looking at its walls `aim` metres up (half of its height)."""
    height = min(height, wishes.top)
    aim = building.height / 2 if aim is None else aim
    distance = drone.distance_for(wishes.pixel)
    rise = height - aim
    across = max(np.sqrt(max(distance**2 - rise**2, 0.0)), wishes.clearance, abs(rise) * 0.35)
    width, _ = drone.footprint(float(np.hypot(across, rise)))
    places, directions = around(building.outline, across, (1 - wishes.forward) * width, MOST_TURN)
    pitch = np.degrees(np.arctan2(-rise, across))
    return Leg(name=name, places=np.c_[places, np.full(len(places), height)], headings=headings_of(directions),
               pitches=np.full(len(places), pitch), distance=float(np.hypot(across, rise)))


def high_orbit(building: Building, drone: Drone, wishes: Wishes, *, aim: float | None = None) -> Leg:
    """Around the building so high that the camera looks 45 degrees down at it, above its roof in any case."""
    aim = building.height / 2 if aim is None else aim
    high = max(aim + drone.distance_for(wishes.pixel) * np.sin(np.radians(-OBLIQUE)), building.height + 2)
    return orbit(building, drone, wishes, float(high), aim=aim, name="High orbit")


def orbits(building: Building, drone: Drone, wishes: Wishes, low: float, high: float) -> list[Leg]:
    """As many level orbits between two heights as the side overlap asks for, each looking a little down."""
    distance = drone.distance_for(wishes.pixel)
    rows = heights(low, high, (1 - wishes.side) * drone.footprint(distance)[1])
    return [orbit(building, drone, wishes, row, aim=max(row - 0.15 * distance, 0.0),
                  name=f"Orbit {row:.0f} m up") for row in rows]


def helix(building: Building, drone: Drone, wishes: Wishes, low: float, high: float) -> Leg:
    """One way that climbs around the building from `low` to `high`, a turn for each height that an orbit would have."""
    turns = orbits(building, drone, wishes, low, high)
    places = np.concatenate([leg.places for leg in turns])
    places[:, 2] = np.linspace(low, high, len(places))
    return Leg(name="Helix", places=places, headings=np.concatenate([leg.headings for leg in turns]),
               pitches=np.concatenate([leg.pitches for leg in turns]), distance=turns[0].distance)


def facade(building: Building, drone: Drone, wishes: Wishes) -> list[Leg]:
    """Lines along every wall of the outline's hull, at the heights that cover it, straight and turned to both sides.

    Walls shorter than a fifth of the longest are passed by the turned photos of their neighbours.
    """
    corners = hull(building.outline)
    ends = np.roll(corners, -1, axis=0)
    lengths = np.linalg.norm(ends - corners, axis=1)
    distance = max(drone.distance_for(wishes.pixel), wishes.clearance)
    width, height = drone.footprint(distance)
    rows = heights(max(LOWEST, min(0.4 * height, building.eaves / 2)), max(building.eaves - 0.3 * height, LOWEST),
                   (1 - wishes.side) * height)
    found = []
    for start, end, length in zip(corners, ends, lengths, strict=True):
        if length < 0.2 * lengths.max():
            continue
        along = (end - start) / length
        outward = np.array([along[1], -along[0]])
        facing = float(headings_of(-outward[None])[0])
        for turn, side in ((0.0, "straight"), (-SIDEWARD, "turned left"), (SIDEWARD, "turned right")):
            # A turned camera looks at the wall from beside it: the line moves so that both ends are seen.
            shift = distance * np.tan(np.radians(turn)) * along
            over = 0.25 * width
            count = max(int(np.ceil((length + 2 * over) / ((1 - wishes.forward) * width))), 1)
            line = start + outward * distance + np.linspace(-over, length + over, count + 1)[:, None] * along + shift
            places = np.concatenate([np.c_[line if n % 2 == 0 else line[::-1], np.full(len(line), row)]
                                     for n, row in enumerate(rows)])
            found.append(Leg(name=f"{compass((facing + 180) % 360).capitalize()} wall, {side}", places=places,
                             headings=np.full(len(places), (facing + turn) % 360), pitches=np.full(len(places), -5.0),
                             distance=distance))
    return found


def court(building: Building, drone: Drone, wishes: Wishes) -> list[Leg]:
    """Inside of a ring: above its inner edge, looking across the court to the opposite wall and down at it; and photos
    straight down into the court."""
    assert building.court is not None
    inner, centre = hull(building.court), middle(hull(building.court))
    # A little inside of the inner eaves, so that the near roof does not stand in the picture.
    reach = np.linalg.norm(inner - centre, axis=1)
    ring = centre + (inner - centre) * (1 - np.minimum(0.5 * wishes.clearance, 0.3 * reach) / reach)[:, None]
    height = min(building.height + max(wishes.clearance, 5.0), wishes.top)
    span = 2 * float(reach.mean())
    width, _ = drone.footprint(span)
    places, _ = around(ring, 1e-6, (1 - wishes.forward) * width, MOST_TURN)
    legs = []
    for aim, name in ((building.eaves * 0.75, "Court, across to the upper floors"),
                      (building.eaves * 0.2, "Court, down to the lower floors")):
        drop = height - aim
        legs.append(Leg(name=name, places=np.c_[places, np.full(len(places), height)],
                        headings=headings_of(centre - places),
                        pitches=np.full(len(places), -np.degrees(np.arctan2(drop, span * 0.9))),
                        distance=float(np.hypot(drop, span * 0.9))))
    above = replace(wishes, above=height)
    floor = Building(outline=building.court, height=0.0, eaves=0.0, obstacles=building.obstacles)
    down = grid(floor, drone, above, name="Court, straight down")
    return [*legs, down]


def heights(low: float, high: float, step: float) -> np.ndarray:
    """Heights from `low` to `high`, evenly spread and no more than `step` apart."""
    if high <= low:
        return np.array([low])
    return np.linspace(low, high, int(np.ceil((high - low) / step)) + 1)


def longest_direction(outline: np.ndarray) -> float:
    """Heading in degrees, 0 to 180, of the longest side of the smallest rectangle about an outline."""
    corners = hull(outline)
    best, found = np.inf, 0.0
    for edge in np.roll(corners, -1, axis=0) - corners:
        turn = float(headings_of(edge[None])[0])
        forward = heading_vector(turn)
        size = np.ptp(corners @ np.stack([forward, [forward[1], -forward[0]]], axis=1), axis=0)
        if size.prod() < best - 1e-6:
            best, found = float(size.prod()), turn if size[0] >= size[1] else turn + 90
    return found % 180


def compass(heading: float) -> str:
    """The side that a heading points to, in a word."""
    return ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")[
        round(heading / 45) % 8]
