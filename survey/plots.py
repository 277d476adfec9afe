# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The report's plots, drawn with Pillow: shares of each answer, and the residuals of a regression."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw
from scipy import stats

from curecon_blender.core.report.fonts import Letters

from .items import LEAST, MOST
from .statistics import spread

WIDTH = 1400
_INK, _PALE, _PAPER, _DOT = (40, 40, 40), (225, 225, 225), (255, 255, 255), (33, 102, 172)
_ANSWERS = ((202, 90, 40), (240, 180, 130), (218, 218, 218), (140, 185, 220), (33, 102, 172))  # told apart by all
_LETTERS, _BAR, _GAP, _LEFT = 24, 34, 12, 400
_TICKS = 5


def shares(rows: Sequence[tuple[str, np.ndarray]], words: Sequence[str], letters: Letters) -> Image.Image:
    """A bar for each named set of ratings (n,): the share of each answer, with the mean behind it. `words` name the
    answers."""
    top, foot = 60, 20
    image = Image.new("RGB", (WIDTH, top + len(rows) * (_BAR + _GAP) + foot), _PAPER)
    draw, font = ImageDraw.Draw(image), letters.sized(_LETTERS)
    width = WIDTH - _LEFT - 170
    x = float(_LEFT)
    for colour, word in zip(_ANSWERS, words, strict=True):
        draw.rectangle((x, 16, x + 22, 38), fill=colour)
        draw.text((x + 30, 27), word, fill=_INK, font=font, anchor="lm")
        x += 30 + int(font.getlength(word)) + 34
    for number, (name, values) in enumerate(rows):
        y = top + number * (_BAR + _GAP)
        draw.text((_LEFT - 16, y + _BAR / 2), _fitted(name, font, _LEFT - 30), fill=_INK, font=font, anchor="rm")
        known = np.rint(values[~np.isnan(values)])
        if not len(known):
            continue
        x = float(_LEFT)
        for answer, colour in enumerate(_ANSWERS, LEAST):
            share = float((known == answer).mean())
            draw.rectangle((x, y, x + share * width, y + _BAR), fill=colour)
            if share > 0.06:
                ink = _PAPER if answer in (LEAST, MOST) else _INK
                draw.text((x + share * width / 2, y + _BAR / 2), f"{100 * share:.0f}", fill=ink, font=font, anchor="mm")
            x += share * width
        draw.text((x + 16, y + _BAR / 2), f"{spread(values).mean:.2f}", fill=_INK, font=font, anchor="lm")
    return image


def _fitted(text: str, font: object, most: int) -> str:
    while len(text) > 4 and font.getlength(text) > most:  # type: ignore[attr-defined]
        text = text[:-2].rstrip("…") + "…"
    return text


def residuals(fitted: np.ndarray, left: np.ndarray, words: tuple[str, str, str, str], letters: Letters) -> Image.Image:
    """Residuals (n,) over fitted values, and over those of a normal distribution, side by side. `words` name the axes:
    fitted, residual, normal, residual."""
    half = WIDTH // 2
    image = Image.new("RGB", (WIDTH, 560), _PAPER)
    normal = stats.norm.ppf((np.arange(len(left)) + 0.5) / len(left)) * left.std(ddof=1)
    _scatter(image, (0, half), fitted, left, words[:2], letters, diagonal=False)
    _scatter(image, (half, WIDTH), normal, np.sort(left), words[2:], letters, diagonal=True)
    return image


def _scatter(
    image: Image.Image, across: tuple[int, int], x: np.ndarray, y: np.ndarray, words: Sequence[str], letters: Letters,
    *, diagonal: bool,
) -> None:
    draw, font = ImageDraw.Draw(image), letters.sized(_LETTERS)
    left, right, top, bottom = across[0] + 100, across[1] - 30, 50, image.height - 80
    (low_x, high_x), (low_y, high_y) = _range(x), _range(y)

    def place(a: float, b: float) -> tuple[float, float]:
        return (left + (a - low_x) / (high_x - low_x) * (right - left),
                bottom - (b - low_y) / (high_y - low_y) * (bottom - top))

    for tick in np.linspace(0, 1, _TICKS):
        a, b = low_x + tick * (high_x - low_x), low_y + tick * (high_y - low_y)
        draw.line([place(low_x, b), place(high_x, b)], fill=_PALE, width=2)
        draw.text((left - 10, place(low_x, b)[1]), f"{round(b, 1) + 0.0:.1f}", fill=_INK, font=font, anchor="rm")
        draw.text((place(a, low_y)[0], bottom + 10), f"{round(a, 1) + 0.0:.1f}", fill=_INK, font=font, anchor="ma")
    ends = (max(low_x, low_y), min(high_x, high_y)) if diagonal else (low_x, high_x)
    draw.line([place(end, end if diagonal else 0.0) for end in ends], fill=_INK, width=2)
    for a, b in zip(x.tolist(), y.tolist(), strict=True):
        column, row = place(a, b)
        draw.ellipse((column - 5, row - 5, column + 5, row + 5), fill=_DOT)
    draw.text(((left + right) / 2, image.height - 12), words[0], fill=_INK, font=font, anchor="md")
    draw.text((left, 12), words[1], fill=_INK, font=font, anchor="la")


def _range(values: np.ndarray) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    edge = max(0.08 * (high - low), 0.1)
    return low - edge, high + edge
