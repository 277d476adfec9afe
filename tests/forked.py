# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line in a fork of a process that has loaded its libraries already, which take two seconds to load."""

from __future__ import annotations

import multiprocessing
import os
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent

_context = multiprocessing.get_context(
    "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn")
_context.set_forkserver_preload(["forked", "curecon_blender.core.run.worker", "curecon_blender.core.run.pipeline"])


def run(arguments: list[str], out: Path, said: Path) -> int | None:
    """Run from the repository's root with stdout and stderr in these files; returns the exit code."""
    process = _context.Process(target=_run, args=(arguments, out, said, dict(os.environ)))
    process.start()
    process.join()
    return process.exitcode


def _run(arguments: list[str], out: Path, said: Path, environment: dict[str, str]) -> None:
    from curecon_blender.core.run.worker import main

    os.environ.update(environment)  # the process that it is a fork of has that of its start
    os.chdir(ROOT)
    for number, path in ((1, out), (2, said)):
        os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT), number)
    sys.exit(main(arguments))
