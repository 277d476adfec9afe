# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the tests share: a part of the sample site, and the command line as a user runs it."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parent.parent
SITE = ROOT / "samples" / "tulou"
# Neighbours from above: enough for depth that others confirm, few enough to be quick.
SITE_PHOTOS = [f"DJI_{i:04d}.JPG" for i in (14, 15, 26, 27, 28, 33)]
QUICK = ["--quality", "preview", "--max-image-size", "320"]


@dataclass(frozen=True)
class Run:
    """What a command left: exit code, its JSON summary (last line of stdout, if any) and what it said."""

    code: int
    summary: dict[str, Any]
    said: str


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "curecon_blender.core", *map(str, arguments)]


def curecon(*arguments: object) -> Run:
    """Run the command line with --json from the repository's root."""
    done = subprocess.run(
        [*command(*arguments), "--json"], cwd=ROOT, capture_output=True, text=True, check=False,
        env={**os.environ, "OMP_NUM_THREADS": "2"},
    )
    lines = done.stdout.strip().splitlines()
    return Run(done.returncode, json.loads(lines[-1]) if lines else {}, done.stderr)


@pytest.fixture(scope="session")
def site_photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a few neighbouring photos of the sample site."""
    folder = tmp_path_factory.mktemp("site") / "photos"
    folder.mkdir()
    for name in SITE_PHOTOS:
        shutil.copy2(SITE / "photos" / name, folder)
    return folder


@pytest.fixture(scope="session")
def finished(site_photos: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Run]:
    """The site reconstructed from its photos alone: (workspace, run). Read only: copy it before changing it."""
    workspace = tmp_path_factory.mktemp("finished") / "workspace"
    return workspace, curecon("reconstruct", site_photos, "--workspace", workspace, *QUICK)
