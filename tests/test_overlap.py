# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The overlap that metadata tells, against flights whose overlap is known."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from curecon_blender.core.base.records import GeoPosition, Gimbal, Photo
from curecon_blender.core.photos import stations
from curecon_blender.core.photos.overlap import estimate

METRES_PER_DEGREE = 111_132.95  # of latitude, near enough at 45 degrees


def photo(number: int, east: float, north: float, *, yaw: float = 0.0, pitch: float = -90.0) -> Photo:
    """A photo of 40 x 30 m of ground when it looks straight down, from 40 m above take-off."""
    position = GeoPosition(
        latitude=45 + north / METRES_PER_DEGREE, altitude=340.0,
        longitude=7 + east / (METRES_PER_DEGREE * math.cos(math.radians(45)) * 1.0034),
    )
    return Photo(
        name=f"{number:03}.jpg", path=Path(f"{number:03}.jpg"), width=1200, height=900, camera="c", focal_px=1200.0,
        gps=position, gimbal=Gimbal(yaw=yaw, pitch=pitch, roll=0.0), relative_altitude=40.0,
        time=f"2026-01-01T10:{number // 60:02}:{number % 60:02}",
    )


def grid(forward: float, side: float, lines: int = 4, length: int = 6) -> tuple[Photo, ...]:
    """Lines flown north and south in turns; photos 30 m long and 40 m wide, at these metres apart."""
    photos = []
    for line in range(lines):
        for step in range(length):
            north = forward * (step if line % 2 == 0 else length - 1 - step)
            photos.append(photo(len(photos), line * side, north, yaw=180.0 * (line % 2)))
    return tuple(photos)


def test_a_grid_flown_straight_down() -> None:
    found = estimate(grid(forward=6.0, side=16.0))
    assert found.forward == pytest.approx(0.8, abs=0.04)
    assert found.side == pytest.approx(0.6, abs=0.04)
    assert (found.weak, found.unknown) == ((), "")


def test_a_single_line_has_no_side_overlap() -> None:
    found = estimate(grid(forward=9.0, side=0.0, lines=1))
    assert found.forward == pytest.approx(0.7, abs=0.04)
    assert found.side is None


def test_photos_far_from_the_others_are_named() -> None:
    photos = (*grid(forward=6.0, side=10.0), photo(24, 30.0, 60.0), photo(25, 30.0, 80.0))
    assert estimate(photos).weak == ("024.jpg", "025.jpg")


def test_an_orbit_that_looks_inwards() -> None:
    def orbit(count: int) -> tuple[Photo, ...]:
        turns = [360 * i / count for i in range(count)]
        return tuple(
            photo(i, 50 * math.sin(math.radians(turn)), 50 * math.cos(math.radians(turn)), yaw=turn + 180, pitch=-40)
            for i, turn in enumerate(turns)
        )

    dense, sparse = estimate(orbit(36)), estimate(orbit(6))
    assert dense.forward is not None and dense.forward > 0.8 and not dense.weak
    assert sparse.forward is not None and sparse.forward < 0.6 and len(sparse.weak) == 6


@pytest.mark.parametrize(("field", "said"), [
    ("gps", "GPS"), ("gimbal", "angles"), ("relative_altitude", "height"), ("focal_px", "focal length"),
])
def test_what_metadata_does_not_tell_is_said(field: str, said: str) -> None:
    photos = tuple(replace(one, **{field: None}) for one in grid(6.0, 10.0))
    found = estimate(photos)
    assert found.forward is None and found.side is None and said in found.unknown


def test_one_photo_without_gps_does_not_hide_the_rest() -> None:
    first, *others = grid(6.0, 16.0)
    found = estimate((replace(first, gps=None), *others))
    assert found.forward == pytest.approx(0.8, abs=0.04)
    assert first.name not in found.weak


def test_a_photo_straight_down_shows_its_own_ground_in_the_order_of_capture() -> None:
    told = stations.describe(grid(forward=6.0, side=16.0, lines=1, length=3)[::-1])
    assert [one["name"] for one in told] == ["000.jpg", "001.jpg", "002.jpg"]
    first = told[0]
    assert first["place"] == pytest.approx([0.0, -6.0, 40.0], abs=0.1)
    corners = np.array(first["ground"]).reshape(4, 2)
    assert np.abs(corners - first["place"][:2]).round(1).tolist() == [[20.0, 15.0]] * 4
    assert len({tuple(corner) for corner in corners.round().tolist()}) == 4


def test_a_photo_that_looks_sideways_shows_no_ground_behind_the_horizon() -> None:
    level, oblique = (stations.describe((photo(0, 0, 0, yaw=90.0, pitch=pitch),))[0] for pitch in (-5.0, -30.0))
    assert level["ground"] is None
    corners = np.array(oblique["ground"]).reshape(4, 2)
    near, far = corners[:, 0].min(), corners[:, 0].max()
    assert 30 < near < 45 and near < far < 190  # to the east, no farther than flat rays go
    assert np.ptp(corners[:, 1]) > 40


def test_without_height_or_angles_photos_have_a_place_alone_and_without_gps_none() -> None:
    high, low, lost = (replace(one, relative_altitude=None, gimbal=None) for one in grid(6.0, 10.0, lines=1, length=3))
    assert high.gps is not None
    told = stations.describe((replace(high, gps=replace(high.gps, altitude=352.0)), low, replace(lost, gps=None)))
    assert [(one["name"], round(one["place"][2]), one["ground"]) for one in told] == [
        ("000.jpg", 12, None), ("001.jpg", 0, None)]
