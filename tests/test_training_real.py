# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A finished reconstruction as a scene to train on: only depth that many photos agree on, the rest unknown."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from conftest import Run

from training.generator import back_project, load, project, save
from training.real import real_scene


def test_a_reconstruction_becomes_a_scene_whose_depth_many_photos_share(
    finished: tuple[Path, Run], tmp_path: Path
) -> None:
    scene = real_scene(finished[0])
    known = scene.depth > 0
    assert not scene.complete and 0.1 < known.mean() < 0.95
    assert scene.visible.shape == (len(scene.images), len(scene.points)) and (scene.visible.sum(axis=0) >= 2).all()

    rows, columns = np.nonzero(known[0])
    pixels = np.column_stack([columns, rows]) + 0.5
    points = back_project(scene.K[0], scene.cam_from_world[0], pixels, scene.depth[0][rows, columns])
    shared = np.zeros(len(points), int)
    for K, pose, depth in zip(scene.K[1:], scene.cam_from_world[1:], scene.depth[1:], strict=True):
        (u, v), z = project(K, pose, points)[0].T.astype(int), project(K, pose, points)[1]
        inside = (z > 0) & (u >= 0) & (v >= 0) & (u < depth.shape[1]) & (v < depth.shape[0])
        there = np.where(inside, depth[v * inside, u * inside], 0)
        shared += np.abs(there / z - 1) < 0.006
    assert (shared >= 1).mean() > 0.8

    save(scene, tmp_path / "scene.npz")
    again = load(tmp_path / "scene.npz")
    assert not again.complete and ((again.depth > 0) == known).all()
