# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh and texture as a user asks for them: after the cloud, again, cancelled, and where they cannot be had."""

from __future__ import annotations

import contextlib
import shutil
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import psutil
import pytest
from conftest import QUICK, ROOT, MakeOnce, Run, command, curecon
from PIL import Image

from curecon_blender.core.cloud.ply import read_cloud
from curecon_blender.core.surface.mesh import read_mesh

FACES = ["--max-faces", "20000", "--texture-size", "1024"]


@pytest.fixture(scope="session")
def surfaced(finished: tuple[Path, Run], made_once: MakeOnce[tuple[Path, Run]]) -> tuple[Path, Run]:
    """A copy of the finished workspace with its surface: (workspace, run). Read only."""
    def surface(folder: Path) -> tuple[Path, Run]:
        shutil.copytree(finished[0], folder, dirs_exist_ok=True)
        return folder, curecon("surface", folder, *FACES)

    return made_once("surfaced", surface)


def test_a_finished_cloud_becomes_a_textured_mesh(surfaced: tuple[Path, Run]) -> None:
    workspace, run = surfaced
    assert run.code == 0, run.said
    [said] = run.summary["meshes"]
    mesh, plain = read_mesh(workspace / "textured" / "mesh.ply"), read_mesh(workspace / "mesh.ply")
    assert said["textured"] and said["faces"] == len(mesh.faces) == len(plain.faces) <= 20000
    assert 0 <= said["filled_share"] < 0.4
    cloud = read_cloud(workspace / "cloud.ply")
    low, high = np.percentile(cloud.points, [1, 99], axis=0)
    middle = np.median(mesh.vertices, axis=0)
    assert (low < middle).all() and (middle < high).all()
    assert mesh.uv is not None and mesh.page is not None
    for number, name in enumerate(mesh.pages):
        with Image.open(workspace / "textured" / name) as page:
            pixels = np.asarray(page.convert("RGB"))
        height, width = pixels.shape[:2]
        assert max(height, width) <= 1024 and pixels.std() > 10
        # A texel shows what the cloud measured there.
        shown = ~mesh.filled & (mesh.page == number)
        u, v = mesh.uv[shown].mean(axis=1).T
        texels = pixels[np.clip((1 - v) * height, 0, height - 1).astype(int),
                        np.clip(u * width, 0, width - 1).astype(int)].astype(float)
        expected = plain.colours[plain.faces][shown].mean(axis=1)
        assert np.median(np.abs(texels - expected).max(axis=1)) < 30


def test_again_does_nothing_and_another_size_only_textures(surfaced: tuple[Path, Run], tmp_path: Path) -> None:
    workspace = tmp_path / "workspace"
    shutil.copytree(surfaced[0], workspace)
    assert curecon("surface", workspace, *FACES).said.count("already done") == 2
    smaller = curecon("surface", workspace, *FACES[:2], "--texture-size", "512", "--texture-format", "jpeg")
    assert smaller.code == 0 and smaller.said.count("already done") == 1
    left = {p.name for p in (workspace / "textured").iterdir()}
    assert "texture_0.jpg" in left and not any(name.endswith(".png") for name in left)


def test_a_new_cloud_takes_the_old_surface_away(
    surfaced: tuple[Path, Run], site_photos: Path, tmp_path: Path
) -> None:
    workspace = tmp_path / "workspace"
    shutil.copytree(surfaced[0], workspace)
    stricter = curecon("reconstruct", site_photos, "--workspace", workspace, *QUICK, "--min-views", 4)
    assert stricter.code == 0 and not (workspace / "mesh.ply").exists() and not (workspace / "textured").exists()


def test_cancelled_while_it_meshes_it_stops_at_once_and_leaves_nothing(
    finished: tuple[Path, Run], tmp_path: Path
) -> None:
    workspace = tmp_path / "workspace"
    shutil.copytree(finished[0], workspace)
    worker = subprocess.Popen(command("surface", workspace), cwd=ROOT, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 120
    children: list[psutil.Process] = []
    while not children and worker.poll() is None and time.monotonic() < deadline:
        for child in psutil.Process(worker.pid).children():
            with contextlib.suppress(psutil.NoSuchProcess):  # one that has just ended
                children += [child] if "poisson_meshing" in " ".join(child.cmdline()) else []
        time.sleep(0.02)
    assert children, "the mesh was made before it could be cancelled"
    worker.send_signal(signal.SIGINT)
    assert worker.wait(timeout=20) == 130
    assert not children[0].is_running()
    assert not (workspace / ".mesh.partial").exists() and not (workspace / "mesh.ply").exists()
    assert (workspace / "cloud.ply").exists()


def test_what_is_no_finished_workspace_is_refused_and_left_alone(finished: tuple[Path, Run], tmp_path: Path) -> None:
    nothing = curecon("surface", tmp_path / "nothing")
    assert nothing.code == 5 and "not a workspace" in nothing.said and not (tmp_path / "nothing").exists()
    workspace = tmp_path / "workspace"
    shutil.copytree(finished[0], workspace)
    (workspace / "stages" / "fusion.json").unlink()
    unfinished = curecon("surface", workspace)
    assert unfinished.code == 5 and "not finished" in unfinished.said


def test_a_surface_that_cannot_be_made_leaves_the_one_before(surfaced: tuple[Path, Run], tmp_path: Path) -> None:
    workspace = tmp_path / "workspace"
    shutil.copytree(surfaced[0], workspace)
    before = (workspace / "mesh.ply").read_bytes()
    for bad in (["--max-faces", "0"], ["--region", "9000", "9000", "0", "9010", "9010", "5"]):
        failed = curecon("surface", workspace, *bad)
        assert failed.code == 10 and failed.summary["remedy"]
        assert (workspace / "mesh.ply").read_bytes() == before and (workspace / "textured" / "mesh.ply").exists()
