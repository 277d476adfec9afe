# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes with fewer faces, which still know what was measured."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_extension import blender, run_script  # noqa: F401

from curecon_blender.core.base import images
from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.base.options import Options
from curecon_blender.core.run.stages import DETAIL_STAGES, STAGES, Job
from curecon_blender.core.run.workspace import Workspace
from curecon_blender.core.surface.detail import simplified
from curecon_blender.core.surface.mesh import (
    Mesh,
    MeshError,
    detail_folder,
    filled_share,
    mesh_file,
    read_mesh,
    write_mesh,
)
from curecon_blender.core.texture.texture import TextureOptions
from curecon_blender.core.texture.transfer import transfer_texture
from tests import box_scene
from tests.test_texturing import box_mesh, errors


def rough(mesh: Mesh) -> Mesh:
    """As measured surfaces are: of a perfect plane, hardly a face would stay."""
    noise = np.random.default_rng(0).normal(0, 0.005, mesh.vertices.shape)
    return replace(mesh, vertices=mesh.vertices + noise.astype(np.float32))


def test_fewer_faces_keep_the_shape_and_what_was_filled(tmp_path: Path) -> None:
    mesh = rough(box_mesh())
    middle = mesh.vertices[mesh.faces].mean(axis=1)
    mesh = replace(mesh, filled=(middle[:, 2] < 0.05) & (middle[:, 0] > 1.2))
    coarse = simplified(mesh, 1200, tmp_path, Reporter())
    assert 900 < len(coarse.faces) <= 1200
    assert coarse.areas.sum() == pytest.approx(mesh.areas.sum(), rel=0.05)
    assert filled_share([coarse]) == pytest.approx(filled_share([mesh]), abs=0.02)
    x, _, z = coarse.vertices[coarse.faces[coarse.filled]].mean(axis=1).T
    assert coarse.filled.any() and (x > 0.9).all() and (z < 0.1).all()
    low, high = coarse.vertices.min(axis=0), coarse.vertices.max(axis=0)
    np.testing.assert_allclose([low, high], [[-3, -3, 0], [3, 3, 1.5]], atol=0.08)
    assert not list(tmp_path.iterdir())


def test_a_mesh_with_few_faces_stays_as_it_is(tmp_path: Path) -> None:
    mesh = box_mesh()
    assert simplified(mesh, len(mesh.faces), tmp_path, Reporter()).faces is mesh.faces
    with pytest.raises(MeshError, match="0 faces"):
        simplified(mesh, 0, tmp_path, Reporter())


def test_a_level_of_detail_has_its_own_texture(tmp_path: Path) -> None:
    component = box_scene.write_scene(tmp_path, [box_scene.make_view(i, 8) for i in range(8)])
    write_mesh(tmp_path / mesh_file(0), rough(box_mesh(finer=2)))
    options = Options(photos=None, workspace=tmp_path, detail=("150k", "20k"), texture_size=512)
    with Workspace(tmp_path) as workspace:
        job = Job(options, workspace, Reporter(), components=[component])
        STAGES["texture"].run(job)
        for level in options.detail:
            DETAIL_STAGES[level].run(job)
    assert not (tmp_path / detail_folder(0, "150k")).exists()  # the mesh has no more faces than that
    folder = tmp_path / detail_folder(0, "20k")
    mesh = read_mesh(folder / "mesh.ply")
    assert 15_000 < len(mesh.faces) <= 20_000
    pages = [images.read_rgb(folder / page) for page in mesh.pages]
    assert np.sqrt((errors(mesh, pages, 2.5) ** 2).mean()) < 8
    under = (np.abs(mesh.vertices[mesh.faces].mean(axis=1)) < (0.8, 0.8, 0.05)).all(axis=1)
    assert mesh.unseen is not None and under.any() and mesh.unseen[under].mean() > 0.9 and mesh.unseen.mean() < 0.4


def bumpy_and_coarse(folder: Path) -> tuple[Mesh, Mesh]:
    """A hill of 2 x 2 m, all of one grey and with bumps of a centimetre, and the hill alone in 32 faces."""

    def hill(cells: int, bumps: float) -> Mesh:
        x, y = (axis.ravel() for axis in np.meshgrid(*[np.linspace(0, 2, cells + 1)] * 2))
        z = 0.3 * np.abs(x - 1) - 0.2 * y + bumps * np.sin(18 * x) * np.sin(18 * y)
        corner = np.arange((cells + 1) ** 2).reshape(cells + 1, -1)
        a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
        faces = np.concatenate([np.stack(three, -1).reshape(-1, 3) for three in ((a, b, c), (a, c, d))])
        points = np.column_stack([x, y, z]).astype(np.float32)
        return Mesh(vertices=points, faces=faces.astype(np.int32), colours=np.full(points.shape, 190, np.uint8),
                    distance=np.zeros(len(points), np.float32), views=np.full(len(points), 3, np.uint8),
                    filled=np.zeros(len(faces), bool), unseen=np.zeros(len(faces), bool))

    fine, coarse = hill(160, 0.01), hill(4, 0.0)
    images.write_jpeg(folder / "texture_0.jpg", np.full((64, 64, 3), 190, np.uint8))
    uv = fine.vertices[fine.faces][..., :2] / 2
    return fine.with_texture(uv, np.zeros(len(uv), np.int32), ("texture_0.jpg",)), coarse


def test_a_coarse_level_is_shaded_like_the_fine_surface(blender: Path, tmp_path: Path) -> None:  # noqa: F811
    box_scene.write_scene(tmp_path, [box_scene.make_view(i, 8) for i in range(8)])
    folders = [tmp_path / "textured", tmp_path / detail_folder(0, "20k")]
    for folder in folders:
        folder.mkdir(parents=True)
    fine, coarse = bumpy_and_coarse(folders[0])
    write_mesh(folders[0] / "mesh.ply", fine)
    made = transfer_texture(coarse, fine, [folders[0] / "texture_0.jpg"], TextureOptions(page_size=512), folders[1],
                            Reporter(), normal_map=True)
    assert made.normal_pages == ("normal_0.png",)
    write_mesh(folders[1] / "mesh.ply", made)
    run_script(blender, "check_relief.py", tmp_path, resources=tmp_path / "user")
