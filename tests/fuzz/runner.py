# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Fuzzing of one target under limits of memory and time."""

from __future__ import annotations

import os
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path

from hypothesis import HealthCheck, Phase, given, seed, settings

from curecon_blender.core.base.errors import CuReconError

from .targets import TARGETS, Target

MEMORY = 1 << 30  # bytes that reading one small file may take on top of the libraries
CASE_SECONDS = 10  # of the processor's time for one case
BATCH = 200  # examples of one seed


class Finding(Exception):
    """What escaped from a reader, told by its kind and place."""


class _Over(BaseException):
    """The time is up: nothing that hypothesis should shrink."""


def fuzz(target: str, seconds: float, first_seed: int, folder: Path) -> None:
    """Fuzz one target in this process; writes `folder`/cases, and a file for every new kind of finding."""
    counted, known = folder / "cases", set()
    with tempfile.TemporaryDirectory(prefix="curecon-fuzz-") as scratch:
        sound, spoiled = Path(scratch) / "sound", Path(scratch) / "spoiled"
        sound.mkdir()
        chosen = TARGETS[target]
        chosen.make(sound)
        shutil.copytree(sound, spoiled)
        chosen.load(spoiled)  # the libraries, before memory is limited
        _limit_memory()
        until, cases, number = time.monotonic() + seconds, 0, first_seed

        def case(drawn: tuple[str, bytes]) -> None:
            nonlocal cases
            if time.monotonic() > until:
                raise _Over
            name, content = drawn
            cases += 1
            counted.write_text(str(cases))
            (folder / "running").write_bytes(name.encode() + b"\0" + content)  # what a crash leaves for the parent
            try:
                try_case(chosen, sound, spoiled, name, content)
            except Finding as finding:
                if (kind := str(finding).splitlines()[0]) not in known:
                    found.append((kind, str(finding), name, content))
                    raise

        while time.monotonic() < until:
            found: list[tuple[str, str, str, bytes]] = []  # kind, words, file, content
            run = settings(
                max_examples=BATCH, deadline=None, database=None, suppress_health_check=list(HealthCheck),
                phases=(Phase.generate, Phase.shrink), report_multiple_bugs=False,
            )(seed(number)(given(chosen.cases(sound))(case)))
            number += 1
            try:
                run()
            except _Over:
                break
            except Exception:  # hypothesis wraps what was raised; `found` ends with the smallest
                if not found:
                    raise
                told, name, content = found[-1][1:]
                known.update(entry[0] for entry in found)
                place = folder / f"{target}_{len(list(folder.glob(f'{target}_*.txt')))}"
                place.with_suffix(".txt").write_text(f"{told}\n{name}\n{content[:4000]!r}\n")
                place.with_suffix(".bin").write_bytes(content)
    (folder / "running").unlink(missing_ok=True)


def try_case(target: Target, sound: Path, spoiled: Path, name: str, content: bytes) -> None:
    """Read the folder `spoiled`, otherwise as `sound`, with one file's content replaced. Raises Finding."""
    (spoiled / name).write_bytes(content)
    try:
        _read(target.read, spoiled)
    finally:
        (spoiled / name).unlink()
        if (sound / name).exists():
            shutil.copy(sound / name, spoiled / name)


def _read(read: Callable[[Path], object], folder: Path) -> None:
    if hasattr(signal, "SIGPROF"):
        signal.signal(signal.SIGPROF, _too_long)
        signal.setitimer(signal.ITIMER_PROF, CASE_SECONDS)  # other programs do not count
    try:
        read(folder)
    except CuReconError as error:
        if not error.remedy or not str(error):
            raise Finding(f"{type(error).__name__} says nothing") from error
    except Exception as error:
        ours = [f for f in traceback.extract_tb(error.__traceback__)
                if "curecon_blender" in f.filename or f.filename.endswith("targets.py")]
        place = f"{Path(ours[-1].filename).name}:{ours[-1].name}" if ours else "?"
        raise Finding(f"{type(error).__name__} in {place}\n{traceback.format_exc()[-1500:]}") from error
    finally:
        if hasattr(signal, "SIGPROF"):
            signal.setitimer(signal.ITIMER_PROF, 0)


def _too_long(*_: object) -> None:
    raise TimeoutError(f"one case took over {CASE_SECONDS} s of the processor's time")


def _limit_memory() -> None:
    if sys.platform != "linux":
        return
    import resource

    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * os.sysconf("SC_PAGESIZE") + MEMORY,) * 2)
