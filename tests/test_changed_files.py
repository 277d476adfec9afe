# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Photos and results that change under a job or between two: nothing finished is lost, and what changed is named."""

from __future__ import annotations

import contextlib
import os
import shutil
import sqlite3
from pathlib import Path

import pytest
from conftest import SITE_PHOTOS, Run, curecon
from faulty import arguments, at_work, before, failed, finished_again, start
from PIL import Image

from curecon_blender.core.views.record import read


def test_a_workspace_that_is_deleted_meanwhile_does_not_come_back(
    textured: tuple[Path, Run], site_photos: Path, tmp_path: Path
) -> None:
    before("depth", textured, tmp_path / "w")
    job = start(site_photos, tmp_path / "w", "depth")
    at_work(job, "depth")
    (tmp_path / "w").rename(tmp_path / "elsewhere")  # what a drive does that is unplugged
    failed(job, "gone")
    assert not (tmp_path / "w").exists()
    (tmp_path / "elsewhere").rename(tmp_path / "w")
    finished_again(site_photos, tmp_path / "w", "depth", textured)


@pytest.mark.parametrize("fault", ["changed", "deleted", "resized"])
def test_a_photo_that_changes_under_the_job_is_named_and_the_next_run_takes_it_as_it_is(
    fault: str, textured: tuple[Path, Run], site_photos: Path, tmp_path: Path
) -> None:
    photos, workspace = tmp_path / "photos", tmp_path / "w"
    shutil.copytree(site_photos, photos)
    before("views", textured, workspace)
    victim, smaller = photos / SITE_PHOTOS[-1], tmp_path / "smaller.png"
    content = victim.read_bytes()
    with Image.open(victim) as photo:
        photo.resize((300, 225)).save(smaller)
    job = start(photos, workspace, "views")
    at_work(job, "views")  # for a fraction of a second
    if fault == "deleted":
        victim.unlink()
    elif fault == "changed":
        os.utime(victim, (1, 1))
    else:
        smaller.replace(victim)
    failed(job, victim.name, "deleted" if fault == "deleted" else "changed")
    victim.write_bytes(content)
    run = finished_again_after_a_check(photos, workspace)
    assert run.summary["registered"] == len(SITE_PHOTOS)


def finished_again_after_a_check(photos: Path, workspace: Path) -> Run:
    """Run to the views: the photos are checked again, and their cameras are found to be done."""
    run = curecon(*arguments(photos, workspace, "views"))
    assert run.code == 0, run.said
    assert "sparse: already done" in run.said and "photos: already done" not in run.said, run.said
    return run


def test_photos_moved_elsewhere_and_clocks_put_wrong_find_everything_done(
    textured: tuple[Path, Run], site_photos: Path, tmp_path: Path
) -> None:
    workspace, photos = tmp_path / "w", tmp_path / "moved"
    shutil.copytree(textured[0], workspace)
    shutil.copytree(site_photos, photos)
    for path in (*photos.iterdir(), *workspace.rglob("*")):
        os.utime(path, (4e9, 4e9))  # the year 2096
    run = curecon(*arguments(photos, workspace, "texture"))
    assert run.code == 0 and run.said.count("already done") == 7, run.said
    assert {Path(view.original).parent for view in read(workspace)[0].views} == {photos}
    assert curecon(*arguments(photos, workspace, "texture")).said.count("already done") == 8


def test_photos_added_or_taken_away_leave_the_features_of_the_others(site_photos: Path, tmp_path: Path) -> None:
    photos, workspace = tmp_path / "photos", tmp_path / "w"
    shutil.copytree(site_photos, photos)
    (photos / SITE_PHOTOS[-1]).unlink()

    def features() -> set[tuple[int, str, bytes]]:
        with contextlib.closing(sqlite3.connect(workspace / "sparse" / "features.db")) as database:
            return set(database.execute("SELECT image_id, name, data FROM images NATURAL JOIN descriptors"))

    assert curecon(*arguments(photos, workspace, "views")).summary["registered"] == len(SITE_PHOTOS) - 1
    with contextlib.closing(sqlite3.connect(workspace / "sparse" / "features.db")) as database, database:
        # A trace that features found anew would not bear.
        (number, data), *_ = database.execute("SELECT image_id, data FROM descriptors")
        database.execute("UPDATE descriptors SET data = ? WHERE image_id = ?", (data[:-1] + b"\0", number))
    before = features()
    shutil.copy2(site_photos / SITE_PHOTOS[-1], photos)
    run = curecon(*arguments(photos, workspace, "views"))
    assert run.code == 0 and run.summary["registered"] == len(SITE_PHOTOS), run.said
    assert before < features()
    (photos / SITE_PHOTOS[-1]).unlink()
    run = curecon(*arguments(photos, workspace, "views"))
    assert run.code == 0 and run.summary["registered"] == len(SITE_PHOTOS) - 1, run.said
    assert {view.name for view in read(workspace)[0].views} == set(SITE_PHOTOS[:-1])
    assert before <= features()


def test_a_result_that_somebody_deleted_is_made_again(
    textured: tuple[Path, Run], site_photos: Path, tmp_path: Path
) -> None:
    workspace = tmp_path / "w"
    shutil.copytree(textured[0], workspace)
    (workspace / "cloud.ply").unlink()
    assert curecon("surface", workspace).code == 5
    lost = workspace / "depth" / f"{SITE_PHOTOS[0]}.npz"
    lost.unlink()
    kept = {path: path.stat().st_mtime_ns for path in workspace.glob("depth/*.npz")}
    run = curecon(*arguments(site_photos, workspace, "fusion"))
    assert run.code == 0 and run.said.count("already done") == 4, run.said
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    for name in ("cloud.ply", f"depth/{lost.name}"):
        assert (workspace / name).read_bytes() == (textured[0] / name).read_bytes()
