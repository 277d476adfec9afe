# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How much of the computer's main memory a stage may use."""

from __future__ import annotations

import psutil

from .options import Options

SHARE = 0.6  # of what is free, where the user says nothing


def budget(options: Options) -> int:
    """Bytes of main memory that a stage may use: the option's, or SHARE of what is free; or half of that."""
    whole = SHARE * psutil.virtual_memory().available if options.memory_gib is None else options.memory_gib * 2**30
    return int(whole / 2 if options.half_memory else whole)
