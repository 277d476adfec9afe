# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The seconds that the sparse stage says are left, against those that then pass, on a clock of the test's own."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest

from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.sparse import progress
from curecon_blender.core.sparse.features import FeatureSettings

CORES = 2


@dataclass(frozen=True, kw_only=True)
class Job:
    """What real sets took at Preview: processor seconds for all photos, pairs, and photos again."""

    photos: int
    pairs: int
    inliers: int
    features: float
    matching: float
    mapping: float
    colours: float


JOBS = {
    "sample site": Job(photos=33, pairs=230, inliers=52_944, features=23.9, matching=20.2, mapping=3.2, colours=0.5),
    "mirafiori_drone": Job(photos=32, pairs=180, inliers=253_816, features=27.9, matching=15.3, mapping=21.9,
                           colours=1.5),
    "castle_p19_half": Job(photos=19, pairs=171, inliers=37_835, features=10.3, matching=30.5, mapping=3.7,
                           colours=0.6),
}


class Clock:
    """Stands in for the module `time`: other programs leave the work a share of the processor."""

    def __init__(self) -> None:
        self.now = self.used = 0.0

    def monotonic(self) -> float:
        return self.now

    def process_time(self) -> float:
        return self.used


def told(job: Job, clock: Clock, busy: Callable[[float], float]) -> Iterator[tuple[float, float]]:
    """When (seconds) the meter tells what is left, and what it tells; `busy` is how many times slower all goes then."""
    settings = FeatureSettings(image_size=1200, max_features=4096)
    meter = progress.Meter(Reporter(), settings, photos=job.photos, pairs=job.pairs, maps=True)
    for phase, units, cost, parallel in (
        (progress.FEATURES, job.photos, job.features, CORES),
        (progress.MATCHING, job.pairs, job.matching, CORES),
        (progress.MAPPING, job.photos, job.mapping, CORES), (progress.COLOURS, job.photos, job.colours, 1),
    ):
        meter.enter(phase)
        for done in range(units):
            clock.used += cost / units
            clock.now += cost / units / parallel * busy(clock.now)
            if phase == progress.MATCHING:
                meter.expect_matches(job.inliers * (1 + 0.3 / (done + 1)))
            meter.advance()
            yield clock.now, meter.seconds_left()


def put_on_a_clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(progress, "time", clock)
    monkeypatch.setattr(progress, "threads", lambda: CORES)
    return clock


@pytest.mark.parametrize("name", JOBS)
@pytest.mark.parametrize("busy", [1.0, 8.0])
def test_the_time_left_is_within_a_factor_of_two_from_a_tenth_of_the_stage_on(
    monkeypatch: pytest.MonkeyPatch, name: str, busy: float
) -> None:
    clock = put_on_a_clock(monkeypatch)
    said = list(told(JOBS[name], clock, lambda now: busy))
    end = said[-1][0]
    wrong = [(now / end, left, end - now) for now, left in said
             if now > 0.1 * end and not 0.5 < (left + 0.5) / (end - now + 0.5) < 2]
    assert not wrong


def test_when_other_programs_end_the_time_left_follows_within_forty_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = put_on_a_clock(monkeypatch)
    job = Job(photos=128, pairs=720, inliers=1_000_000, features=112.0, matching=61.0, mapping=88.0, colours=6.0)
    quiet = 200.0  # seconds of the clock, when the others end
    said = list(told(job, clock, lambda now: 8.0 if now < quiet else 1.0))
    end = said[-1][0]
    after = [(left + 0.5) / (end - now + 0.5) for now, left in said if now > quiet + 40]
    assert after and all(0.5 < ratio < 2 for ratio in after)
