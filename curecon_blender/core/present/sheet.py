# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Sheets of paper: what stands where, in millimetres from the lower left corner, as pictures and filled triangles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import cos, radians, sin, sqrt

import numpy as np

from ..base.errors import SurfaceError
from ..base.language import Text
from .marks import HATCH, THICK

Letters = Callable[[str], np.ndarray]  # a text to triangles (N,3,2) about 1 high, from (0, 0) on the base line
PAPERS = {"A4": (297, 210), "A3": (420, 297), "A2": (594, 420), "A1": (841, 594), "A0": (1189, 841)}
MARGIN = 10.0  # from the paper's edge to the frame
GAP = 8.0  # from the frame to the drawing
STRIP = 24.0  # height of the title strip
LINE = 0.25
INK, GREY, WHITE = (0.08, 0.08, 0.08), (0.45, 0.45, 0.45), (1.0, 1.0, 1.0)
LONGEST_BAR = 60.0
DIRECTIONS = ("North", "North-east", "East", "South-east", "South", "South-west", "West", "North-west")


@dataclass(frozen=True, kw_only=True)
class Picture:
    """`pixels` (H,W,3) sRGB bytes, top row first, fill the rectangle whose lower left corner is (x, y)."""

    x: float
    y: float
    width: float
    height: float
    pixels: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Fill:
    """Triangles (N,3,2), anticlockwise, of one colour, sRGB in [0, 1]."""

    triangles: np.ndarray
    colour: tuple[float, float, float] = INK


@dataclass(kw_only=True)
class Sheet:
    width: float
    height: float
    pictures: list[Picture] = field(default_factory=list)
    fills: list[Fill] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class Mark:
    """What a hatching means, in words; `slope` 1 rises to the right, -1 falls."""

    slope: int
    words: str


@dataclass(frozen=True, kw_only=True)
class Drawing:
    """What a sheet says of its drawing.

    `pixels_per_mm` holds on the paper. `scale` is the denominator, 100 for 1:100; None when the scale is unknown.
    `north` is where north points on a plan, degrees clockwise from the sheet's top; None on façades and where north is
    unknown. `orientation` says in words which way the drawing faces, `notes` what the drawing rests on, `legend` what
    its hatchings mean.
    """

    pixels: np.ndarray
    pixels_per_mm: float
    title: str
    name: str
    date: str
    scale: int | None
    orientation: str
    north: float | None = None
    notes: str = ""
    legend: tuple[Mark, ...] = ()

    @property
    def size(self) -> tuple[float, float]:
        """Width and height on the paper."""
        height, width = self.pixels.shape[:2]
        return width / self.pixels_per_mm, height / self.pixels_per_mm


def room(paper: str, *, upright: bool) -> tuple[float, float]:
    """Width and height that a paper has for a drawing."""
    width, height = PAPERS[paper][::-1] if upright else PAPERS[paper]
    around = 2 * (MARGIN + GAP)
    return width - around, height - around - STRIP


def paper_for(width: float, height: float) -> tuple[str, bool]:
    """The smallest paper that holds a drawing, and whether it stands upright. Raises SurfaceError when none does."""
    for name in PAPERS:
        for upright in (False, True):
            available = room(name, upright=upright)
            if width <= available[0] and height <= available[1]:
                return name, upright
    raise SurfaceError(
        Text("The drawing would be {:.2f} x {:.2f} m: no paper up to A0 holds it.", width / 1000, height / 1000),
        remedy="Choose a smaller scale, such as 1:200, or a region box about less.",
    )


def compass(azimuth: float) -> str:
    """The name of a direction in degrees clockwise from north."""
    return DIRECTIONS[round(azimuth / 45) % 8]


def lay_out(drawing: Drawing, letters: Letters) -> Sheet:
    """A drawing on the smallest paper that holds it, with frame and title strip. Raises SurfaceError."""
    width, height = drawing.size
    paper, upright = paper_for(width, height)
    sheet = _empty(paper, upright=upright)
    left, right, top = MARGIN, sheet.width - MARGIN, sheet.height - MARGIN
    free = room(paper, upright=upright)
    # Whole pixels, so that the drawing is not sampled again.
    x = _whole(left + GAP + (free[0] - width) / 2, drawing.pixels_per_mm)
    y = _whole(MARGIN + STRIP + GAP + (free[1] - height) / 2, drawing.pixels_per_mm)
    sheet.pictures.append(Picture(x=x, y=y, width=width, height=height, pixels=drawing.pixels))
    _frame(sheet, left, MARGIN, right, top)
    _legend(sheet, letters, drawing.legend, left + 4, MARGIN + STRIP + 2.4)
    sheet.fills.append(Fill(triangles=rectangle(left, MARGIN + STRIP, right, MARGIN + STRIP + LINE)))
    base, third = MARGIN + STRIP / 2, (right - left) / 3
    end = right - 4
    if drawing.north is not None:
        _north(sheet, letters, drawing.north, right - 13, base)
        end = right - 26
    words = 0.75 * third
    bar = min(left + 1.35 * third, end - words - GAP - LONGEST_BAR)  # on upright paper all three stand close
    _write(sheet, letters, drawing.title, left + 4, base + 2.5, 5.0, most=bar - left - GAP)
    _write(sheet, letters, drawing.name, left + 4, base - 5.5, 3.6, most=bar - left - GAP)
    _scale(sheet, letters, drawing.scale, bar, base)
    known = f"Scale 1:{drawing.scale} on {paper}" if drawing.scale else "Scale unknown"
    _write(sheet, letters, known, end, base + 2.5, 3.6, align=1, most=words)
    turn = f"{drawing.orientation}  ·  {drawing.date}"
    _write(sheet, letters, turn, end, base - 5.5, 2.8, align=1, most=words)
    if drawing.notes:
        _write(sheet, letters, drawing.notes, left + 4, MARGIN + 1.8, 2.0, most=right - left - 8, colour=GREY)
    return sheet


def contact_sheet(pictures: list[tuple[str, np.ndarray]], title: str, date: str, letters: Letters) -> Sheet:
    """Named pictures (H,W,3), at most five, on an upright A4: the first one large, the others below it in twos."""
    sheet = _empty("A4", upright=True)
    right, top = sheet.width - MARGIN, sheet.height - MARGIN
    gap, caption = 6.0, 6.0
    _write(sheet, letters, title, MARGIN, top - 6, 6.0, most=140)
    _write(sheet, letters, date, right, top - 6, 3.2, align=1, colour=GREY)
    y = top - 14
    rows = [pictures[:1], *(pictures[first : first + 2] for first in range(1, len(pictures), 2))]
    for columns, row in zip((1, *[2] * len(rows)), rows, strict=False):
        width = (right - MARGIN - (columns - 1) * gap) / columns
        heights = [width * pixels.shape[0] / pixels.shape[1] for _, pixels in row]
        for column, ((name, pixels), height) in enumerate(zip(row, heights, strict=True)):
            x = MARGIN + column * (width + gap)
            sheet.pictures.append(Picture(x=x, y=y - height, width=width, height=height, pixels=pixels))
            _write(sheet, letters, name, x, y - height - 4.2, 2.8, colour=GREY, most=width)
        y -= max(heights) + caption + gap / 2
    return sheet


def rectangle(x0: float, y0: float, x1: float, y1: float) -> np.ndarray:
    """Two triangles (2,3,2)."""
    return np.array([[(x0, y0), (x1, y0), (x1, y1)], [(x0, y0), (x1, y1), (x0, y1)]], float)


def bar_length(scale: int) -> float:
    """The longest of 1, 2, 5, 10 ... metres (or their tenths) whose bar at 1:`scale` is not too long."""
    fitting = [step * 10.0**power for power in range(-2, 5) for step in (1, 2, 5)
               if step * 10.0**power * 1000 / scale <= LONGEST_BAR]
    return max(fitting)


def _empty(paper: str, *, upright: bool) -> Sheet:
    width, height = PAPERS[paper][::-1] if upright else PAPERS[paper]
    return Sheet(width=width, height=height)


def _whole(position: float, pixels_per_mm: float) -> float:
    return round(position * pixels_per_mm) / pixels_per_mm


def _frame(sheet: Sheet, x0: float, y0: float, x1: float, y1: float) -> None:
    for corners in ((x0, y0, x1, y0 + LINE), (x0, y1 - LINE, x1, y1), (x0, y0, x0 + LINE, y1),
                    (x1 - LINE, y0, x1, y1)):
        sheet.fills.append(Fill(triangles=rectangle(*corners)))


def _write(
    sheet: Sheet, letters: Letters, text: str, x: float, y: float, size: float, *, align: float = 0,
    colour: tuple[float, float, float] = INK, most: float = np.inf,
) -> None:
    """`align` 0 begins at x, 0.5 is centred on it, 1 ends there; a text longer than `most` is made smaller."""
    triangles = letters(text) * size
    if not len(triangles):
        return
    width = float(triangles[..., 0].max())
    shrunk = min(1.0, most / width)
    place = np.array([x - align * width * shrunk, y])
    sheet.fills.append(Fill(triangles=triangles * shrunk + place, colour=colour))


def _scale(sheet: Sheet, letters: Letters, scale: int | None, x: float, y: float) -> None:
    if scale is None:
        _write(sheet, letters, "Scale unknown: do not measure", x, y - 1.3, 3.2)
        return
    metres = bar_length(scale)
    length, low, high = metres * 1000 / scale, y - 4.5, y - 2.0
    sheet.fills.append(Fill(triangles=rectangle(x, low, x + length, high)))
    parts = 4
    for part in range(1, parts, 2):  # black, white, black, white, within black lines
        inner = (x + part * length / parts, low + LINE, x + (part + 1) * length / parts - LINE, high - LINE)
        sheet.fills.append(Fill(triangles=rectangle(*inner), colour=WHITE))
    for share in (0.0, 0.5, 1.0):
        text = f"{metres * share:g}" + (" m" if share == 1 else "")
        _write(sheet, letters, text, x + share * length, y - 0.2, 2.8, align=0.5 if share < 1 else 0.3)


def _north(sheet: Sheet, letters: Letters, north: float, x: float, y: float) -> None:
    """An arrow to north about (x, y), half black and half white, with an N before its tip."""
    turn = radians(north)
    along, across = np.array([sin(turn), cos(turn)]), np.array([cos(turn), -sin(turn)])
    middle = np.array([x, y]) - 1.2 * along
    tip, notch = middle + 7 * along, middle - 3.2 * along
    for side in (-1, 1):
        half = np.array([[tip, middle - 5.5 * along + side * 3.2 * across, notch]])
        sheet.fills.append(Fill(triangles=_anticlockwise(half)))
        if side == 1:
            sheet.fills.append(Fill(triangles=_anticlockwise(_inset(half, LINE)), colour=WHITE))
    name = tip + 2 * along
    _write(sheet, letters, "N", name[0], name[1] - 0.9, 2.6, align=0.5)


def _legend(sheet: Sheet, letters: Letters, legend: tuple[Mark, ...], x: float, y: float) -> None:
    """A swatch and its words for each hatching, side by side from (x, y)."""
    height, width = 3.2, 7.0
    for mark in legend:
        for start in np.arange(x, x + width - height, HATCH * sqrt(2) / 2):
            foot, head = (start, start + height)[:: mark.slope]
            across = THICK / sqrt(2)
            line = np.array([(foot - across, y), (foot + across, y), (head + across, y + height),
                             (head - across, y + height)])
            sheet.fills.append(Fill(triangles=_anticlockwise(line[[[0, 1, 2], [0, 2, 3]]])))
        words = letters(mark.words) * 2.4
        _write(sheet, letters, mark.words, x + width + 2, y + 0.7, 2.4)
        x += width + 8 + (float(words[..., 0].max()) if len(words) else 0)


def _inset(triangles: np.ndarray, distance: float) -> np.ndarray:
    """Triangles (N,3,2), smaller by `distance` on each side."""
    opposite = np.linalg.norm(np.roll(triangles, -1, axis=1) - np.roll(triangles, -2, axis=1), axis=2)[..., None]
    middle = (triangles * opposite).sum(axis=1, keepdims=True) / opposite.sum(axis=1, keepdims=True)
    sides = triangles[:, 1:] - triangles[:, :1]
    area = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])[:, None, None] / 2
    radius = 2 * area / opposite.sum(axis=1, keepdims=True)
    result: np.ndarray = middle + (triangles - middle) * (1 - distance / radius)
    return result


def _anticlockwise(triangles: np.ndarray) -> np.ndarray:
    first, second = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    flipped = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0] < 0
    result = triangles.copy()
    result[flipped] = result[flipped][:, ::-1]
    return result
