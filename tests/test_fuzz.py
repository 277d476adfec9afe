# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What is fuzzed for long by `python -m tests.fuzz` is fuzzed here for a moment, with seeds that never change."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings

from tests.fuzz import runner, targets


@pytest.mark.parametrize("name", targets.TARGETS)
def test_fuzzing_for_a_moment(tmp_path: Path, name: str) -> None:
    target = targets.TARGETS[name]
    sound, folder = tmp_path / "sound", tmp_path / "spoiled"
    for place in (sound, folder):
        place.mkdir()
        target.make(place)
    target.load(folder)

    @settings(max_examples=20, derandomize=True, database=None, deadline=None, suppress_health_check=list(HealthCheck))
    @given(target.cases(sound))
    def run(case: tuple[str, bytes]) -> None:
        runner.try_case(target, sound, folder, *case)

    run()
