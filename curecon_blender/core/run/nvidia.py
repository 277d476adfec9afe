# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The computer's NVIDIA card, asked of its driver's own program, before there is a torch to ask."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass

QUERY = ["nvidia-smi", "--query-gpu=name,driver_version,compute_cap", "--format=csv,noheader"]
PATIENCE = 20.0  # seconds: a sleeping card takes a few to answer
# What CUDA 13 needs, for which the locked torch is built.
FIRST_DRIVER, FIRST_CAPABILITY = 580, 7.5


@dataclass(frozen=True)
class Card:
    """`driver` is the major number of its version; `capability` is what CUDA calls the generation of the card."""

    name: str
    driver: int
    capability: float

    @property
    def too_old(self) -> bool:
        """Whether the locked torch cannot compute on it, whatever its driver."""
        return self.capability < FIRST_CAPABILITY

    @property
    def usable(self) -> bool:
        return not self.too_old and self.driver >= FIRST_DRIVER


def find_card() -> Card | None:
    """The most capable NVIDIA card, if there is one. A driver that does not know the question is from before 2021,
    and its card is not told of."""
    try:
        said = subprocess.run(
            QUERY, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=PATIENCE, check=True,
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        ).stdout
    except (OSError, subprocess.SubprocessError):
        return None
    return max((card for line in said.splitlines() if (card := _read(line))), default=None,
               key=lambda card: (card.usable, card.capability))


def _read(line: str) -> Card | None:
    name, *rest = line.rsplit(",", 2)
    try:
        driver, capability = rest
        return Card(name.strip(), int(driver.partition(".")[0]), float(capability))
    except ValueError:  # "[N/A]"
        return None
