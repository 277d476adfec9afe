# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What closes a surface's gaps and what keeps them open: sheets that go on, and photos that look through."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from curecon_blender.core.base.messages import Progress, Reporter
from curecon_blender.core.base.records import Component, Frame, View
from curecon_blender.core.cloud.ply import Cloud, joined
from curecon_blender.core.surface.borders import clip
from curecon_blender.core.surface.build import SHARES, MeshOptions, build_mesh
from curecon_blender.core.surface.continuation import continued, over_wide_gaps
from curecon_blender.core.surface.extent import FAR, find_building, within
from curecon_blender.core.surface.mesh import MeshError
from curecon_blender.core.surface.sight import Glance, Sight, looked_through, weak_points
from curecon_blender.core.surface.triangles import triangle_areas

SPACING = 0.04
TOP, ROOF = 2.0, 2.7  # metres: where the measured part of the wall ends, and where the roof is
K = np.array([[200.0, 0, 160], [0, 200.0, 120], [0, 0, 1]])


def plane(origin: tuple[float, ...], u: tuple[float, ...], v: tuple[float, ...]) -> Cloud:
    a, b = np.array(u), np.array(v)
    steps = [np.arange(0.5, np.linalg.norm(side) / SPACING) * SPACING / np.linalg.norm(side) for side in (a, b)]
    weights = np.stack(np.meshgrid(*steps), axis=-1).reshape(-1, 2)
    points = np.array(origin) + weights @ np.stack([a, b])
    points += np.random.default_rng(1).normal(0, 0.05 * SPACING, points.shape)
    normal, count = np.cross(a, b) / np.linalg.norm(np.cross(a, b)), len(points)
    return Cloud(points=points.astype(np.float32), colours=np.full((count, 3), 128, np.uint8),
                 normals=np.tile(normal, (count, 1)).astype(np.float32), confidence=np.full(count, 0.9, np.float32),
                 views=np.full(count, 4, np.uint8))


def house(roof: float = ROOF) -> Cloud:
    """A wall at y = 0 that looks to -y, measured up to TOP, with a roof over it that juts out, and the ground before
    it."""
    return joined(plane((-2, 0, 0), (4, 0, 0), (0, 0, TOP)), plane((-2, -1.5, roof), (4, 0, 0), (0, 3, 0)),
                  plane((-2, -3, 0), (4, 0, 0), (0, 3, 0)))


class Looks(Sight):
    """A photo from y = -8, 1.2 m above the ground, whose depth map is given."""

    def __init__(self, depth: float, sure: bool = True, z_up: bool = True) -> None:
        rotation = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
        pose = np.column_stack([rotation, -rotation @ np.array([0, -8, 1.2])])
        self.views = self._told = [View(name="a.jpg", image="a.jpg", width=320, height=240, K=K, cam_from_world=pose,
                                        near=1.0, far=100.0, sources=())]
        self._depth, self._confidence, self.z_up = depth, 0.9 if sure else 0.1, z_up

    def glances(self) -> Iterator[Glance]:
        depth = np.full((240, 320), self._depth, np.float32)
        confidence = np.full(depth.shape, self._confidence, np.float32)
        yield Glance(self.views[0], depth, confidence > 0.5, confidence, np.zeros((240, 320, 3), np.uint8))


def test_a_wall_goes_on_up_to_its_roof_where_no_photo_is_sure() -> None:
    made = continued(house(), SPACING, Looks(30.0, sure=False))
    wall = made.points[np.abs(made.normals[:, 1]) > 0.9]
    middle = wall[np.abs(wall[:, 0]) < 1]
    assert np.abs(wall[:, 1]).max() < SPACING and wall[:, 2].max() < ROOF + SPACING
    heights = np.histogram(middle[:, 2], np.arange(TOP + 0.1, ROOF - 0.15, 0.1))[0]
    assert (heights > 10).all()
    assert (made.views == 0).all()
    assert not (made.points[:, 2] > ROOF + SPACING).any() and made.points[:, 2].min() > -SPACING


def test_a_wide_gap_closes_too_however_dense_the_points_are() -> None:
    roof = 5.6
    made = over_wide_gaps(house(roof), SPACING, Looks(30.0, sure=False))
    middle = made.points[(np.abs(made.normals[:, 1]) > 0.9) & (np.abs(made.points[:, 0]) < 1)]
    assert np.abs(middle[:, 1]).max() < 2 * SPACING and middle[:, 2].max() < roof + SPACING
    heights = np.histogram(middle[:, 2], np.arange(TOP + 0.2, roof - 0.3, 0.1))[0]
    assert (heights > 0.6 * 2 / SPACING * 0.1 / SPACING).all()


def test_a_wide_gap_behind_what_juts_out_of_a_wall_stays_open() -> None:
    roof, low, high, before = 5.6, 2.8, 4.8, 0.5
    bay = plane((-0.8, -before, low), (1.6, 0, 0), (0, 0, high - low))
    made = over_wide_gaps(joined(house(roof), bay), SPACING, Looks(30.0, sure=False))
    wall = made.points[(np.abs(made.normals[:, 1]) > 0.9) & (np.abs(made.points[:, 1]) < 2 * SPACING)]
    behind = (np.abs(wall[:, 0]) < 0.6) & (wall[:, 2] > low + 0.2) & (wall[:, 2] < high - 0.2)
    assert not behind.any()
    beside = (np.abs(wall[:, 0]) > 1.2) & (wall[:, 2] > low + 0.2) & (wall[:, 2] < high - 0.2)
    assert beside.sum() > 500


@pytest.mark.parametrize("z_up", [True, False])
def test_a_wall_goes_on_plumb_though_what_was_seen_of_it_leans_where_z_is_up(z_up: bool) -> None:
    low, lean = 1.2, 0.1
    site = joined(plane((-2, 0, 0), (4, 0, 0), (0, lean * low, low)), plane((-2, -1.5, ROOF), (4, 0, 0), (0, 3, 0)),
                  plane((-2, -3, 0), (4, 0, 0), (0, 3, 0)))
    made = continued(site, SPACING, Looks(30.0, sure=False, z_up=z_up))
    top = made.points[(np.abs(made.normals[:, 1]) > 0.9) & (np.abs(made.points[:, 0]) < 1) & (made.points[:, 2] > 2.2)]
    assert len(top) > 100
    assert (np.median(top[:, 1]) < lean * low + 0.05) == z_up


def test_z_is_up_in_a_region_that_is_turned_about_it_and_not_in_one_that_is_tilted(tmp_path: Path) -> None:
    component = Component(index=0, sparse="", cloud="", frame=Frame(scale="metres", up="gps", north=True), views=())
    turned = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    assert Sight(component, tmp_path, Reporter(), turned).z_up
    assert not Sight(component, tmp_path, Reporter(), turned[:, [0, 2, 1]] * [1, 1, -1]).z_up


def test_a_gap_that_a_sure_photo_looks_through_stays_open() -> None:
    made = continued(house(), SPACING, Looks(30.0))
    assert not ((np.abs(made.normals[:, 1]) > 0.9) & (made.points[:, 2] > TOP + 0.1)
                & (np.abs(made.points[:, 0]) < 1)).any()


@pytest.mark.parametrize(("half", "closed"), [(0.2, True), (0.8, False)])
def test_a_slit_between_two_closed_parts_of_a_wall_is_closed_and_a_wide_gap_is_not(half: float, closed: bool) -> None:
    site = house()  # nobody saw the roof over a part of the wall
    made = continued(site.take((site.points[:, 2] < TOP + 0.1) | (np.abs(site.points[:, 0]) > half)), SPACING,
                     Looks(30.0, sure=False))
    slit = (np.abs(made.normals[:, 1]) > 0.9) & (np.abs(made.points[:, 0]) < half / 2) & (
        made.points[:, 2] > TOP + 0.1) & (made.points[:, 2] < ROOF - 0.15)
    assert slit.any() == closed


def test_a_wall_with_nothing_above_it_ends_where_it_was_measured() -> None:
    wall = plane((-2, 0, 0), (4, 0, 0), (0, 0, TOP))
    assert not len(continued(wall, SPACING, Looks(30.0, sure=False)))


@pytest.mark.parametrize(("wall", "z_up"), [(True, True), (False, True), (True, False)])
def test_level_ground_goes_on_to_a_wall_that_it_meets_and_no_farther(wall: bool, z_up: bool) -> None:
    shade = 0.8  # metres before the wall that no photo saw
    ground = plane((-2, -3, 0), (4, 0, 0), (0, 3 - shade, 0))
    site = joined(ground, plane((-2, 0, 0), (4, 0, 0), (0, 0, TOP))) if wall else ground
    made = continued(site, SPACING, Looks(30.0, sure=False, z_up=z_up))
    in_shade = made.points[(made.points[:, 1] > -shade + SPACING) & (np.abs(made.points[:, 0]) < 1)]
    if wall and z_up:
        assert len(in_shade) > 0.8 * 2 * (shade - SPACING) / (1.25 * SPACING) ** 2  # as far apart as they are made
        assert np.abs(in_shade[:, 2]).max() < SPACING and in_shade[:, 1].max() < 2 * SPACING
    else:
        assert not len(in_shade)


def test_what_one_sure_photo_alone_tells_is_weak_and_new() -> None:
    cloud, sight = house(), Looks(8.0)  # its depth map is the plane y = 0
    weak = weak_points(cloud, sight, SPACING)
    assert len(weak) > 1000 and (weak.views == 1).all()
    assert np.abs(weak.points[:, 1]).max() < 0.01 and (weak.normals[:, 1] < -0.99).all()
    measured = (weak.points[:, 2] > 0.1) & (weak.points[:, 2] < TOP - 0.1) & (np.abs(weak.points[:, 0]) < 1.8)
    assert not measured.any()
    assert not len(weak_points(cloud, Looks(8.0, sure=False), SPACING))


def test_places_before_a_sure_depth_are_looked_through() -> None:
    places = np.array([[0, -4, 1.2], [0, 1, 1.2], [0, -9, 1.2], [90, -4, 1.2]], np.float32)
    assert looked_through(places, Looks(8.0)).tolist() == [1, 0, 0, 0]
    assert not looked_through(places, Looks(8.0, sure=False)).any()


def test_the_closed_wall_is_marked_as_filled(tmp_path: Path) -> None:
    mesh = build_mesh(house(), MeshOptions(), tmp_path / "scratch", Reporter(), Looks(30.0, sure=False))
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    band = (np.abs(centres[:, 1]) < 4 * SPACING) & (np.abs(centres[:, 0]) < 1.5)
    gap = band & (centres[:, 2] > TOP + 0.2) & (centres[:, 2] < ROOF - 0.2)
    wall = band & (centres[:, 2] > 0.3) & (centres[:, 2] < TOP - 0.2)
    assert gap.any() and mesh.filled[gap].all() and not mesh.filled[wall].any()
    assert mesh.areas[gap].sum() > 0.7 * 3 * (ROOF - TOP - 0.4)


def test_a_closed_wall_has_the_colour_of_the_wall_and_not_of_the_roof_that_it_meets(tmp_path: Path) -> None:
    site = house()
    site.colours[site.points[:, 2] > TOP + 0.3] = 220, 60, 40
    mesh = build_mesh(site, MeshOptions(), tmp_path / "scratch", Reporter(), Looks(30.0, sure=False))
    gap = (np.abs(mesh.vertices[:, 1]) < 2 * SPACING) & (np.abs(mesh.vertices[:, 0]) < 1.5) & (
        mesh.vertices[:, 2] > TOP + 0.2) & (mesh.vertices[:, 2] < ROOF - 0.15)
    assert gap.sum() > 50 and np.abs(mesh.colours[gap].astype(int) - 128).max() < 10


@pytest.mark.parametrize("depth", [0.02, 1e-6])
def test_a_camera_inside_of_a_wall_takes_nothing_away(tmp_path: Path, depth: float) -> None:
    sight = Looks(depth)
    rotation = sight.views[0].cam_from_world[:, :3]
    sight.views[0].cam_from_world[:, 3] = -rotation @ np.array([0, 0, 1.0])
    mesh = build_mesh(house(), MeshOptions(), tmp_path / "scratch", Reporter(), sight)
    wall = np.abs(mesh.vertices[mesh.faces][..., 1]).max(axis=1) < 2 * SPACING
    assert mesh.areas[wall & ~mesh.filled].sum() > 0.9 * 4 * TOP


def test_without_depth_maps_it_is_said_what_is_lost(tmp_path: Path) -> None:
    frame = Frame(scale="unknown", up="gravity", north=False)
    component = Component(index=0, sparse="sparse/0", cloud="cloud.ply", frame=frame, views=())
    reporter = Reporter()
    build_mesh(house(), MeshOptions(), tmp_path / "scratch", reporter, Sight(component, tmp_path, reporter))
    assert any("no depth maps" in warning for warning in reporter.warnings)


def test_progress_moves_with_the_depth_maps_that_are_read(tmp_path: Path) -> None:
    class Watched(Looks):
        def glances(self) -> Iterator[Glance]:
            for glance in super().glances():
                self.each()
                yield glance

    seen: list[object] = []
    build_mesh(house(), MeshOptions(), tmp_path / "scratch", Reporter(seen.append), Watched(8.0))
    early = [message.done for message in seen if isinstance(message, Progress) and message.done <= SHARES[0]]
    assert len(set(early)) >= 4 and early == sorted(early)


@pytest.mark.parametrize("slope", [0.0, 0.37])
def test_a_border_is_cut_along_the_iso_line(slope: float) -> None:
    x, y = np.meshgrid(np.arange(11.0), np.arange(11.0))
    vertices = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3).astype(np.float32)
    corner = (np.arange(10)[:, None] * 11 + np.arange(10)).ravel()
    faces = np.concatenate([np.stack([corner, corner + 1, corner + 11], 1),
                            np.stack([corner + 1, corner + 12, corner + 11], 1)]).astype(np.int32)
    field = vertices[:, 0] - 4.3 + slope * (vertices[:, 1] - 5)
    cut, kept = clip(vertices, faces, field)
    assert triangle_areas(cut[kept]).sum() == pytest.approx(57, rel=1e-3)
    inside = cut[np.unique(kept)]
    assert (inside[:, 0] - 4.3 + slope * (inside[:, 1] - 5)).min() > -0.03
    normals = np.cross(cut[kept][:, 1] - cut[kept][:, 0], cut[kept][:, 2] - cut[kept][:, 0])
    assert (normals[:, 2] > 0).all()


def test_background_that_photos_saw_only_from_afar_is_no_site() -> None:
    view = Looks(8.0).views[0]
    x = np.linspace(-1, 1, 50)
    wall = np.stack(np.meshgrid(x, [0.0], x + 1.2), axis=-1).reshape(-1, 3)
    fields = np.stack(np.meshgrid(10 * x[::5], [40.0], x[::5] + 1.2), axis=-1).reshape(-1, 3)
    points = np.concatenate([wall, fields]).astype(np.float32)
    inside = within(points, [view], SPACING, FAR)
    assert inside[: len(wall)].all() and not inside[len(wall) :].any()
    assert within(points, [], SPACING, FAR).all()


def court() -> tuple[Cloud, Cloud]:
    """A wall of 2 m height and 0.8 m thickness about a court of 4 x 4 m, and apart from that the ground, 12 x 12 m,
    with a tree."""
    sides = []
    for turn in range(4):
        angle = np.pi / 2 * turn
        rotation = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        for part in (plane((-2.8, -2.8, 0), (5.6, 0, 0), (0, 0, 2)), plane((2, -2, 0), (-4, 0, 0), (0, 0, 2)),
                     plane((-2.8, -2.8, 2), (5.6, 0, 0), (0, 0.8, 0))):
            sides.append(part.rotated(rotation))
    generator = np.random.default_rng(2)
    leaves = plane((0, 0, 0), (2, 0, 0), (0, 2, 0))
    out = generator.normal(0, 1, leaves.points.shape)
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    leaves.points[:] = np.array([4.5, 4.5, 1.7]) + out * generator.random((len(out), 1)) ** (1 / 3)
    leaves.normals[:] = generator.permutation(out)
    ground = plane((-6, -6, 0), (12, 0, 0), (0, 12, 0))
    hidden = (np.abs(ground.points[:, :2]) < 2.8).all(axis=1) & (np.abs(ground.points[:, :2]) > 2).any(axis=1)
    return joined(*sides), joined(ground.take(~hidden), leaves)


def test_the_building_alone_is_what_stands_with_its_court_and_without_ground_and_trees() -> None:
    walls, around = court()
    building, kept = find_building(joined(walls, around), (), SPACING)
    assert building.tall == pytest.approx(2, abs=0.1)
    assert kept[: len(walls)].mean() > 0.97
    in_court = (np.abs(around.points[:, :2]) < 2).all(axis=1)
    rest = kept[len(walls) :]
    assert rest[in_court].mean() > 0.97 and rest[~in_court].mean() < 0.01


def test_a_mesh_of_the_building_alone_has_no_ground_before_it(tmp_path: Path) -> None:
    sight = Looks(30.0, sure=False)
    made = build_mesh(house(), MeshOptions(extent="building"), tmp_path / "scratch", Reporter(), sight)
    assert made.vertices[:, 2].max() > ROOF - 0.1 and made.vertices[:, 1].min() > -2
    assert (made.vertices[made.vertices[:, 1] < -1][:, 2] > ROOF - 0.2).all()
    field = plane((-2, -2, 0), (4, 0, 0), (0, 4, 0))
    with pytest.raises(MeshError, match="stands on the ground"):
        build_mesh(field, MeshOptions(extent="building"), tmp_path / "scratch", Reporter(), sight)


def test_the_background_stays_where_everything_is_asked_for(tmp_path: Path) -> None:
    far = plane((-2, 40, 0), (4, 0, 0), (0, 0, 2))
    depth = [build_mesh(joined(house(), far), MeshOptions(extent=extent), tmp_path / extent, Reporter(),
                        Looks(30.0, sure=False)).vertices[:, 1].max() for extent in ("site", "everything")]
    assert depth[0] < 3 and depth[1] > 39
