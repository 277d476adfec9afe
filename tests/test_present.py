# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The sun, the flights and the sheets of the step Present, and what they make in Blender 4.5 LTS and 5.2 LTS."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from test_extension import blender, run_script  # noqa: F401

from curecon_blender.core import capture, sun
from curecon_blender.core.errors import WorkspaceError

GREENWICH = (51.4779, 0.0)


def highest(day: datetime, latitude: float, longitude: float) -> float:
    minutes = [day.replace(hour=m // 60, minute=m % 60, tzinfo=UTC) for m in range(1440)]
    return max(sun.position(minute, latitude, longitude)[1] for minute in minutes)


@pytest.mark.parametrize(("month", "tilt"), [(6, 23.44), (12, -23.44)])
def test_the_sun_at_the_solstices_is_as_high_as_the_earths_tilt_says(month: int, tilt: float) -> None:
    day = datetime(2024, month, 21)
    assert highest(day, *GREENWICH) == pytest.approx(90 - GREENWICH[0] + tilt, abs=0.1)
    assert highest(day, -33.87, 151.21) == pytest.approx(90 - 33.87 - tilt, abs=0.1)  # Sydney
    assert highest(day, tilt, 117.0) == pytest.approx(90, abs=0.3)  # in the zenith on that tropic


def test_the_sun_of_an_equinox_rises_in_the_east_and_sets_in_the_west() -> None:
    day = [datetime(2024, 3, 20, m // 60, m % 60, tzinfo=UTC) for m in range(1440)]
    for latitude in (0.0, 40.0, -35.0):
        places = np.array([sun.position(minute, latitude, 0.0) for minute in day])
        crossings = np.flatnonzero(np.diff(np.sign(places[:, 1])))
        assert sorted(places[crossings, 0]) == pytest.approx([90, 270], abs=0.5)


def test_the_sun_is_due_south_at_greenwich_when_the_equation_of_time_says() -> None:
    # Published equation of time: +16 min 25 s on 3 November, -14 min 14 s on 11 February.
    for moment in (datetime(2024, 11, 3, 11, 43, 35, tzinfo=UTC), datetime(2024, 2, 11, 12, 14, 14, tzinfo=UTC)):
        assert sun.position(moment, *GREENWICH)[0] == pytest.approx(180, abs=0.1)


def test_the_sun_of_the_sample_site_is_where_its_shadows_say() -> None:
    # 28 September 2024, 10:49 in Fujian: the almanac's declination is -2.0 degrees, solar time 10:46.
    azimuth, altitude = sun.position(datetime(2024, 9, 28, 2, 49, tzinfo=UTC), 24.658, 117.052)
    hour, declination, place = np.radians([(10 + 46.5 / 60 - 12) * 15, -2.04, 24.658])
    expected = np.degrees(np.arcsin(np.sin(declination) * np.sin(place)
                                    + np.cos(declination) * np.cos(place) * np.cos(hour)))
    assert altitude == pytest.approx(expected, abs=0.5)
    assert 140 < azimuth < 150
    east, north, up = sun.direction(azimuth, altitude)
    assert east > 0 > north and up == pytest.approx(np.sin(np.radians(altitude)))
    np.testing.assert_allclose(sun.direction(90, 0, north=90), [0, -1, 0], atol=1e-12)  # north is +X: east is -Y


def test_capture_times_come_in_order_and_say_what_is_known_of_their_zone(tmp_path: Path) -> None:
    with pytest.raises(WorkspaceError, match="capture times are unknown"):
        capture.read_times(tmp_path)
    photos = [{"name": "c", "time": "2024-09-28T10:49:00+08:00"}, {"name": "a", "time": "2024-09-28T10:48:00"},
              {"name": "b", "time": None}, {"name": "d", "time": "2024-09-28T10:50:00"}]
    (tmp_path / capture.FILE_NAME).write_text(json.dumps({"photos": photos, "skipped": []}))
    times = capture.read_times(tmp_path)
    assert list(times) == ["a", "c", "d"] and capture.middle_time(times) == times["c"]
    assert capture.to_utc(times["c"], 0.0) == datetime(2024, 9, 28, 2, 49, tzinfo=UTC)  # its own offset counts
    assert capture.to_utc(times["a"], 117.0) == datetime(2024, 9, 28, 2, 48, tzinfo=UTC)  # the longitude's hour
    (tmp_path / capture.FILE_NAME).write_text("{")
    with pytest.raises(WorkspaceError, match="damaged"):
        capture.read_times(tmp_path)


def test_the_sun_falls_as_on_the_day_of_the_photos(blender: Path, tmp_path: Path) -> None:  # noqa: F811
    run_script(blender, "check_present_sun.py", tmp_path, resources=tmp_path / "user")
