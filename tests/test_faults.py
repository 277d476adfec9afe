# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Faults, really done: nothing finished is lost, the user is told what to do, and nobody needs to clean up.

docs/faults.md is the table of what is seen here. (Bad input: test_bad_input.py; bad photos: test_photo_check.py.)
"""

from __future__ import annotations

import contextlib
import os
import shlex
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from conftest import ROOT, SITE, SITE_PHOTOS, Run, curecon
from PIL import Image

from curecon_blender.core.base.messages import Failure, Message, Progress, Result, StageStarted
from curecon_blender.core.base.options import STAGES
from curecon_blender.core.views.record import read
from curecon_blender.job import Job

SMALL = ["--quality", "preview", "--max-image-size", "192", "--max-faces", "3000", "--texture-size", "512"]
# What each stage makes; the feature database goes with the cameras.
MADE = {
    "photos": ["photos.json"], "sparse": ["sparse"], "views": ["views.json", "undistorted"], "depth": ["depth"],
    "fusion": ["cloud.ply"], "mesh": ["mesh.ply"], "texture": ["textured"],
}


@pytest.fixture(scope="module")
def small_photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A few neighbouring photos of the sample site at half their size, with their EXIF."""
    folder = tmp_path_factory.mktemp("small") / "photos"
    folder.mkdir()
    for name in SITE_PHOTOS:
        with Image.open(SITE / "photos" / name) as photo:
            half = photo.resize((photo.width // 2, photo.height // 2), Image.Resampling.LANCZOS)
            half.save(folder / name, quality=92, exif=photo.info["exif"])
    return folder


@pytest.fixture(scope="module")
def textured(small_photos: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Run]:
    """All seven stages done: (workspace, run). Read only: `before` copies it."""
    workspace = tmp_path_factory.mktemp("textured") / "workspace"
    run = curecon("reconstruct", small_photos, "--workspace", workspace, *SMALL, "--until", "texture")
    assert run.code == 0, run.said
    return workspace, run


def before(stage: str, textured: tuple[Path, Run], workspace: Path) -> None:
    """Copy the finished workspace as it stood just before a stage."""
    shutil.copytree(textured[0], workspace)
    for later in STAGES[STAGES.index(stage):]:
        (workspace / "stages" / f"{later}.json").unlink()
        for name in MADE[later]:
            path = workspace / name
            shutil.rmtree(path) if path.is_dir() else path.unlink()


def arguments(photos: Path, workspace: Path, until: str) -> list[str]:
    return ["reconstruct", str(photos), "--workspace", str(workspace), *SMALL, "--until", until]


def start(photos: Path, workspace: Path, until: str) -> Job:
    """A worker as the add-on has it."""
    return Job(arguments(photos, workspace, until), python=sys.executable, import_paths=[ROOT], workspace=workspace)


def at_work(job: Job, stage: str) -> None:
    """Wait for the first progress of a stage."""
    while True:
        for message in job.poll():
            assert not isinstance(message, Failure), message
            if isinstance(message, Progress) and message.stage == stage:
                return
        assert not job.finished, f"the worker never got to {stage}"
        time.sleep(0.002)


def ended(job: Job) -> Message:
    """The last message."""
    assert job.wait(300)
    return job.poll()[-1]


def failed(job: Job, *words: str) -> Failure:
    """The job failed with these words, and says what to do."""
    failure = ended(job)
    assert isinstance(failure, Failure), failure
    assert failure.kind != "fault" and failure.remedy, failure
    for word in words:
        assert word in failure.message, failure
    return failure


def finished_again(photos: Path, workspace: Path, stage: str, textured: tuple[Path, Run]) -> Run:
    """Run to the end of the stage: it comes out as it did undisturbed, and nothing unfinished lies about."""
    run = curecon(*arguments(photos, workspace, stage))
    assert run.code == 0, run.said
    assert run.said.count("already done") == STAGES.index(stage), run.said
    for name in MADE[stage]:
        assert (workspace / name).exists()
    if stage in ("depth", "fusion"):
        for file in ("cloud.ply",) if stage == "fusion" else [f"depth/{name}.npz" for name in SITE_PHOTOS]:
            assert (workspace / file).read_bytes() == (textured[0] / file).read_bytes()
    assert not [*workspace.rglob(".*.partial")]
    return run


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A small disk of its own."""
    folder = tmp_path / "disk"
    folder.mkdir()
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64m", "tmpfs", str(folder)], check=False,
                          capture_output=True, text=True)
    if done.returncode:
        pytest.skip(f"mounting a small disk needs root: {done.stderr.strip()}")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def fill(filler: Path) -> None:
    """Take all that is left of the disk, though others write to it too."""
    with open(filler, "wb", buffering=0) as file, contextlib.suppress(OSError):
        while True:
            file.write(bytes(4096))


@pytest.mark.parametrize("stage", STAGES)
def test_the_disk_fills_up_and_then_the_worker_is_killed(
    stage: str, textured: tuple[Path, Run], small_photos: Path, disk: Path
) -> None:
    workspace, filler = disk / "w", disk / "filler"
    before(stage, textured, workspace)
    if stage == "photos":  # it writes one small file, a moment after it begins
        fill(filler)
    job = start(small_photos, workspace, stage)
    if stage != "photos":
        at_work(job, stage)
        fill(filler)
    failed(job, "disk is full")
    filler.unlink()

    kept = {path: path.stat().st_mtime_ns for path in workspace.glob("depth/*.npz")}
    job = start(small_photos, workspace, stage)
    at_work(job, stage)
    children = psutil.Process(job.pid).children(recursive=True)
    os.kill(job.pid, signal.SIGKILL)
    last = ended(job)
    if stage == "depth":  # the system kills for memory: once it goes on by itself, with less
        assert isinstance(last, Result)
        assert curecon(*arguments(small_photos, workspace, stage)).said.count("already done") == 4
    elif stage == "photos":  # it may have been done already
        assert curecon(*arguments(small_photos, workspace, stage)).summary["photos"] == len(SITE_PHOTOS)
    else:
        assert isinstance(last, Failure) and "killed" in last.message, last
        finished_again(small_photos, workspace, stage, textured)
    assert not [child for child in children if child.is_running()]
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    assert not [*workspace.rglob(".*.partial")]


@pytest.mark.skipif(not hasattr(psutil, "RLIMIT_AS"), reason="a process's memory can be limited on Linux only")
@pytest.mark.parametrize("stage", ["photos", "depth", "texture"])
def test_memory_that_is_refused_is_told_as_such(
    stage: str, textured: tuple[Path, Run], small_photos: Path, tmp_path: Path
) -> None:
    before(stage, textured, tmp_path / "w")
    job = start(small_photos, tmp_path / "w", stage)
    while not any(isinstance(message, StageStarted) and message.stage == stage for message in job.poll()):
        assert not job.finished
        time.sleep(0.001)
    worker = psutil.Process(job.pid)
    worker.rlimit(psutil.RLIMIT_AS, (worker.memory_info().vms,) * 2)  # not one page more
    if not job.wait(30):  # the linear algebra's library asks again and again, for ever, now and then
        job.cancel()
    failure = ended(job)
    assert isinstance(failure, Failure) and failure.kind in ("memory", "cancelled"), failure
    finished_again(small_photos, tmp_path / "w", stage, textured)


@pytest.fixture
def drive(tmp_path: Path) -> Iterator[Path]:
    """A drive that `stalled` can stop."""
    folder, image = tmp_path / "drive", tmp_path / "drive.img"
    folder.mkdir()
    with open(image, "wb") as file:
        file.truncate(100 << 20)
    try:
        for command in (["mkfs.ext4", "-q", image], ["mount", "-o", "loop", image, folder]):
            subprocess.run(command, check=True, capture_output=True, text=True)
    except (subprocess.CalledProcessError, FileNotFoundError) as error:
        pytest.skip(f"mounting a drive needs root and mkfs.ext4: {error}")
    yield folder
    subprocess.run(["umount", folder], check=True)


@contextlib.contextmanager
def stalled(drive: Path) -> Iterator[None]:
    """Whoever writes to the drive stands still, in a call that no signal ends, as when a network is gone."""
    subprocess.run(["fsfreeze", "--freeze", drive], check=True)
    try:
        yield
    finally:
        subprocess.run(["fsfreeze", "--unfreeze", drive], check=True)


@pytest.mark.parametrize("wish", ["wait", "cancel"])
def test_a_drive_that_stalls_holds_the_job_up_and_nothing_else(
    wish: str, textured: tuple[Path, Run], small_photos: Path, drive: Path
) -> None:
    before("depth", textured, drive / "w")
    job = start(small_photos, drive / "w", "depth")
    at_work(job, "depth")
    with stalled(drive):
        time.sleep(5)
        job.poll()  # what was on its way
        if wish == "cancel":
            job.cancel()
        time.sleep(5)
        assert not job.poll() and not job.finished
    last = ended(job)
    if wish == "wait":
        assert isinstance(last, Result), last
    else:
        assert isinstance(last, Failure) and last.kind == "cancelled", last
        finished_again(small_photos, drive / "w", "depth", textured)


def test_a_job_begun_while_the_drive_stalls_keeps_nobody_waiting(
    textured: tuple[Path, Run], small_photos: Path, drive: Path
) -> None:
    before("depth", textured, drive / "w")
    with stalled(drive):
        began = time.monotonic()
        job = start(small_photos, drive / "w", "depth")
        job.poll()
        assert time.monotonic() - began < 2
        time.sleep(5)
        assert not job.finished
    last = ended(job)
    assert isinstance(last, Result), last


def test_a_workspace_that_is_deleted_meanwhile_does_not_come_back(
    textured: tuple[Path, Run], small_photos: Path, tmp_path: Path
) -> None:
    before("depth", textured, tmp_path / "w")
    job = start(small_photos, tmp_path / "w", "depth")
    at_work(job, "depth")
    (tmp_path / "w").rename(tmp_path / "elsewhere")  # what a drive does that is unplugged
    failed(job, "gone")
    assert not (tmp_path / "w").exists()
    (tmp_path / "elsewhere").rename(tmp_path / "w")
    finished_again(small_photos, tmp_path / "w", "depth", textured)


@pytest.mark.parametrize("fault", ["changed", "deleted", "resized"])
def test_a_photo_that_changes_under_the_job_is_named_and_the_next_run_takes_it_as_it_is(
    fault: str, textured: tuple[Path, Run], small_photos: Path, tmp_path: Path
) -> None:
    photos, workspace = tmp_path / "photos", tmp_path / "w"
    shutil.copytree(small_photos, photos)
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
    textured: tuple[Path, Run], small_photos: Path, tmp_path: Path
) -> None:
    workspace, photos = tmp_path / "w", tmp_path / "moved"
    shutil.copytree(textured[0], workspace)
    shutil.copytree(small_photos, photos)
    for path in (*photos.iterdir(), *workspace.rglob("*")):
        os.utime(path, (4e9, 4e9))  # the year 2096
    run = curecon(*arguments(photos, workspace, "texture"))
    assert run.code == 0 and run.said.count("already done") == 6, run.said
    assert {Path(view.original).parent for view in read(workspace)[0].views} == {photos}
    assert curecon(*arguments(photos, workspace, "texture")).said.count("already done") == 7


def test_photos_added_or_taken_away_leave_the_features_of_the_others(small_photos: Path, tmp_path: Path) -> None:
    photos, workspace = tmp_path / "photos", tmp_path / "w"
    shutil.copytree(small_photos, photos)
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
    shutil.copy2(small_photos / SITE_PHOTOS[-1], photos)
    run = curecon(*arguments(photos, workspace, "views"))
    assert run.code == 0 and run.summary["registered"] == len(SITE_PHOTOS), run.said
    assert before < features()
    (photos / SITE_PHOTOS[-1]).unlink()
    run = curecon(*arguments(photos, workspace, "views"))
    assert run.code == 0 and run.summary["registered"] == len(SITE_PHOTOS) - 1, run.said
    assert {view.name for view in read(workspace)[0].views} == set(SITE_PHOTOS[:-1])
    assert before <= features()


def test_a_result_that_somebody_deleted_is_made_again(
    textured: tuple[Path, Run], small_photos: Path, tmp_path: Path
) -> None:
    workspace = tmp_path / "w"
    shutil.copytree(textured[0], workspace)
    (workspace / "cloud.ply").unlink()
    assert curecon("surface", workspace).code == 5
    lost = workspace / "depth" / f"{SITE_PHOTOS[0]}.npz"
    lost.unlink()
    kept = {path: path.stat().st_mtime_ns for path in workspace.glob("depth/*.npz")}
    run = curecon(*arguments(small_photos, workspace, "fusion"))
    assert run.code == 0 and run.said.count("already done") == 3, run.said
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    for name in ("cloud.ply", f"depth/{lost.name}"):
        assert (workspace / name).read_bytes() == (textured[0] / name).read_bytes()


PARENT = """
import sys, time
from pathlib import Path
from curecon_blender.job import Job
job = Job(sys.argv[2:], python=sys.executable, import_paths=[Path.cwd()], workspace=Path(sys.argv[1]))
print(job.pid, flush=True)
while True:
    for message in job.poll():
        if getattr(message, "stage", "") == "depth":
            print("at work", flush=True)
    time.sleep(0.01)
"""


def test_a_killed_parent_takes_its_worker_with_it_and_the_job_goes_on_at_once(
    textured: tuple[Path, Run], small_photos: Path, tmp_path: Path
) -> None:
    before("depth", textured, tmp_path / "w")
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT, tmp_path / "w", *arguments(small_photos, tmp_path / "w", "depth")], cwd=ROOT,
        stdout=subprocess.PIPE, text=True,
    )
    assert parent.stdout
    worker = psutil.Process(int(parent.stdout.readline()))
    assert parent.stdout.readline() == "at work\n"
    parent.kill()
    parent.wait()
    finished_again(small_photos, tmp_path / "w", "depth", textured)  # waits for the lock, not for a person
    assert not worker.is_running()


@pytest.mark.skipif("CURECON_BLENDER" not in os.environ, reason="NO BLENDER WITH A WINDOW: see tests/test_window.py")
def test_what_a_user_may_do_to_blender_while_a_job_runs(small_photos: Path, tmp_path: Path) -> None:
    done = subprocess.run(
        [*shlex.split(os.environ["CURECON_BLENDER"]), "--factory-startup", "--python",
         ROOT / "tests" / "window" / "faults.py", "--", small_photos, tmp_path, sys.executable],
        capture_output=True, text=True, timeout=900, check=False,
    )
    assert "FAULT failed" not in done.stdout and "RUNNING" in done.stdout, f"{done.stdout}\n{done.stderr}"
    worker = int(done.stdout.partition("RUNNING ")[2].split()[0])
    deadline = time.monotonic() + 30
    while psutil.pid_exists(worker):
        assert time.monotonic() < deadline, "the worker outlived Blender"
        time.sleep(0.1)
