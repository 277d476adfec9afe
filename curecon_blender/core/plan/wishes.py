# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a person asks of a flight. No library is needed: the command line declares its arguments from here."""

from __future__ import annotations

from dataclasses import dataclass

# What is flown for a kind of building, and single forms (mission.py).
KINDS = ("building", "tulou", "tower", "facade", "courtyard", "ruin", "grid", "crossed", "orbit", "helix")

MOST_PHOTOS = 30  # that are asked for to close gaps


@dataclass(frozen=True, kw_only=True)
class Wishes:
    """How it is to be flown: `pixel` millimetres on the building; overlaps of a photo with the one before and with the
    neighbouring line, 0 to 1; least distance to anything (`clearance`), greatest height above take-off (`ceiling`) and
    the place of take-off, in metres; `above` is the height of grids above the building, in place of the one that
    `pixel` gives; `kept_back` is the share of a battery that is not flown."""

    pixel: float = 10.0
    forward: float = 0.8
    side: float = 0.7
    clearance: float = 5.0
    ceiling: float = 120.0
    takeoff: tuple[float, float, float] = (0.0, 0.0, 0.0)
    above: float | None = None
    kept_back: float = 0.3

    @property
    def top(self) -> float:
        """The greatest height that may be flown, above the ground at the building."""
        return self.takeoff[2] + self.ceiling
