# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The C library's memory allocator, set for a process that fills and drops large arrays all the time."""

from __future__ import annotations

import ctypes
import os
import platform
import sys

# By default glibc returns every large array to the system and fetches fresh pages for the next, four kilobytes at a
# time: filling those takes longer than the arithmetic. With these it keeps them, in huge pages.
_GLIBC = {
    "GLIBC_TUNABLES": "glibc.malloc.hugetlb=1",
    "MALLOC_MMAP_MAX_": "0",
    "MALLOC_TRIM_THRESHOLD_": str(1 << 33),
    "MALLOC_TOP_PAD_": str(64 << 20),
}


def use_large_pages() -> None:
    """Start this program again, in the same process, with the allocator set; returns where there is nothing to do.

    The allocator reads its settings when a program starts, so setting them from within comes too late. Call it before
    anything else is done. What the user has set stands.
    """
    if platform.libc_ver()[0] == "glibc" and not any(name in os.environ for name in _GLIBC):
        os.execve(sys.executable, sys.orig_argv, {**os.environ, **_GLIBC})


def release() -> None:
    """Give memory that is free back to the system, which the settings above keep for the next depth map."""
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc has it, other C libraries may not
        if trim is not None:
            trim(0)
