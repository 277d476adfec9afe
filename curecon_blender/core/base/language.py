# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Words for people, and their translations by the English text, one file a language.

A file is a JSON object of English to translation. {} stands for a value; a translation may number them ({1}, {0}) to
change their order, and keeps what follows a colon ({:,}) except for dates.

Text carries its message and its values, so that its translation is certain. A text that was formatted before is read
backwards, to the message that it most likely came from.
"""

from __future__ import annotations

import json
import string
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Self

FOLDER = Path(__file__).resolve().parents[2] / "languages"
JOINTS = ("  ·  ", ". ", ": ", ", ", " and ")  # between parts that are messages of their own
FEW_LETTERS = 7  # of a message whose values are numbers and names
NAME_WORDS = 6  # of a name before a message that begins with a verb: "IMG 1.jpg is a screenshot"
LONGEST = 4000


class Text(str):
    """A text for people: in English as it stands, and to be translated by its `message` and `values`.

    A value that is a Text is translated, too; one that is a plain string is a name and stays. Without values the text
    is a message itself, or one that was formatted in English before, such as a note in a file.
    """

    message: str
    values: tuple[object, ...]

    def __new__(cls, message: str, *values: object) -> Self:
        if isinstance(message, cls) and not values:
            return message
        text = super().__new__(cls, message.format(*values) if values else message)
        text.message, text.values = message, values
        return text


def load() -> dict[str, Language]:
    """Every language, by Blender's name of it."""
    files = sorted(FOLDER.glob("*.json"))
    return {file.stem: Language(json.loads(file.read_text(encoding="utf-8")), file.stem.replace("_", "-"))
            for file in files}


class Language:
    """`words` are the translations by the English text; what is empty is not translated yet. `tag` is the language's
    name as web pages have it."""

    def __init__(self, words: Mapping[str, str], tag: str = "en") -> None:
        self.tag = tag
        self.words = {text: said for text, said in words.items() if said}
        said = {text.removesuffix("."): said.removesuffix("。") for text, said in self.words.items()}
        self._said = self.words | said | self.words  # a sentence within another one has no full stop
        self._patterns = [(text, _literals(text)) for text in self._said if values(text) and _letters(text) > 1
                          and not any(name for name, _ in _parts(text))]
        self._best = lru_cache(maxsize=4096)(self._find_best)  # panels ask again at every drawing

    def translated(self, text: str) -> str:
        """A text, whole or formatted or joined of several, with what of it has a translation translated."""
        if isinstance(text, Text) and text.values:
            given = [self.translated(value) if isinstance(value, Text) else value for value in text.values]
            return (self.words.get(text.message) or self._joined(text.message)).format(*given)
        text = str(text)
        return self._best(text)[0] if len(text) <= LONGEST else text

    def said(self, text: str) -> str:
        """A Text in the language; any other string is a name and stays."""
        return self.translated(text) if self.words and isinstance(text, Text) else str(text)

    def joined(self, sentences: Sequence[str]) -> str:
        """Sentences after one another."""
        return self.words.get(". ", ". ")[1:].join(self.said(sentence) for sentence in sentences)

    def _joined(self, message: str) -> str:
        """A message that is not known as a whole, such as "{}, {} and {}", with its joints translated."""
        return "{}".join(self.words.get(literal, literal) for literal in _literals(message))

    def _find_best(self, text: str) -> tuple[str, int]:
        """The reading of a text that leaves the fewest letters in English, and their number; among equals, the one by
        the longest message."""
        begun = text[:1].upper() + text[1:]  # "north-east" within a sentence
        if said := self._said.get(text) or self._said.get(begun):
            return said, 0
        readings = [(text, _letters(text), 0), *self._by_messages(text), *self._by_parts(text)]
        return min(readings, key=lambda reading: reading[1:])[:2]

    def _by_messages(self, text: str) -> Iterator[tuple[str, int, int]]:
        """By the messages that it may have been formatted from: translation, letters left, minus the message's own."""
        for message, literals in self._patterns:
            for given in _matches(text, literals):
                found = [self._best(value) for value in given]
                # "{} photos" is no reading of a whole sentence that ends so, nor of "the photos".
                if _letters(message) >= FEW_LETTERS or not any(
                    left and (" " in said or said.isalpha()) for said, left in found
                ):
                    said = _filled(self._said[message], [said for said, _ in found])
                    yield said, sum(left for _, left in found), -sum(map(len, literals))

    def _by_parts(self, text: str) -> Iterator[tuple[str, int, int]]:
        """As several messages after one another, or as one behind a name."""
        if text.endswith(".") and (found := self._best(text[:-1]))[0] != text[:-1]:
            yield found[0] + self.words.get(". ", ". ").rstrip(), found[1], 0
        for joint in JOINTS:
            parts = text.split(joint, 1 if joint == ": " else -1)  # "IMG_1.jpg: The disk is full: ..."
            if len(parts) > 1 and all(parts):
                all_found = [self._best(part) for part in parts]
                if any(said != part for (said, _), part in zip(all_found, parts, strict=True)):
                    left = sum(left for _, left in all_found) + (len(parts) - 1) * _letters(joint)
                    yield self.words.get(joint, joint).join(said for said, _ in all_found), left, 0
        words = text.split(" ")
        for count in range(1, min(NAME_WORDS, len(words) - 2) + 1):
            name, rest = " ".join(words[:count]), " ".join(words[count:])
            if rest[:1].islower():
                whole = [(self._said[rest], 0, 0)] if rest in self._said else [*self._by_messages(rest)]
                yield from ((f"{name} {said}", _letters(name) + left, 0) for said, left, _ in whole)


ENGLISH = Language({})


def of_name(name: str) -> Language:
    """A language by Blender's name of it; English where there is none such."""
    return load().get(name, ENGLISH)


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
    return sum(letter.isalpha() for letter in message)


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
