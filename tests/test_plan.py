# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A planned flight sees the whole building, touches nothing, fits battery and app, and says what it cannot do."""

from __future__ import annotations

import csv
import json
import zipfile
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import fastkml
import fastkml.utils
import gpxpy
import numpy as np
import pycolmap
import pytest
from conftest import SITE, curecon
from test_extension import blender, run_script  # noqa: F401

from curecon_blender.core.base.errors import PlanError
from curecon_blender.core.base.records import GeoPosition
from curecon_blender.core.plan import coverage, site
from curecon_blender.core.plan.drones import DRONES
from curecon_blender.core.plan.files import write_gpx, write_kml, write_kmz
from curecon_blender.core.plan.mission import FORMS, of_legs, plan
from curecon_blender.core.plan.outlines import area
from curecon_blender.core.plan.page import page
from curecon_blender.core.plan.records import Building, Plan
from curecon_blender.core.plan.wishes import KINDS, Wishes
from evaluation.cloud_metrics import read_points

DRONE = DRONES["mini4pro"]
HERE = GeoPosition(latitude=24.66, longitude=117.05, altitude=None)
RING = site.of_ring(40, 24, 14, eaves=11, origin=HERE)
TOWER = site.of_size(8, 8, 40, eaves=38)
HOUSE = site.of_size(60, 12, 15, turn=30, eaves=12)
BUILDINGS = {"tulou": RING, "tower": TOWER, "helix": TOWER}
WISHES = Wishes(pixel=8, takeoff=(0, -60, 0))
WPML = "{http://www.dji.com/wpmz/1.0.2}"
KML = "{http://www.opengis.net/kml/2.2}"


def planned(kind: str) -> Plan:
    return plan(kind, BUILDINGS.get(kind, HOUSE), DRONE, WISHES)


def dense_ways(made: Plan) -> list[np.ndarray]:
    """Places every 20 cm on each flight's way, the vertical ways from and to take-off among them."""
    ways = []
    for flight in made.flights:
        places = np.array([made.wishes.takeoff, *(w.place for w in flight.waypoints), made.wishes.takeoff])
        steps = [start + np.linspace(0, 1, max(int(np.linalg.norm(end - start) / 0.2), 1))[:, None] * (end - start)
                 for start, end in pairwise(places)]
        ways.append(np.concatenate(steps))
    return ways


@pytest.mark.parametrize("kind", ["building", "tulou", "tower", "facade", "courtyard", "ruin"])
def test_a_flight_for_a_kind_of_building_shows_all_its_walls_and_roofs(kind: str) -> None:
    made = planned(kind)
    seen = coverage.of_plan(made, coverage.parts_of(made.building))
    assert seen.share > 0.97
    assert seen.usual_pixel < 1.3 * WISHES.pixel


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_the_whole_way_stays_clear_of_the_building_and_below_the_ceiling(kind: str) -> None:
    made = planned(kind)
    building = made.building
    for way in dense_ways(made):
        assert way[:, 2].max() <= WISHES.top
        near = way[np.abs(way[:, :2]).max(axis=1) < 60]
        flown = near[near[:, 2] > 1]
        # The building as columns of its own outline, apart from the plan's own obstacles.
        inside = _distance_to(flown[:, :2], building)
        above = np.maximum(flown[:, 2] - building.height, 0)
        assert np.hypot(inside, above).min() > 0.85 * WISHES.clearance


def _distance_to(places: np.ndarray, building: Building) -> np.ndarray:
    """Metres in plan from places to the solid part of a building."""
    if building.court is not None:
        radius = np.linalg.norm(places, axis=1)
        return np.maximum(np.maximum(radius - 20, 12 - radius), 0)
    turned = places @ _axes(building).T
    half = np.abs(building.outline @ _axes(building).T).max(axis=0)
    return np.linalg.norm(np.maximum(np.abs(turned) - half, 0), axis=1)


def _axes(building: Building) -> np.ndarray:
    along = building.outline[1] - building.outline[0]
    along = along / np.linalg.norm(along)
    return np.array([along, [-along[1], along[0]]])


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_no_flight_is_longer_than_its_battery_or_the_apps_list(kind: str) -> None:
    made = planned(kind)
    assert sum(flight.photos for flight in made.flights) == made.photos
    for flight in made.flights:
        assert flight.minutes <= DRONE.minutes * (1 - WISHES.kept_back)
        assert len(flight.waypoints) <= DRONE.waypoints
    small = plan(kind, made.building, replace(DRONE, waypoints=40, minutes=5), WISHES)
    assert len(small.flights) > len(made.flights)


def test_flights_that_the_app_cuts_short_share_a_battery() -> None:
    made = plan("building", HOUSE, DRONE, WISHES)
    usable, minutes = DRONE.minutes * (1 - WISHES.kept_back), sum(flight.minutes for flight in made.flights)
    assert minutes / usable <= made.batteries < len(made.flights)
    weak = plan("building", HOUSE, replace(DRONE, minutes=max(f.minutes for f in made.flights) / 0.69), WISHES)
    assert weak.batteries >= len(weak.flights) / 2
    page_of = page(made, coverage.of_plan(made, coverage.parts_of(HOUSE)), "House")
    assert f"{len(made.flights)} flights on {made.batteries} batter" in page_of


def test_every_kind_that_can_be_asked_for_can_be_flown() -> None:
    assert tuple(FORMS) == KINDS


def test_the_mission_of_the_tulou_study_keeps_its_height_and_overlap() -> None:
    drone = DRONES["mavic2ea"]
    village = site.of_size(200, 200, 14)
    made = plan("grid", village, drone, Wishes(above=20, forward=0.4, side=0.4, takeoff=(0, 0, 14)))
    places = made.legs[0].places
    assert places[:, 2] == pytest.approx(34)
    across, along = drone.footprint(20)
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    lines = min((np.diff(np.unique(np.round(places[:, axis], 2))) for axis in range(2)), key=len)
    assert np.median(steps) == pytest.approx(0.6 * along, rel=0.1)
    assert np.ptp(lines) < 0.05 and 0.5 * across < lines[0] <= 0.6 * across + 0.01
    assert 200 < made.photos < 300  # they took 248, and do not say of how large an area


def test_a_photo_of_a_grid_overlaps_the_one_before_as_asked() -> None:
    made = plan("grid", HOUSE, DRONE, WISHES)
    along = DRONE.footprint(made.legs[0].distance)[1]
    steps = np.linalg.norm(np.diff(made.legs[0].places[:, :2], axis=0), axis=1)
    assert np.quantile(steps, 0.6) <= (1 - WISHES.forward) * along + 1e-6


def test_trees_beside_the_building_raise_the_photos_near_them() -> None:
    ring = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    walls = np.concatenate([np.stack([r * np.cos(ring), r * np.sin(ring), np.full(400, 12.0)], axis=1)
                            for r in np.arange(12, 20.1, 0.5)])
    x, y = np.meshgrid(np.arange(-60, 60, 1.0), np.arange(-60, 60, 1.0))
    ground = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    tree = np.stack([42 + np.cos(ring), np.sin(ring), np.full(400, 16.0)], axis=1)
    building = site.of_points(np.concatenate([walls, ground, tree]))
    assert building.height == pytest.approx(12, abs=0.5)
    assert building.court is not None and np.sqrt(abs(area(building.court)) / np.pi) == pytest.approx(12, abs=1)
    made = plan("tulou", building, DRONE, replace(WISHES, takeoff=(0, -50, 0)))
    assert any("higher up to stay clear" in note for note in made.notes)
    for way in dense_ways(made):
        near = way[(np.linalg.norm(way[:, :2] - [42, 0], axis=1) < 1 + 0.8 * WISHES.clearance) & (way[:, 2] > 1)]
        assert len(near) == 0 or near[:, 2].min() > 16 + 0.5 * WISHES.clearance


def test_the_sample_sites_own_cloud_gives_a_ring_with_its_court() -> None:
    points = read_points(SITE / "truth" / "cloud.npz")
    building = site.of_points(points.astype(float))
    assert building.court is not None
    made = plan("tulou", building, DRONE, replace(WISHES, takeoff=(0, -45, 0)))
    assert coverage.of_plan(made, coverage.parts_of(building)).share > 0.85


def test_mission_files_hold_the_plan(tmp_path: Path) -> None:
    run = curecon("plan", tmp_path / "out", "--kind", "tulou", "--ring", 40, 24, "--height", 14, "--eaves", 11,
                  "--position", 24.66, 117.05, "--takeoff", 0, -60, 2, "--pixel", 8,
                  "--name", "<b>'Tulou' & \"co\"</b>")
    assert run.code == 0, run.said
    told = json.loads((tmp_path / "out" / "plan.json").read_text())
    centre = pycolmap.GPSTransform().ellipsoid_to_ecef([[24.66, 117.05, 0]])[0]
    for n, waypoints in enumerate(told["waypoints"], start=1):
        wanted = np.array([waypoint["place"] for waypoint in waypoints])
        photos = sum(waypoint["photo"] for waypoint in waypoints)
        with zipfile.ZipFile(tmp_path / "out" / f"flight_{n}.kmz") as archive:
            assert set(archive.namelist()) == {"wpmz/template.kml", "wpmz/waylines.wpml"}
            ElementTree.fromstring(archive.read("wpmz/template.kml"))
            wayline = ElementTree.fromstring(archive.read("wpmz/waylines.wpml"))
        marks = wayline.findall(f".//{KML}Placemark")
        found = np.array([[*map(float, mark.findtext(f".//{KML}coordinates", "").split(",")),
                           float(mark.findtext(f"{WPML}executeHeight", ""))] for mark in marks])
        assert [mark.findtext(f"{WPML}index") for mark in marks] == [str(i) for i in range(len(waypoints))]
        assert sum(action.text == "takePhoto" for action in wayline.iter(f"{WPML}actionActuatorFunc")) == photos
        assert wayline.findtext(f".//{WPML}executeHeightMode") == "relativeToStartPoint"
        with open(tmp_path / "out" / f"flight_{n}_litchi.csv", newline="") as file:
            rows = list(csv.DictReader(file))
        litchi = np.array([[float(row[name]) for name in ("longitude", "latitude", "altitude(m)")] for row in rows])
        assert sum("1" in [row[f"actiontype{i}"] for i in range(1, 16)] for row in rows) == photos
        for places in (found, litchi):
            # Another library's way from degrees to metres: places agree to a centimetre, heights count from take-off.
            ecef = pycolmap.GPSTransform().ellipsoid_to_ecef(np.c_[places[:, 1], places[:, 0], np.zeros(len(places))])
            apart = np.linalg.norm(ecef - centre, axis=1)
            assert apart == pytest.approx(np.linalg.norm(wanted[:, :2], axis=1), abs=0.01)
            assert places[:, 2] == pytest.approx(wanted[:, 2] - 2, abs=0.006)
        pitches = [float(row["gimbalpitchangle"]) for row in rows]
        assert pitches == pytest.approx([waypoint["pitch"] for waypoint in waypoints], abs=0.06)
    ElementTree.parse(tmp_path / "out" / "plan.kml")
    ElementTree.parse(tmp_path / "out" / "plan.gpx")
    page = (tmp_path / "out" / "plan.html").read_text()
    assert "<b>'Tulou'" not in page and "&lt;b&gt;" in page


def test_other_programs_read_the_ways_of_a_flight_across_180_degrees(tmp_path: Path) -> None:
    origin = GeoPosition(latitude=-17.0, longitude=179.9999, altitude=None)
    made = plan("tulou", replace(RING, origin=origin), DRONE, WISHES)
    write_kml(tmp_path / "plan.kml", made)
    write_gpx(tmp_path / "plan.gpx", made)
    write_kmz(tmp_path / "flight.kmz", made, made.flights[0], 1_700_000_000_000)
    with open(tmp_path / "plan.gpx") as file:
        routes = gpxpy.parse(file).routes
    assert [len(route.points) for route in routes] == [len(flight.waypoints) for flight in made.flights]
    with zipfile.ZipFile(tmp_path / "flight.kmz") as archive:
        wayline = fastkml.KML.from_string(archive.read("wpmz/waylines.wpml").decode(), strict=False)
    marks = [mark.geometry for mark in fastkml.utils.find_all(wayline, of_type=fastkml.Placemark)]
    whole = fastkml.KML.parse(tmp_path / "plan.kml")
    lines = [mark.geometry for mark in fastkml.utils.find_all(whole, of_type=fastkml.Placemark)
             if mark.geometry.geom_type == "LineString"]
    for flight, route, line in zip(made.flights, routes, lines, strict=True):
        wanted = [waypoint.place for waypoint in flight.waypoints]
        told = {"GPX": [(point.longitude, point.latitude, point.elevation) for point in route.points],
                "KML": list(line.coords)}
        if flight is made.flights[0]:
            told["KMZ"] = [(mark.x, mark.y, place[2]) for mark, place in zip(marks, wanted, strict=True)]
        for places in told.values():
            longitudes, latitudes, heights = np.array(places).T
            assert (np.abs(longitudes) > 179.99).all() and (longitudes > 0).any() and (longitudes < 0).any()
            east = ((longitudes - origin.longitude + 180) % 360 - 180) * 106_480  # metres a degree at 17 degrees south
            assert east == pytest.approx([place[0] for place in wanted], abs=0.2)
            assert (latitudes + 17) * 110_640 == pytest.approx([place[1] for place in wanted], abs=0.2)
            assert heights == pytest.approx([place[2] for place in wanted], abs=0.01)


def test_a_mission_of_one_photo_is_a_mission(tmp_path: Path) -> None:
    hut = site.of_size(3, 3, 2, origin=HERE)
    made = plan("grid", hut, DRONE, Wishes(pixel=40, side=0, forward=0, takeoff=(0, -60, 0)))
    assert made.photos <= 6
    one = replace(made.legs[0], places=made.legs[0].places[:1], headings=made.legs[0].headings[:1],
                  pitches=made.legs[0].pitches[:1])
    made = of_legs("grid", [one], hut, DRONE, WISHES, [])
    assert made.photos == 1 and len(made.flights) == 1
    write_kmz(tmp_path / "flight.kmz", made, made.flights[0], 1_700_000_000_000)
    with zipfile.ZipFile(tmp_path / "flight.kmz") as archive:
        assert archive.read("wpmz/waylines.wpml").count(b"takePhoto") == 1


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_no_photo_is_taken_below_the_ground_of_a_low_building(kind: str) -> None:
    low = site.of_ring(30, 14, 3, eaves=2) if kind == "tulou" else site.of_size(20, 12, 3, eaves=2)
    made = plan(kind, low, DRONE, replace(WISHES, takeoff=(0, -60, -4)))
    heights = np.array([waypoint.place[2] for flight in made.flights for waypoint in flight.waypoints])
    assert heights.min() > 2.9 and heights.max() <= WISHES.ceiling - 4


@pytest.mark.parametrize(("arguments", "code", "said"), [
    (("--drone", "dragonfly9"), 2, "invalid choice"), (("--waypoints", 1), 14, "waypoints"),
    (("--camera", 13.2, 8.8, 8.8, 5472, 3648, "--minutes", 20), 0, "Own camera"),
])
def test_a_drone_that_is_not_in_the_table_has_numbers_of_its_own(
    tmp_path: Path, arguments: tuple[object, ...], code: int, said: str
) -> None:
    run = curecon("plan", tmp_path / "out", "--size", 20, 10, "--height", 9, *arguments)
    assert run.code == code and said in f"{run.said} {run.summary} {_page(tmp_path)}"


def _page(folder: Path) -> str:
    page = folder / "out" / "plan.html"
    return page.read_text() if page.is_file() else ""


def test_a_part_of_one_photo_stands_on_the_page_too() -> None:
    made = planned("orbit")
    leg = made.legs[0]
    one = replace(leg, name="One look", places=leg.places[:1], headings=leg.headings[:1], pitches=leg.pitches[:1])
    made = replace(made, legs=(leg, one))
    assert "One look" in page(made, coverage.of_plan(made, coverage.parts_of(made.building)), "House")


def test_without_a_position_there_is_a_page_for_flying_by_hand(tmp_path: Path) -> None:
    run = curecon("plan", tmp_path / "out", "--size", 20, 10, "--height", 9)
    assert run.code == 0 and any("--position" in warning for warning in run.summary["warnings"])
    assert {file.name for file in (tmp_path / "out").iterdir()} == {"plan.html", "plan.json"}


def test_an_outline_drawn_on_a_map_gives_building_and_court(tmp_path: Path) -> None:
    places = [[(0, 0), (0.001, 0), (0.001, 0.0005), (0, 0.0005)],
              [(0.0003, 0.0002), (0.0006, 0.0002), (0.0006, 0.0003), (0.0003, 0.0003)]]
    # Astride the line where longitudes change from 180 to -180.
    rings = [[[(179.9995 + x + 180) % 360 - 180, -17 + y] for x, y in ring] for ring in places]
    (tmp_path / "a.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": [
        {"type": "Feature", "geometry": {"type": "Polygon", "coordinates": [[*ring, ring[0]] for ring in rings]}}]}))
    kml = ""
    for side, ring in zip(("outer", "inner"), rings, strict=True):
        line = " ".join(f"{x},{y},0" for x, y in [*ring, ring[0]])
        kml += f"<{side}BoundaryIs><LinearRing><coordinates>{line}</coordinates></LinearRing></{side}BoundaryIs>"
    (tmp_path / "a.kml").write_text(f'<kml xmlns="{KML[1:-1]}"><Placemark><Polygon>{kml}</Polygon></Placemark></kml>')
    for file in ("a.geojson", "a.kml"):
        building = site.of_file(tmp_path / file, 12)
        assert building.origin is not None and abs(abs(building.origin.longitude) - 180) < 0.001
        assert abs(area(building.outline)) == pytest.approx(106.5 * 55.3, rel=0.01)
        assert building.court is not None and abs(area(building.court)) == pytest.approx(31.9 * 11.1, rel=0.01)
        waypoints = plan("grid", building, DRONE, WISHES)
        assert waypoints.photos > 10


@pytest.mark.parametrize(("building", "wishes", "said"), [
    (replace(HOUSE, outline=np.array([[0.0, 0], [10, 0], [20, 0]])), WISHES, "no area"),
    (replace(HOUSE, outline=np.array([[0.0, 0]])), WISHES, "no area"),
    (HOUSE, replace(WISHES, ceiling=18), "less than the clearance"),
    (HOUSE, replace(WISHES, takeoff=(0, -60, -110)), "less than the clearance"),
    (HOUSE, replace(WISHES, takeoff=(0, -9000, 0)), "does not reach"),
    (site.of_size(2000, 2000, 10), replace(WISHES, pixel=1), "photos"),
    (replace(HOUSE, origin=GeoPosition(latitude=89.9, longitude=0, altitude=None)), WISHES, "pole"),
])
def test_what_cannot_be_flown_is_refused_with_the_reason(building: Building, wishes: Wishes, said: str) -> None:
    with pytest.raises(PlanError, match=said) as error:
        plan("building", building, DRONE, wishes)
    assert error.value.remedy


@pytest.mark.parametrize(("text", "said"), [
    ('{"type": "Point", "coordinates": [1, 2]}', "no polygon"),
    ('{"type": "Polygon", "coordinates": [[[500000, 2700000], [500100, 2700000], [500100, 2700100]]]}', "longitude"),
    ('{"type": "Polygon", "coordinates": [[[0, 0], [1, 0], [1, 1]]]}', "across"),
    ('{"type": "Polygon", "coordinates": [[["a", 0], [1, 0], [1, 1]]]}', "cannot be read"),
    ('{"type": "Polygon", "coordinates": [[[NaN, 0], [1, 0], [1, 1]]]}', "cannot be read"),
    ('<!DOCTYPE a [<!ENTITY b "c">]><kml/>', "entities"),
    ("neither", "cannot be read"),
])
def test_a_drawn_outline_that_is_none_is_refused(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "drawn").write_text(text)
    with pytest.raises(PlanError, match=said):
        site.of_file(tmp_path / "drawn", 10)


def test_a_ring_without_a_court_and_flat_ground_are_refused() -> None:
    with pytest.raises(PlanError, match="court"):
        plan("tulou", HOUSE, DRONE, WISHES)
    with pytest.raises(PlanError, match="Nothing stands out"):
        site.of_points(np.random.default_rng(0).uniform([0, 0, 0], [50, 50, 0.2], (5000, 3)))


def test_a_flight_is_planned_drawn_and_exported_in_blender(blender: Path, tmp_path: Path) -> None:  # noqa: F811
    run_script(blender, "check_plan.py", tmp_path, resources=tmp_path / "user")
