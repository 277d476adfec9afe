# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Work on many photos or pairs at the same time, within reason."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from typing import TypeVar

MAX_THREADS = 16

Step = Callable[[], None]  # called after every photo or pair; raises Cancelled
Item = TypeVar("Item")
Value = TypeVar("Value")


def threads() -> int:
    """Cores that this process may use, within reason."""
    return min(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1, MAX_THREADS)


def in_order(
    function: Callable[[Item], Value], items: Iterable[Item], workers: int
) -> Generator[tuple[Item, Value], None, None]:
    """`function` of every item, in order, computed `workers` at a time and never far ahead of the consumer."""
    left = iter(items)
    with ThreadPoolExecutor(workers) as pool:
        running: list[tuple[Item, Future[Value]]] = [(i, pool.submit(function, i)) for i in islice(left, 2 * workers)]
        try:
            while running:
                item, future = running.pop(0)
                value = future.result()
                running += [(i, pool.submit(function, i)) for i in islice(left, 1)]
                yield item, value
        finally:
            for _, future in running:
                future.cancel()
