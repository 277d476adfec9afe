# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The few photos that close the gaps of a first model: a greedy cover of what is lacking, and a sentence for each."""

from __future__ import annotations

import numpy as np

from ..base.language import Text
from .coverage import Eyes, Sight, sightings
from .forms import compass
from .obstacles import inside
from .outlines import hull
from .patches import Judged, count_in, news, rays_to
from .records import Building, Leg
from .wishes import MOST_PHOTOS

_LEAST = 0.01  # of all that is lacking: a photo that adds less is not worth the flight
_LINKED = 0.3  # of what a photo sees, what one that looks alike sees, too: with less it is not placed
_ALIKE = 45.0  # degrees
_AIMED = 11.5  # degrees from a photo's middle to the nearest patch that it shows, at most: others look past the site


def advise(judged: Judged, taken: Eyes, offered: Eyes, sight: Sight, most: int = MOST_PHOTOS) -> np.ndarray:
    """Numbers (K,) of the offered cameras to take, the most useful first; `judged` is brought up to date.

    Each step takes the camera that shows the most square metres of what lacks a photo, from a direction that is new
    there. A camera counts in full where a photo that is there, or that was taken before it, looks alike at the same
    patches: else no program would find its place.
    """
    n, m, depth = sightings(judged.patches.parts, offered, sight)
    order = np.argsort(m, kind="stable")
    n, m, depth = n[order], m[order], depth[order]
    fine = 1000 * depth / offered.focals[m] <= judged.coarsest
    rays = np.empty((len(n), 3))
    ends = np.searchsorted(m, np.arange(len(offered) + 1))
    for number, eye in enumerate(offered.centres):
        of = slice(ends[number], ends[number + 1])
        rays[of] = rays_to(judged.patches.parts.places[n[of]], eye)
    off = np.full(len(offered), np.pi)
    np.minimum.at(off, m, np.arccos(np.clip(-(rays * offered.turns[m, 2]).sum(axis=1), -1, 1)))
    aimed = off < np.radians(_AIMED)
    views = np.zeros((len(offered), len(judged.patches)), np.float32)
    views[m, n] = np.sqrt(judged.patches.areas[n])
    total = np.maximum((views**2).sum(axis=1), 1e-9)
    before = np.zeros((len(taken), len(judged.patches)), np.float32)
    tn, tm, _ = sightings(judged.patches.parts, taken, sight)
    before[tm, tn] = np.sqrt(judged.patches.areas[tn])
    alike = np.cos(np.radians(_ALIKE))
    linked = np.where(offered.turns[:, 2] @ taken.turns[:, 2].T > alike, views @ before.T, 0).max(axis=1, initial=0)
    lacking = float((judged.short * judged.patches.areas).sum())
    chosen: list[int] = []
    while len(chosen) < most:
        new = fine & news(judged, n, rays)
        area = np.bincount(m[new], judged.patches.areas[n[new]], len(offered))
        gain = area * np.minimum(linked / total / _LINKED, 1) * aimed
        best = int(gain.argmax()) if len(offered) else -1
        if best < 0 or gain[best] <= _LEAST * lacking:
            break
        chosen.append(best)
        of = slice(ends[best], ends[best + 1])
        count_in(judged, n[of][fine[of]], offered.centres[best])
        near = offered.turns[:, 2] @ offered.turns[best, 2] > alike
        linked = np.maximum(linked, np.where(near, views @ views[best], 0))
    return np.array(chosen, int)


def in_order(leg: Leg, start: np.ndarray) -> np.ndarray:
    """Numbers (N,) of a leg's photos as they are flown from a place (3,): always the nearest of those that are left."""
    left, here, order = list(range(len(leg))), start, list[int]()
    while left:
        nearest = min(left, key=lambda number: float(np.linalg.norm(leg.places[number] - here)))
        left.remove(nearest)
        order.append(nearest)
        here = leg.places[nearest]
    return np.array(order, int)


def sentence(place: np.ndarray, heading: float, pitch: float, building: Building, *, north: bool) -> Text:
    """Where a person flies for a photo and where it looks, such as "12 m off the south wall, 6 m up: look north, 10
    degrees up". Sides are those of the frame where north is not known."""
    corners = hull(building.outline)
    over = bool(inside(place[None, :2], corners)[0])
    up = place[2]
    if building.court is not None and inside(place[None, :2], building.court)[0]:
        where = Text("In the court, {:.0f} m up" if up < building.height else "Above the court, {:.0f} m up", up)
    elif over:
        where = Text("Above the roof, {:.0f} m up", up)
    else:
        nearest, off = _nearest(place[:2], corners)
        away = place[:2] - nearest
        where = Text("{:.0f} m off the {} wall, {:.0f} m up", off, side(away, north=north), up)
    if pitch < -85:
        return Text("{}: look straight down.", where)
    facing = side(np.array([np.sin(np.radians(heading)), np.cos(np.radians(heading))]), north=north)
    if abs(pitch) < 3:
        return Text("{}: look {}, level.", where, facing)
    if pitch < 0:
        return Text("{}: look {}, {:.0f} degrees down.", where, facing, -pitch)
    return Text("{}: look {}, {:.0f} degrees up.", where, facing, pitch)


def side(direction: np.ndarray, *, north: bool) -> Text:
    """A direction (2,) in a word: by the compass, or by the frame's axes where y is not north."""
    heading = float(np.degrees(np.arctan2(direction[0], direction[1])) % 360)
    if north:
        return Text(compass(heading))
    return Text(("+Y", "+X+Y", "+X", "+X-Y", "-Y", "-X-Y", "-X", "-X+Y")[round(heading / 45) % 8])


def _nearest(place: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, float]:
    """The place (2,) of a polygon's border nearest to one outside, and metres to it."""
    edge = np.roll(corners, -1, axis=0) - corners
    share = ((place - corners) * edge).sum(axis=1) / np.maximum((edge**2).sum(axis=1), 1e-12)
    feet = corners + np.clip(share, 0, 1)[:, None] * edge
    away = np.linalg.norm(feet - place, axis=1)
    return feet[away.argmin()], float(away.min())
