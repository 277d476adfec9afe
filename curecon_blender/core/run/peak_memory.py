# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The most memory that a piece of work takes."""

from __future__ import annotations

import threading

import psutil


class PeakMemory:
    """The largest resident memory of the process and its children while the block runs, sampled ten times a second."""

    def __enter__(self) -> PeakMemory:
        self._process = psutil.Process()
        self.bytes = self._process.memory_info().rss
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._sample, daemon=True)
        self._thread.start()
        return self

    def _sample(self) -> None:
        while not self._stop.wait(0.1):
            self.bytes = max(self.bytes, sum(map(_resident, [self._process, *self._process.children()])))

    def __exit__(self, *exception: object) -> None:
        self._stop.set()
        self._thread.join()


def _resident(process: psutil.Process) -> int:
    try:
        return int(process.memory_info().rss)
    except psutil.NoSuchProcess:  # a child that has just ended
        return 0
