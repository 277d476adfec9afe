# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Predicted time, memory and disk, against the runs in benchmarks/RESULTS.md and the jobs of one computer."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from curecon_blender.core.base import images, messages
from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.base.options import PRESETS, STAGES, Options
from curecon_blender.core.base.records import GeoPosition, Photo
from curecon_blender.core.run import cost

REFERENCE = dict.fromkeys(STAGES, 1.0)


def site(count: int, width: int, height: int, *, gps: bool = True) -> tuple[Photo, ...]:
    return tuple(
        Photo(
            name=f"{i}.jpg", path=Path(f"{i}.jpg"), width=width, height=height, camera="c", focal_px=float(width),
            gps=GeoPosition(latitude=45 + row * 1e-4, longitude=7 + column * 1e-4, altitude=300.0) if gps else None,
        )
        for i in range(count) for row, column in [divmod(i, 6)]
    )


def reference_seconds(photos: tuple[Photo, ...], options: Options) -> dict[str, float]:
    return cost.reference_seconds(photos, cost.count_pairs(photos), options)


def predict(photos: tuple[Photo, ...], options: Options) -> dict[str, Any]:
    return cost.predict(photos, cost.count_pairs(photos), options, REFERENCE)


# photos, width, height, GPS, quality, measured seconds of sparse, depth and fusion, and peak GiB
MEASURED = [
    (33, 1200, 900, True, "standard", None, 334, 23, None),
    (32, 1600, 1300, True, "preview", 68, 85, 9, 2.3),
    (11, 2832, 2128, False, "preview", None, 33, 3, 1.6),
    (11, 3072, 2048, False, "preview", None, 34, 3, 1.8),
    (172, 800, 600, True, "preview", None, 375, 42, None),
]


@pytest.mark.parametrize(("count", "width", "height", "gps", "quality", "sparse", "depth", "fusion", "peak"), MEASURED)
def test_known_runs_are_predicted(
    count: int, width: int, height: int, gps: bool, quality: str, sparse: float | None, depth: float, fusion: float,
    peak: float | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(cost, "threads", lambda: 2)  # the reference's
    options = Options(photos=None, workspace=tmp_path, quality=quality, memory_gib=10.0)
    photos = site(count, width, height, gps=gps)
    seconds = reference_seconds(photos, options)
    if sparse is None:  # not measured since the stage was last changed, like a peak
        sparse = seconds["sparse"]
    assert seconds["sparse"] == pytest.approx(sparse, rel=0.4)
    assert seconds["depth"] == pytest.approx(depth, rel=0.55)
    assert seconds["fusion"] == pytest.approx(fusion, rel=0.3)
    predicted = predict(photos, options)
    assert predicted["seconds"] == pytest.approx(sparse + depth + fusion, rel=0.35)
    if peak is not None:
        assert predicted["memory_gib"] == pytest.approx(peak, rel=0.3)


def test_better_costs_more_and_so_does_going_further(tmp_path: Path) -> None:
    predicted = cost.predict_all(site(20, 5472, 3648), Options(photos=None, workspace=tmp_path), REFERENCE)
    seconds = [predicted[quality]["fusion"]["seconds"] for quality in PRESETS]
    disk = [predicted[quality]["fusion"]["disk_gib"] for quality in PRESETS]
    assert seconds == sorted(seconds) and len(set(seconds)) == 4
    assert disk == sorted(disk) and len(set(disk)) == 4
    goals = [predicted["standard"][goal] for goal in cost.GOALS]
    assert [goal["seconds"] for goal in goals] == sorted(goal["seconds"] for goal in goals)


def test_the_pairs_of_photos_are_counted_once_for_all_qualities_and_goals(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    photos, options = site(70, 1600, 1200), Options(photos=None, workspace=tmp_path, memory_gib=4.0)
    one_by_one = {
        quality: {goal: predict(photos, replace(options, quality=quality, until=goal)) for goal in cost.GOALS}
        for quality in PRESETS
    }
    counted = []
    metadata_pairs = cost.metadata_pairs
    monkeypatch.setattr(cost, "metadata_pairs", lambda photos: counted.append(photos) or metadata_pairs(photos))
    assert cost.predict_all(photos, options, REFERENCE) == one_by_one
    assert counted == [photos]


def test_predictions_come_true_after_the_first_job(tmp_path: Path) -> None:
    speeds = tmp_path / "user" / "speeds.json"
    options = Options(photos=None, workspace=tmp_path, speeds=speeds, device="cpu")
    photos = site(20, 1600, 1200)
    took = {stage: 3.7 * seconds for stage, seconds in reference_seconds(photos, options).items()}
    for stage in ("sparse", "depth", "fusion"):
        cost.learn(stage, took[stage], photos, options)
    bigger = site(40, 1600, 1200)
    slowness = cost.slowness_here("cpu", speeds)
    expected = reference_seconds(bigger, options)
    for stage in ("sparse", "depth", "fusion"):
        assert slowness[stage] * expected[stage] == pytest.approx(3.7 * expected[stage], rel=0.01)


def test_a_first_job_on_a_busy_computer_is_known_to_take_longer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Programs that give way do not count, those that queue do; what finished jobs took here is taken as it is."""
    monkeypatch.setattr(cost, "_probe", lambda device: dict(REFERENCE))
    monkeypatch.setattr(cost.psutil, "cpu_count", lambda: 4)
    monkeypatch.setattr(cost.psutil, "getloadavg", lambda: (12.0, 0.0, 0.0))
    options = Options(photos=None, workspace=tmp_path, speeds=tmp_path / "speeds.json", device="cpu")
    photos = site(20, 1600, 1200)
    cost.learn("depth", 1.5 * reference_seconds(photos, options)["depth"], photos, options)
    for user, system, expected in ((0.0, 0.0, 1.0), (40.0, 10.0, 1.5), (90.0, 10.0, 4.0)):
        used = SimpleNamespace(user=user, system=system, nice=50.0)
        monkeypatch.setattr(cost.psutil, "cpu_times_percent", lambda interval, used=used: used)
        slowness = cost.slowness_here("cpu", options.speeds)
        assert slowness["sparse"] == pytest.approx(expected)
        assert slowness["depth"] == pytest.approx(1.5, rel=0.01)


def test_a_resumed_stage_is_known_as_such() -> None:
    reporter = Reporter()
    reporter.begin({"depth": 0.9, "fusion": 0.1})
    reporter.stage("depth")
    reporter.progress(1, 3)
    assert not reporter.resumed
    reporter.progress(2, 3, fresh=False)
    assert reporter.resumed
    reporter.stage("fusion")
    assert not reporter.resumed


def test_one_slow_job_does_not_spoil_the_rest_and_a_damaged_file_is_learned_anew(tmp_path: Path) -> None:
    speeds = tmp_path / "speeds.json"
    options = Options(photos=None, workspace=tmp_path, speeds=speeds, device="cpu")
    photos = site(20, 1600, 1200)
    speeds.write_text("half of a fi")
    for ratio in (2.0, 2.0, 40.0):
        cost.learn("depth", ratio * reference_seconds(photos, options)["depth"], photos, options)
    assert cost.slowness_here("cpu", speeds)["depth"] == pytest.approx(2.0, rel=0.01)


def test_the_depth_stage_keeps_to_its_budget(tmp_path: Path) -> None:
    photos = site(20, 8000, 6000)
    options = Options(photos=None, workspace=tmp_path, quality="preview")
    wide = predict(photos, replace(options, max_image_size=8000, memory_gib=100.0))
    tight = predict(photos, replace(options, max_image_size=8000, memory_gib=2.0))
    assert tight["memory_gib"] < 4 < wide["memory_gib"]


def test_a_large_site_needs_no_more_memory_than_its_mesh_of_a_million_faces(tmp_path: Path) -> None:
    options = Options(photos=None, workspace=tmp_path, quality="standard", memory_gib=4.0, until="texture")
    memory = [predict(site(count, 1600, 1200), options)["memory_gib"] for count in (4, 240, 2000)]
    assert memory[0] < memory[1] == memory[2] < 8
    assert predict(site(240, 1600, 1200), replace(options, quality="preview"))["memory_gib"] < 2


def test_many_cores_do_not_read_huge_photos_all_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert [images.readers(megapixels * 1_000_000, 16) for megapixels in (0, 20, 48, 100, 500)] == [16, 16, 11, 5, 1]
    monkeypatch.setattr(cost, "threads", lambda: 16)
    options = Options(photos=None, workspace=tmp_path, quality="preview", memory_gib=2.0)
    assert predict(site(20, 11664, 8750), options)["memory_gib"] < 8


def test_a_short_stage_that_lags_does_not_make_a_long_one_endless(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, told = [0.0], []
    monkeypatch.setattr(messages.time, "monotonic", lambda: clock[0])
    reporter = messages.Reporter(told.append)
    reporter.begin({"sparse": 100.0, "views": 1.0, "depth": 1000.0})
    for stage, seconds in (("sparse", 110.0), ("views", 30.0)):
        reporter.stage(stage)
        for done in range(1, 11):
            clock[0] += seconds / 10
            reporter.progress(done, 10)
    assert told[-1].eta == pytest.approx(1000 * 140 / 101, rel=0.01)
