# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The add-on's side of the worker protocol, against small real processes that speak it."""

from __future__ import annotations

import os
import signal
import sys
import textwrap
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from curecon_blender.core.base.messages import Failure, Log, Message, Progress, Result, StageStarted, Warning
from curecon_blender.job import Job, Status, WorkerError, duration

StartWorker = Callable[..., Job]
PRELUDE = """
import json, sys, time
def say(of_type, **fields): print(json.dumps({"type": of_type, **fields}), flush=True)
"""


@pytest.fixture
def start_worker(tmp_path: Path) -> StartWorker:
    """Starts a Job whose worker runs the given Python lines."""

    def start(lines: str, grace: float = 20.0) -> Job:
        package = tmp_path / "worker package" / "curecon_blender" / "core"
        package.mkdir(parents=True)
        (package.parent / "__init__.py").touch()
        (package / "__init__.py").touch()
        (package / "__main__.py").write_text(PRELUDE + textwrap.dedent(lines), encoding="utf-8")
        return Job(
            ["reconstruct", "photos"], python=sys.executable, import_paths=[package.parent.parent],
            workspace=tmp_path, grace=grace,
        )

    return start


def wait_for(job: Job, kind: type[Message]) -> list[Message]:
    """Poll until a message of `kind` has come."""
    seen: list[Message] = []
    deadline = time.monotonic() + 30
    while not any(isinstance(message, kind) for message in seen):
        assert time.monotonic() < deadline, seen
        seen += job.poll()
        time.sleep(0.01)
    return seen


def finish(job: Job) -> list[Message]:
    assert job.wait(30)
    messages = job.poll()
    assert job.finished
    return messages


def test_messages_arrive_in_order_and_end_with_the_result(start_worker: StartWorker) -> None:
    job = start_worker("""
        say("stage", stage="depth", index=0, count=1)
        for done in range(1, 4):
            say("progress", stage="depth", done=done, total=3, overall=done / 3, eta=None)
        say("result", summary={"points": 7, "arguments": sys.argv[1:]})
    """)
    messages = finish(job)
    assert [m.done for m in messages if isinstance(m, Progress)] == [1, 2, 3]
    assert messages[-1] == Result(summary={"points": 7, "arguments": ["--messages", "reconstruct", "photos"]})
    status = Status()
    for message in messages:
        status.apply(message)
    assert status.result is not None and status.failure is None
    assert [(s.stage, s.fraction) for s in status.stages] == [("depth", 1.0)]


def test_garbage_on_stdout_becomes_a_log_line(start_worker: StartWorker) -> None:
    job = start_worker("""
        print("Elapsed time: 0.1 [minutes]")
        print('{"type": "nonsense"}')
        sys.stdout.flush()
        sys.stdout.buffer.write(b"\\xff\\xfe broken bytes\\n")
        print("[1, 2]", "null", sep="\\n", flush=True)
        say("result", summary={})
    """)
    messages = finish(job)
    assert [type(m) for m in messages] == [Log, Log, Log, Log, Log, Result]
    assert messages[0] == Log(text="Elapsed time: 0.1 [minutes]")


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="SIGKILL is there on POSIX systems only")
@pytest.mark.parametrize("stage", ["depth", "fusion"])
def test_a_killed_worker_goes_on_once_with_half_the_memory_and_then_says_what_to_do(
    start_worker: StartWorker, stage: str
) -> None:
    job = start_worker(f"""
        say("stage", stage="{stage}", index=0, count=1)
        say("log", text=" ".join(sys.argv[1:]))
        time.sleep(60)
    """)
    assert "--half-memory" not in str(wait_for(job, Log))
    os.kill(job.pid, signal.SIGKILL)
    seen = wait_for(job, Log)
    assert isinstance(seen[0], Warning) and "half the memory" in seen[0].text
    assert "--half-memory" in str(seen[-1])
    os.kill(job.pid, signal.SIGKILL)
    (failure,) = finish(job)
    assert isinstance(failure, Failure)
    assert "killed" in failure.message and "memory" in failure.message
    assert "goes on from the last finished photo" in failure.remedy


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="SIGKILL is there on POSIX systems only")
@pytest.mark.parametrize("cancelled", [False, True])
def test_a_worker_killed_in_another_stage_or_after_a_cancel_is_not_started_again(
    start_worker: StartWorker, cancelled: bool
) -> None:
    job = start_worker(f"""
        say("stage", stage="{"depth" if cancelled else "mesh"}", index=0, count=1)
        time.sleep(60)
    """)
    wait_for(job, StageStarted)
    if cancelled:
        job.cancel()
    os.kill(job.pid, signal.SIGKILL)
    (failure,) = finish(job)
    assert isinstance(failure, Failure) and failure.kind == ("cancelled" if cancelled else "worker")


@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="SIGSTOP is there on POSIX systems only")
@pytest.mark.parametrize("end", [Job.cancel, Job.close])
def test_a_worker_that_stands_still_can_be_ended(start_worker: StartWorker, end: Callable[[Job], None]) -> None:
    job = start_worker("""
        say("log", text="ready")
        sys.stdin.read()
    """, grace=0.2)
    wait_for(job, Log)
    os.kill(job.pid, signal.SIGSTOP)
    end(job)
    (failure,) = finish(job)
    assert isinstance(failure, Failure) and failure.kind == "cancelled"


def test_a_worker_that_dies_tells_its_last_words_and_where_the_log_is(
    start_worker: StartWorker, tmp_path: Path
) -> None:
    job = start_worker('sys.exit("the sky fell")')
    (failure,) = finish(job)
    assert isinstance(failure, Failure)
    log = tmp_path / "worker.log"
    assert "the sky fell" in failure.message and str(log) in failure.remedy
    assert "the sky fell" in log.read_text(encoding="utf-8")


def test_a_worker_python_without_torch_names_the_preference(start_worker: StartWorker) -> None:
    job = start_worker("import torch_that_is_not_installed")
    (failure,) = finish(job)
    assert isinstance(failure, Failure)
    assert "torch_that_is_not_installed" in failure.message and "Worker Python" in failure.remedy


def test_an_interpreter_that_is_not_there_is_an_error_with_a_remedy(tmp_path: Path) -> None:
    with pytest.raises(WorkerError, match="no-python-here") as caught:
        Job([], python=tmp_path / "no-python-here", import_paths=[tmp_path], workspace=tmp_path)
    assert "Worker Python" in caught.value.remedy


def test_cancel_lets_the_worker_stop_by_itself(start_worker: StartWorker) -> None:
    job = start_worker("""
        say("log", text="ready")
        assert sys.stdin.readline() == "cancel\\n"
        say("failure", kind="cancelled", message="Cancelled after tidying up.", remedy="", exit_code=130)
    """)
    wait_for(job, Log)
    job.cancel()
    (failure,) = finish(job)
    assert isinstance(failure, Failure) and failure.message == "Cancelled after tidying up."


def test_cancel_ends_a_worker_that_does_not_listen(start_worker: StartWorker) -> None:
    job = start_worker("""
        import signal
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        say("log", text="ready")
        time.sleep(60)
    """, grace=0.2)
    wait_for(job, Log)
    job.cancel()
    (failure,) = finish(job)
    assert isinstance(failure, Failure) and failure.kind == "cancelled"


def test_close_ends_the_worker(start_worker: StartWorker) -> None:
    job = start_worker("""
        say("log", text="ready")
        sys.stdin.read()
    """)
    wait_for(job, Log)
    job.close()
    finish(job)
    with pytest.raises(ProcessLookupError):
        os.kill(job.pid, 0)


@pytest.mark.parametrize(("seconds", "words"), [(20, "less than a minute"), (150, "2 min"), (3599, "1 h 00 min"),
                                                (9000, "2 h 30 min")])
def test_duration_reads_as_words(seconds: float, words: str) -> None:
    assert duration(seconds) == words


def test_the_remaining_time_makes_no_leap() -> None:
    """One slow photo at the start, whose estimate is three times the truth, moves what is shown by a part of that."""
    status = Status()
    status.apply(Progress(stage="depth", done=1, total=30, overall=0.1, eta=900.0))
    status.apply(Progress(stage="depth", done=2, total=30, overall=0.12, eta=2700.0))
    assert status.seconds_left is not None and 900 < status.seconds_left < 1300
    for done in range(3, 30):  # and comes to the truth while the estimates agree
        status.apply(Progress(stage="depth", done=done, total=30, overall=done / 30, eta=600.0))
    assert abs(status.seconds_left - 600) < 10
    status.apply(StageStarted(stage="fusion", index=4, count=5))
    assert status.seconds_left is not None  # it does not vanish between two stages
