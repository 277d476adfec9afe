# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the tests share: a part of the sample site, small, and the command line as a user runs it."""

from __future__ import annotations

import json
import os
import pickle
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import forked
import pytest
from filelock import FileLock
from PIL import Image

if TYPE_CHECKING:
    from atlas_run import Asker, Atlas

# Threads that wait for each other turn in circles: two tests side by side, of one thread each, take a third of the
# processor's time that two threads each would. Set before torch is imported, and for every process that a test starts.
os.environ["OMP_NUM_THREADS"] = "1"

ROOT = Path(__file__).parent.parent
SITE = ROOT / "samples" / "tulou"
# Neighbours from above: enough for depth that others confirm, few enough to be quick.
SITE_PHOTOS = [f"DJI_{i:04d}.JPG" for i in (14, 15, 26, 27, 28, 33)]
QUICK = ["--quality", "preview", "--max-image-size", "320"]
SMALL = ["--quality", "preview", "--max-image-size", "192", "--max-faces", "3000", "--texture-size", "512"]


@dataclass(frozen=True)
class Run:
    """What a command left: exit code, its JSON summary (last line of stdout, if any) and what it said."""

    code: int | None
    summary: dict[str, Any]
    said: str


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "curecon_blender.core", *map(str, arguments)]


def curecon(*arguments: object) -> Run:
    """Run the command line with --json from the repository's root."""
    with tempfile.TemporaryDirectory() as folder:
        out, said = Path(folder) / "out", Path(folder) / "said"
        code = forked.run([*map(str, arguments), "--json"], out, said)
        lines = out.read_text(encoding="utf-8").strip().splitlines()
        return Run(code, json.loads(lines[-1]) if lines else {}, said.read_text(encoding="utf-8"))


Made = TypeVar("Made")
MakeOnce = Callable[[str, Callable[[Path], Made]], Made]


@pytest.fixture(scope="session")
def made_once(tmp_path_factory: pytest.TempPathFactory) -> MakeOnce[Any]:
    """What is dear to make, made once a test run though each pytest-xdist worker is a process of its own.

    `made_once(name, make)` is what `make(folder)` returned, pickled, and the folder as it left it: read only.
    """
    base = tmp_path_factory.getbasetemp()
    base = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base

    def once(name: str, make: Callable[[Path], Any]) -> Any:
        folder, kept = base / name, base / f"{name}.pickle"
        with FileLock(base / f"{name}.lock"):
            if not kept.exists():
                shutil.rmtree(folder, ignore_errors=True)  # of a worker whose attempt failed
                folder.mkdir()
                kept.write_bytes(pickle.dumps(make(folder)))
        return pickle.loads(kept.read_bytes())

    return once


@pytest.fixture(scope="session")
def site_photos(made_once: MakeOnce[Path]) -> Path:
    """A folder with a few neighbouring photos of the sample site at half their size, with their metadata."""
    def halved(folder: Path) -> Path:
        for name in SITE_PHOTOS:
            with Image.open(SITE / "photos" / name) as photo:
                half = photo.resize((photo.width // 2, photo.height // 2), Image.Resampling.LANCZOS)
                half.save(folder / name, quality=92, exif=photo.info["exif"], xmp=photo.info["xmp"])
        return folder

    return made_once("site_photos", halved)


@pytest.fixture(scope="session")
def finished(site_photos: Path, made_once: MakeOnce[tuple[Path, Run]]) -> tuple[Path, Run]:
    """The site reconstructed from its photos alone: (workspace, run). Read only: copy it before changing it."""
    return made_once("finished", lambda folder: (
        folder, curecon("reconstruct", site_photos, "--workspace", folder, *QUICK)))


@pytest.fixture(scope="session")
def textured(finished: tuple[Path, Run], site_photos: Path, made_once: MakeOnce[tuple[Path, Run]]) -> tuple[Path, Run]:
    """All stages done: (workspace, run). Read only: `before` copies it."""
    def surfaced(folder: Path) -> tuple[Path, Run]:
        shutil.copytree(finished[0], folder, dirs_exist_ok=True)  # the cameras are the same
        run = curecon("reconstruct", site_photos, "--workspace", folder, *SMALL, "--until", "texture")
        assert run.code == 0 and run.said.count("already done") == 3, run.said
        return folder, run

    return made_once("textured", surfaced)


@pytest.fixture
def mounted(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Path]:
    """A small disk of its own, mounted with the options in the fixture's parameter."""
    disk = tmp_path / "disk"
    disk.mkdir()
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", request.param, "tmpfs", str(disk)], check=False,
                          capture_output=True, text=True)
    if done.returncode:
        pytest.skip(f"mounting a small disk needs root: {done.stderr.strip()}")
    yield disk
    subprocess.run(["umount", str(disk)], check=True)


# ---- the atlas: its own libraries are loaded where a test asks for it

@pytest.fixture(scope="module")
def little(made_once: MakeOnce[Path]) -> Callable[..., Path]:
    """A published little site. Read only."""
    from atlas_run import make_site

    from curecon_blender.core.base.options import CELL

    return lambda title="Gate", location=CELL: made_once(
        f"atlas_{title}_{location}", lambda folder: make_site(folder / "p", title, location))


@pytest.fixture(scope="module")
def files(little: Callable[..., Path]) -> dict[str, bytes]:
    """What is sent of it."""
    from atlas_run import listed

    return listed(little())


@pytest.fixture
def titled(files: dict[str, bytes], request: pytest.FixtureRequest) -> dict[str, bytes]:
    """The files of a site with a name of its own."""
    name = request.node.name[:50]
    record = {
        **json.loads(files["site.json"]),
        "title": name,
        "id": "".join(c if c.isalnum() else "-" for c in name.lower()),
    }
    return {**files, "site.json": json.dumps(record).encode()}


@pytest.fixture(scope="module")
def atlas(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Atlas]:
    from atlas_run import LIMITS, running

    with running(tmp_path_factory.mktemp("atlas"), more=LIMITS) as found:
        yield found


@pytest.fixture(scope="module")
def moderator(atlas: Atlas) -> Asker:
    return atlas.somebody("moderator", "Moira")


@pytest.fixture(scope="module")
def contributor(atlas: Atlas) -> Asker:
    return atlas.somebody("contributor", "Conrad")
