# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Walls that no photo saw, under the eaves of a roof that photos did see."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.cloud.ply import Cloud, joined
from curecon_blender.core.surface.build import MeshOptions, build_mesh
from curecon_blender.core.surface.eaves import under_eaves
from tests.test_holes import SPACING, Looks, plane

LONG, WIDE, EAVE, JUT = 3.0, 2.0, 2.6, 0.5  # half the sides of a house's walls, metres
NONE = np.zeros(0, np.int64)


def house(*, front: float | None = None, walls: bool = True) -> Cloud:
    """A house with a flat roof on level ground; photos saw three of its walls, and one at the front that stands so far
    behind where the others would meet it."""
    x, y = LONG + JUT, WIDE + JUT
    parts = [plane((-x, -y, EAVE), (2 * x, 0, 0), (0, 2 * y, 0)),
             plane((-8, -8, 0), (16, 0, 0), (0, 8 - y, 0)), plane((-8, y, 0), (16, 0, 0), (0, 8 - y, 0)),
             plane((-8, -y, 0), (8 - x, 0, 0), (0, 2 * y, 0)), plane((x, -y, 0), (8 - x, 0, 0), (0, 2 * y, 0))]
    if walls:
        parts += [plane((LONG, -WIDE, 0), (0, 2 * WIDE, 0), (0, 0, EAVE)),
                  plane((-LONG, WIDE, 0), (0, -2 * WIDE, 0), (0, 0, EAVE)),
                  plane((LONG, WIDE, 0), (-2 * LONG, 0, 0), (0, 0, EAVE))]
    if front is not None:
        parts.append(plane((-LONG, front - WIDE, 0), (2 * LONG, 0, 0), (0, 0, EAVE)))
    return joined(*parts)


def made(cloud: Cloud, looks: Looks | None = None) -> Cloud:
    return under_eaves(cloud, cloud.take(NONE), SPACING, looks or Looks(30.0, sure=False))


def test_a_wall_that_nobody_saw_stands_as_far_under_its_eave_as_the_others_do() -> None:
    found = made(house())
    middle = found.points[np.abs(found.points[:, 0]) < LONG - JUT]
    assert len(middle) > 0.8 * (2 * (LONG - JUT) * EAVE) / SPACING**2
    assert np.abs(middle[:, 1] + WIDE).max() < 0.15
    assert middle[:, 2].min() < 0.1 and EAVE - 0.3 < middle[:, 2].max() < EAVE + 0.1
    assert (found.normals[np.abs(found.points[:, 0]) < LONG - JUT, 1] < -0.9).all()
    assert (found.views == 0).all()
    assert (found.points[:, 1] < 0).all()


@pytest.mark.parametrize(("site", "looks"), [
    (house(front=0.0), None), (house(front=0.8), None), (house(walls=False), None), (house(), Looks(30.0)),
], ids=["all were seen", "one stands farther in", "on posts", "a photo looks through"])
def test_no_wall_stands_where_one_was_seen_or_none_is_known_or_a_photo_looks_through(
    site: Cloud, looks: Looks | None
) -> None:
    found = made(site, looks)
    assert not (np.abs(found.points[:, 0]) < LONG - JUT).any()


def test_where_photos_saw_no_farther_a_roof_does_not_end() -> None:
    site = house()
    seen = made(site.take(site.points[:, 1] > -WIDE - JUT))
    assert not (np.abs(seen.points[:, 0]) < LONG - JUT).any()


def test_a_short_stretch_of_dark_ground_beside_a_roof_opens_no_wall() -> None:
    site = house()
    dark = (site.points[:, 2] < 0.5) & (site.points[:, 1] < -WIDE - JUT) & (np.abs(site.points[:, 0]) < 0.8)
    found = made(site.take(~dark))
    assert len(found.take(np.abs(found.points[:, 0]) < 0.6)) > 0.8 * (2 * 0.6 * EAVE) / SPACING**2


def test_a_roof_that_reaches_over_another_does_not_tell_how_far_that_one_juts_out() -> None:
    high, far = 6.0, 1.3  # a tower's eaves, and how far they jut out
    side = LONG + JUT - 2 * SPACING  # of the tower's roof, above the edge of the house's
    tower = joined(plane((side, -3 - far, high), (6 + 2 * far, 0, 0), (0, 6 + 2 * far, 0)),
                   plane((side + far, 3, 0), (6, 0, 0), (0, 0, high)),
                   plane((side + far + 6, -3, 0), (0, 6, 0), (0, 0, high)),
                   plane((side + far, -3, 0), (6, 0, 0), (0, 0, high)))
    found = made(joined(house(), tower))
    middle = found.points[np.abs(found.points[:, 0]) < LONG - JUT]
    assert len(middle) and np.abs(middle[:, 1] + WIDE).max() < 0.15


def test_the_ground_goes_on_to_a_wall_that_stands_under_an_eave(tmp_path: Path) -> None:
    mesh = build_mesh(house(), MeshOptions(), tmp_path / "scratch", Reporter(), Looks(30.0, sure=False))
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    under = (np.abs(centres[:, 2]) < 0.1) & (np.abs(centres[:, 0]) < 2) & (centres[:, 1] > -WIDE - JUT + 0.1) & (
        centres[:, 1] < -WIDE - 0.1)
    assert mesh.areas[under].sum() > 0.8 * 4 * (JUT - 0.2) and mesh.filled[under].mean() > 0.9


def test_a_cloud_of_bare_ground_has_no_eaves() -> None:
    assert len(made(plane((-4, -4, 0), (8, 0, 0), (0, 8, 0)))) == 0
