# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A model that is bent is told of, and one whose heights rest on nothing; one that is sound is not."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from test_adjust import ORIGIN, flight

from curecon_blender.core.adjust import bending
from curecon_blender.core.adjust.adjust import adjust_model, lenses_found
from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.base.records import SEA_LEVEL, GeoPosition, Photo
from curecon_blender.core.photos import shutter
from curecon_blender.core.photos.check import with_one_datum

ABOVE = 45.0


def grid(bend: float, noise: float) -> tuple[list[Photo], np.ndarray]:
    """Thirty photos at one height above take-off, told to 6 cm, whose model is bent by so much at its edge."""
    rng = np.random.default_rng(4)
    plan = np.stack(np.meshgrid(np.arange(6) * 9.0, np.arange(5) * 9.0), axis=-1).reshape(-1, 2)
    squared = ((plan - plan.mean(axis=0)) ** 2).sum(axis=1)
    heights = ABOVE + bend * squared / squared.max() + rng.normal(0, noise, len(plan))
    photos = [Photo(name=f"{n}.jpg", path=Path(f"{n}.jpg"), width=1600, height=1200, camera="DJI FC3682", focal_px=1e3,
                    relative_altitude=ABOVE + rng.normal(0, 0.06), speed=5.0) for n in range(len(plan))]
    return photos, np.column_stack([plan, heights])


@pytest.mark.parametrize("bend", [-1.8, 1.8])
def test_a_bent_model_is_told_against_the_height_above_take_off(bend: float) -> None:
    photos, centres = grid(bend, 0.02)
    found = bending.domes(photos, centres, np.full(30, np.nan), ABOVE)
    assert [dome.source for dome in found] == [bending.RELATIVE_ALTITUDE]
    assert found[0].bend == pytest.approx(bend, abs=0.15)
    said = bending.doubt(found, None)
    assert f"{abs(found[0].bend):.2f} m" in said and ("raised" if bend < 0 else "lowered") in said


@pytest.mark.parametrize(("bend", "noise"), [(0.0, 0.02), (0.2, 0.02), (0.0, 0.6)])
def test_a_sound_model_is_left_in_peace(bend: float, noise: float) -> None:
    photos, centres = grid(bend, noise)
    gps = centres[:, 2] + np.random.default_rng(1).normal(0, 2, 30)
    assert bending.doubt(bending.domes(photos, centres, gps, ABOVE), 0.003) == ""


@pytest.mark.parametrize(("oblique", "calibrated"), [(False, True), (False, False), (True, False)])
def test_heights_are_doubtful_where_neither_the_photos_nor_the_maker_tell_the_focal_length(
    oblique: bool, calibrated: bool
) -> None:
    model, photos, _ = flight(oblique=oblique, rtk=False)
    if not calibrated:
        photos = {name: replace(photo, lens=None, focal_sigma=0.04) for name, photo in photos.items()}
    adjusted = adjust_model(model, photos, ORIGIN, Reporter())
    assert adjusted is not None
    _, share = lenses_found(adjusted.bundle, adjusted.sources)
    assert bool(bending.doubt((), share)) == (not oblique and not calibrated)


@pytest.mark.parametrize(("focal", "scale", "doubtful"), [
    (0.0086, 0.0137, True), (0.0081, 0.0014, False), (0.0086, 0.0004, False), (0.0002, 0.02, False),
], ids=["GPS alone, straight down", "RTK", "control points", "from all sides"])
def test_what_gps_leaves_open_of_the_scale_adds_to_a_focal_length_that_photos_leave_open(
    focal: float, scale: float, doubtful: bool
) -> None:
    assert bool(bending.doubt((), focal, scale)) == doubtful


def test_a_rolling_shutter_moves_the_ground_by_what_the_drone_flies() -> None:
    photos, centres = grid(0.0, 0.0)
    still = [replace(photo, speed=None) for photo in photos]
    focal, above = np.full(30, 1000.0), np.full(30, ABOVE)
    assert shutter.shutter_shift(photos, centres, focal, above) == pytest.approx(5 * 0.023 * 1000 / ABOVE)
    assert shutter.shutter_shift(still, centres, focal, above) is None
    mechanical = [replace(photo, camera="DJI FC6310 8.8 mm") for photo in photos]
    assert shutter.shutter_shift(mechanical, centres, focal, above) == 0


@pytest.mark.parametrize(("seconds", "told"), [(2, True), (9, False)])
def test_places_and_times_tell_the_speed_where_the_drone_does_not_and_cannot_have_stopped(
    seconds: int, told: bool
) -> None:
    photos, _ = grid(0.0, 0.0)
    centres = np.column_stack([np.arange(30) * 9.0, np.zeros(30), np.full(30, ABOVE)])
    start = datetime(2026, 5, 4, 23, 59, 40)
    timed = [replace(photo, speed=None, time=(start + timedelta(seconds=seconds * n)).isoformat())
             for n, photo in enumerate(photos)]
    shift = shutter.shutter_shift(timed[::-1], centres[::-1], np.full(30, 1000.0), np.full(30, ABOVE))
    assert shift == (pytest.approx(4.5 * 0.023 * 1000 / ABOVE) if told else None)


@pytest.mark.parametrize(("bend", "said"), [(0.4, True), (-0.4, True), (0.02, False)])
def test_a_dome_against_control_points_is_told(bend: float, said: bool) -> None:
    plan = np.array([[-30.0, -20], [30, -20], [30, 20], [-30, 20], [2, 1], [-4, 3]])
    off = 0.1 + bend * (plan**2).sum(axis=1) / 1300 + np.random.default_rng(2).normal(0, 0.005, 6)
    found = bending.control_dome(plan, off, np.full(6, 0.02), pixel=0.01)
    assert found is not None and found.bend == pytest.approx(bend, rel=0.2, abs=0.02)
    assert ("by the control points" in bending.doubt((found,), None)) == said
    rough = bending.control_dome(plan, off, np.full(6, 0.5), pixel=0.01)
    assert rough is not None and not bending.is_bent(rough)  # points known to half a metre show no such dome
    assert bending.control_dome(plan[:4], off[:4], np.full(4, 0.02), pixel=0.01) is None
    corners = np.vstack([plan[:4], [[36.0556, 0]]])  # all equally far from the middle
    assert bending.control_dome(corners, np.zeros(5), np.full(5, 0.02), pixel=0.01) is None


def test_altitudes_of_two_levels_are_not_mixed() -> None:
    photos, _ = grid(0.0, 0.0)
    place = GeoPosition(latitude=24.6, longitude=117.0, altitude=500.0, altitude_datum=SEA_LEVEL)
    photos = [replace(photo, gps=place) for photo in photos]
    photos[3] = replace(photos[3], gps=replace(place, altitude=512.0, altitude_datum="ellipsoid"))
    reporter = Reporter()
    kept = with_one_datum(photos, reporter)
    assert kept[3].gps is not None and kept[3].gps.altitude is None
    assert kept[:3] + kept[4:] == photos[:3] + photos[4:]
    assert "1 photos count their altitude from the ellipsoid, 29 from the sea level" in reporter.warnings[0]
    assert with_one_datum(kept, Reporter()) == kept
