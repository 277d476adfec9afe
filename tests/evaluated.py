# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the tests of the evaluation share: its commands, run in this process."""

from __future__ import annotations

import importlib
import io
import json
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from curecon_blender.core.cloud.ply import Cloud, CloudWriter


@dataclass
class Done:
    returncode: int
    stdout: str
    stderr: str


def command(module: str, *arguments: object) -> Done:
    """Run a command in this process: a test below starts each as `python -m` too."""
    with redirect_stdout(io.StringIO()) as out, redirect_stderr(io.StringIO()) as err:
        code = importlib.import_module(f"evaluation.{module}").main([str(a) for a in arguments])
    return Done(code, out.getvalue(), err.getvalue())


def answer(module: str, *arguments: object) -> Any:
    done = command(module, *arguments, "--json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def write_ply(path: Path, points: np.ndarray) -> None:
    count = len(points)
    with CloudWriter(path) as writer:
        writer.write(Cloud(points, np.zeros((count, 3), np.uint8), np.zeros((count, 3)), np.ones(count),
                           np.full(count, 3, np.uint8)))
