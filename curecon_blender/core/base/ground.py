# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the ground of a site lies."""

from __future__ import annotations

import numpy as np

LEVEL = 0.9  # z of a unit normal is above it where something lies level
LEVELS = 64  # between the lowest and the highest of a site
WIDE = 0.4  # times as many points as on the widest level: the ground has them
STRAYS = 0.5, 99.5  # percentiles of all heights between which the levels lie


def lowest_wide_level(heights: np.ndarray, level: np.ndarray | None = None) -> float:
    """Height of the lowest level that spreads wide among a site's `heights` (N,), N > 0, Z up.

    Where it is known which points lie on something level, their heights `level` (M,), M > 0, alone are counted; without
    them walls count too, which spread over all levels alike and hardly change the answer.
    """
    counted = heights if level is None else level
    counts, edges = np.histogram(counted, LEVELS, np.percentile(heights, STRAYS) + [-1e-6, 1e-6])
    wide = np.convolve(counts, np.ones(3), "same")
    at = int(np.argmax(wide >= WIDE * wide.max()))
    while at + 1 < LEVELS and wide[at + 1] > wide[at]:
        at += 1
    near = counted[(counted >= edges[max(at - 1, 0)]) & (counted <= edges[min(at + 2, LEVELS)])]
    return float(np.median(near))
