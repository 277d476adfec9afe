# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a person sees of a surface: right, wrong and empty are told apart, and the sample site's views are usable."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from curecon_blender.core.base.records import View
from curecon_blender.core.surface.mesh import Mesh
from evaluation.looks import EYE_LEVEL, Truth, measure, read_truth

SITE = Path(__file__).parent.parent / "samples" / "tulou"
WIDTH, HEIGHT, DEPTH = 48, 36, 10.0
GREY = 90


def wall(offset: float = 0.0, right: float = 20.0) -> Mesh:
    """A grey wall across the view, `offset` metres behind the true one, from x = -20 to `right`."""
    x, y = np.meshgrid([-20.0, right], [-20.0, 20.0])
    vertices = np.stack([x, y, np.full_like(x, DEPTH + offset)], axis=-1).reshape(-1, 3).astype(np.float32)
    return Mesh(vertices=vertices, faces=np.array([[0, 2, 1], [1, 2, 3]], np.int32),
                colours=np.full((4, 3), GREY, np.uint8), distance=np.zeros(4, np.float32),
                views=np.full(4, 3, np.uint8), filled=np.zeros(2, bool))


@pytest.fixture(scope="module")
def truth() -> Truth:
    K = np.array([[40.0, 0, WIDTH / 2], [0, 40.0, HEIGHT / 2], [0, 0, 1]])
    view = View(name="1.jpg", image="1.jpg", width=WIDTH, height=HEIGHT, K=K, cam_from_world=np.eye(4)[:3], near=0.1,
                far=100.0, sources=())
    count = EYE_LEVEL + 1
    depth = np.full((count, HEIGHT, WIDTH), DEPTH, np.float32)
    depth[:, : HEIGHT // 4] = np.inf  # beyond the building: counts nowhere
    noise = np.random.default_rng(0).integers(-3, 4, (count, HEIGHT, WIDTH, 3))
    hidden = np.zeros(depth.shape, bool)
    hidden[:, :, WIDTH * 3 // 4 :] = True
    return Truth((view,) * count, depth, (2 * GREY + noise).astype(np.uint8), hidden)


@pytest.mark.parametrize(("offset", "right_10cm", "right_20cm", "wrong", "empty"), [
    (0.0, 100, 100, 0, 0), (-0.15, 0, 100, 0, 0), (0.4, 0, 0, 100, 0), (-2.0, 0, 0, 100, 0), (3.0, 0, 0, 0, 100),
])
def test_a_wall_too_near_or_too_far(
    truth: Truth, offset: float, right_10cm: float, right_20cm: float, wrong: float, empty: float
) -> None:
    for looks in measure(wall(offset), [], truth):
        assert (looks.right_10cm, looks.right_20cm, looks.wrong, looks.empty) == pytest.approx(
            (right_10cm, right_20cm, wrong, empty))


def test_half_a_wall_is_half_empty_and_exposure_is_no_error(truth: Truth) -> None:
    looks, _, _ = measure(wall(right=0.0), [], truth)
    assert looks.right_10cm == pytest.approx(50) and looks.empty == pytest.approx(50)
    assert looks.hidden == pytest.approx(25)  # half of that is seen by no three photos
    assert looks.psnr > 35  # the truth is twice as bright


def test_the_sample_sites_views_show_its_building() -> None:
    truth = read_truth(SITE)
    building = ((truth.depth > 0) & np.isfinite(truth.depth)).mean(axis=(1, 2))
    assert len(truth.views) == 24 and building.min() > 0.2
    hidden = (truth.hidden.sum(axis=(1, 2)) / (building * truth.depth[0].size))[[9, 10, 13]]
    assert hidden[0] < 0.3 and hidden[1] > 0.5 and hidden[2] < 0.3  # one stands before a wall that no photo shows
    heights = np.array([view.centre[2] for view in truth.views])
    assert heights[:EYE_LEVEL].max() < 5 < 10 < heights[EYE_LEVEL:].min()
