# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a tour is to do, what it reports, and how it waits for the add-on's jobs."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

from person import Person, Wait

MODULE = "bl_ext.user_default.curecon_blender"
BEAT = 0.02  # seconds between two looks at whether Blender still answers

task = json.loads(Path(sys.argv[sys.argv.index("--") + 1]).read_text())
out = Path(task["out"])
report: dict[str, Any] = {"steps": [], "stall": {}}
began = time.monotonic()


def step(name: str) -> None:
    """The next step of the tour begins: in the report, each has the second in which it began."""
    report["steps"].append({"name": name, "began": round(time.monotonic() - began, 1)})
    print(f"TOUR {report['steps'][-1]['began']:7.1f} s  {name}", flush=True)


def busy() -> bool:
    return sys.modules[f"{MODULE}.curecon_blender.operators.running"].status.running


def failure() -> str:
    failed = sys.modules[f"{MODULE}.curecon_blender.operators.running"].status.failure
    return f"{failed.message} {failed.remedy}" if failed is not None else ""


def worked(person: Person, seconds: float, what: str) -> Wait:
    yield from person.until(busy, seconds=10, what=f"{what} has begun")
    yield from person.until(lambda: not busy(), seconds=seconds, what=what)
    assert not failure(), failure()
    yield 1.0
