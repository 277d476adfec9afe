# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Loops over pixels that a CPU runs as machine code, in bands of rows on as many threads as torch may use."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import torch
from numba import njit

# What may be reordered; not that there are no NaNs, since a NaN must never become an index.
_FAST = {"contract", "reassoc", "arcp", "nsz"}
compiled: Any = njit(nogil=True, fastmath=_FAST, error_model="numpy")


def in_bands(height: int, work: Callable[[int, int, int], None]) -> None:
    """`work(top, bottom, band)` over as many bands of rows as torch may use threads."""
    bands = torch.get_num_threads()
    edges = [height * band // bands for band in range(bands + 1)]
    if bands == 1:
        work(0, height, 0)
        return
    with ThreadPoolExecutor(bands) as pool:
        list(pool.map(work, edges[:-1], edges[1:], range(bands)))
