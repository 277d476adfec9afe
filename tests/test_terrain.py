# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The ground of a site, closed where nobody saw it, and the line where the site ends."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.cloud.ply import Cloud, joined
from curecon_blender.core.surface.build import MeshOptions, build_mesh
from curecon_blender.core.surface.poisson import poisson
from curecon_blender.core.surface.terrain import Outline, closed_ground
from curecon_blender.core.surface.triangles import triangle_areas, unit
from tests.test_holes import SPACING, Looks, plane

HALF = 5.0  # metres: half the side of a square of ground
UNSURE = Looks(30.0, sure=False)


def field(slope: float = 0.0) -> Cloud:
    return plane((-HALF, -HALF, 0), (2 * HALF, 0, 2 * HALF * slope), (0, 2 * HALF, 0))


def without(cloud: Cloud, x: tuple[float, float], y: tuple[float, float]) -> Cloud:
    inside = (cloud.points[:, 0] > x[0]) & (cloud.points[:, 0] < x[1]) & (cloud.points[:, 1] > y[0]) & (
        cloud.points[:, 1] < y[1])
    return cloud.take(~inside)


def tree() -> Cloud:
    """Leaves that turn every way, in a ball 2 m above the ground's middle."""
    rng = np.random.default_rng(0)
    places, normals = unit(rng.normal(0, 1, (2, 4000, 3)))
    places *= rng.random((4000, 1)) ** (1 / 3)
    like = field().take(np.zeros(4000, np.int64))
    return Cloud(points=(places + [0, 0, 3]).astype(np.float32), colours=like.colours, confidence=like.confidence,
                 normals=normals.astype(np.float32), views=like.views)


def made(site: Cloud, looks: Looks = UNSURE) -> tuple[Cloud, Outline]:
    return closed_ground(site, site.take(np.zeros(0, np.int64)), SPACING, looks)


@pytest.mark.parametrize("slope", [0.0, 0.2])
def test_a_hole_in_the_ground_is_closed_along_its_rim(slope: float) -> None:
    found, _ = made(without(field(slope), (-1, 1), (-1, 1)))
    inside = found.points[(np.abs(found.points[:, :2]) < 0.9).all(axis=1)]
    assert len(inside) > 0.8 * 1.8**2 / (2 * SPACING) ** 2
    assert np.abs(inside[:, 2] - slope * (inside[:, 0] + HALF)).max() < 0.05
    assert (found.views == 0).all()
    expected = np.array([-slope, 0, 1]) / np.hypot(slope, 1)
    assert (found.normals @ expected > 0.98).mean() > 0.95


def test_a_hole_that_a_photo_looks_through_stays_open() -> None:
    found, _ = made(without(field(), (-1, 1), (-1, 1)), Looks(30.0))
    assert not len(found)


def test_the_ground_is_closed_under_a_tree_and_not_within_a_building() -> None:
    site = without(field(), (-1, 1), (-1, 1))
    roof = plane((-1.2, -1.2, 2.4), (2.4, 0, 0), (0, 2.4, 0))
    assert len(made(joined(site, tree()))[0]) > 0.8 * 1.8**2 / (2 * SPACING) ** 2
    assert not len(made(joined(site, roof))[0])


def test_behind_half_a_house_the_ground_goes_on_under_its_roof_to_the_wall_that_was_seen() -> None:
    site = without(field(), (-1.5, 1.5), (-2, 1))  # the front at y = -2 and the roof to its ridge at y = -1.6 were seen
    half = joined(plane((-1.5, -2, 0), (3, 0, 0), (0, 0, 2)), plane((-1.5, -2, 2), (3, 0, 0), (0, 0.4, 0)))
    found, _ = made(joined(site, half))
    under = (np.abs(found.points[:, 0]) < 1.2) & (found.points[:, 1] < -1.6) & (found.points[:, 1] > -1.9)
    assert under.sum() > 0.5 * 2.4 * 0.3 / (2 * SPACING) ** 2 and np.abs(found.points[under, 2]).max() < 0.1


def test_a_tongue_of_ground_is_cut_off_and_one_that_carries_a_house_or_a_wall_is_not() -> None:
    tongue = plane((-0.25, HALF, 0), (0.5, 0, 0), (0, 3, 0))
    end = np.array([[0, HALF + 2, 0]])
    assert made(joined(field(), tongue))[1].depths(end)[0] < 0
    roof = plane((-0.6, HALF + 1.4, 2), (1.2, 0, 0), (0, 1.2, 0))
    wall = plane((0, HALF, 0), (0, 3, 0), (0, 0, 2))
    for built in (roof, wall):
        assert made(joined(field(), tongue, built))[1].depths(end)[0] > 0


def test_nothing_of_a_facade_alone_is_cut_off() -> None:
    facade = joined(plane((-5, 0, 0), (10, 0, 0), (0, 0, 3)), plane((-5, -0.3, 0), (10, 0, 0), (0, 0.3, 0)))
    assert (made(facade)[1].depths(facade.points) > -2 * SPACING).all()


def test_a_path_that_is_narrow_all_along_stays() -> None:
    path = plane((-20, -0.6, 0), (40, 0, 0), (0, 1.2, 0))
    inside = made(path)[1].depths(path.points) > 0
    assert inside.mean() > 0.8 and inside[np.abs(path.points[:, 0]) < 19].mean() > 0.85


def test_a_narrow_bay_is_closed_and_what_lies_beyond_the_site_is_not() -> None:
    found, outline = made(without(field(), (-0.8, 0.8), (2, HALF)))
    bay = (np.abs(found.points[:, 0]) < 0.6) & (found.points[:, 1] > 2.2) & (found.points[:, 1] < HALF - 0.5)
    assert bay.sum() > 0.8 * 1.2 * (HALF - 2.7) / (2 * SPACING) ** 2
    assert np.abs(found.points[:, :2]).max() < HALF + 0.3
    beyond, middle = outline.depths(np.array([[0.0, HALF + 1, 0], [0, 0, 0]]))
    assert beyond == pytest.approx(-1, abs=0.4) and middle > 3


def test_a_bay_between_buildings_stays_open() -> None:
    low = without(field(), (-2.2, 2.2), (0.5, HALF))
    roofs = [plane((x, 0.5, 2), (1.4, 0, 0), (0, HALF - 0.5, 0)) for x in (-2.2, 0.8)]
    found, outline = made(joined(low, *roofs))
    between = np.array([[0.0, 1.5, 0]])
    assert outline.depths(between)[0] > 0
    assert not (np.linalg.norm(found.points - between, axis=1) < 0.5).any()


def test_a_site_closes_its_ground_and_ends_smoothly_and_everything_measured_does_not(tmp_path: Path) -> None:
    site = joined(without(field(), (-1.5, 1.5), (-1.5, 1.5)), plane((-0.25, HALF, 0), (0.5, 0, 0), (0, 3, 0)))
    measured, tongue, hole = {}, {}, {}
    for extent in ("site", "everything"):
        mesh = build_mesh(site, MeshOptions(extent=extent), tmp_path / extent, Reporter(), UNSURE)
        centres, areas = mesh.vertices[mesh.faces].mean(axis=1), triangle_areas(mesh.vertices[mesh.faces])
        inside = (np.abs(centres[:, :2]) < 1.2).all(axis=1)
        hole[extent], tongue[extent] = areas[inside].sum(), areas[centres[:, 1] > HALF + 1].sum()
        measured[extent] = areas[inside & ~mesh.filled].sum()
    assert hole["site"] == pytest.approx(2.4**2, rel=0.1) and measured["site"] == 0
    assert tongue["site"] == 0 and tongue["everything"] > 0.5
    assert hole["everything"] == 0


def test_a_site_that_is_a_little_larger_is_meshed_as_finely(tmp_path: Path) -> None:
    made_faces = []
    for long in (4.5, 4.8):  # an octree as wide as each would have leaves of 1.9 and of 1.03 spacings
        cloud = plane((0, 0, 0), (long, 0, 0), (0, 2, 0))
        (tmp_path / str(long)).mkdir()
        vertices, faces = poisson(cloud, SPACING, 1_000_000, tmp_path / str(long), Reporter())
        near = np.abs(vertices[faces].mean(axis=1) - [long / 2, 1, 0]) < [0.9, 0.9, 0.1]
        made_faces.append(near.all(axis=1).sum())
    assert made_faces[0] == pytest.approx(made_faces[1], rel=0.2)
