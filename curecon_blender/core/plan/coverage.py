# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How well photos cover a building: how many see each part of it, from how different directions, and how finely."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Protocol

import numpy as np

from .drones import Drone
from .obstacles import inside
from .outlines import area
from .records import Building, Plan

SPACING = 1.0  # metres between the parts that are looked at
MOST_SLANT = 60.0  # degrees between a photo's ray and the surface's normal, beyond which it measures badly
ENOUGH = 3  # photos
LEAST_ANGLE = 5.0  # degrees between two photos of a place
_CHUNK = 400_000  # pairs of part and photo at once


@dataclass(frozen=True)
class Parts:
    """Parts of a surface: places (N,3) and outward normals (N,3)."""

    places: np.ndarray
    normals: np.ndarray


@dataclass(frozen=True)
class Eyes:
    """Cameras: `centres` (M,3); `turns` (M,3,3), whose rows are right, down and forward; focal lengths (M,), principal
    points (M,2) and sizes (M,2) of the pictures in pixels."""

    centres: np.ndarray
    turns: np.ndarray
    focals: np.ndarray
    middles: np.ndarray
    sizes: np.ndarray

    def __len__(self) -> int:
        return len(self.centres)

    def take(self, which: np.ndarray) -> Eyes:
        """Those that `which` names."""
        return Eyes(*(getattr(self, field.name)[which] for field in fields(self)))


class Sight(Protocol):
    """What may stand between an eye and what it looks at."""

    def hidden(self, eyes: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Whether (N,) something stands between each eye (N,3) and its place (N,3)."""


@dataclass(frozen=True)
class Seen:
    """Of each part (N,): the photos that see it, the largest angle between two of them in degrees, and the finest
    pixel in millimetres (inf where none sees it)."""

    photos: np.ndarray
    angle: np.ndarray
    pixel: np.ndarray

    @property
    def share(self) -> float:
        """The share of the parts that enough photos see, two of them LEAST_ANGLE apart or more."""
        return float(((self.photos >= ENOUGH) & (self.angle >= LEAST_ANGLE)).mean())


    @property
    def usual_pixel(self) -> float:
        """Median of the finest pixels in millimetres, of what is seen at all; nan where nothing is."""
        found = self.pixel[self.photos > 0]
        return float(np.median(found)) if len(found) else float("nan")


def parts_of(building: Building) -> Parts:
    """The building as a block: its walls to the eaves, those of its court, and its top."""
    places, normals = [], []
    for outline, side in ((building.outline, 1.0), (building.court, -1.0)):
        if outline is None:
            continue
        ring = outline if area(outline) > 0 else outline[::-1]
        for start, end in zip(ring, np.roll(ring, -1, axis=0), strict=True):
            length = float(np.linalg.norm(end - start))
            if length < 1e-6:
                continue
            outward = side * np.array([end[1] - start[1], start[0] - end[0], 0.0]) / length
            across = (np.arange(max(round(length / SPACING), 1)) + 0.5) / max(round(length / SPACING), 1)
            up = (np.arange(max(round(building.eaves / SPACING), 1)) + 0.5) * building.eaves / max(
                round(building.eaves / SPACING), 1)
            wall = start + across[:, None] * (end - start)
            places.append(np.c_[np.repeat(wall, len(up), axis=0), np.tile(up, len(wall))])
            normals.append(np.broadcast_to(outward, (len(places[-1]), 3)))
    low, high = building.outline.min(axis=0), building.outline.max(axis=0)
    x, y = np.meshgrid(*(np.arange(low[axis], high[axis], SPACING) + SPACING / 2 for axis in range(2)))
    top = np.stack([x.ravel(), y.ravel()], axis=1)
    top = top[inside(top, building.outline)]
    if building.court is not None:
        top = top[~inside(top, building.court)]
    places.append(np.c_[top, np.full(len(top), building.height)])
    normals.append(np.broadcast_to(np.array([0.0, 0.0, 1.0]), (len(top), 3)))
    return Parts(np.concatenate(places), np.concatenate(normals))


def sightings(parts: Parts, eyes: Eyes, obstacles: Sight) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Part (K,), photo (K,) and z-depth (K,) in metres, wherever a photo sees a part: within the picture, less than
    MOST_SLANT off the normal, and not behind anything."""
    found: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    step = max(1, _CHUNK // max(len(eyes), 1))
    for begin in range(0, len(parts.places), step):
        part = slice(begin, begin + step)
        ray = parts.places[part, None] - eyes.centres
        distance = np.linalg.norm(ray, axis=2)
        right, down, depth = np.einsum("nmk,mak->anm", ray, eyes.turns)
        far = np.maximum(depth, 1e-6)
        facing = -np.einsum("nmk,nk->nm", ray, parts.normals[part]) / np.maximum(distance, 1e-9)
        good = (depth > 0.5) & (facing > np.cos(np.radians(MOST_SLANT)))
        for axis, across in enumerate((right, down)):
            pixel = across / far * eyes.focals + eyes.middles[:, axis]
            good &= (pixel > 0) & (pixel < eyes.sizes[:, axis])
        n, m = np.nonzero(good)
        clear = ~obstacles.hidden(eyes.centres[m], parts.places[part][n] + 0.3 * parts.normals[part][n])
        found.append((n[clear] + begin, m[clear], depth[n[clear], m[clear]]))
    n, m, depth = (np.concatenate(column) for column in zip(*found, strict=True))
    return n, m, depth


def seen(parts: Parts, eyes: Eyes, found: tuple[np.ndarray, np.ndarray, np.ndarray]) -> Seen:
    """What photos see of the parts, of their `sightings`."""
    n, m, depth = found
    photos, pixel = np.zeros(len(parts.places), int), np.full(len(parts.places), np.inf)
    np.add.at(photos, n, 1)
    np.minimum.at(pixel, n, 1000 * depth / eyes.focals[m])
    return Seen(photos, _widest(parts.places, eyes.centres, np.stack([n, m])), pixel)


def of_plan(plan: Plan, parts: Parts) -> Seen:
    """What all photos of a plan see."""
    eyes = eyes_of(plan.drone, np.concatenate([leg.places for leg in plan.legs]),
                   np.concatenate([leg.headings for leg in plan.legs]),
                   np.concatenate([leg.pitches for leg in plan.legs]))
    return seen(parts, eyes, sightings(parts, eyes, plan.building.obstacles))


def eyes_of(drone: Drone, places: np.ndarray, headings: np.ndarray, pitches: np.ndarray) -> Eyes:
    """A drone's camera at places (M,3), with headings and pitches (M,) in degrees."""
    count, size = len(places), np.array(drone.picture, float)
    return Eyes(places, np.stack(axes(headings, pitches), axis=1), np.full(count, drone.focal_px),
                np.tile(size / 2, (count, 1)), np.tile(size, (count, 1)))


def axes(headings: np.ndarray, pitches: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Right, down and forward (M,3) of cameras, from degrees."""
    heading, pitch = np.radians(headings), np.radians(pitches)
    forward = np.stack([np.sin(heading) * np.cos(pitch), np.cos(heading) * np.cos(pitch), np.sin(pitch)], axis=1)
    right = np.stack([np.cos(heading), -np.sin(heading), np.zeros(len(heading))], axis=1)
    return right, np.cross(forward, right), forward


def _widest(places: np.ndarray, eyes: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Of each place (N,) the largest angle in degrees between two rays to it, found by going to the farthest ray twice:
    exact where the eyes lie on a line or a ring, a little too small elsewhere."""
    n, m = pairs
    rays = eyes[m] - places[n]
    rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-9)
    chosen = np.zeros((len(places), 3))
    chosen[n[::-1]] = rays[::-1]
    least = np.ones(len(places))
    for _ in range(2):
        cosine = (rays * chosen[n]).sum(axis=1)
        order = np.argsort(-cosine, kind="stable")  # the last one written is the smallest
        chosen[n[order]] = rays[order]
        least[n[order]] = cosine[order]
    return np.degrees(np.arccos(np.clip(least, -1, 1)))
