# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The sun, the flights and the sheets of the step Present, and what they make in Blender 4.5 LTS and 5.2 LTS."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from test_extension import blender, run_script  # noqa: F401

from curecon_blender.core.base.errors import SurfaceError, WorkspaceError
from curecon_blender.core.base.records import Photo, PhotoSet
from curecon_blender.core.photos import capture, record
from curecon_blender.core.present import camera_path, marks, sheet, sheet_files, sun, terrain
from curecon_blender.core.site import footprint

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
    taken = {"c": "2024-09-28T10:49:00+08:00", "a": "2024-09-28T10:48:00", "b": None, "d": "2024-09-28T10:50:00"}
    record.write_photos(tmp_path, PhotoSet(photos=tuple(
        Photo(name=name, path=tmp_path / name, width=4, height=3, camera="", focal_px=None, time=time)
        for name, time in taken.items()
    )))
    times = capture.read_times(tmp_path)
    assert list(times) == ["a", "c", "d"] and capture.middle_time(times) == times["c"]
    assert capture.to_utc(times["c"], 0.0) == datetime(2024, 9, 28, 2, 49, tzinfo=UTC)  # its own offset counts
    assert capture.to_utc(times["a"], 117.0) == datetime(2024, 9, 28, 2, 48, tzinfo=UTC)  # the longitude's hour
    (tmp_path / record.FILE_NAME).write_text("{")
    with pytest.raises(WorkspaceError, match="damaged"):
        capture.read_times(tmp_path)


class Letters:
    """Draws each text as a bar and remembers it."""

    def __init__(self) -> None:
        self.texts: list[str] = []

    def __call__(self, text: str) -> np.ndarray:
        self.texts.append(text)
        return sheet.rectangle(0, 0, 0.5 * len(text), 0.7)


def drawing(*, scale: int | None, north: float | None = None) -> sheet.Drawing:
    """A red field of 200 x 100 mm at 4 pixels a millimetre."""
    return sheet.Drawing(
        pixels=np.full((400, 800, 3), (200, 30, 20), np.uint8), pixels_per_mm=4, title="Site", name="Roof plan",
        date="1 May 2026", scale=scale, orientation="North as the arrow" if north is not None else "North unknown",
        north=north,
    )


def test_the_smallest_paper_that_holds_a_drawing_is_taken() -> None:
    assert sheet.paper_for(260, 140) == ("A4", False)
    assert sheet.paper_for(140, 220) == ("A4", True)
    assert sheet.paper_for(262, 140) == ("A3", False)
    assert sheet.paper_for(1150, 780) == ("A0", False)
    with pytest.raises(SurfaceError, match="no paper up to A0"):
        sheet.paper_for(1200, 900)


@pytest.mark.parametrize(("scale", "metres"), [(20, 1), (50, 2), (100, 5), (200, 10), (500, 20), (1000, 50)])
def test_the_scale_bar_has_its_length_on_paper(scale: int, metres: float) -> None:
    assert sheet.bar_length(scale) == metres
    letters = Letters()
    laid = sheet.lay_out(drawing(scale=scale), letters)
    widths = [np.ptp(fill.triangles[..., 0]) for fill in laid.fills]
    assert min(abs(width - metres * 1000 / scale) for width in widths) < 1e-9
    assert f"Scale 1:{scale} on A4" in letters.texts and f"{metres:g} m" in letters.texts


def test_a_sheet_of_unknown_scale_or_north_says_so() -> None:
    letters, bare = Letters(), Letters()
    known = sheet.lay_out(drawing(scale=100, north=45), letters)
    unknown = sheet.lay_out(drawing(scale=None), bare)
    assert "N" in letters.texts and "N" not in bare.texts
    assert "Scale unknown: do not measure" in bare.texts and "Scale unknown" in bare.texts
    assert not [text for text in bare.texts if text.endswith(" m") or "1:" in text]
    assert any("North unknown" in text for text in bare.texts)
    assert len(known.fills) - len(unknown.fills) > 3  # the bar and the arrow
    black, white = (fill.triangles for fill in known.fills if len(fill.triangles) == 1 and fill.colour == sheet.INK)
    shared = np.array([corner for corner in black[0] if np.isclose(corner, white[0]).all(axis=1).any()])
    along = shared[np.argmax(shared.sum(axis=1))] - shared[np.argmin(shared.sum(axis=1))]  # the arrow's spine
    assert np.degrees(np.arctan2(*along)) == pytest.approx(45, abs=0.1)


@pytest.mark.parametrize("size", [(200, 100), (150, 200)])
@pytest.mark.parametrize("north", [None, 14.0])
def test_nothing_is_written_over_the_scale_bar(size: tuple[int, int], north: float | None) -> None:
    field = np.zeros((4 * size[1], 4 * size[0], 3), np.uint8)
    laid = sheet.lay_out(replace(drawing(scale=1000, north=north), pixels=field, title="A long title " * 4), Letters())
    boxes = [(*fill.triangles.min(axis=(0, 1)), *fill.triangles.max(axis=(0, 1))) for fill in laid.fills]
    x0, y0, x1, y1 = next(box for box in boxes if box[2] - box[0] == pytest.approx(50) and box[3] - box[1] < 3)
    parts = [box for box in boxes if x0 <= box[0] and box[2] <= x1 and y0 <= box[1] and box[3] <= y1]
    over = [box for box in boxes if box not in parts and box[0] < x1 and box[2] > x0 and box[1] < y1 and box[3] > y0]
    assert not over and len(parts) == 3


def test_a_sheet_is_drawn_pixel_for_pixel() -> None:
    laid = sheet.lay_out(drawing(scale=100), Letters())
    for density in (4, 8):
        pixels = sheet_files.rasterise(laid, density)
        assert pixels.shape == (210 * density, 297 * density, 3)
        red = np.all(pixels == (200, 30, 20), axis=2)
        assert red.sum() == 200 * 100 * density**2 and red.any(axis=0).sum() == 200 * density
    assert pixels[-round(10.1 * 8), 100 * 8].max() < 60  # the frame, 10 mm above the paper's edge


def facts(shown: np.ndarray, depth: np.ndarray, right: np.ndarray, filled: np.ndarray | None = None) -> marks.Facts:
    none = np.zeros_like(shown)
    return marks.Facts(shown=shown, depth=depth, normals=np.stack([right, np.zeros_like(right)], axis=2),
                       filled=none if filled is None else filled, unseen=none)


def test_what_was_not_measured_is_hatched_and_what_lies_outside_is_not() -> None:
    shown = np.ones((200, 300), bool)
    shown[:, :20] = False  # beside the building
    shown[60:120, 60:120] = False  # a hole in its wall
    shown[150:, 200:230] = False  # its gate, open below
    shown[100, 200:] = False  # a crack
    filled = np.zeros_like(shown)
    filled[20:60, 200:260] = True
    filled[180:182, 100:102] = True  # a speck
    depth = np.zeros(shown.shape)
    found = marks.hatching(facts(shown, depth, depth, filled), 4).unmeasured
    assert found[70:110, 70:110].all() and found[30:50, 210:250].all()
    assert found.sum() == pytest.approx(60 * 60 + 40 * 60, rel=0.06)
    assert not found[:, :20].any() and not found[160:, 205:225].any()
    pixels = np.full((200, 300, 3), (40, 40, 40), np.uint8)
    drawn = marks.hatch(pixels, marks.Hatching(found, np.zeros_like(found)), 4)
    assert (drawn[~found] == 40).all()
    ink = (drawn[70:110, 70:110] < 40).all(axis=2)
    rim = (drawn[70:110, 70:110] == 255).all(axis=2)
    assert 0.05 < ink.mean() < 0.15 and 0.05 < rim.mean() < 0.2
    assert (drawn[70:110, 70:110][~ink & ~rim] == 40).all()  # what is drawn beneath can still be read
    rows, columns = np.nonzero(ink)
    assert len(np.unique(rows + columns)) < 0.15 * (rows + columns).ptp()  # they rise to the right


def test_edges_are_where_the_surface_steps_turns_or_ends() -> None:
    row, column = np.mgrid[:200, :300].astype(float)
    depth = 0.9 * column  # a wall seen aslant is no edge
    depth[50:150, 50:100] -= 40  # something before it
    right = np.where(column < 200, 0.0, 0.9)  # the house's corner
    depth[row < 20] = 0
    noise = np.random.default_rng(0).normal(0, 0.1, depth.shape)
    drawn = marks.edges(facts(row >= 20, depth, np.clip(right + noise, -0.99, 0.99)), 4)
    assert drawn[60:140, 49:52].any(axis=1).all() and drawn[60:140, 98:101].any(axis=1).all()
    assert drawn[49:52, 60:90].any(axis=0).all() and drawn[20:22, 5:190].any(axis=0).all()
    assert drawn[30:190, 196:204].any(axis=1).mean() > 0.9
    assert not drawn[:19].any()
    quiet = np.ones_like(drawn)
    quiet[:24], quiet[45:155, 45:105], quiet[:, 190:210] = False, False, False
    assert drawn[quiet].mean() < 0.002


def test_a_legend_tells_what_hatchings_mean() -> None:
    letters = Letters()
    bare = sheet.lay_out(drawing(scale=100), Letters())
    told = tuple(sheet.Mark(slope=slope, words=words) for slope, words in ((1, "Not measured"), (-1, "Unseen")))
    laid = sheet.lay_out(replace(drawing(scale=100), legend=told), letters)
    assert letters.texts.count("Not measured") and letters.texts.count("Unseen")
    added = [fill.triangles for fill in laid.fills if not any(fill.triangles.shape == other.triangles.shape
             and np.allclose(fill.triangles, other.triangles) for other in bare.fills)]
    rises = [np.polyfit(*line.reshape(-1, 2).T, 1)[0] > 0 for line in added if len(line) == 2 and np.ptp(line) > 0
             and np.ptp(line[..., 1]) > 2.5]
    assert rises.count(True) == rises.count(False) >= 2
    # In the free strip between the drawing and the title.
    assert all(line[..., 1].min() > sheet.MARGIN + sheet.STRIP and line[..., 1].max() < laid.pictures[0].y
               for line in added)


def test_a_plain_ground_lies_under_the_sites_own_and_not_on_its_roofs() -> None:
    rng = np.random.default_rng(2)
    plan = rng.uniform(-20, 20, (40_000, 2))
    roof = (np.abs(plan - (8, 0)) < 4).all(axis=1)
    hole = (np.abs(plan + (8, 0)) < 4).all(axis=1) | roof & (rng.random(len(plan)) < 0.01)
    height = 0.1 * plan[:, 0] + rng.normal(0, 0.02, len(plan)) + np.where(roof, 6.0, 0.0)
    points = np.column_stack([plan, height])[~hole]
    colours = np.where(points[:, :1] < 0, (0.1, 0.4, 0.1), (0.4, 0.2, 0.1))
    made = terrain.spread(points, np.tile([0.0, 0.0, 1.0], (len(points), 1)), colours, np.zeros(3), 28.0, 8.0,
                          (0.3, 0.3, 0.3))
    x, _, z = made.points[(np.abs(made.points[..., :2]) < 19).all(axis=2)].T
    assert (z < 0.1 * x + 0.03).mean() > 0.97 and (z > 0.1 * x - 0.9).all()
    in_hole = (np.abs(made.points[..., :2] + (8, 0)) < 3).all(axis=2)
    np.testing.assert_allclose(made.colours[in_hole][:, :3].mean(axis=0), (0.1, 0.4, 0.1), atol=0.05)
    assert made.colours[in_hole][:, 3].min() > 0.95 and made.colours[0, :, 3].max() < 0.01  # and it melts away
    a, b, c = (made.points.reshape(-1, 3)[made.faces[:, k]] for k in range(3))
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()


def test_the_sun_falls_as_on_the_day_of_the_photos(blender: Path, tmp_path: Path) -> None:  # noqa: F811
    run_script(blender, "check_present_sun.py", tmp_path, resources=tmp_path / "user")


def angles_between(rotations: np.ndarray) -> np.ndarray:
    """Degrees from each frame's view to the next's, and from the last to the first."""
    cosines = np.abs(np.sum(rotations * np.roll(rotations, -1, axis=0), axis=1)).clip(0, 1)
    return np.degrees(2 * np.arccos(cosines))


def view_of(rotation: np.ndarray) -> np.ndarray:
    """The direction (3,) in which a camera with this quaternion looks."""
    w, x, y, z = rotation
    return -np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])


@pytest.mark.parametrize("turn", [-40.0, 0.0, 12.0])
def test_a_house_stands_as_its_walls_do_and_a_round_one_as_the_map(turn: float) -> None:
    """A wall's noise does not make it round, nor do a round house's porch and steps give it sides."""
    rng = np.random.default_rng(0)
    ways = np.radians(turn) + np.pi / 2 * rng.integers(0, 4, 2000) + rng.normal(0, 0.3, 2000)
    for angles, expected in ((ways, (turn, False)), (np.concatenate([rng.uniform(0, 2 * np.pi, 8000), ways[:200]]),
                                                     (0.0, True))):
        walls = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))])
        roofs = np.tile([0.0, 0.0, 1.0], (500, 1))
        normals = np.concatenate([walls, roofs])
        found = footprint.wall_direction(normals, np.ones(len(normals)))
        assert found is not None and found[1] == expected[1]
        assert np.degrees(found[0]) == pytest.approx(expected[0], abs=2)
    assert footprint.wall_direction(roofs, np.ones(500)) is None


def test_a_still_looks_at_the_side_with_measured_wall() -> None:
    """A square building whose south wall no photo shows, and a court whose walls nobody sees from outside."""
    towards = np.array([[0, 1, 0], [1, 0, 0], [-1, 0, 0]], float)  # north, east, west
    places, normals = np.concatenate([10 * towards, 4 * towards]), np.concatenate([towards, -towards])
    areas, middle = np.array([50, 20, 20, 500, 500, 500.0]), np.zeros(3)
    side = camera_path.walled_side(places, normals, areas, middle, 145.0)
    assert min(side, 360 - side) < 30
    assert camera_path.walled_side(places, normals, areas, middle, 20.0) == 20.0  # hardly less shows from there
    roof = np.tile([0, 0, 1.0], (6, 1))
    assert camera_path.walled_side(places, roof, areas, middle, 145.0) == 145.0


def test_an_orbit_is_even_closes_and_looks_at_the_middle() -> None:
    centre = np.array([3.0, -2, 1])
    path = camera_path.orbit(centre, 20.0, 8.0, 90.0, 100)
    np.testing.assert_allclose(path.places[0], centre + [20, 0, 8], atol=1e-9)  # 90 degrees is east
    np.testing.assert_allclose(path.places[25], centre + [0, -20, 8], atol=1e-9)  # then south
    steps = np.linalg.norm(path.places - np.roll(path.places, -1, axis=0), axis=1)
    assert np.ptp(steps) < 1e-9 and np.ptp(angles_between(path.rotations)) < 1e-4
    for place, rotation in zip(path.places, path.rotations, strict=True):
        np.testing.assert_allclose(view_of(rotation), (centre - place) / np.linalg.norm(centre - place), atol=1e-9)


def test_a_crane_shot_rises_gently_in_one_line() -> None:
    path = camera_path.crane(np.zeros(3), 20.0, -1.0, 10.0, 180.0, 50)
    np.testing.assert_allclose(path.places[[0, -1]], [[0, -20, -1], [0, -20, 10]], atol=1e-9)
    rises = np.diff(path.places[:, 2])
    assert np.all(rises > 0) and rises[0] < rises.max() / 5 and rises[-1] < rises.max() / 5


def test_a_flight_along_real_cameras_is_even_and_smooth() -> None:
    # An uneven orbit with shaking hands, a photo taken twice, then a row of pictures straight down.
    rng = np.random.default_rng(3)
    angles = np.cumsum(rng.uniform(5, 25, 20))
    ring = np.stack([30 * np.sin(np.radians(angles)), 30 * np.cos(np.radians(angles)), np.full(20, 15.0)], axis=1)
    ring += rng.normal(0, 0.5, ring.shape)
    ring[7] = ring[6]
    row = np.stack([np.linspace(-20, 20, 8), np.zeros(8), np.full(8, 40.0)], axis=1)
    rotations = np.concatenate([camera_path.look_at(ring, np.zeros(3)), np.tile([1.0, 0, 0, 0], (8, 1))])
    rotations[::3] *= -1  # the same rotations, of the other sign
    places = np.concatenate([ring, row])
    path = camera_path.fly_through(places, rotations, 300)
    np.testing.assert_allclose(path.places[[0, -1]], places[[0, -1]], atol=1e-6)
    assert np.abs(np.sum(path.rotations[[0, -1]] * rotations[[0, -1]], axis=1)).min() > 0.9999
    steps = np.linalg.norm(np.diff(path.places, axis=0), axis=1)
    assert steps.max() < 1.1 * np.median(steps) and angles_between(path.rotations)[:-1].max() < 4
    assert np.mean(np.abs(steps / np.median(steps) - 1) < 0.02) > 0.7  # mostly at one speed
    assert np.linalg.norm(np.diff(path.places, 2, axis=0), axis=1).max() < 0.25 * np.median(steps)  # no corners
    nearest = np.linalg.norm(places[:, None] - path.places, axis=2).min(axis=1)
    assert nearest.max() < 8  # it stays with the cameras
    with pytest.raises(ValueError, match="do not move"):
        camera_path.fly_through(np.zeros((3, 3)), rotations[:3], 10)


def test_cameras_move_and_photos_lie_over_the_scene(blender: Path, tmp_path: Path) -> None:  # noqa: F811
    run_script(blender, "check_present_cameras.py", tmp_path, resources=tmp_path / "user")


def test_sheets_measure_right_and_films_play(blender: Path, tmp_path: Path) -> None:  # noqa: F811
    run_script(blender, "check_present_renders.py", tmp_path, resources=tmp_path / "user")


def test_the_users_scene_does_not_show_in_sheets_and_films(blender: Path, tmp_path: Path) -> None:  # noqa: F811
    """Markers, stereo, view layers, colours, objects' and output settings; Cycles off, no FFmpeg, a swapped camera."""
    run_script(blender, "check_present_alone.py", tmp_path, resources=tmp_path / "user")
