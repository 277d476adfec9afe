# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A surface that is bumpy, rounded or off the points comes back onto them, with sharp edges, and stays sound."""

from __future__ import annotations

import numpy as np
import pytest

from curecon_blender.core.cloud.ply import Cloud
from curecon_blender.core.surface.crossing import crossing, uncrossed
from curecon_blender.core.surface.refine import refined
from curecon_blender.core.surface.slivers import flipped
from curecon_blender.core.surface.support import Support
from curecon_blender.core.surface.triangles import face_normals, triangle_areas
from evaluation.soundness import soundness

SPACING = 0.05


def grid(side: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices over 4 x 4 m, every `side`, and faces that look up."""
    steps = np.arange(-2, 2 + side / 2, side)
    x, y = np.meshgrid(steps, steps)
    corner = (np.arange(len(steps) - 1)[:, None] * len(steps) + np.arange(len(steps) - 1)).ravel()
    right, up = corner + 1, corner + len(steps)
    faces = np.concatenate([np.stack([corner, right, up], axis=1), np.stack([right, up + 1, up], axis=1)])
    return np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1), faces.astype(np.int32)


def ridge(x: np.ndarray) -> np.ndarray:
    """Heights of a roof of 45 degrees with its ridge at x = 0."""
    heights: np.ndarray = -np.abs(x)
    return heights


@pytest.fixture(scope="module")
def support() -> Support:
    """The roof, measured with noise, with one stray in fifty, and nothing about (1.2, 1.2)."""
    generator = np.random.default_rng(0)
    points = grid(SPACING)[0]
    points[:, :2] += generator.normal(0, 0.1 * SPACING, (len(points), 2))
    side = np.where(points[:, 0] < 0, 1.0, -1.0)
    points[:, 2] = ridge(points[:, 0]) + generator.normal(0, 0.1 * SPACING, len(points))
    points[::50, 2] += 2 * SPACING
    points = points[np.linalg.norm(points[:, :2] - 1.2, axis=1) > 0.5]
    side = np.where(points[:, 0] < 0, 1.0, -1.0)
    normals = np.stack([-side, 0 * side, np.ones(len(points))], axis=1) / np.sqrt(2)
    cloud = Cloud(points=points.astype(np.float32), colours=np.full(points.shape, 128, np.uint8),
                  normals=normals.astype(np.float32), confidence=np.full(len(points), 0.9, np.float32),
                  views=np.full(len(points), 4, np.uint8))
    return Support(cloud, np.full(len(points), SPACING, np.float32), 0.0, np.zeros((0, 3)), 1.0)


@pytest.fixture(scope="module")
def bumpy() -> tuple[np.ndarray, np.ndarray]:
    """The roof as Poisson has it: its ridge rounded off, bumps of a third of the spacing."""
    vertices, faces = grid(0.8 * SPACING)
    vertices[:, 2] = np.minimum(ridge(vertices[:, 0]), -2 * SPACING + 0.3 * SPACING)
    vertices[:, 2] += np.random.default_rng(1).normal(0, 0.15 * SPACING, len(vertices))
    return vertices.astype(np.float32), faces


def inner(vertices: np.ndarray) -> np.ndarray:
    return (np.abs(vertices[:, :2]) < 1.8).all(axis=1) & (np.linalg.norm(vertices[:, :2] - 1.2, axis=1) > 0.6)


def test_it_comes_onto_the_points_and_the_ridge_is_sharp(
    support: Support, bumpy: tuple[np.ndarray, np.ndarray]
) -> None:
    vertices, faces = bumpy
    made = refined(vertices, faces, support)
    off, before = (np.abs(each[:, 2] - ridge(each[:, 0]))[inner(each)] for each in (made, vertices))
    assert np.sqrt((off**2).mean()) < 0.5 * np.sqrt((before**2).mean())
    at_ridge = inner(made) & (np.abs(made[:, 0]) < 0.4 * SPACING)
    assert made[at_ridge, 2].mean() > 0.6 * vertices[at_ridge, 2].mean()  # both lie below it
    normals = face_normals(made, faces)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    slope = inner(made[faces].mean(axis=1)) & (np.abs(made[faces].mean(axis=1)[:, 0]) > 2 * SPACING)
    tilt = np.degrees(np.arccos(np.clip(np.abs(normals[slope][:, [0, 2]]).sum(axis=1) / np.sqrt(2), -1, 1)))
    assert np.median(tilt) < 4


def test_it_stays_sound_and_where_nothing_was_measured_it_stays(
    support: Support, bumpy: tuple[np.ndarray, np.ndarray]
) -> None:
    vertices, faces = bumpy
    made = refined(vertices, faces, support)
    found = soundness(made, faces)
    assert found.crossing == found.folds == 0 and found.slivers < 1
    gap = np.linalg.norm(vertices[:, :2] - 1.2, axis=1) < 0.3
    assert np.abs(made[gap] - vertices[gap]).max() < SPACING


def test_slivers_are_flipped_away_without_a_change_of_shape() -> None:
    vertices, faces = grid(0.1)
    # Every other row pushed onto the next one: half of the faces are caps with a vertex beside their longest edge.
    vertices[:, 0] += np.where(np.arange(len(vertices)) // 41 % 2 == 1, 0.049, 0)
    vertices[:, 1] = np.where(np.arange(len(vertices)) // 41 % 2 == 1, vertices[:, 1] - 0.096, vertices[:, 1])
    made = flipped(vertices, faces)
    before, after = soundness(vertices, faces), soundness(vertices, made)
    assert before.slivers > 20 and after.slivers < before.slivers / 3
    assert after.crowded == after.crossing == after.folds == 0
    assert triangle_areas(vertices[made]).sum() == pytest.approx(triangle_areas(vertices[faces]).sum())
    assert (face_normals(vertices, made)[:, 2] > 0).all()
    # Nothing is flipped over a ridge.
    ridged = vertices * [1, 1, 0] + [0, 0, 1] * ridge(vertices[:, 0])[:, None]
    made = flipped(ridged, faces)
    middle = ridged[made].mean(axis=1)
    assert np.abs(middle[:, 2] - ridge(middle[:, 0])).max() == pytest.approx(
        np.abs(ridged[faces].mean(axis=1)[:, 2] - ridge(ridged[faces].mean(axis=1)[:, 0])).max())


def test_faces_that_refinement_pushed_through_each_other_go_back() -> None:
    """Two sheets, one above the other: where a vertex is pushed through, both stay apart in the end."""
    vertices, faces = grid(0.5)
    count = len(vertices)
    before = np.concatenate([vertices, vertices + [0.1, 0.1, 0.3]]).astype(np.float32)
    both = np.concatenate([faces, faces + count])
    moved = before.copy()
    moved[:, 0] += 0.01
    middle = np.linalg.norm(vertices[:, :2], axis=1).argmin()
    moved[middle, 2] += 0.5
    assert crossing(moved[both], both).any()
    made = uncrossed(before, moved, both)
    assert not crossing(made[both], both).any()
    assert (made == moved).all(axis=1).mean() > 0.9  # all others stay where they were moved to


def test_faces_that_crossed_before_are_smoothed_apart() -> None:
    vertices, faces = grid(0.5)
    before = np.concatenate([vertices, vertices + [0.1, 0.1, 0.3]]).astype(np.float32)
    both = np.concatenate([faces, faces + len(vertices)])
    before[np.linalg.norm(vertices[:, :2], axis=1).argmin(), 2] += 0.5
    assert crossing(before[both], both).any()
    assert not (made := crossing(uncrossed(before, before, both)[both], both)).any(), made.sum()


def test_a_face_of_a_fields_size_is_looked_at_like_the_others() -> None:
    """It spans billions of the small faces' cells: it must cross what it crosses, and not fill the memory."""
    vertices, faces = grid(0.05)
    field = np.array([[-3000, -3000, -299.987], [6000, -3000, 600.013], [0, 6000, 0.013]])
    corners = np.concatenate([vertices[faces], field[None]])
    found = crossing(corners, np.concatenate([faces, len(vertices) + np.array([[0, 1, 2]], np.int32)]))
    normal = np.cross(field[1] - field[0], field[2] - field[0])
    side = (vertices - field[0]) @ normal > 0
    cut = side[faces].any(axis=1) & ~side[faces].all(axis=1)
    assert cut.any()
    np.testing.assert_array_equal(found, np.r_[cut, True])
