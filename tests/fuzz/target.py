# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a target of fuzzing is."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from hypothesis import strategies as st

from curecon_blender.core.base.errors import CuReconError

PHOTO = "DJI_0001.JPG"  # in every sound folder that has one


@dataclass(frozen=True)
class Target:
    """`make` writes a sound folder; `cases` draws (file in it, its new bytes); `read` reads the spoiled folder."""

    make: Callable[[Path], None]
    cases: Callable[[Path], st.SearchStrategy[tuple[str, bytes]]]
    read: Callable[[Path], object]

    def load(self, folder: Path) -> None:
        """Read the sound file; the first time that also loads the libraries."""
        with suppress(CuReconError):
            self.read(folder)
