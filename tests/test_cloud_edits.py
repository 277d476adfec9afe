# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Points taken out of a cloud, as the workspace keeps them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import curecon
from test_meshing import HOUSE

from curecon_blender.core.base.errors import WorkspaceError
from curecon_blender.core.base.files import write_json
from curecon_blender.core.base.records import Component, Frame
from curecon_blender.core.cloud import edits as cloud_edits
from curecon_blender.core.cloud.ply import Cloud, CloudWriter
from curecon_blender.core.surface.mesh import read_mesh
from curecon_blender.core.views import record as components


def write(path: Path, count: int, seed: int = 0) -> Cloud:
    rng = np.random.default_rng(seed)
    cloud = Cloud(
        points=rng.random((count, 3), np.float32), colours=np.zeros((count, 3), np.uint8),
        normals=np.zeros((count, 3), np.float32), confidence=np.ones(count, np.float32),
        views=np.full(count, 3, np.uint8),
    )
    with CloudWriter(path) as writer:
        writer.write(cloud)
    return cloud


def test_removed_points_are_kept_beside_the_cloud(tmp_path: Path) -> None:
    path = tmp_path / "cloud_1.ply"
    cloud = write(path, 1003)
    before = path.read_bytes()
    assert cloud_edits.edits_key(path) == "" and len(cloud_edits.read_edited_cloud(path)) == 1003
    removed = np.arange(1003) % 5 == 0
    cloud_edits.write_removed(path, removed)
    assert (tmp_path / "removed_1.npz").is_file() and path.read_bytes() == before
    np.testing.assert_array_equal(cloud_edits.read_removed(path, 1003), removed)
    np.testing.assert_array_equal(cloud_edits.read_edited_cloud(path).points, cloud.points[~removed])
    first = cloud_edits.edits_key(path)
    cloud_edits.write_removed(path, ~removed)
    assert first and cloud_edits.edits_key(path) not in ("", first)
    cloud_edits.write_removed(path, np.zeros(1003, bool))
    assert not (tmp_path / "removed_1.npz").exists()


def test_another_cloud_has_all_its_points(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    write(path, 500)
    cloud_edits.write_removed(path, np.ones(500, bool))
    write(path, 500, seed=1)
    assert cloud_edits.is_stale(path) and cloud_edits.read_removed(path, 500) is None
    assert len(cloud_edits.read_edited_cloud(path)) == 500 and cloud_edits.edits_key(path) == ""
    (tmp_path / "removed.npz").write_bytes(b"no archive")
    with pytest.raises(WorkspaceError, match="damaged"):
        cloud_edits.read_edited_cloud(path)


def test_a_mesh_is_made_of_a_turned_region_without_what_was_taken_out(tmp_path: Path) -> None:
    """The command line on a workspace whose cloud is finished."""
    cloud = HOUSE
    with CloudWriter(tmp_path / "cloud.ply") as writer:
        writer.write(cloud)
    write_json(tmp_path / "workspace.json", {"format": 1})
    write_json(tmp_path / "photos.json", {"photos": [], "skipped": []})
    write_json(tmp_path / "stages" / "fusion.json", {"key": "k", "seconds": 0, "peak_gib": 0})
    frame = Frame(scale="metres", up="gps")
    components.write(tmp_path, [Component(index=0, sparse="sparse/0", cloud="cloud.ply", frame=frame)])
    cloud_edits.write_removed(tmp_path / "cloud.ply", cloud.points[:, 0] > 0.5)
    half = np.radians(30) / 2  # the box is turned by 30 degrees; the site turns back to it
    box = ["--region-turn", np.cos(half), 0, 0, -np.sin(half), "--region", -2, -0.8, -0.2, 2, 0.8, 0.5]
    run = curecon("surface", tmp_path, "--until", "mesh", *box)
    assert run.code == 0, run.said
    mesh = read_mesh(tmp_path / "mesh.ply")
    x, y = mesh.vertices[:, :2].T
    along, across = x * np.cos(2 * half) + y * np.sin(2 * half), y * np.cos(2 * half) - x * np.sin(2 * half)
    assert np.abs(along).max() <= 2.001 and np.abs(across).max() <= 0.801 and mesh.vertices[:, 2].max() <= 0.501
    assert along.min() < -1.8 and np.ptp(across) > 1.5
    assert mesh.vertices[~np.isin(np.arange(len(x)), mesh.faces[mesh.filled]), 0].max() < 0.7  # no further than 0.5
