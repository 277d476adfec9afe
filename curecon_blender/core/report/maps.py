# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Plan views of a part, from above, coloured by what the report tells, with a legend, a bar of lengths and north; and
pictures of what the lenses leave over."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw

from ..base.language import Text
from .fonts import Letters
from .observations import Pattern

WIDTH, HEIGHT, LOWEST, FOOT = 1140, 840, 360, 104  # pixels of a map, at most and at least, and of the strip below it
_EDGE, _LETTERS = 24, 28
_PAPER, _INK, _MARK, _FRAME = (255, 255, 255), (40, 40, 40), (235, 100, 20), (190, 190, 190)
# From dark blue by green to yellow: even steps for the eye, and told apart by all.
_RAMP = np.array([[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]], float)
_BELOW_AND_ABOVE = np.array([[5, 80, 190], [120, 170, 225], [225, 225, 225], [235, 150, 110], [190, 30, 30]], float)
_TONE = np.array([0.3, 0.59, 0.11])
_STEPS = tuple(step * 10.0**power for power in range(-4, 6) for step in (1, 2, 5))
_NEIGHBOURS = [(row, column) for row in (-1, 0, 1) for column in (-1, 0, 1) if row or column]
_CLOSED = 3  # neighbours that a pixel without a point needs to take one of theirs
_LONGEST_ARROW = 0.9  # of a cell, or of the map's width over the number of cameras across


@dataclass(frozen=True)
class Lettering:
    """The letters that pictures are lettered with, and what says a text in the report's language."""

    letters: Letters
    say: Callable[[str], str]

    def write(self, draw: ImageDraw.ImageDraw, place: tuple[float, float], text: str, anchor: str) -> None:
        draw.text(place, self.say(text), fill=_INK, font=self.letters.sized(_LETTERS), anchor=anchor)


@dataclass(frozen=True)
class Plan:
    """Which point (H,W) int64 is the topmost in each pixel, -1 where none is; the pixels of one unit of length, and its
    name; the place (2,) in the middle; whether y is north."""

    topmost: np.ndarray
    scale: float
    unit: str
    middle: np.ndarray
    north: bool
    lettering: Lettering

    def pixels(self, places: np.ndarray) -> np.ndarray:
        """Columns and rows (N,2) of places (N,2+)."""
        height, width = self.topmost.shape
        off = (places[:, :2] - self.middle) * self.scale
        return np.column_stack([off[:, 0] + width / 2, height / 2 - off[:, 1]])


def plan_of(
    points: np.ndarray, unit: str, lettering: Lettering, *, north: bool, shown: np.ndarray | None = None
) -> Plan:
    """The plan of points (N,3), Z up; its frame is that of the places `shown` (M,2+), or of all points."""
    framed = points if shown is None else shown
    low, high = framed[:, :2].min(axis=0), framed[:, :2].max(axis=0)
    across, along = np.maximum(high - low, 1e-9).tolist()
    scale = min((WIDTH - 2 * _EDGE) / across, (HEIGHT - 2 * _EDGE) / along)
    height = max(LOWEST, round(along * scale) + 2 * _EDGE)
    bare = Plan(np.full((height, WIDTH), -1, np.int64), scale, unit, (low + high) / 2, north, lettering)
    column, row = np.floor(bare.pixels(points)).astype(np.int64).T
    inside = np.flatnonzero((column >= 0) & (column < WIDTH) & (row >= 0) & (row < height))
    order = inside[np.argsort(points[inside, 2], kind="stable")]  # the topmost comes last, and stays
    bare.topmost[row[order], column[order]] = order
    _close(bare.topmost)
    return bare


def _close(topmost: np.ndarray) -> None:
    """Give single pixels between points one of these points, so that sparse clouds are surfaces, too."""
    padded = np.pad(topmost, 1, constant_values=-1)
    height, width = topmost.shape
    around = np.stack([padded[1 + row : 1 + row + height, 1 + column : 1 + column + width]
                       for row, column in _NEIGHBOURS])
    lone = (topmost < 0) & ((around >= 0).sum(axis=0) >= _CLOSED)
    topmost[lone] = around.max(axis=0)[lone]


def photo_map(plan: Plan, colours: np.ndarray) -> Image.Image:
    """The plan in the points' own colours (N,3)."""
    return _with_foot(_painted(plan, colours), plan)


def ramp_map(plan: Plan, values: np.ndarray, low: float, high: float, labels: Sequence[str]) -> Image.Image:
    """The plan coloured from `low` to `high` of the values (N,); `labels` stand along the bar, evenly."""
    picture = _painted(plan, ramp(np.clip((values - low) / max(high - low, 1e-12), 0, 1)))
    foot = _with_foot(picture, plan)
    _bar(foot, plan, _RAMP, labels)
    return foot


def marked_map(plan: Plan, colours: np.ndarray, marked: np.ndarray, label: str) -> Image.Image:
    """The plan in grey, with what is marked (N,) bool in orange."""
    shown = np.where(marked[:, None], _MARK, _grey(colours))
    foot = _with_foot(_painted(plan, shown), plan)
    draw = ImageDraw.Draw(foot)
    left, top = WIDTH // 2, foot.height - FOOT + 32
    draw.rectangle((left, top, left + 34, top + 24), fill=_MARK)
    plan.lettering.write(draw, (left + 48, top + 12), label, "lm")
    return foot


def camera_map(
    plan: Plan, colours: np.ndarray, cameras: np.ndarray, off: np.ndarray, say: Callable[[float], str]
) -> Image.Image:
    """The plan in pale grey with the cameras (N,3) on it. From each a line leads towards its GPS, `off` (N,3) being
    camera less GPS, nan where there is none. The lines are magnified; the foot shows how long one of a round length is.
    A camera's colour is what it is off in height, which `say` names."""
    foot = _with_foot(_painted(plan, 0.35 * _grey(colours) + 160), plan)
    draw = ImageDraw.Draw(foot)
    known = np.isfinite(off).all(axis=1)
    reach = float(np.linalg.norm(off[known, :2], axis=1).max()) if known.any() else 0.0
    most = max(float(np.abs(off[known, 2]).max()), 1e-6) if known.any() else 1.0
    usual = WIDTH / max(np.sqrt(len(cameras)), 4) / 2  # pixels between neighbours, about
    longer = max((step for step in _STEPS if step * reach * plan.scale <= usual), default=1.0)
    places = plan.pixels(cameras)
    ends = plan.pixels(cameras[:, :2] - longer * np.nan_to_num(off[:, :2]))
    tints = _along(_BELOW_AND_ABOVE, np.nan_to_num(off[:, 2]) / most / 2 + 0.5)
    for place, end, tint, has in zip(places.tolist(), ends.tolist(), tints.tolist(), known.tolist(), strict=True):
        if has:
            draw.line((*place, *end), fill=_INK, width=4)
        x, y = place
        draw.ellipse((x - 9, y - 9, x + 9, y + 9), fill=tuple(tint) if has else _PAPER, outline=_INK, width=2)
    if known.any():
        _bar(foot, plan, _BELOW_AND_ABOVE, [f"−{say(most)}", "0", f"+{say(most)}"])
        step = max(step for step in _STEPS if step * longer * plan.scale <= 2 * usual)
        y, left = foot.height - FOOT + 18, WIDTH // 4
        draw.line((left, y, left + step * longer * plan.scale, y), fill=_INK, width=4)
        draw.ellipse((left - 9, y - 9, left + 9, y + 9), fill=_PAPER, outline=_INK, width=2)
        plan.lettering.write(draw, (left, y + 18), Text("{} {}", f"{step:g}", plan.unit), "la")
    return foot


def pattern_map(pattern: Pattern, lettering: Lettering, say: Callable[[float], str]) -> Image.Image:
    """What a lens leaves over in each cell of its picture, as arrows; `say` names a number of pixels."""
    rows, columns, _ = pattern.mean.shape
    cell = (WIDTH // 2 - 2 * _EDGE) / columns
    width, height = round(columns * cell), round(rows * cell)
    picture = Image.new("RGB", (width + 2 * _EDGE, height + 2 * _EDGE + FOOT // 2), _PAPER)
    draw = ImageDraw.Draw(picture)
    draw.rectangle((_EDGE, _EDGE, _EDGE + width, _EDGE + height), outline=_FRAME)
    lengths = np.linalg.norm(pattern.mean, axis=2)
    longest = float(np.nanmax(lengths)) if np.isfinite(lengths).any() else 0.0
    scale = _LONGEST_ARROW * cell / max(longest, 1e-9)
    for row in range(rows):
        for column in range(columns):
            x, y = _EDGE + (column + 0.5) * cell, _EDGE + (row + 0.5) * cell
            if np.isfinite(lengths[row, column]):
                dx, dy = (pattern.mean[row, column] * scale).tolist()
                _arrow(draw, (x - dx / 2, y - dy / 2), (x + dx / 2, y + dy / 2))
    if longest > 0:
        y = height + 2 * _EDGE + 6
        _arrow(draw, (_EDGE, y), (_EDGE + longest * scale, y))
        lettering.write(draw, (_EDGE + longest * scale + 14, y), say(longest), "lm")
    return picture


def _arrow(draw: ImageDraw.ImageDraw, start: tuple[float, float], end: tuple[float, float]) -> None:
    draw.line((*start, *end), fill=_INK, width=2)
    along = np.array(end) - start
    tip = min(float(np.linalg.norm(along)), 9.0)
    if tip > 1:
        along *= tip / np.linalg.norm(along)
        across = np.array([-along[1], along[0]]) / 2
        draw.polygon([tuple(end), tuple(end - along + across), tuple(end - along - across)], fill=_INK)


def ramp(values: np.ndarray) -> np.ndarray:
    """Colours (N,3) uint8 of values in [0, 1]."""
    return _along(_RAMP, values)


def _along(stops: np.ndarray, values: np.ndarray) -> np.ndarray:
    steps = np.linspace(0, 1, len(stops))
    channels = [np.interp(values, steps, stops[:, channel]) for channel in range(3)]
    return np.rint(np.stack(channels, axis=-1)).astype(np.uint8)


def _grey(colours: np.ndarray) -> np.ndarray:
    return np.asarray(90 + 0.6 * np.repeat((colours @ _TONE)[:, None], 3, axis=1))


def _painted(plan: Plan, colours: np.ndarray) -> Image.Image:
    canvas = np.empty((*plan.topmost.shape, 3), np.uint8)
    canvas[:] = _PAPER
    there = plan.topmost >= 0
    canvas[there] = colours[plan.topmost[there]]
    return Image.fromarray(canvas)


def _bar(foot: Image.Image, plan: Plan, stops: np.ndarray, labels: Sequence[str]) -> None:
    """The colours' bar at the right of a map's foot."""
    draw = ImageDraw.Draw(foot)
    left, right, top = WIDTH // 2, WIDTH - 6 * _EDGE, foot.height - FOOT + 12
    colours = _along(stops, np.linspace(0, 1, right - left))
    foot.paste(Image.fromarray(np.repeat(colours[None], 20, axis=0)), (left, top))
    for place, label in enumerate(labels):
        x = left + (right - left) * place / max(len(labels) - 1, 1)
        plan.lettering.write(draw, (x, top + 28), label, "ma")


def _with_foot(picture: Image.Image, plan: Plan) -> Image.Image:
    """The map with a bar of lengths below it, and an arrow to the north where the part's frame knows it."""
    whole = Image.new("RGB", (WIDTH, picture.height + FOOT), _PAPER)
    whole.paste(picture, (0, 0))
    draw = ImageDraw.Draw(whole)
    longest = WIDTH / 5 / plan.scale
    length = max(step for step in _STEPS if step <= longest)
    end, top = _EDGE + round(length * plan.scale), picture.height + 14
    draw.rectangle((_EDGE, top, end, top + 8), fill=_INK)
    draw.rectangle((_EDGE, top, (_EDGE + end) // 2, top + 8), fill=_PAPER, outline=_INK)
    plan.lettering.write(draw, ((_EDGE + end) / 2, top + 20), Text("{} {}", f"{length:g}", plan.unit), "ma")
    if plan.north:
        x, y = WIDTH - 2 * _EDGE, 2 * _EDGE
        draw.polygon([(x, y - 28), (x + 14, y + 20), (x, y + 9), (x - 14, y + 20)], fill=_INK)
        plan.lettering.write(draw, (x, y + 26), "N", "ma")
    return whole
