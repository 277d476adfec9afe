# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes of clouds drawn from a box house on the ground: on the surface, honest about holes, and within limits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
import pytest
from box_scene import BOX, surface_distance, texture
from scipy.spatial import cKDTree

from curecon_blender.core.base.errors import Cancelled
from curecon_blender.core.base.messages import Progress, Reporter
from curecon_blender.core.cloud.ply import Cloud
from curecon_blender.core.surface import build as surface
from curecon_blender.core.surface import poisson
from curecon_blender.core.surface.build import SHARES, MeshOptions, build_mesh
from curecon_blender.core.surface.mesh import Mesh, MeshError
from evaluation.mesh import sample
from evaluation.soundness import soundness

SPACING = 0.03  # metres
HOLE = np.array([0.3, -0.2, 1.5])  # in the roof
HOLE_RADIUS = 0.25


def patch(origin: tuple[float, ...], u: tuple[float, ...], v: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Points (n,3) over a parallelogram, a spacing apart with some disorder, and their normals u x v."""
    a, b, normal = np.array(u), np.array(v), np.cross(u, v)
    i, j = (np.arange(0.5, np.linalg.norm(side) / SPACING) * SPACING / np.linalg.norm(side) for side in (a, b))
    weights = np.stack(np.meshgrid(i, j), axis=-1).reshape(-1, 2)
    weights += np.random.default_rng(1).normal(0, 0.1 * SPACING, weights.shape)
    points = np.array(origin) + weights @ np.stack([a, b])
    return points, np.tile(normal / np.linalg.norm(normal), (len(points), 1))


def cloud_of(points: np.ndarray, normals: np.ndarray, views: int = 5) -> Cloud:
    return Cloud(points=points.astype(np.float32), colours=texture(points), normals=normals.astype(np.float32),
                 confidence=np.full(len(points), 0.9, np.float32), views=np.full(len(points), views, np.uint8))


def joined(*clouds: Cloud) -> Cloud:
    return Cloud(*(np.concatenate([getattr(c, name) for c in clouds])
                   for name in ("points", "colours", "normals", "confidence", "views")))


def house() -> Cloud:
    """Ground |x|, |y| < 2.5 without what is under the house, four walls, and a roof with a round hole."""
    patches = [patch((-2.5, -2.5, 0), (5, 0, 0), (0, 5, 0)), patch((-1, -1, 1.5), (2, 0, 0), (0, 2, 0)),
               patch((-1, -1, 0), (2, 0, 0), (0, 0, 1.5)), patch((1, -1, 0), (0, 2, 0), (0, 0, 1.5)),
               patch((1, 1, 0), (-2, 0, 0), (0, 0, 1.5)), patch((-1, 1, 0), (0, -2, 0), (0, 0, 1.5))]
    points, normals = (np.concatenate(arrays) for arrays in zip(*patches, strict=True))
    under = (np.abs(points[:, :2]) < 1).all(axis=1) & (points[:, 2] < 0.01) & (normals[:, 2] > 0.5)
    keep = ~under & (np.linalg.norm(points - HOLE, axis=1) > HOLE_RADIUS)
    return cloud_of(points[keep], normals[keep])


HOUSE = house()


def build(cloud: Cloud, folder: Path, reporter: Reporter | None = None, **options: object) -> Mesh:
    return build_mesh(cloud, MeshOptions(**options), folder / "scratch", reporter or Reporter())  # type: ignore


def check_sound(mesh: Mesh) -> None:
    assert np.isfinite(mesh.vertices).all() and np.isfinite(mesh.distance).all()
    assert np.array_equal(np.unique(mesh.faces), np.arange(len(mesh.vertices)))
    assert mesh.areas.min() > 0
    ends = mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    assert np.unique(np.sort(ends, axis=1), axis=0, return_counts=True)[1].max() <= 2
    assert np.unique(ends, axis=0, return_counts=True)[1].max() == 1  # neighbours turn the same way round
    found = soundness(mesh.vertices, mesh.faces)
    assert found.crossing <= 1e-3 * found.faces and found.folds <= 1e-3 * found.faces and found.slivers < 8, found


def normals_of(mesh: Mesh) -> np.ndarray:
    corners = mesh.vertices[mesh.faces]
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def in_hole(places: np.ndarray) -> np.ndarray:
    return np.linalg.norm(places - HOLE, axis=1) < HOLE_RADIUS - 4 * SPACING


@pytest.fixture(scope="module")
def mesh(tmp_path_factory: pytest.TempPathFactory) -> Mesh:
    return build(HOUSE, tmp_path_factory.mktemp("mesh"))


def test_the_surface_is_where_the_points_are_and_nowhere_else(mesh: Mesh) -> None:
    check_sound(mesh)
    points, face = sample(mesh, 0.02)
    measured = ~mesh.filled[face]
    distance = surface_distance(points[measured])
    assert distance.mean() < 0.3 * SPACING and np.percentile(distance, 99) < 2 * SPACING
    to_mesh = cKDTree(points).query(HOUSE.points)[0]
    assert np.percentile(to_mesh, 99) < SPACING
    assert (np.abs(mesh.vertices[:, :2]) < 2.5 + 5 * SPACING).all()  # no skirt beyond the ground's edge
    assert mesh.vertices[:, 2].min() > -4 * SPACING  # nor a floor under it
    assert mesh.distance[~np.isin(np.arange(len(mesh.vertices)), mesh.faces[mesh.filled])].max() < 5 * SPACING


def test_faces_look_outwards(mesh: Mesh) -> None:
    corners = mesh.vertices[mesh.faces].mean(axis=1)
    roof = (np.abs(corners[:, 2] - BOX[1, 2]) < SPACING) & (np.abs(corners[:, :2]) < 0.8).all(axis=1)
    wall = (np.abs(corners[:, 0] - 1) < SPACING) & (np.abs(corners[:, 1]) < 0.8) & (np.abs(corners[:, 2] - 0.7) < 0.4)
    normals = normals_of(mesh)
    assert (normals[roof, 2] > 0).mean() > 0.99 and (normals[wall, 0] > 0).mean() > 0.99


def test_a_small_hole_is_closed_and_said_to_be(mesh: Mesh) -> None:
    points, face = sample(mesh, 0.02)
    assert in_hole(points).sum() > 30
    assert mesh.filled[face[in_hole(points)]].mean() > 0.9
    far = np.linalg.norm(points - HOLE, axis=1) > HOLE_RADIUS + 3 * SPACING
    assert mesh.filled[face[far]].mean() < 0.01
    middle = np.linalg.norm(mesh.vertices - HOLE, axis=1).argmin()
    assert mesh.views[middle] == 0 and mesh.distance[middle] == pytest.approx(HOLE_RADIUS, abs=2 * SPACING)
    assert np.median(mesh.views) == 5


def test_holes_stay_open_where_asked(tmp_path: Path) -> None:
    mesh = build(HOUSE, tmp_path, fill_holes=False)
    check_sound(mesh)
    assert not in_hole(sample(mesh, 0.02)[0]).any()
    assert not mesh.filled.any() and mesh.distance.max() < 5 * SPACING


def test_colours_are_those_of_the_place(mesh: Mesh) -> None:
    known = mesh.distance < SPACING
    error = np.abs(mesh.colours[known].astype(int) - texture(mesh.vertices[known]))
    assert np.median(error) < 8 and np.percentile(error, 95) < 40


def test_what_floats_or_is_unsure_is_gone(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    ball = random.normal(size=(150, 3))
    ball /= np.linalg.norm(ball, axis=1)[:, None]
    floating = cloud_of(np.array([0, 0, 2.5]) + 0.08 * ball, ball)
    directions = random.normal(size=(3000, 3))
    sky = replace(cloud_of(random.uniform((-2, -2, 1.8), (2, 2, 3), (3000, 3)),
                           directions / np.linalg.norm(directions, axis=1)[:, None]),
                  confidence=np.full(3000, 0.3, np.float32))
    mesh = build(joined(HOUSE, floating, sky), tmp_path)
    check_sound(mesh)
    assert mesh.vertices[:, 2].max() < 1.5 + 4 * SPACING


def test_max_faces_holds_and_the_surface_stays(tmp_path: Path) -> None:
    mesh = build(HOUSE, tmp_path, max_faces=2000)
    check_sound(mesh)
    assert 1000 < len(mesh.faces) <= 2000
    points, face = sample(mesh, 0.02)
    assert surface_distance(points[~mesh.filled[face]]).mean() < 0.5 * SPACING
    assert mesh.filled[face[in_hole(points)]].mean() > 0.5  # coarse faces, still honest
    assert not list((tmp_path / "scratch").iterdir())


def test_a_cloud_of_too_many_points_is_thinned_evenly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(surface, "POINTS_A_FACE", 0.01)
    told: list[str] = []
    mesh = build(HOUSE, tmp_path, Reporter(lambda message: told.append(getattr(message, "text", ""))))
    check_sound(mesh)
    points, face = sample(mesh, 0.02)
    assert surface_distance(points[~mesh.filled[face]]).mean() < 0.5 * SPACING
    assert cKDTree(points).query(HOUSE.points)[0].max() < 4 * SPACING  # nothing of the house is gone
    used = int(next(text for text in told if "of the cloud's" in text).split()[5])
    assert 5_000 < used <= 10_000 < len(HOUSE)


def test_only_the_region_is_made(tmp_path: Path) -> None:
    region = ((-0.5, -3.0, 0.3), (3.0, 0.5, 2.0))
    for max_faces in (1_000_000, 1500):
        mesh = build(HOUSE, tmp_path, region=region, max_faces=max_faces)
        check_sound(mesh)
        assert (mesh.vertices >= np.float32(region[0])).all() and (mesh.vertices <= np.float32(region[1])).all()
        assert mesh.vertices[:, 0].min() < -0.4 and mesh.vertices[:, 2].max() > 1.45


def test_a_plane_gives_a_plane(tmp_path: Path) -> None:
    points, normals = patch((-2, -2, 0), (4, 0, 0), (0, 4, 0))
    mesh = build(cloud_of(points, normals), tmp_path)
    check_sound(mesh)
    assert np.abs(mesh.vertices[:, 2]).max() < SPACING
    assert mesh.areas.sum() == pytest.approx(16, rel=0.1)


def test_damaged_points_are_left_out_with_a_word(tmp_path: Path) -> None:
    cloud = replace(HOUSE, points=HOUSE.points.copy())
    cloud.points[::50] = np.nan
    cloud.points[1::500, 0] = np.inf
    reporter = Reporter()
    mesh = build(cloud, tmp_path, reporter)
    check_sound(mesh)
    assert len(reporter.warnings) == 1 and "left out" in reporter.warnings[0]


def test_a_thousand_points_at_one_place_change_nothing(tmp_path: Path, mesh: Mesh) -> None:
    place = len(HOUSE) // 2
    heap = HOUSE.take(np.full(1000, place))
    made = build(joined(HOUSE, heap), tmp_path)
    check_sound(made)
    assert abs(made.areas.sum() / mesh.areas.sum() - 1) < 0.01 and abs(made.filled.mean() - mesh.filled.mean()) < 0.01
    assert cKDTree(made.vertices).query(heap.points[0])[0] < 2 * SPACING


@pytest.mark.skipif(not hasattr(psutil, "RLIMIT_AS"), reason="a process's memory can be limited on Linux only")
@pytest.mark.parametrize("mebibytes", [100, 400])
def test_too_little_memory_for_poisson_is_an_error_in_words_and_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mebibytes: int
) -> None:
    limit = f"import resource; resource.setrlimit(resource.RLIMIT_AS, ({mebibytes} << 20,) * 2)"
    monkeypatch.setattr(poisson, "_POISSON", f"{limit}\n{poisson._POISSON}")
    with pytest.raises(MeshError, match="No surface could be made") as caught:
        build(HOUSE, tmp_path)
    assert caught.value.remedy
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


NOTHING = np.zeros((0, 3))


@pytest.mark.parametrize(("cloud", "options", "says"), [
    (cloud_of(NOTHING, NOTHING), {}, "empty"),
    (cloud_of(HOUSE.points[:900], HOUSE.normals[:900]), {}, "900 points"),
    (replace(HOUSE, points=np.full_like(HOUSE.points, np.nan)), {}, "finite"),
    (replace(HOUSE, normals=np.zeros_like(HOUSE.normals)), {}, "normals"),
    (replace(HOUSE, points=np.ones_like(HOUSE.points)), {}, "same place"),
    (HOUSE, {"max_faces": 0}, "0 faces"),
    (HOUSE, {"region": ((0, 0, 0), (1, 0, 1))}, "no box"),
    (HOUSE, {"region": ((0, 0, 0), (1, np.nan, 1))}, "no box"),
    (HOUSE, {"region": ((10, 10, 0), (11, 11, 1))}, "region"),
])
def test_bad_input_gets_a_clear_error(
    tmp_path: Path, cloud: Cloud, options: dict[str, object], says: str
) -> None:
    with pytest.raises(MeshError, match=says) as caught:
        build(cloud, tmp_path, **options)
    assert caught.value.remedy and caught.value.exit_code == 10


def test_a_cancelled_mesh_goes_on_where_it_stopped_and_progress_moves_all_the_while(tmp_path: Path) -> None:
    def told(seen: list[object]) -> list[int]:
        return [message.done for message in seen if isinstance(message, Progress)]

    begin, end = SHARES[0], SHARES[0] + SHARES[1]  # Poisson
    first: list[object] = []
    with pytest.raises(Cancelled):
        build(HOUSE, tmp_path, Reporter(first.append, cancelled=lambda: max(told(first), default=0) >= end))
    assert any(begin < done < end for done in told(first)), "nothing is told while Poisson works"
    assert told(first) == sorted(told(first))
    second: list[object] = []
    mesh = build(HOUSE, tmp_path, Reporter(second.append))
    assert not any(begin < done < end for done in told(second)) and told(second)[-1] == 100
    assert [path.name for path in tmp_path.iterdir() if path.is_file()] == [], "what was kept stays behind"
    check_sound(mesh)


def test_cancel_between_the_steps(tmp_path: Path) -> None:
    seen: list[object] = []
    reporter = Reporter(seen.append, cancelled=lambda: sum(isinstance(m, Progress) for m in seen) >= 2)
    with pytest.raises(Cancelled):
        build(HOUSE, tmp_path, reporter)
