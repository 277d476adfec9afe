# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Up to six results on one sheet: the same view, the same light, the same scale, one colour bar, and a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw
from scipy.spatial import cKDTree

from ..base.files import atomic_write
from ..report.fonts import LATIN, Letters, letters_of
from .geometry import normals_of, one_a_voxel

MOST_RESULTS = 6
_WIDTH, _HEIGHT, _EDGE, _DPI = 3508, 2480, 90, 300  # A4 across
_LIGHT = np.array([-0.45, -0.55, 0.70])
_INK, _PALE, _GREY = (40, 40, 40), (225, 225, 225), (185, 180, 172)
_RAMP = np.array([[44, 123, 182], [171, 217, 233], [255, 255, 191], [253, 174, 97], [215, 25, 28]], float)
_MOST_DRAWN = 400_000
_BAR = 700


@dataclass(frozen=True)
class Shown:
    """A result in our frame: places (N,3) float64, colours (N,3) uint8 or None, distance (N,) of each place from the
    reference (NaN: not measured) or None where it is the reference, and its row of the table, a cell a heading."""

    name: str
    places: np.ndarray
    colours: np.ndarray | None
    distance: np.ndarray | None
    cells: tuple[str, ...]


@dataclass(frozen=True)
class View:
    """From a heading and a height, both in degrees, without perspective: pixels a unit about a middle (3,)."""

    right: np.ndarray
    up: np.ndarray
    toward: np.ndarray
    middle: np.ndarray
    scale: float


def view_of(points: np.ndarray, size: tuple[int, int], heading: float = -35.0, height: float = 32.0) -> View:
    """The view that holds these points (N,3) in a picture of this width and height."""
    a, b = np.radians([heading, height])
    toward = np.array([np.sin(a) * np.cos(b), -np.cos(a) * np.cos(b), np.sin(b)])
    right = np.array([np.cos(a), np.sin(a), 0.0])
    up = np.cross(toward, right)
    middle = np.median(points, axis=0)
    across = np.stack([(points - middle) @ right, (points - middle) @ up])
    low, high = np.percentile(across, 0.5, axis=1), np.percentile(across, 99.5, axis=1)
    scale = float((np.array(size) / np.maximum(high - low, 1e-9)).min() * 0.94)
    middle = middle + right * (low[0] + high[0]) / 2 + up * (low[1] + high[1]) / 2
    return View(right, up, toward, middle, scale)


def drawn(places: np.ndarray, rgb: np.ndarray, view: View, size: tuple[int, int]) -> Image.Image:
    """Points (N,3) of colours (N,3) as dots large enough to meet, the nearest in front."""
    width, height = size
    off = places - view.middle
    x = np.floor(off @ view.right * view.scale + width / 2).astype(np.int64)
    y = np.floor(height / 2 - off @ view.up * view.scale).astype(np.int64)
    order = np.argsort(off @ view.toward, kind="stable")  # the nearest come last, and stay
    tree = cKDTree(places[:: max(len(places) // 20_000, 1)])
    spacing = float(np.median(tree.query(tree.data[:2000], k=min(2, tree.n))[0][:, -1])) / np.sqrt(
        max(len(places) / tree.n, 1))
    dot = int(np.clip(np.ceil(2 * spacing * view.scale), 1, 9))
    shifts = np.arange(-(dot // 2), dot - dot // 2)
    dx, dy = (grid.ravel() for grid in np.meshgrid(shifts, shifts))
    columns, rows = (x[order, None] + dx).ravel(), (y[order, None] + dy).ravel()
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    picture = np.full((height * width, 3), 255, np.uint8)
    picture[rows[inside] * width + columns[inside]] = np.repeat(rgb[order], dot**2, axis=0)[inside]
    return Image.fromarray(picture.reshape(height, width, 3))


def lit(places: np.ndarray, colours: np.ndarray | None) -> np.ndarray:
    """Colours (N,3) as one light from above shows them; grey where there are none."""
    normals = normals_of(places, cKDTree(places))
    light = 0.6 + 0.4 * np.abs(normals @ (_LIGHT / np.linalg.norm(_LIGHT)))
    base = np.array(_GREY, float) if colours is None else colours.astype(float)
    shown: np.ndarray = np.clip(base * light[:, None], 0, 255).astype(np.uint8)
    return shown


def ramp(values: np.ndarray) -> np.ndarray:
    """Colours (N,3) uint8 of values from 0 to 1; pale where they are no numbers."""
    at = np.clip(np.nan_to_num(values), 0, 1) * (len(_RAMP) - 1)
    colours: np.ndarray = np.stack([np.interp(at, np.arange(len(_RAMP)), _RAMP[:, c]) for c in range(3)], 1)
    colours[np.isnan(values)] = _PALE
    return np.rint(colours).astype(np.uint8)


def write_sheet(
    folder: Path, shown: Sequence[Shown], about: np.ndarray, head: Sequence[str], title: str, notes: Sequence[str],
    most: float, unit: str,
) -> tuple[Path, Path]:
    """Write sheet.png and sheet.pdf: each result's colours, below them its distances up to `most`, and the table; the
    view holds the points `about` (N,3). Raises WorkspaceError."""
    names = {one.name for one in shown} | {cell for one in shown for cell in one.cells} | {title, unit, *notes, *head}
    letters = letters_of(set(LATIN).union(*names), None)
    sheet = Image.new("RGB", (_WIDTH, _HEIGHT), "white")
    draw = ImageDraw.Draw(sheet)
    draw.text((_EDGE, 60), title, fill=_INK, font=letters.sized(64), anchor="la")
    table_top = _HEIGHT - _EDGE - 46 * (len(shown) + 2) - 40 * len(notes)
    about = _few(about)
    columns = max(range(1, len(shown) + 1),
                  key=lambda wide: view_of(about, _cell(len(shown), wide, table_top)[1]).scale)
    (cell_width, cell_height), size = _cell(len(shown), columns, table_top)
    view = view_of(about, size)
    large = letters.sized(42)
    for number, one in enumerate(shown):
        x, y = _EDGE + number % columns * cell_width, 160 + number // columns * cell_height
        fits = max(length for length in range(len(one.name) + 1) if large.getlength(one.name[:length]) <= size[0])
        draw.text((x, y), one.name[:fits], fill=_INK, font=large, anchor="la")
        which = _chosen(one.places)
        places, colours = one.places[which], None if one.colours is None else one.colours[which]
        sheet.paste(drawn(places, lit(places, colours), view, size), (x, y + 60))
        below = (x, y + 60 + size[1])
        if one.distance is None:
            draw.text((below[0] + size[0] / 2, below[1] + size[1] / 2), "reference", fill=_GREY, font=large,
                      anchor="mm")
        else:
            sheet.paste(drawn(places, ramp(one.distance[which] / most), view, size), below)
    _bar(draw, letters, most, unit, table_top - 90)
    _length(draw, letters, view.scale, unit, table_top - 90)
    _table(draw, letters, shown, head, notes, table_top)
    png, pdf = folder / "sheet.png", folder / "sheet.pdf"
    with atomic_write(png) as file:
        sheet.save(file, "PNG", dpi=(_DPI, _DPI))
    with atomic_write(pdf) as file:
        sheet.save(file, "PDF", resolution=_DPI, quality=92)
    return png, pdf


def _cell(count: int, columns: int, bottom: int) -> tuple[tuple[int, int], tuple[int, int]]:
    """The size of a result's place on the sheet, and of each of its two pictures."""
    width, height = (_WIDTH - 2 * _EDGE) // columns, (bottom - 270) // -(-count // columns)
    return (width, height), (width - 30, (height - 70) // 2)


def _few(points: np.ndarray) -> np.ndarray:
    return points[:: max(len(points) // 50_000, 1)]


def _chosen(points: np.ndarray) -> np.ndarray:
    """Numbers of at most _MOST_DRAWN points, spread evenly."""
    if len(points) <= _MOST_DRAWN:
        return np.arange(len(points))
    extent = float(np.linalg.norm(np.percentile(_few(points), 98, axis=0) - np.percentile(_few(points), 2, axis=0)))
    which = one_a_voxel(points, extent / 900)
    return which if len(which) <= _MOST_DRAWN else which[:: len(which) // _MOST_DRAWN + 1]


def _bar(draw: ImageDraw.ImageDraw, letters: Letters, most: float, unit: str, top: int) -> None:
    left = _WIDTH - _EDGE - _BAR
    for pixel in range(_BAR):
        draw.line([(left + pixel, top), (left + pixel, top + 34)],
                  fill=tuple(ramp(np.array([pixel / _BAR]))[0].tolist()))
    for share in (0.0, 0.5, 1.0):
        text = f"{share * most:g} {unit}" + ("+" if share == 1 else "")
        draw.text((left + share * _BAR, top + 40), text, fill=_INK, font=letters.sized(30), anchor="ma")
    draw.text((left - 20, top + 17), "distance from the reference", fill=_INK, font=letters.sized(32), anchor="rm")


def _length(draw: ImageDraw.ImageDraw, letters: Letters, scale: float, unit: str, top: int) -> None:
    wanted = 500 / scale
    step = 10.0 ** np.floor(np.log10(wanted))
    length = step * max(factor for factor in (1, 2, 5) if factor * step <= wanted)
    draw.line([(_EDGE, top + 17), (_EDGE + length * scale, top + 17)], fill=_INK, width=6)
    draw.text((_EDGE, top + 40), f"{length:g} {unit}", fill=_INK, font=letters.sized(30), anchor="la")


def _table(
    draw: ImageDraw.ImageDraw, letters: Letters, shown: Sequence[Shown], head: Sequence[str], notes: Sequence[str],
    top: int,
) -> None:
    small = letters.sized(32)
    first = 640
    step = (_WIDTH - 2 * _EDGE - first) / max(len(head), 1)
    for row, (name, cells) in enumerate([("", tuple(head)), *((one.name, one.cells) for one in shown)]):
        y = top + 46 * row + 8
        draw.text((_EDGE, y), name[:34], fill=_INK, font=small, anchor="la")
        for column, cell in enumerate(cells):
            draw.text((_EDGE + first + (column + 1) * step, y), cell, fill=_INK if row else (110, 110, 110), font=small,
                      anchor="ra")
        draw.line([(_EDGE, y + 42), (_WIDTH - _EDGE, y + 42)], fill=_PALE if row else _INK, width=2)
    for row, note in enumerate(notes):
        draw.text((_EDGE, top + 46 * (len(shown) + 1) + 24 + 40 * row), note[:180], fill=_INK, font=letters.sized(28),
                  anchor="la")
