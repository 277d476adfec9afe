# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Faults of the computer, really done: nothing finished is lost, the user is told what to do, and nobody cleans up.

docs/faults.md is the table of what is seen here and in test_changed_files.py. (Bad input: test_bad_input.py; bad
photos: test_photo_check.py.)
"""

from __future__ import annotations

import contextlib
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from conftest import ROOT, SITE_PHOTOS, Run, curecon
from faulty import arguments, at_work, before, ended, failed, finished_again, start

from curecon_blender.core.base.messages import Failure, Result, StageStarted
from curecon_blender.core.base.options import STAGES


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
    stage: str, textured: tuple[Path, Run], site_photos: Path, disk: Path
) -> None:
    workspace, filler = disk / "w", disk / "filler"
    before(stage, textured, workspace)
    if stage == "photos":  # it writes one small file, a moment after it begins
        fill(filler)
    job = start(site_photos, workspace, stage)
    if stage != "photos":
        at_work(job, stage)
        worker = psutil.Process(job.pid)
        worker.suspend()  # a small stage is over before the disk is full
        fill(filler)
        worker.resume()
    failed(job, "disk is full")
    filler.unlink()

    kept = {path: path.stat().st_mtime_ns for path in workspace.glob("depth/*.npz")}
    job = start(site_photos, workspace, stage)
    at_work(job, stage)
    children = psutil.Process(job.pid).children(recursive=True)
    os.kill(job.pid, signal.SIGKILL)
    last = ended(job)
    if stage in ("depth", "fusion"):  # the system kills for memory: once it goes on by itself, with less
        assert isinstance(last, Result)
        done = curecon(*arguments(site_photos, workspace, stage)).said.count("already done")
        assert done == STAGES.index(stage) + 1
    elif stage == "photos":  # it may have been done already
        assert curecon(*arguments(site_photos, workspace, stage)).summary["photos"] == len(SITE_PHOTOS)
    else:
        assert isinstance(last, Failure) and "killed" in last.message, last
        finished_again(site_photos, workspace, stage, textured)
    assert not [child for child in children if child.is_running()]
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    assert not [*workspace.rglob(".*.partial")]


@pytest.mark.skipif(not hasattr(psutil, "RLIMIT_AS"), reason="a process's memory can be limited on Linux only")
@pytest.mark.parametrize("stage", ["photos", "depth"])
def test_memory_that_is_refused_is_told_as_such(
    stage: str, textured: tuple[Path, Run], site_photos: Path, tmp_path: Path
) -> None:
    before(stage, textured, tmp_path / "w")
    job = start(site_photos, tmp_path / "w", stage, grace=2.0)
    while not any(isinstance(message, StageStarted) and message.stage == stage for message in job.poll()):
        assert not job.finished
        time.sleep(0.001)
    worker = psutil.Process(job.pid)
    worker.rlimit(psutil.RLIMIT_AS, (worker.memory_info().vms,) * 2)
    if not job.wait(10):  # the linear algebra's library asks again and again, for ever, now and then
        job.cancel()
    failure = ended(job)
    assert isinstance(failure, Failure) and failure.kind in ("memory", "cancelled"), failure
    finished_again(site_photos, tmp_path / "w", stage, textured)


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
    wish: str, textured: tuple[Path, Run], site_photos: Path, drive: Path
) -> None:
    before("depth", textured, drive / "w")
    job = start(site_photos, drive / "w", "depth")
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
        finished_again(site_photos, drive / "w", "depth", textured)


def test_a_job_begun_while_the_drive_stalls_keeps_nobody_waiting(
    textured: tuple[Path, Run], site_photos: Path, drive: Path
) -> None:
    before("depth", textured, drive / "w")
    with stalled(drive):
        began = time.monotonic()
        job = start(site_photos, drive / "w", "depth")
        job.poll()
        assert time.monotonic() - began < 2
        time.sleep(5)
        assert not job.finished
    last = ended(job)
    assert isinstance(last, Result), last


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
    textured: tuple[Path, Run], site_photos: Path, tmp_path: Path
) -> None:
    before("depth", textured, tmp_path / "w")
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT, tmp_path / "w", *arguments(site_photos, tmp_path / "w", "depth")], cwd=ROOT,
        stdout=subprocess.PIPE, text=True,
    )
    assert parent.stdout
    worker = psutil.Process(int(parent.stdout.readline()))
    assert parent.stdout.readline() == "at work\n"
    parent.kill()
    parent.wait()
    finished_again(site_photos, tmp_path / "w", "depth", textured)  # waits for the lock, not for a person
    assert not worker.is_running()


@pytest.mark.skipif("CURECON_BLENDER" not in os.environ, reason="NO BLENDER WITH A WINDOW: see tests/test_window.py")
def test_what_a_user_may_do_to_blender_while_a_job_runs(site_photos: Path, tmp_path: Path) -> None:
    done = subprocess.run(
        [*shlex.split(os.environ["CURECON_BLENDER"]), "--factory-startup", "--python",
         ROOT / "tests" / "window" / "faults.py", "--", site_photos, tmp_path, sys.executable],
        capture_output=True, text=True, timeout=900, check=False,
    )
    assert "FAULT failed" not in done.stdout and "RUNNING" in done.stdout, f"{done.stdout}\n{done.stderr}"
    worker = int(done.stdout.partition("RUNNING ")[2].split()[0])
    deadline = time.monotonic() + 30
    while psutil.pid_exists(worker):
        assert time.monotonic() < deadline, "the worker outlived Blender"
        time.sleep(0.1)
