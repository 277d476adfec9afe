# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The sky is told from walls and ground, right up to the roof's outline."""

from __future__ import annotations

import numpy as np
import pytest

from curecon_blender.core.cloud.sky import sky_mask

HEIGHT, WIDTH = 300, 400
K = np.array([[350.0, 0, WIDTH / 2], [0, 350.0, HEIGHT / 2], [0, 0, 1]])
LEVEL = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0]])  # looks north, Z up
DOWN = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0]])


@pytest.fixture(name="photo")
def make_photo() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A house with a white gable before a clouded sky: the picture, its depth map's confidence, and the true sky.

    As the network has it, the sky for six pixels around the house is as sure as the house.
    """
    rng = np.random.default_rng(0)
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    clouds = 20 * np.sin(columns / 60.0) * np.sin(rows / 45.0)
    picture = np.stack([150 + clouds, 185 + clouds, 230 + 0.5 * clouds], axis=2) + rng.normal(0, 1.5, (*rows.shape, 3))
    house = (np.abs(columns - 200) < 110) & (rows > 70 + 0.4 * np.abs(columns - 200))
    ground = rows > 160
    picture[house | ground] = rng.uniform(30, 200, ((house | ground).sum(), 1)) * [1.0, 0.9, 0.7]
    wall = house & (np.abs(columns - 200) < 40) & (rows > 100) & (rows < 155)
    picture[wall] = [225, 222, 215]
    sky = ~(house | ground)
    near_house = np.zeros_like(sky)
    near_house[6:, 6:] |= (house | ground)[:-6, :-6]
    near_house[:-6, :-6] |= (house | ground)[6:, 6:]
    near_house[:-6, 6:] |= (house | ground)[6:, :-6]
    confidence = np.where(sky & ~near_house, rng.uniform(0, 0.4, rows.shape), 0.95)
    return np.clip(picture, 0, 255).astype(np.uint8), confidence.astype(np.float32), sky


def test_the_sky_goes_up_to_the_roof_and_no_wall_goes_with_it(photo: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    picture, confidence, sky = photo
    found = sky_mask(picture, confidence, K, LEVEL)
    assert found[sky].mean() > 0.98
    inner = ~sky & ~np.roll(sky, (3, 3), (0, 1)) & ~np.roll(sky, (3, -3), (0, 1)) & ~np.roll(sky, 4, 0)
    assert found[inner].mean() < 0.01


def test_no_sky_where_one_looks_down_or_where_the_depth_is_sure(
    photo: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> None:
    picture, confidence, _ = photo
    assert not sky_mask(picture, confidence, K, DOWN).any()
    assert not sky_mask(picture, np.full_like(confidence, 0.9), K, LEVEL).any()


def test_a_pale_wall_that_the_network_is_unsure_of_is_no_sky(photo: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    picture, confidence, sky = photo
    wall = np.s_[102:153, 162:238]
    picture[wall], confidence[wall] = [205, 212, 225], 0.4  # in shade, as blue as a cloud
    found = sky_mask(picture, confidence, K, LEVEL)
    assert found[sky].mean() > 0.98 and not found[wall].any()


def test_a_camera_held_on_its_side_sees_its_sky_beyond_another_edge(
    photo: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> None:
    picture, confidence, sky = (np.rot90(each).copy() for each in photo)
    turned = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]) @ LEVEL  # what was up now lies to the left
    confidence = np.where(sky, 0.4, confidence)
    found = sky_mask(picture, confidence, np.array([[350.0, 0, HEIGHT / 2], [0, 350.0, WIDTH / 2], [0, 0, 1]]), turned)
    assert found[sky].mean() > 0.98
