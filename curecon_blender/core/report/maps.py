# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Plan views of a part, from above, coloured by what the report tells; with a bar of the colours and of lengths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw, ImageFont

WIDTH, HEIGHT, FOOT = 760, 560, 64  # pixels of a map, and of the strip below it
_PAPER, _INK = (255, 255, 255), (40, 40, 40)
# From dark blue by green to yellow: even steps for the eye, and told apart by all.
_RAMP = np.array([[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]], float)
_TONE = np.array([0.3, 0.59, 0.11])


@dataclass(frozen=True)
class Plan:
    """Which point (H,W) int64 is the topmost in each pixel, -1 where none is; the pixels of one unit of length, and
    its name."""

    topmost: np.ndarray
    scale: float
    unit: str


def plan_of(points: np.ndarray, unit: str, shown: np.ndarray | None = None) -> Plan:
    """The plan of points (N,3), Z up; its frame is that of the `shown` (N,) bool, or of all."""
    framed = points if shown is None else points[shown]
    low, high = framed[:, :2].min(axis=0), framed[:, :2].max(axis=0)
    scale = 0.96 * min(WIDTH / max(high[0] - low[0], 1e-9), HEIGHT / max(high[1] - low[1], 1e-9))
    middle = (low + high) / 2
    column = np.floor((points[:, 0] - middle[0]) * scale + WIDTH / 2).astype(np.int64)
    row = np.floor((middle[1] - points[:, 1]) * scale + HEIGHT / 2).astype(np.int64)
    inside = np.flatnonzero((column >= 0) & (column < WIDTH) & (row >= 0) & (row < HEIGHT))
    order = inside[np.argsort(points[inside, 2], kind="stable")]  # the topmost comes last, and stays
    topmost = np.full((HEIGHT, WIDTH), -1, np.int64)
    topmost[row[order], column[order]] = order
    return Plan(topmost, float(scale), unit)


def photo_map(plan: Plan, colours: np.ndarray) -> Image.Image:
    """The plan in the points' own colours (N,3)."""
    return _with_foot(_painted(plan, colours), plan)


def ramp_map(plan: Plan, values: np.ndarray, low: float, high: float, labels: Sequence[str]) -> Image.Image:
    """The plan coloured from `low` to `high` of the values (N,); `labels` stand along the bar, evenly."""
    picture = _painted(plan, ramp(np.clip((values - low) / max(high - low, 1e-12), 0, 1)))
    foot = _with_foot(picture, plan)
    draw, font = ImageDraw.Draw(foot), ImageFont.load_default(15)
    left, right, top = WIDTH // 2 - 40, WIDTH - 40, HEIGHT + 14
    bar = ramp(np.linspace(0, 1, right - left))
    foot.paste(Image.fromarray(np.repeat(bar[None], 14, axis=0)), (left, top))
    for place, label in enumerate(labels):
        x = left + (right - left) * place / max(len(labels) - 1, 1)
        draw.text((x, top + 20), label, fill=_INK, font=font, anchor="ma")
    return foot


def marked_map(plan: Plan, colours: np.ndarray, marked: np.ndarray, label: str) -> Image.Image:
    """The plan in grey, with what is marked (N,) bool in orange."""
    grey = np.repeat((colours @ _TONE)[:, None], 3, axis=1)
    shown = np.where(marked[:, None], [235, 100, 20], 90 + 0.6 * grey)
    foot = _with_foot(_painted(plan, shown), plan)
    draw = ImageDraw.Draw(foot)
    left, top = WIDTH // 2 - 40, HEIGHT + 22
    draw.rectangle((left, top, left + 22, top + 16), fill=(235, 100, 20))
    draw.text((left + 32, top + 8), label, fill=_INK, font=ImageFont.load_default(15), anchor="lm")
    return foot


def ramp(values: np.ndarray) -> np.ndarray:
    """Colours (N,3) uint8 of values in [0, 1]."""
    steps = np.linspace(0, 1, len(_RAMP))
    channels = [np.interp(values, steps, _RAMP[:, channel]) for channel in range(3)]
    return np.rint(np.stack(channels, axis=-1)).astype(np.uint8)


def _painted(plan: Plan, colours: np.ndarray) -> Image.Image:
    canvas = np.empty((HEIGHT, WIDTH, 3), np.uint8)
    canvas[:] = _PAPER
    there = plan.topmost >= 0
    canvas[there] = colours[plan.topmost[there]]
    return Image.fromarray(canvas)


def _with_foot(picture: Image.Image, plan: Plan) -> Image.Image:
    """The map with a bar of lengths below it. North is up where the part's frame knows it."""
    whole = Image.new("RGB", (WIDTH, HEIGHT + FOOT), _PAPER)
    whole.paste(picture, (0, 0))
    draw = ImageDraw.Draw(whole)
    longest = 220 / plan.scale
    length = max(step * 10.0**power for power in range(-4, 6) for step in (1, 2, 5) if step * 10.0**power <= longest)
    end = 30 + round(length * plan.scale)
    draw.rectangle((30, HEIGHT + 18, end, HEIGHT + 24), fill=_INK)
    draw.text(((30 + end) / 2, HEIGHT + 34), f"{length:g} {plan.unit}", fill=_INK, font=ImageFont.load_default(15),
              anchor="ma")
    return whole
