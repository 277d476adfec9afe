# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What too few photos saw is found where it is, and the photos that are asked for close it, clear of everything."""

from __future__ import annotations

import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import Run, curecon
from test_extension import blender, run_script  # noqa: F401

from curecon_blender.core.base.errors import WorkspaceError
from curecon_blender.core.plan import gaps, patches, site
from curecon_blender.core.plan.candidates import candidates, seeing
from curecon_blender.core.plan.coverage import ENOUGH, SPACING, Eyes, axes, eyes_of, parts_of
from curecon_blender.core.plan.drones import DRONES
from curecon_blender.core.plan.patches import ABSENT, FILLED, MEASURED, Judged
from curecon_blender.core.plan.records import Building, Leg
from curecon_blender.core.plan.solid import Solid
from curecon_blender.core.plan.wishes import Wishes

DRONE = DRONES["mini4pro"]
WISHES = Wishes(clearance=4)
HALF = np.array([10.0, 6.0, 9.0])  # of a house: half its width and depth, and its height
RING = site.of_ring(40, 24, 14)


def house(*, south: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Places and normals, 25 cm apart, of a house with a flat roof on flat ground; its south wall may be lacking."""
    step = 0.25
    x, y, z = (np.arange(low + step / 2, high, step) for low, high in ((-10, 10), (-6, 6), (0, 9)))
    places, normals = [], []
    sides: list[tuple[list[float], tuple[np.ndarray, ...]]] = [
        ([1, 0, 0], tuple(np.meshgrid([10.0], y, z))), ([-1, 0, 0], tuple(np.meshgrid([-10.0], y, z))),
        ([0, 1, 0], tuple(np.meshgrid(x, [6.0], z))), ([0, 0, 1], tuple(np.meshgrid(x, y, [9.0])))]
    if south:
        sides.append(([0, -1, 0], tuple(np.meshgrid(x, [-6.0], z))))
    for normal, grid in sides:
        places.append(np.stack([part.ravel() for part in grid], axis=1))
        normals.append(np.tile(np.array(normal, float), (len(places[-1]), 1)))
    flat = np.arange(-16, 16, 0.5)
    ground = np.stack([part.ravel() for part in np.meshgrid(flat, flat, [0.0])], axis=1)
    ground = ground[(np.abs(ground[:, :2]) > HALF[:2]).any(axis=1)]
    return np.concatenate([*places, ground]), np.concatenate([*normals, np.tile([0.0, 0, 1], (len(ground), 1))])


def flown(*, south: bool) -> Eyes:
    """Photos around the house and straight down, those from the south left out."""
    turns = np.radians(np.arange(0, 360, 12))
    eyes, looks = [], []
    for away, up in ((28, 8), (22, 22)):
        ring = np.stack([away * np.sin(turns), away * np.cos(turns), np.full(len(turns), up)], axis=1)
        eyes.append(ring if south else ring[ring[:, 1] > -2])
        looks.append([0, 0, 4] - eyes[-1])
    centres, ways = np.concatenate(eyes), np.concatenate(looks)
    headings = np.degrees(np.arctan2(ways[:, 0], ways[:, 1]))
    return eyes_of(DRONE, centres, headings, np.degrees(np.arctan2(ways[:, 2], np.hypot(ways[:, 0], ways[:, 1]))))


def judged(taken: Eyes, *, south_wall: bool = True, filled: bool = False) -> tuple[Judged, Building, Solid]:
    places, normals = house(south=south_wall)
    building = site.of_points(places)
    marks = np.full(len(places), filled) & (normals[:, 1] < -0.5)
    found = patches.patches_of(places, normals, np.full(len(places), 0.0625), marks, 1.0)
    found = patches.with_absent(found, patches.absent(parts_of(building), found), SPACING**2)
    solid = Solid(places, 0.3)
    return patches.judge(found, taken, solid), building, solid


def advised(found: Judged, building: Building, solid: Solid, taken: Eyes, most: int) -> Leg:
    leg = candidates(building, DRONE, WISHES, 20.0)
    chosen = gaps.advise(found, taken, seeing(leg, DRONE), solid, most)
    return replace(leg, places=leg.places[chosen], headings=leg.headings[chosen], pitches=leg.pitches[chosen])


def south_wall(found: Judged) -> np.ndarray:
    return (found.patches.parts.normals[:, 1] < -0.9) & (found.patches.parts.places[:, 1] < -5)


def test_a_house_flown_around_has_no_gaps_in_its_walls_and_roof() -> None:
    found, _, _ = judged(flown(south=True))
    up = found.patches.parts.places[:, 2] > 0.5
    assert (found.short[up] == 0).mean() > 0.97
    assert (found.patches.kinds == MEASURED).all()


def test_the_side_that_nobody_photographed_is_the_gap_and_further_photos_close_it() -> None:
    taken = flown(south=False)
    found, building, solid = judged(taken)
    wall = south_wall(found)
    assert (found.short[wall] == ENOUGH).all() and wall.sum() > 80
    other = (found.patches.parts.places[:, 2] > 0.5) & ~wall
    assert (found.short[other] == 0).mean() > 0.9
    leg = advised(found, building, solid, taken, 6)
    assert (found.short[wall] == 0).mean() > 0.95
    forward = axes(leg.headings, leg.pitches)[2]
    assert ((leg.places[:3, 1] < -6) & (forward[:3, 1] > 0)).all()  # first of all from the south, looking north
    outside = np.maximum(np.abs(leg.places) - [*HALF[:2], 0], 0)
    distance = np.hypot(np.linalg.norm(outside[:, :2], axis=1), np.maximum(leg.places[:, 2] - HALF[2], 0))
    assert distance.min() > WISHES.clearance - 0.6 and leg.places[:, 2].max() <= WISHES.top


def test_the_photos_asked_for_close_more_than_as_many_at_random() -> None:
    taken = flown(south=False)
    found, building, solid = judged(taken)
    before = found.share
    count = len(advised(found, building, solid, taken, 6).places)
    leg = candidates(building, DRONE, WISHES, 20.0)
    left = []
    for seed in range(5):
        other, _, _ = judged(taken)
        offered = seeing(leg, DRONE).take(np.random.default_rng(seed).choice(len(leg), count, replace=False))
        gaps.advise(other, taken, offered, solid, count)
        left.append(other.share)
    assert before - found.share > 2 * (before - np.mean(left))


def test_no_photo_is_asked_for_whose_middle_looks_past_the_site() -> None:
    taken = eyes_of(DRONE, np.array([[6.0, -25, 8]]), np.array([0.0]), np.array([5.0]))
    chosen = []
    for heading in (0.0, 40.0):  # both see the south wall, the second one at its picture's side
        found, _, solid = judged(taken)
        offered = eyes_of(DRONE, np.array([[0.0, -25, 8]]), np.array([heading]), np.array([5.0]))
        chosen.append(len(gaps.advise(found, taken, offered, solid, 1)))
    assert chosen == [1, 0]


@pytest.mark.parametrize("filled", [True, False])
def test_what_was_filled_or_never_found_counts_as_seen_by_nobody(filled: bool) -> None:
    found, _, _ = judged(flown(south=True), south_wall=filled, filled=filled)
    kind = FILLED if filled else ABSENT
    lacking = found.patches.kinds == kind
    assert lacking.sum() > 60 and (found.short[lacking] == ENOUGH).all()
    assert found.patches.parts.places[lacking, 1].max() < -4.5
    assert found.patches.areas[lacking].sum() == pytest.approx(20 * 9, rel=0.25)


def test_photos_from_one_direction_and_coarse_ones_do_not_count() -> None:
    one = eyes_of(DRONE, np.tile([0.0, -25, 8], (6, 1)) + np.arange(6)[:, None] * [0.1, 0, 0], np.zeros(6),
                  np.full(6, -10.0))
    found, _, _ = judged(one)
    assert (found.seen.photos[south_wall(found)] == 6).mean() > 0.9
    assert (found.short[south_wall(found)] == ENOUGH - 1).mean() > 0.9  # six photos from one place are worth one
    ring = flown(south=True)
    far = np.array([[40.0 * n, -300, 60] for n in (-1, 0, 1)])
    beyond = eyes_of(DRONE, far, -np.degrees(np.arctan2(far[:, 0], 300)), np.full(3, -10.0))
    taken = flown(south=False)
    both = Eyes(*(np.concatenate([a, b]) for a, b in zip(vars(taken).values(), vars(beyond).values(), strict=True)))
    found, _, _ = judged(both)
    assert (found.short[south_wall(found)] == ENOUGH).all() and len(ring) > len(taken)


def test_a_ray_passes_below_an_eave_and_not_through_a_wall() -> None:
    places, _ = house()
    solid = Solid(places, 0.3)
    eave = np.stack([part.ravel() for part in np.meshgrid(np.arange(-10, 10, 0.25), np.arange(-9, -6, 0.25), [9.0])], 1)
    roofed = Solid(np.concatenate([places, eave]), 0.3)
    wall, low, high = np.array([[0.0, -6.3, 5]]), np.array([[0.0, -30.0, 4]]), np.array([[0.0, -12.0, 30]])
    assert not solid.hidden(low, wall)[0] and not roofed.hidden(low, wall)[0]
    assert not solid.hidden(high, wall)[0] and roofed.hidden(high, wall)[0]
    assert solid.hidden(-low * [1, 1, -1], wall)[0]


@pytest.mark.parametrize(("place", "heading", "pitch", "said"), [
    ((0, -32, 6), 0, 10, "12 m off the south wall, 6 m up: look north, 10 degrees up."),
    ((45, 0, 30), 271, -45, "25 m off the east wall, 30 m up: look west, 45 degrees down."),
    ((0, 0, 8), 90, 1, "In the court, 8 m up: look east, level."),
    ((2, 0, 25), 0, -90, "Above the court, 25 m up: look straight down."),
    ((0, 16, 20), 180, -35, "Above the roof, 20 m up: look south, 35 degrees down."),
])
def test_a_person_is_told_where_to_fly(place: tuple[float, ...], heading: float, pitch: float, said: str) -> None:
    assert gaps.sentence(np.array(place, float), heading, pitch, RING, north=True) == said


def test_where_north_is_unknown_no_compass_is_named() -> None:
    said = gaps.sentence(np.array([0.0, -32, 6]), 0, 10, RING, north=False)
    assert said == "12 m off the -Y wall, 6 m up: look +Y, 10 degrees up."


def test_the_command_finds_gaps_and_writes_patches_and_missions(textured: tuple[Path, Run], tmp_path: Path) -> None:
    workspace = tmp_path / "w"
    shutil.copytree(textured[0], workspace)
    run = curecon("gaps", workspace, "--photos", 5)
    assert run.code == 0, run.said
    told = run.summary["gaps"]
    assert 0 < len(told["photos"]) <= 5 and told["lacking_after"] < told["lacking"]
    assert all(photo["says"] in run.said for photo in told["photos"])
    kept = patches.read_patches(workspace / "gaps" / "gaps.ply")
    assert len(kept.areas) == told["patches"] and (kept.short <= ENOUGH).all()
    lacking = kept.areas[kept.short > 0].sum() / kept.areas.sum()
    assert lacking == pytest.approx(told["lacking"], abs=0.001)
    plan = json.loads((workspace / "gaps" / "plan.json").read_text())
    assert plan["photos"] == len(told["photos"]) and (workspace / "gaps" / "flight_1.kmz").is_file()
    page = (workspace / "gaps" / "plan.html").read_text()
    assert told["photos"][0]["says"] in page


def test_an_unknown_scale_and_a_workspace_without_a_cloud_are_refused(
    textured: tuple[Path, Run], tmp_path: Path
) -> None:
    workspace = tmp_path / "w"
    shutil.copytree(textured[0], workspace)
    record = workspace / "views.json"
    record.write_text(record.read_text().replace('"scale": "metres"', '"scale": "unknown"'))
    run = curecon("gaps", workspace)
    assert run.code == 14 and "scale" in run.summary["error"]
    (workspace / "cloud.ply").unlink()
    assert curecon("gaps", workspace).code == 5
    assert curecon("gaps", tmp_path).code == 5


def test_a_file_that_holds_no_patches_is_refused(textured: tuple[Path, Run], tmp_path: Path) -> None:
    for content in (b"", b"ply\n", (textured[0] / "cloud.ply").read_bytes()):
        (tmp_path / "gaps.ply").write_bytes(content)
        with pytest.raises(WorkspaceError, match="cannot be read as gaps"):
            patches.read_patches(tmp_path / "gaps.ply")


def test_gaps_are_found_and_drawn_in_blender(
    blender: Path, textured: tuple[Path, Run], tmp_path: Path  # noqa: F811
) -> None:
    shutil.copytree(textured[0], tmp_path / "w")
    run_script(blender, "check_gaps.py", tmp_path / "w", Path(sys.executable), resources=tmp_path / "user")
