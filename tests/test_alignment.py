# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A frame put right by measurements, and how sure a measured distance is."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

from curecon_blender.core.base.errors import WorkspaceError
from curecon_blender.core.base.records import Frame, GeoPosition
from curecon_blender.core.site import adjustment as alignment
from curecon_blender.core.site import measuring
from curecon_blender.core.site.adjustment import Adjustment, FrameError

WHEN = datetime(2026, 5, 4, 3, 2, 1)
UNKNOWN = Frame(scale="unknown", up="gravity", note="No GPS.")
UP = np.array([0.0, 0, 9])


def moved(adjustment: Adjustment, points: np.ndarray) -> np.ndarray:
    return points @ adjustment.matrix[:3, :3].T


def test_the_ground_comes_to_zero_and_the_origin_keeps_its_place_on_earth() -> None:
    origin = GeoPosition(latitude=24.0, longitude=117.0, altitude=530.0)
    scaled = alignment.with_length(Adjustment(), np.zeros(3), UP, 18.0, sigma=0.01, when=WHEN)
    ground = np.array([[3.0, 4, -8]])  # -16 as it is scaled
    down = alignment.with_ground(scaled, -16.0, when=WHEN)
    np.testing.assert_allclose(down.matrix @ [3, 4, -8, 1], [6, 8, 0, 1])
    frame = alignment.adjusted_frame(replace(UNKNOWN, origin=origin), down)
    assert frame.origin is not None and frame.origin.altitude == pytest.approx(514)
    assert "Z = 0 at the cloud's lowest wide level, 2026-05-04" in frame.note
    # A later distance is picked in the lifted frame, and the ground stays.
    later = alignment.with_length(down, np.array([6.0, 8, 0]), np.array([6.0, 8, 5]), 10.0, sigma=0.01, when=WHEN)
    np.testing.assert_allclose(later.matrix @ [*ground[0], 1], [12, 16, 0, 1])
    np.testing.assert_allclose(later.of(alignment.SCALE).points[0], ground[0])
    assert alignment.from_json(alignment.to_json(later)).lift == later.lift


def tilted() -> np.ndarray:
    """A rotation (3,3) by 20 degrees about a slanting axis."""
    axis = np.array([2.0, 1, 0.4]) / np.linalg.norm([2, 1, 0.4])
    cross = np.cross(np.eye(3), axis).T
    return np.eye(3) + np.sin(0.35) * cross + (1 - np.cos(0.35)) * cross @ cross


def test_a_known_distance_sets_the_scale_and_the_next_one_replaces_it() -> None:
    ends = np.array([[1.0, 2, 3], [4, 6, 3]])
    once = alignment.with_length(Adjustment(), *ends, 2.5, sigma=0.05, when=WHEN)
    assert np.linalg.norm(np.diff(moved(once, ends), axis=0)) == pytest.approx(2.5)
    twice = alignment.with_length(once, *moved(once, ends), 4.2, sigma=0.021, when=WHEN)
    assert np.linalg.norm(np.diff(moved(twice, ends), axis=0)) == pytest.approx(4.2)
    (step,) = twice.measured
    np.testing.assert_allclose(step.points, ends)  # as reconstructed, whatever was set before
    frame = alignment.adjusted_frame(UNKNOWN, twice)
    assert frame.scale == "metres" and "a measured distance of 4.20 m, 2026-05-04" in frame.note
    assert alignment.scale_source(UNKNOWN, twice) == "a measured distance of 4.20 m"
    assert step.sigma == pytest.approx(0.005)


def test_a_floor_becomes_level_seen_from_the_cameras_side() -> None:
    floor = np.array([[0.0, 0, 0], [5, 0, 0], [0, 7, 0]])
    for order in ([0, 1, 2], [0, 2, 1]):  # picked either way round
        crooked = floor[order] @ tilted().T
        level = alignment.with_level(Adjustment(), crooked, wall=False, above=tilted() @ UP, when=WHEN)
        assert np.ptp(moved(level, crooked)[:, 2]) < 1e-9
        assert moved(level, tilted() @ UP)[2] > 8
    # A model that stands on its head: no smallest turn, yet right.
    over = alignment.with_level(Adjustment(), floor, wall=False, above=-UP, when=WHEN)
    assert moved(over, -UP)[2] == pytest.approx(9) and np.linalg.det(over.rotation) == pytest.approx(1)
    assert alignment.adjusted_frame(UNKNOWN, over).up == "measured"


def test_a_wall_becomes_upright_and_keeps_its_direction() -> None:
    wall = np.array([[0.0, 0, 0], [5, 1, 0.1], [0.3, 0, 4]])
    upright = alignment.with_level(Adjustment(), wall, wall=True, above=UP, when=WHEN)
    a, b, c = moved(upright, wall)
    assert np.cross(b - a, c - a)[2] == pytest.approx(0, abs=1e-9)
    assert alignment.angle_between(Adjustment(), upright) < 5
    with pytest.raises(FrameError, match="floor or a roof"):
        alignment.with_level(Adjustment(), np.diag([1.0, 1, 0]) @ wall + [[0, 0, 0], [0, 0, 0], [0, 2, 0]],
                             wall=True, above=UP, when=WHEN)


def test_a_bearing_turns_the_site_to_north() -> None:
    ends = np.array([[2.0, 1, 0], [6, 1, 1]])  # to the east so far
    north = alignment.with_bearing(Adjustment(), *ends, 30.0, when=WHEN)
    east, along, up = np.diff(moved(north, ends), axis=0)[0]
    assert np.degrees(np.arctan2(east, along)) == pytest.approx(30) and up == pytest.approx(1)
    assert alignment.adjusted_frame(UNKNOWN, north).north
    turned = alignment.with_turn(north, 15.0, north=False, when=WHEN)
    assert not alignment.adjusted_frame(UNKNOWN, turned).north and len(turned.measured) == 1
    east, along, _ = np.diff(moved(turned, ends), axis=0)[0]
    assert np.degrees(np.arctan2(east, along)) == pytest.approx(45)  # clockwise


def test_what_fixes_nothing_is_an_error_in_words() -> None:
    line = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0.001]])
    with pytest.raises(FrameError, match="one line"):
        alignment.with_level(Adjustment(), line, wall=False, above=UP, when=WHEN)
    with pytest.raises(FrameError, match="same place"):
        alignment.with_length(Adjustment(), line[0], line[0], 2.0, sigma=0, when=WHEN)
    with pytest.raises(FrameError, match="above zero"):
        alignment.with_length(Adjustment(), line[0], line[1], 0.0, sigma=0, when=WHEN)
    with pytest.raises(FrameError, match="above each other"):
        alignment.with_bearing(Adjustment(), UP, 0 * UP, 10, when=WHEN)


def test_an_adjustment_is_kept_in_its_file(tmp_path: Path) -> None:
    made = alignment.with_length(Adjustment(), UP, 0 * UP, 3.0, sigma=0.01, when=WHEN)
    made = alignment.with_turn(made, 33.0, north=True, when=WHEN)
    alignment.write(tmp_path, made)
    found = alignment.read(tmp_path)
    np.testing.assert_allclose(found.matrix, made.matrix, rtol=1e-12)
    assert found.measured == made.measured
    alignment.write(tmp_path, Adjustment())
    assert not list(tmp_path.iterdir()) and alignment.read(tmp_path).measured == ()
    (tmp_path / alignment.FILE_NAME).write_text('{"format": 1, "scale": -1, "rotation": [], "measured": []}')
    with pytest.raises(WorkspaceError, match="damaged"):
        alignment.read(tmp_path)


def test_the_uncertainty_follows_the_points_spacing_scatter_and_scale() -> None:
    rng = np.random.default_rng(3)
    grid = np.stack([*np.meshgrid(np.arange(0, 4, 0.05), np.arange(0, 2, 0.05)), np.zeros((40, 80))], axis=-1)
    wall = grid.reshape(-1, 3).astype(np.float32)
    first, second = np.array([0.5, 1, 0]), np.array([3.5, 1, 0])

    def spread(points: np.ndarray, end: np.ndarray = second) -> float:
        around = measuring.surroundings(points, first), measuring.surroundings(points, end)
        return measuring.spread(first, end, around)

    assert spread(wall) == pytest.approx(0.05 / 2 * np.sqrt(2), rel=0.15)  # along the wall: half a spacing an end
    noisy = wall + np.array([0, 0, 0.02], np.float32) * rng.standard_normal((len(wall), 1)).astype(np.float32)
    across = np.array([0.5, 1, 3.0])  # straight off the wall, where nothing was measured
    assert measuring.surroundings(noisy, first).sigma_along(np.array([0.0, 0, 1])) == pytest.approx(0.02, rel=0.4)
    assert spread(noisy, across) > 2.9  # the gap counts in full
    assert measuring.uncertainty(10.0, 0.03, 0.004) == pytest.approx(2 * np.hypot(0.03, 0.04))
    assert measuring.uncertainty(10.0, 0.03, None) == pytest.approx(0.06)
    assert measuring.surroundings(wall[:3], first) is None


@pytest.mark.parametrize("place", [(0.1, 0.2, 0.3), (9.0, -9.0, 30.0)])
def test_what_lies_about_a_pick_is_of_the_nearest_of_all_points(place: tuple[float, float, float]) -> None:
    cloud = np.random.default_rng(4).normal(size=(4 * measuring.SAMPLE, 3)).astype(np.float32)
    distances = np.sort(np.linalg.norm(cloud - np.array(place), axis=1))[: measuring.NEAREST]
    found = measuring.surroundings(cloud, np.array(place))
    assert found.gap == pytest.approx(distances[0], rel=1e-4)
    area = np.pi * (distances[-1] ** 2 - distances[0] ** 2)
    assert found.spacing == pytest.approx(np.sqrt(area / measuring.NEAREST), rel=1e-3)


@pytest.mark.parametrize(("length", "off", "metres", "words"), [
    (12.3412, 0.031, True, "12.34 m ± 0.03 m"), (12.3412, 0.0042, True, "12.341 m ± 0.004 m"),
    (12.3412, 0.31, True, "12.34 m ± 0.31 m"), (123.4, 3.4, True, "123 m ± 3 m"),
    (12.3412, 0.031, False, "12.34 units ± 0.03 units"),
])
def test_a_distance_in_words(length: float, off: float, metres: bool, words: str) -> None:
    assert measuring.in_words(length, off, metres=metres) == words


def test_gps_tells_how_sure_its_scale_is() -> None:
    centres = np.array([[50.0, 0, 0], [-50, 0, 0], [0, 50, 0], [0, -50, 0]])
    frame = Frame(scale="metres", up="gps", north=True, gps_residual=0.77)
    assert alignment.gps_scale_sigma(frame, centres) == pytest.approx(0.01, rel=0.01)
    assert alignment.gps_scale_sigma(UNKNOWN, centres) is None
    assert alignment.scale_source(frame, Adjustment()) == "the photos' GPS"
