# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Translations by the English text, one file a language, also of texts that were formatted in English.

A file is a JSON object of English to translation. {} stands for a value; a translation may number them ({1}, {0}) to
change their order, and keeps what follows a colon ({:,}) except for dates.
"""

from __future__ import annotations

import json
import string
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
JOINTS = ("  ·  ", ". ", ": ", ", ", " and ")  # between parts that are messages of their own
FEWEST_LETTERS = 2  # of a message with values: with fewer, nearly every text could have come from it
LONGEST = 4000


def load() -> dict[str, Language]:
    """Every language, by Blender's name of it."""
    files = sorted(FOLDER.glob("*.json"))
    return {file.stem: Language(json.loads(file.read_text(encoding="utf-8"))) for file in files}


class Language:
    """`words` are the translations by the English text; what is empty is not translated yet."""

    def __init__(self, words: Mapping[str, str]) -> None:
        self.words = {text: said for text, said in words.items() if said}
        said = {text.removesuffix("."): said.removesuffix("。") for text, said in self.words.items()}
        self._said = self.words | said | self.words  # a sentence within another one has no full stop
        self._patterns = [(text, _literals(text)) for text in self._said
                          if values(text) and _letters(text) >= FEWEST_LETTERS and not any(n for n, _ in _parts(text))]
        self._best = lru_cache(maxsize=4096)(self._find_best)  # panels ask again at every drawing

    def translated(self, text: str) -> str:
        """A text, whole or formatted or joined of several, with what of it has a translation translated."""
        return self._best(text)[0] if len(text) <= LONGEST else text

    def _find_best(self, text: str) -> tuple[str, int]:
        """The reading of a text that leaves the fewest letters in English, and their number."""
        begun = text[:1].upper() + text[1:]  # "north-east" within a sentence
        if said := self._said.get(text) or self._said.get(begun):
            return said, 0
        readings = [(text, sum(letter.isalpha() for letter in text))]
        for message, literals in self._patterns:
            for given in _matches(text, literals):
                found = [self._best(value) for value in given]
                readings.append((_filled(self._said[message], [said for said, _ in found]), sum(n for _, n in found)))
        for joint in JOINTS:
            parts = text.split(joint, 1 if joint == ": " else -1)  # "IMG_1.jpg: The disk is full: ..."
            if len(parts) > 1 and all(parts):
                found = [self._best(part) for part in parts]
                if any(said != part for (said, _), part in zip(found, parts, strict=True)):
                    between = self.words.get(joint, joint)
                    left = sum(n for _, n in found) + (len(parts) - 1) * _letters(joint)
                    readings.append((between.join(said for said, _ in found), left))
        return min(readings, key=lambda reading: reading[1])


def values(message: str) -> set[tuple[str, str]]:
    """A message's values: the number of each and how it is formatted; a date may be formatted in any way."""
    return {(name.partition(".")[0] or str(count), "" if form.startswith("%") else form)
            for count, (name, form) in enumerate(_parts(message))}


def _parts(message: str) -> Iterator[tuple[str, str]]:
    """Name and format of each value."""
    for _, name, form, _ in string.Formatter().parse(message):
        if name is not None:
            yield name, form or ""


def _filled(said: str, given: list[str]) -> str:
    """A translation with values that are text already."""
    parts, count = [], 0
    for literal, name, _, _ in string.Formatter().parse(said):
        parts.append(literal)
        if name is not None:
            parts.append(given[int(name) if name else count])
            count += 1
    return "".join(parts)


def _letters(message: str) -> int:
    return sum(letter.isalpha() for literal, *_ in string.Formatter().parse(message) for letter in literal)


def _literals(message: str) -> list[str]:
    """What stands before, between and after its values."""
    found = [""]
    for literal, name, _, _ in string.Formatter().parse(message):
        found[-1] += literal
        if name is not None:
            found.append("")
    return found


def _matches(text: str, literals: list[str]) -> Iterator[list[str]]:
    """The values with which the literals give the text: as short as they can be from the left, then from the right."""
    first, *middle, last = literals
    end = len(text) - len(last)
    if len(first) > end or not (text.startswith(first) and text.endswith(last)):
        return
    cuts, start = [], len(first)
    for literal in middle:
        at = text.find(literal, start, end)
        if at < 0:
            return
        cuts.append(text[start:at])
        start = at + len(literal)
    yield [*cuts, text[start:end]]
    if middle:
        cuts, stop = [], end
        for literal in reversed(middle):
            at = text.rfind(literal, len(first), stop)
            cuts.append(text[at + len(literal) : stop])
            stop = at
        yield [text[len(first) : stop], *reversed(cuts)]
