# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the server refuses, and why, in English and in the languages of `languages/`."""

from __future__ import annotations

import json
import struct
from functools import cache
from pathlib import Path

from curecon_blender.core.base import language
from curecon_blender.core.base.language import ENGLISH, Language, Text

LANGUAGES = Path(__file__).parent / "languages"
_MOST = 200  # letters of what a stranger's file may have part in: reading it backwards takes a while
_NAMES = {"zh": "zh_HANS"}  # by the first letters of a browser's name for a language


class Problem(Exception):
    """An answer other than the one that was asked for: `status` of HTTP, a `code` that programs know it by, and a Text
    that says what to do, to be translated."""

    def __init__(self, status: int, code: str, said: str, **facts: object) -> None:
        super().__init__(said)
        self.status, self.code, self.said, self.facts = status, code, Text(said), facts


def refused(said: str) -> Problem:
    """Of an upload's files."""
    return Problem(422, "refused", said)


def why(error: Exception) -> Text:
    """What an error of a reader says, to be a value of another Text."""
    if isinstance(error, (json.JSONDecodeError, UnicodeDecodeError)):
        return Text("it is no JSON")
    if isinstance(error, RecursionError):
        return Text("its values are nested too deeply")
    if isinstance(error, struct.error):
        return Text("it is cut short")
    said = error.args[0] if error.args else ""
    return said if isinstance(said, Text) else Text(str(error)[:_MOST])


def language_of(accepted: str) -> Language:
    """The language that a request asks for first, in its header Accept-Language."""
    return _language(_NAMES.get(accepted.strip()[:2].lower(), ""))


@cache
def _language(name: str) -> Language:
    """The server's words, and those of the extension's readers, which it checks strangers' files with."""
    if not name:
        return ENGLISH
    words = json.loads((LANGUAGES / f"{name}.json").read_text(encoding="utf-8"))
    return Language({**language.of_name(name).words, **words}, name.replace("_", "-"))
