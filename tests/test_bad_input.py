# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Bad input gets a clear error, the documented exit code, and loses nothing. (Bad photos: test_photo_check.py.)"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from conftest import QUICK, ROOT, Run, command, curecon
from PIL import Image

from curecon_blender.core.network.weights import SHIPPED
from curecon_blender.core.run.workspace import Workspace


def noise_photos(folder: Path, count: int) -> Path:
    """Photos of entirely different things."""
    folder.mkdir()
    for i in range(count):
        coarse = np.random.default_rng(i).integers(0, 255, (60, 80, 3), np.uint8)
        Image.fromarray(coarse).resize((640, 480), Image.Resampling.BICUBIC).save(folder / f"{i}.jpg")
    return folder


def refused(run: Run, code: int, *words: str) -> None:
    """The run failed with the code, and its error has the words and says what to do."""
    assert run.code == code, run.said
    assert run.summary["exit_code"] == code
    assert run.summary["remedy"]
    for word in words:
        assert word in run.summary["error"], run.summary
    assert "Traceback" not in run.said


def test_a_missing_folder(tmp_path: Path) -> None:
    refused(curecon("reconstruct", tmp_path / "nowhere", "--workspace", tmp_path / "w"), 3, "nowhere")


def test_an_empty_folder(tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    refused(curecon("reconstruct", tmp_path / "photos", "--workspace", tmp_path / "w"), 3, "photos")


@pytest.mark.parametrize("count", [1, 2])
def test_too_few_photos(tmp_path: Path, count: int) -> None:
    photos = noise_photos(tmp_path / "photos", count)
    refused(curecon("reconstruct", photos, "--workspace", tmp_path / "w"), 3, str(count))


def test_photos_that_do_not_overlap(tmp_path: Path) -> None:
    photos = noise_photos(tmp_path / "photos", 4)
    refused(curecon("reconstruct", photos, "--workspace", tmp_path / "w", *QUICK), 4)


def test_one_bad_photo_never_sinks_a_run(site_photos: Path, tmp_path: Path) -> None:
    photos = tmp_path / "photos"
    shutil.copytree(site_photos, photos)
    whole = next(photos.iterdir()).read_bytes()
    (photos / "cut short.jpg").write_bytes(whole[: len(whole) // 3])
    (photos / "a text.jpg").write_text("not a photo")
    Image.new("RGB", (1, 1)).save(photos / "dot.png")
    run = curecon("reconstruct", photos, "--workspace", tmp_path / "w", *QUICK, "--until", "photos")
    assert run.code == 0, run.said
    assert run.summary["photos"] == 6
    assert {Path(s["path"]).name for s in run.summary["skipped"]} == {"cut short.jpg", "a text.jpg", "dot.png"}


def test_odd_file_names_go_all_the_way(site_photos: Path, tmp_path: Path) -> None:
    photos = tmp_path / "photos"
    photos.mkdir()
    odd = ["a space.JPG", "o'clock \"quoted\".JPG", "承启楼.JPG", "two\nlines.JPG", "plain.JPG", "ünï.JPG"]
    for name, file in zip(odd, sorted(site_photos.iterdir()), strict=True):
        shutil.copy2(file, photos / name)
    run = curecon("reconstruct", photos, "--workspace", tmp_path / "w", *QUICK)
    assert run.code == 0, run.said
    assert run.summary["registered"] == len(odd)
    assert len(list((tmp_path / "w" / "depth").glob("*.npz"))) == len(odd)


def test_two_jobs_on_one_workspace(site_photos: Path, tmp_path: Path) -> None:
    with Workspace(tmp_path / "w"):
        refused(curecon("reconstruct", site_photos, "--workspace", tmp_path / "w"), 5, "Another")
    assert curecon("reconstruct", site_photos, "--workspace", tmp_path / "w", "--until", "photos").code == 0


def test_a_workspace_made_by_a_newer_version(site_photos: Path, tmp_path: Path) -> None:
    (tmp_path / "w").mkdir()
    marker = tmp_path / "w" / "workspace.json"
    marker.write_text(json.dumps({"format": 99, "made_by": "CU-Recon"}))
    refused(curecon("reconstruct", site_photos, "--workspace", tmp_path / "w"), 5, "newer")
    assert json.loads(marker.read_text())["format"] == 99


def test_a_file_where_the_workspace_should_be(site_photos: Path, tmp_path: Path) -> None:
    (tmp_path / "w").write_text("mine")
    refused(curecon("reconstruct", site_photos, "--workspace", tmp_path / "w"), 5, "file")
    assert (tmp_path / "w").read_text() == "mine"


@pytest.mark.parametrize("mounted", ["ro,size=1m"], indirect=True)
def test_a_read_only_disk(site_photos: Path, mounted: Path) -> None:
    refused(curecon("reconstruct", site_photos, "--workspace", mounted / "w"), 5, "ermission")


@pytest.mark.parametrize("mounted", ["size=1m"], indirect=True)
def test_a_disk_too_full_for_the_job(site_photos: Path, mounted: Path) -> None:
    run = curecon("reconstruct", site_photos, "--workspace", mounted / "w", *QUICK)
    refused(run, 5, "disk")
    assert (mounted / "w" / "stages" / "photos.json").exists()  # what was done before stays


@pytest.mark.parametrize("mounted", ["size=64m"], indirect=True)
def test_a_disk_that_fills_up_on_the_way_goes_on_when_there_is_room(
    finished: tuple[Path, Run], site_photos: Path, mounted: Path
) -> None:
    workspace = mounted / "w"
    shutil.copytree(finished[0], workspace)
    shutil.rmtree(workspace / "depth")
    (workspace / "stages" / "depth.json").unlink()
    free = os.statvfs(mounted)
    (mounted / "filler").write_bytes(bytes(free.f_bavail * free.f_frsize - 900_000))
    refused(curecon("reconstruct", site_photos, "--workspace", workspace, *QUICK), 5, "full")
    assert not list(workspace.glob("depth/.*"))  # nothing half-written is left
    (mounted / "filler").unlink()
    run = curecon("reconstruct", site_photos, "--workspace", workspace, *QUICK)
    assert run.code == 0, run.said
    assert run.summary["points"] == finished[1].summary["points"]


@pytest.mark.parametrize("mounted", ["size=64m"], indirect=True)
def test_a_disk_that_fills_up_while_the_surface_is_made(finished: tuple[Path, Run], mounted: Path) -> None:
    workspace, filler = mounted / "w", mounted / "filler"
    shutil.copytree(finished[0], workspace)
    small = ["--max-faces", "20000", "--texture-size", "1024"]

    def with_room_for(size: int) -> Run:
        free = os.statvfs(mounted)
        filler.write_bytes(bytes(free.f_bavail * free.f_frsize - size))
        run = curecon("surface", workspace, *small)
        filler.unlink()
        return run

    refused(with_room_for(300_000), 5, "full")
    assert not (workspace / "mesh.ply").exists() and (workspace / "cloud.ply").exists()
    assert not (workspace / ".mesh.partial").exists()  # what the stage worked with is gone
    assert curecon("surface", workspace, *small, "--until", "mesh").code == 0
    mesh = (workspace / "mesh.ply").read_bytes()
    refused(with_room_for(300_000), 5, "full")
    assert (workspace / "mesh.ply").read_bytes() == mesh and not (workspace / "textured" / "mesh.ply").exists()
    assert curecon("surface", workspace, *small).code == 0
    assert (workspace / "textured" / "mesh.ply").exists()


@pytest.fixture
def own_weights(tmp_path: Path) -> Path:
    for suffix in (".safetensors", ".json"):
        shutil.copy(SHIPPED.with_suffix(suffix), tmp_path / f"own{suffix}")
    return tmp_path / "own.safetensors"


def with_weights(finished: tuple[Path, Run], site_photos: Path, weights: Path) -> Run:
    """Run a copy of the finished job with other weights; its cloud and depth maps must be there afterwards."""
    workspace = weights.parent / "w"
    shutil.copytree(finished[0], workspace, dirs_exist_ok=True)
    run = curecon("reconstruct", site_photos, "--workspace", workspace, *QUICK, "--weights", weights)
    assert (workspace / "cloud.ply").read_bytes() == (finished[0] / "cloud.ply").read_bytes()
    assert len(list((workspace / "depth").glob("*.npz"))) == len(list((finished[0] / "depth").glob("*.npz")))
    return run


def test_weights_that_are_missing(finished: tuple[Path, Run], site_photos: Path, own_weights: Path) -> None:
    own_weights.unlink()
    # The record beside them still tells the checksum: only loading finds the file gone.
    record = own_weights.with_suffix(".json")
    record.write_text(record.read_text().replace('"sha256": "', '"sha256": "0'))
    refused(with_weights(finished, site_photos, own_weights), 6, "own.safetensors", "missing")
    record.unlink()
    refused(with_weights(finished, site_photos, own_weights), 6, "missing")


def test_weights_that_are_corrupted(finished: tuple[Path, Run], site_photos: Path, own_weights: Path) -> None:
    content = bytearray(own_weights.read_bytes())
    content[len(content) // 2] ^= 1
    own_weights.write_bytes(content)
    record = json.loads(own_weights.with_suffix(".json").read_text())
    record["sha256"] = "0" + record["sha256"][1:] if record["sha256"][0] != "0" else "1" + record["sha256"][1:]
    own_weights.with_suffix(".json").write_text(json.dumps(record))
    refused(with_weights(finished, site_photos, own_weights), 6, "corrupted")


def test_a_device_that_is_not_there(finished: tuple[Path, Run], site_photos: Path, tmp_path: Path) -> None:
    workspace = tmp_path / "w"
    shutil.copytree(finished[0], workspace)
    (workspace / "stages" / "depth.json").unlink()
    missing = "mps" if os.uname().sysname != "Darwin" else "cuda"
    refused(curecon("reconstruct", site_photos, "--workspace", workspace, *QUICK, "--device", missing), 7,
            missing.upper())


def test_a_memory_budget_too_small(finished: tuple[Path, Run], site_photos: Path, tmp_path: Path) -> None:
    workspace = tmp_path / "w"
    shutil.copytree(finished[0], workspace)
    shutil.rmtree(workspace / "depth")
    (workspace / "stages" / "depth.json").unlink()
    refused(curecon("reconstruct", site_photos, "--workspace", workspace, *QUICK, "--memory", 0.05), 7, "0.05 GiB")


def test_a_python_without_the_libraries(site_photos: Path, tmp_path: Path) -> None:
    (tmp_path / "torch.py").write_text("raise ImportError('No module named torch')")
    done = subprocess.run(
        command("reconstruct", site_photos, "--workspace", tmp_path / "w", "--json"), cwd=ROOT, capture_output=True,
        text=True, check=False, env={**os.environ, "PYTHONPATH": str(tmp_path)},
    )
    assert done.returncode == 9
    assert "torch" in done.stderr and "Worker Python" in done.stderr
