# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Cubes that space is cut into, each with a number."""

from __future__ import annotations

import numpy as np

STEPS = np.array([1 << 42, 1 << 21, 1])  # from a cube's number to the next one's along each axis


def cell_numbers(points: np.ndarray, low: np.ndarray, side: float) -> np.ndarray:
    """The numbers (n,) int64 of the cubes that points (n,3) lie in, counted from a corner `low` (3,) below them all."""
    numbers: np.ndarray = np.floor((points - low) / side).astype(np.int64) @ STEPS
    return numbers
