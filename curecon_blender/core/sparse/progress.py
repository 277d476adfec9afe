# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The sparse stage's progress: what is done, and how many seconds are left by what each phase has taken so far.

Work is counted in processor seconds, which stay the same when other programs come and go. What those do to the clock is
measured apart, from the last half minute.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

from ..base.messages import Reporter
from .features import FeatureSettings
from .parallel import threads

FEATURES, MATCHING, MAPPING, LEARNED, COLOURS = "features", "matching", "mapping", "learned", "colours"

# Processor seconds on a reference computer. Only their ratios matter, and they only until a phase has shown its own
# pace. Features and matching are spread over all threads, mapping over about two, colours are on one.
_FEATURE_COST = 0.75  # a photo at 1200 pixels
_PAIR_COST = 0.11  # a pair of photos with 4096 features each
_INLIER_COST, _TYPICAL_INLIERS = 8e-5, 500  # mapping, a verified match; as many as a pair of photos may have
_LEARNED_COST = 1.0  # a pair of photos matched by networks, with its share of their features
_COLOUR_COST = 0.03  # a photo
_TRUST = 0.05  # share of a phase that counts as much as what was expected of it
_LATELY = 30.0  # seconds, from which is told how much of the processor other programs leave


@dataclass
class _Phase:
    units: float
    cost: float  # expected processor seconds a unit, on the reference
    threads: int
    done: float = 0.0
    fresh: float = 0.0  # of those done, in this run
    seconds: float = 0.0  # of the processor, that they took


class Meter:
    """Progress over the stage's phases in per cent, with the seconds left.

    A phase that has begun is reckoned by its own pace, one to come by what is expected of it times how slow the others
    were.
    """

    def __init__(self, reporter: Reporter, settings: FeatureSettings, *, photos: int, pairs: int, maps: bool) -> None:
        self.reporter = reporter
        self._phases = {
            FEATURES: _Phase(photos, _FEATURE_COST * (settings.image_size / 1200) ** 2, threads()),
            MATCHING: _Phase(pairs, _PAIR_COST * (settings.max_features / 4096) ** 2, threads()),
            MAPPING: _Phase(photos if maps else 0, 0.0, min(threads(), 2)),
            LEARNED: _Phase(0, _LEARNED_COST, threads()),
            COLOURS: _Phase(photos, _COLOUR_COST, 1),
        }
        self.expect_matches(_TYPICAL_INLIERS * pairs)
        self._phase = ""
        self._started = time.monotonic()
        self._last = time.monotonic(), time.process_time()
        self._waited = self._worked = 0.0  # seconds lately: of the clock, and that the work would take undisturbed
        self._found, self._told = 0.0, 0

    def expect_matches(self, inliers: float) -> None:
        """Say how many verified matches there will be: mapping takes as long."""
        mapping = self._phases[MAPPING]
        mapping.cost = _INLIER_COST * inliers / max(mapping.units, 1)

    def expect_learned(self, pairs: int) -> None:
        """Say how many pairs the networks will match in all."""
        self._phases[LEARNED].units = pairs

    def enter(self, phase: str, found: float = 0.0) -> None:
        """Begin a phase, of which so many units were found done from an earlier run."""
        self._phase, self._last = phase, (time.monotonic(), time.process_time())
        self._phases[phase].done += found
        if found:
            self._started = time.monotonic()
            self._found = self._told = int(100 * self._share_done())
            self.reporter.progress(self._told, 100, fresh=False)

    def advance(self, units: float = 1.0) -> None:
        """So many units more are done. Raises Cancelled."""
        phase, now, used = self._phases[self._phase], time.monotonic(), time.process_time()
        waited, worked = now - self._last[0], used - self._last[1]
        self._last = now, used
        phase.done, phase.fresh, phase.seconds = phase.done + units, phase.fresh + units, phase.seconds + worked
        keep = math.exp(-waited / _LATELY)
        self._waited, self._worked = keep * self._waited + waited, keep * self._worked + worked / phase.threads
        elapsed, left = now - self._started, self.seconds_left()
        share = elapsed / max(elapsed + left, 1e-9)
        self._told = max(self._told, min(int(self._found + (100 - self._found) * share), 99))
        self.reporter.progress(self._told, 100, left=left)

    def finish(self) -> None:
        self.reporter.progress(100, 100, left=0.0)

    def seconds_left(self) -> float:
        expected = sum(phase.cost * phase.fresh for phase in self._phases.values())
        slowness = (sum(phase.seconds for phase in self._phases.values()) + 0.1) / (expected + 0.1)
        left = 0.0
        for phase in self._phases.values():
            prior = max(_TRUST * phase.units, 1.0)
            pace = (prior * phase.cost * slowness + phase.seconds) / (prior + phase.fresh)
            left += pace * max(phase.units - phase.done, 0.0) / phase.threads
        return left * (self._waited + 0.1) / (self._worked + 0.1)

    def _share_done(self) -> float:
        everything = sum(phase.cost * phase.units for phase in self._phases.values())
        return sum(phase.cost * min(phase.done, phase.units) for phase in self._phases.values()) / max(everything, 1e-9)
