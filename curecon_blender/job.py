# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The worker process as the add-on sees it: started, listened to on a thread, cancelled. No bpy here."""

from __future__ import annotations

import contextlib
import os
import queue
import re
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from .core.base.errors import NO_MEMORY, Cancelled, CuReconError, OutOfMemory
from .core.base.language import Text
from .core.base.messages import (
    Failure,
    Log,
    Message,
    Progress,
    Result,
    StageStarted,
    Warning,
    decode,
    failure,
)
from .core.base.options import RUN, declared

LOG_NAME = "worker.log"
CANCEL_GRACE = 15.0  # seconds a worker has to stop by itself: one tile or one pycolmap call
LOG_GRACE = 2.0  # seconds to take in what a worker that has ended said last
ETA_SHARE = 0.2  # of the way from the remaining time that is shown to a new estimate
LAST_WARNINGS = 5
LAST_WORDS = 4000  # bytes
KILLED = -getattr(signal, "SIGKILL", 9)
HALF_MEMORY = next(argument.flag for option, argument in declared(RUN) if option.name == "half_memory")
IN_BUDGET = ("depth", "fusion")  # the stages that keep to the memory budget
MISSING_MODULE = re.compile(r"ModuleNotFoundError: No module named '([\w.]+)'")
DISK_FULL = re.compile(r"disk is full|No space left on device")  # COLMAP's database ends the process then


class WorkerError(CuReconError):
    """The worker process could not be started, or died without a word."""

    kind = "worker"


@dataclass
class StageStatus:
    stage: str
    done: int = 0
    total: int = 0

    @property
    def fraction(self) -> float:
        return self.done / self.total if self.total else 0.0


@dataclass
class Status:
    """Where a job stands, folded from its messages: what a panel shows."""

    task: str = ""  # what is being done, in words: "Checking photos"
    running: bool = False
    cancelling: bool = False
    stages: list[StageStatus] = field(default_factory=list)
    stage_index: int = 0
    stage_count: int = 0
    overall: float = 0.0
    eta: float | None = None  # seconds
    eta_at: float = 0.0  # time.monotonic() when `eta` was told
    warnings: list[str] = field(default_factory=list)
    warning_count: int = 0
    result: Result | None = None
    failure: Failure | None = None
    began: float = field(default_factory=time.monotonic)
    said: str = ""  # the report of a job that ended well

    def apply(self, message: Message) -> None:
        match message:
            case StageStarted():
                self.stages.append(StageStatus(message.stage))
                self.stage_index, self.stage_count = message.index, message.count
            case Progress():
                if not self.stages or self.stages[-1].stage != message.stage:
                    self.stages.append(StageStatus(message.stage))
                self.stages[-1].done, self.stages[-1].total = message.done, message.total
                self._take_eta(message.eta)
                self.overall = message.overall
            case Warning():
                text = message.text if message.photo is None else Text("{}: {}", message.photo, message.text)
                self.warnings = [*self.warnings, text][-LAST_WARNINGS:]
                self.warning_count += 1
            case Result():
                self.result, self.overall = message, 1.0
            case Failure():
                self.failure = message
            case Log():
                pass

    def _take_eta(self, eta: float | None) -> None:
        """What is shown goes a part of the way to a new estimate each time: one slow photo makes no leap."""
        shown = self.seconds_left
        if eta is not None and shown is not None:
            eta = shown + ETA_SHARE * (eta - shown)
        self.eta, self.eta_at = eta, time.monotonic()

    @property
    def seconds_running(self) -> float:
        return time.monotonic() - self.began

    @property
    def seconds_left(self) -> float | None:
        """Remaining time, counted down between two messages."""
        return None if self.eta is None else max(0.0, self.eta - (time.monotonic() - self.eta_at))


def duration(seconds: float) -> str:
    """A remaining time in words, no more exact than an estimate can be."""
    if seconds < 60:
        return "less than a minute"
    minutes = round(seconds / 60)
    if minutes < 60:
        return f"{minutes} min"
    return f"{minutes // 60} h {minutes % 60:02d} min"


class Job:
    """A running worker. `poll` never blocks; messages come in order and end with one Result or Failure.

    `arguments` are the worker's own ("reconstruct", PHOTOS, ...); `python` is the interpreter; `import_paths` are the
    folders put on its PYTHONPATH, of which one holds the package `curecon_blender`; `environment` are variables of its
    own. What it says on stderr is added to
    a log in the `workspace`, on a thread: a drive that stalls must not hold Blender up. Raises WorkerError when the
    interpreter cannot be started.
    """

    def __init__(
        self, arguments: Sequence[str], *, python: Path | str, import_paths: Sequence[Path | str],
        workspace: Path | None, grace: float = CANCEL_GRACE, environment: Mapping[str, str] | None = None,
    ) -> None:
        self.log: Path | None = None  # once it has been opened
        self.cancelled = False
        self._workspace = workspace
        self._grace = grace
        self._messages: queue.SimpleQueue[Message] = queue.SimpleQueue()
        self._arguments, self._python, self._import_paths = [*arguments], str(python), [*import_paths]
        self._environment = dict(environment or {})
        self._stage = ""  # that the worker is at
        self._starting = threading.Lock()  # a worker must not be started anew while it is cancelled
        self._process = self._start()
        self._reader = threading.Thread(target=self._read, name="curecon-worker-reader", daemon=True)
        self._reader.start()

    def _start(self) -> subprocess.Popen[bytes]:
        # Blender's own PYTHONHOME would lead another Python to the wrong standard library.
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONHOME"}
        environment |= self._environment | {
            "PYTHONPATH": os.pathsep.join(str(path) for path in self._import_paths),
            "PYTHONUTF8": "1", "PYTHONUNBUFFERED": "1", "PYTHONDONTWRITEBYTECODE": "1",
        }
        command = [self._python, "-m", "curecon_blender.core", "--messages", *self._arguments]
        try:
            process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment,
                cwd=self._import_paths[0], creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
            )
        except OSError as error:
            raise WorkerError(
                Text("The worker could not be started with {}: {}.", self._python, error.strerror),
                remedy="Set Worker Python in the add-on's preferences to a Python 3.11 or newer that has torch "
                       "and pycolmap.", path=self._python,
            ) from error
        assert process.stderr is not None
        self._said = b""  # the last of it
        self._logger = threading.Thread(target=self._keep_log, args=(process.stderr,), name="curecon-worker-log",
                                        daemon=True)
        self._logger.start()
        return process

    def _keep_log(self, stderr: IO[bytes]) -> None:
        with contextlib.ExitStack() as files:
            files.enter_context(stderr)
            log = open_log(self._workspace)
            if log is not None:
                self.log = Path(files.enter_context(log).name)
            while said := stderr.read1(1 << 16):  # type: ignore[attr-defined]
                self._said = (self._said + said)[-LAST_WORDS:]
                if log is not None:
                    with contextlib.suppress(OSError):  # the disk is full: the last words tell of it
                        log.write(said)

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def finished(self) -> bool:
        """True once the worker has ended and every message has been polled."""
        return not self._reader.is_alive() and self._messages.empty()

    def poll(self) -> list[Message]:
        """The messages since the last poll, oldest first."""
        messages = []
        with contextlib.suppress(queue.Empty):
            while True:
                messages.append(self._messages.get_nowait())
        return messages

    def wait(self, timeout: float | None = None) -> bool:
        """Block until the worker has ended, at most `timeout` seconds; poll afterwards. True if it has ended."""
        self._reader.join(timeout)
        return not self._reader.is_alive()

    def cancel(self) -> None:
        """Ask the worker to stop; end it when it has not done so after the grace time. Returns at once."""
        with self._starting:
            if self.cancelled:
                return
            self.cancelled = True
        self._tell(b"cancel\n")
        threading.Thread(target=self._end, args=(self._grace,), name="curecon-worker-end", daemon=True).start()

    def close(self) -> None:
        """End the worker now, for when Blender quits: finished work is on disk and a later run resumes."""
        with self._starting:
            self.cancelled = True
        with contextlib.suppress(OSError):  # the worker has gone already: that is what is wanted
            if self._process.stdin is not None:
                self._process.stdin.close()
        self._end(2.0)
        self._reader.join(2.0)

    def _tell(self, line: bytes) -> None:
        with contextlib.suppress(OSError, ValueError):  # it has gone, or its stdin was closed by close()
            if self._process.stdin is not None:
                self._process.stdin.write(line)
                self._process.stdin.flush()

    def _end(self, grace: float) -> None:
        for step in (lambda: None, self._process.terminate, self._process.kill):
            step()
            try:
                self._process.wait(grace)
                return
            except subprocess.TimeoutExpired:
                continue

    def _read(self) -> None:
        code = self._listen()
        if code == KILLED and self._stage in IN_BUDGET and self._start_with_half_the_memory():
            code = self._listen()
        if code is not None:
            self._messages.put(failure(Cancelled()) if self.cancelled else self._death(code))

    def _start_with_half_the_memory(self) -> bool:
        """Start a job's worker again after the system has killed it, unless it was that already or was cancelled."""
        with self._starting:
            if self.cancelled or self._arguments[:1] != [RUN] or HALF_MEMORY in self._arguments:
                return False
            self._arguments.append(HALF_MEMORY)
            try:
                self._process = self._start()
            except (WorkerError, OSError):  # that it was killed is what must be told then
                return False
        self._messages.put(Warning(
            text="The worker was killed by the system, most often because the computer ran out of memory: it goes on "
                 "with half the memory budget."
        ))
        return True

    def _listen(self) -> int | None:
        """Take in what the worker says until it has ended; its exit code if it ended without a Result or a Failure."""
        final: Message | None = None
        assert self._process.stdout is not None
        with self._process.stdout as stdout:
            for raw in stdout:
                line = raw.decode("utf-8", "replace").strip()
                if not line:
                    continue
                try:
                    message = decode(line)
                except ValueError:
                    message = Log(text=line)  # a native library's own printing
                if isinstance(message, Result | Failure):
                    final = message
                elif isinstance(message, StageStarted):
                    self._stage = message.stage
                self._messages.put(message)
        code = self._process.wait()
        return code if final is None else None

    def _death(self, code: int) -> Failure:
        """Words for a worker that ended without a Result or a Failure."""
        error: CuReconError
        self._logger.join(LOG_GRACE)
        said = self._said.decode("utf-8", "replace").strip()
        if missing := MISSING_MODULE.search(said):
            error = WorkerError(
                Text("The worker's Python has no module {}.", missing[1]),
                remedy="Set Worker Python in the add-on's preferences to a Python that has torch and pycolmap.",
            )
        elif DISK_FULL.search(said):
            error = WorkerError(
                "The disk is full.", remedy="Free some space, then run it again: finished work is kept."
            )
        elif NO_MEMORY.search(said):  # some libraries end the process then
            error = OutOfMemory()
        elif code == KILLED:
            error = WorkerError(
                "The worker was killed by the system, most often because the computer ran out of memory.",
                remedy="Run it again: it goes on from the last finished photo. If it happens again, set a smaller "
                       "memory budget in the preferences or choose a lower quality.",
            )
        else:
            last = Text(" It last said: {}", said.splitlines()[-1]) if said else ""
            again = "Run it again: it goes on from the last finished photo."
            error = WorkerError(
                Text("The worker ended unexpectedly ({}).{}", Text(_ending(code)), last),
                remedy=Text("{} Its log is {}.", Text(again), self.log) if self.log else again,
            )
        return failure(error)


def _ending(code: int) -> str:
    if code < 0:
        try:
            return signal.Signals(-code).name
        except ValueError:
            return f"signal {-code}"
    return f"exit code {code}"


def open_log(workspace: Path | None) -> IO[bytes] | None:
    """Where a worker's stderr goes: into the workspace, or the temporary folder where that cannot be written, or
    nowhere; the worker itself tells the user what is wrong with the workspace."""
    with contextlib.suppress(OSError):
        if workspace is not None:
            workspace.mkdir(parents=True, exist_ok=True)
            return open(workspace / LOG_NAME, "ab", buffering=0)
    with contextlib.suppress(OSError):
        handle, name = tempfile.mkstemp(prefix="curecon-", suffix=".log")
        os.close(handle)
        return open(name, "ab", buffering=0)
    return None
