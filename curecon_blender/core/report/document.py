# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a report is put together of, before it is laid out, and how lengths, shares and lists are said."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from PIL import Image

from ..base.language import Text

_LONG_WORD, _NUMBER = 24, 6  # letters


@dataclass(frozen=True, kw_only=True)
class Table:
    """Rows of cells under a heading each; `total` stands below them. The first column is of words, the others of
    figures, unless `words`."""

    title: Text
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    total: tuple[str, ...] | None = None
    words: bool = False


@dataclass(frozen=True)
class Picture:
    """A picture and what it shows; a `wide` one takes the page's width."""

    caption: Text
    image: Image.Image
    wide: bool = True


@dataclass(frozen=True, kw_only=True)
class Section:
    """A heading, sentences, rows of a label and its value, tables and pictures."""

    title: Text
    sentences: tuple[Text, ...]
    rows: tuple[tuple[Text, str], ...] = ()
    tables: tuple[Table, ...] = ()
    pictures: tuple[Picture, ...] = ()


def length(value: float, *, metres: bool) -> str:
    """A length in words: millimetres below a metre; in units where the scale is unknown."""
    if not metres:
        return Text("{} units", f"{value:.3g}")
    if abs(value) < 1:
        return f"{1000 * value:.1f} mm" if abs(value) < 0.1 else f"{1000 * value:.0f} mm"
    return f"{value:,.2f} m"


def rounded(value: float, *, metres: bool) -> str:
    """The same to two figures, for what is so only about."""
    value = float(f"{value:.2g}")
    if not metres:
        return Text("{} units", f"{value:g}")
    return f"{1000 * value:g} mm" if abs(value) < 1 else f"{value:g} m"


def short(name: str) -> str:
    """A camera's name without most of its number, which is a digest."""
    return " ".join(word[:_NUMBER] if len(word) > _LONG_WORD else word for word in name.split(" "))


def share(value: float) -> str:
    return f"{100 * value:.2g} %" if value < 0.1 else f"{100 * value:.0f} %"


def listed(words: Sequence[Text]) -> Text:
    """Words as a list within a sentence."""
    if not words:
        return Text("")
    if len(words) == 1:
        return words[0]
    first = words[0]
    for word in words[1:-1]:
        first = Text("{}, {}", first, word)
    return Text("{} and {}", first, words[-1])
