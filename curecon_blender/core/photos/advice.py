# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Why a flight will give a weak model, and what to do, before anything is computed: what the photos' metadata and a
first look at them tell. What they do not tell is not guessed at."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import timedelta

import cv2
import numpy as np

from ..base.geodesy import gps_enu
from ..base.language import Text
from ..base.records import Photo
from . import overlap, shutter
from .find import listed

FEWEST = 8  # photos that are a flight
MANY = 0.1  # share of the photos that must overlap too little for it to be the flight's fault
STRAIGHT_DOWN = -70.0  # degrees: flatter photos show walls
LEVEL = 0.1  # of the height: a flight whose heights differ less has one
ZOOMED = 0.03  # of the focal length: focus alone changes it by less
LONG = timedelta(hours=2)  # in which shadows wander by 30 degrees
SKY, WITH_SKY = 0.45, 0.2  # share of a picture that is sky, and of the photos that show so much of it
_SMALL = 160  # pixels: longest side at which sky is looked for
_SMOOTH, _BRIGHT = 6.0, 110  # grey levels from pixel to pixel, and of the brightest channel
_SIDES = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")
_SET = re.compile(r" [\d.]+ mm| as [\d.]+ mm| zoomed | \d+x\d+$")  # what a camera's name tells beside the camera


@dataclass(frozen=True)
class Advice:
    """One weakness of the flight in a sentence, and what to do."""

    says: Text
    remedy: Text


def advise(photos: tuple[Photo, ...], found: overlap.Overlap) -> tuple[Advice, ...]:
    """The weaknesses of a flight with this overlap, the gravest first: what tears a model apart, what bends it, what
    leaves parts of it out, what makes it less sharp."""
    if len(photos) < FEWEST:
        return ()
    rules = (_too_little_overlap(photos, found), _changed_zoom(photos), _one_height(photos), _no_obliques(photos),
             _rolling_shutter(photos), _wandering_shadows(photos), _much_sky(photos))
    return tuple(advice for rule in rules for advice in rule)


def sky_share(rgb: np.ndarray) -> float:
    """The share of a picture (H,W,3) uint8 that is bright, smooth, not warm in colour and reaches its upper edge."""
    scale = _SMALL / max(rgb.shape[:2])
    small = cv2.resize(rgb, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    grey = cv2.cvtColor(small, cv2.COLOR_RGB2GRAY).astype(np.float32)
    change = np.hypot(cv2.Sobel(grey, cv2.CV_32F, 1, 0, scale=0.125), cv2.Sobel(grey, cv2.CV_32F, 0, 1, scale=0.125))
    red, green, blue = (small[..., channel].astype(int) for channel in range(3))
    like = (change < _SMOOTH) & (small.max(axis=2) > _BRIGHT) & (blue >= red - 4) & (blue >= green - 8)
    _, labels = cv2.connectedComponents(like.astype(np.uint8), connectivity=4)
    top = np.unique(labels[0][labels[0] > 0])
    return float(np.isin(labels, top).mean()) if len(top) else 0.0


def _too_little_overlap(photos: tuple[Photo, ...], found: overlap.Overlap) -> Iterator[Advice]:
    if found.forward is None:
        return
    if len(found.weak) > MANY * len(photos):
        text = Text("{} of {} photos overlap less than {:.0f} % with any other, most of them in the {}: {}.",
                    len(found.weak), len(photos), 100 * overlap.WEAK, _where(photos, set(found.weak)),
                    listed(list(found.weak)))
        yield Advice(text, Text("Fly there again with photos half as far apart."))
    elif found.side is not None and found.side < overlap.WEAK - 0.1:
        yield Advice(Text("Neighbouring lines of flight overlap by {:.0f} % only.", 100 * found.side),
                     Text("Fly further lines between them, or a second grid across."))


def _where(photos: tuple[Photo, ...], names: set[str]) -> Text:
    """The side of the flight that most photos of these names were taken on."""
    placed = [photo for photo in photos if photo.gps is not None]
    positions = gps_enu(placed)[0][:, :2]
    away = positions - np.median(positions, axis=0)
    reach = np.linalg.norm(away, axis=1)
    sides = np.round(np.degrees(np.arctan2(away[:, 0], away[:, 1])) / 45).astype(int) % 8
    chosen = np.array([photo.name in names for photo in placed]) & (reach > 0.25 * reach.max(initial=0.0))
    if not chosen.any():
        return Text("middle")
    return Text(_SIDES[int(np.bincount(sides[chosen], minlength=8).argmax())])


def _changed_zoom(photos: tuple[Photo, ...]) -> Iterator[Advice]:
    """Within photos of one camera and size: a drone's second camera has another size or another name."""
    focals: dict[tuple[str, int, int], list[float]] = defaultdict(list)
    for photo in photos:
        if photo.focal_px is not None:
            name = _SET.split(photo.camera)[0]
            focals[name, max(photo.width, photo.height), min(photo.width, photo.height)].append(photo.focal_px)
    for (name, *_), values in focals.items():
        if len(values) >= FEWEST and np.ptp(values) > ZOOMED * np.median(values):
            yield Advice(
                Text("The zoom of {} was moved: focal lengths lie between {:.0f} and {:.0f} pixels.", name,
                     min(values), max(values)),
                Text("Take all photos at one zoom, the widest, with focus fixed at infinity."))


def _heights(photos: tuple[Photo, ...]) -> np.ndarray | None:
    """Metres (N,) above take-off, where nearly all photos tell them."""
    told = [photo.relative_altitude for photo in photos if (photo.relative_altitude or 0) > 0]
    return np.array(told, float) if len(told) >= overlap.TOLD_BY * len(photos) else None


def _pitches(photos: tuple[Photo, ...]) -> np.ndarray | None:
    """Degrees (N,), where nearly all photos tell them."""
    told = [photo.gimbal.pitch for photo in photos if photo.gimbal is not None]
    return np.array(told) if len(told) >= overlap.TOLD_BY * len(photos) else None


def _one_height(photos: tuple[Photo, ...]) -> Iterator[Advice]:
    heights = _heights(photos)
    if heights is None or np.ptp(np.quantile(heights, [0.02, 0.98])) > LEVEL * np.median(heights):
        return
    yield Advice(Text("All photos were taken from one height, {:.0f} m: the model may be bent or too high.",
                      float(np.median(heights))),
                 Text("Add a round at another height, a third higher or lower."))


def _no_obliques(photos: tuple[Photo, ...]) -> Iterator[Advice]:
    pitches = _pitches(photos)
    if pitches is None or (pitches > STRAIGHT_DOWN).mean() > 1 - overlap.TOLD_BY:
        return
    yield Advice(Text("The photos look straight down: walls will be missing or smeared."),
                 Text("Fly around the building with the camera 30 to 45 degrees down."))


def _rolling_shutter(photos: tuple[Photo, ...]) -> Iterator[Advice]:
    heights, pitches = _heights(photos), _pitches(photos)
    told = [photo for photo in photos if photo.gps is not None and photo.focal_px is not None
            and photo.gimbal is not None and (photo.relative_altitude or 0) > 0]
    if heights is None or pitches is None or len(told) < FEWEST:
        return
    centres = gps_enu(told)[0]
    sines = np.array([max(-np.sin(np.radians(photo.gimbal.pitch)), 0.2) for photo in told if photo.gimbal])
    distance = np.array([photo.relative_altitude or 0.0 for photo in told]) / sines
    shift = shutter.shutter_shift(told, centres, np.array([photo.focal_px or 0.0 for photo in told]), distance)
    if shift is not None and shift > shutter.MOST_SHIFT:
        yield Advice(Text("The drone moved by {:.1f} pixels while a photo was read out (rolling shutter).", shift),
                     Text("Fly slower, or stop for each photo."))


def _wandering_shadows(photos: tuple[Photo, ...]) -> Iterator[Advice]:
    """By the time of day, also of photos of several days."""
    times = [time for photo in photos if (time := photo.clock) is not None]
    if len(times) < overlap.TOLD_BY * len(photos):
        return
    seconds = np.sort([time.hour * 3600 + time.minute * 60 + time.second for time in times])
    first, last = np.quantile(seconds, [0.02, 0.98])
    if last - first > LONG.total_seconds():
        yield Advice(Text("The photos were taken between {:02.0f}:{:02.0f} and {:02.0f}:{:02.0f}: where the sun shone, "
                          "shadows wander, and their edges are matched wrongly.", first // 3600, first % 3600 // 60,
                          last // 3600, last % 3600 // 60),
                     Text("Fly within one hour, or below an even cloud."))


def _much_sky(photos: tuple[Photo, ...]) -> Iterator[Advice]:
    names = [photo.name for photo in photos if photo.sky >= SKY]
    if len(names) > WITH_SKY * len(photos):
        yield Advice(Text("Sky fills half of {} photos: {}.", len(names), listed(names)),
                     Text("Tilt the camera down, or come nearer: nothing in the sky can be measured."))
