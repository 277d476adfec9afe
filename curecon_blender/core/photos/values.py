# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a tag of EXIF or XMP holds, as a number or a text; a tag may hold anything."""

from __future__ import annotations

import math
from typing import Any

_MOST_TEXT = 100  # characters


def number(value: Any) -> float | None:
    """A finite float, also of a fraction in words ("5447/10"), or None for whatever else a tag may hold."""
    try:
        if isinstance(value, str) and "/" in value[:_MOST_TEXT]:
            above, _, below = value.partition("/")
            result = float(above) / float(below)
        else:
            result = float(value)
    except (TypeError, ValueError, ArithmeticError):
        return None
    return result if math.isfinite(result) else None


def positive(value: Any) -> float | None:
    told = number(value)
    return told if told is not None and told > 0 else None


def text(value: Any) -> str:
    """A tag's text up to its first NUL, on one line, without control characters."""
    if isinstance(value, bytes):
        value = value.decode("ascii", "replace")
    if not isinstance(value, str):
        return ""
    words = " ".join(value.split("\x00", 1)[0].split())
    return "".join(letter for letter in words if letter.isprintable())[:_MOST_TEXT]
