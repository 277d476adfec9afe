# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Places as the names of the squares of a web map that they lie in: a square's name begins those of its quarters, so
that all places in it are one range of an index."""

from __future__ import annotations

import math

DEEPEST = 12
STEP = 3  # levels from a tile of the map's catalogue to those below it
_MOST_LATITUDE = 85.05112878


def of(longitude: float, latitude: float) -> str:
    """The name of the smallest square, one of 0 to 3 for each level."""
    across = (longitude + 180) / 360 % 1
    sine = math.sin(math.radians(max(-_MOST_LATITUDE, min(_MOST_LATITUDE, latitude))))
    down = 0.5 - math.log((1 + sine) / (1 - sine)) / (4 * math.pi)
    side = 1 << DEEPEST
    x, y = (min(side - 1, max(0, int(value * side))) for value in (across, down))
    return "".join(str((x >> level & 1) + 2 * (y >> level & 1)) for level in reversed(range(DEEPEST)))


def path(key: str) -> list[str]:
    """The tiles that a place is in, the world first."""
    return [key[:level] for level in range(0, DEEPEST + 1, STEP)]
