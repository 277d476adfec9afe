# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The worker's libraries in a folder of their own: the wheels that a lock names, brought by pip, each held against its
hash.

Runs in the Python that is to have them, before any of them is there. Wheels that have come stay in the folder's
`.wheels` until all have, so that what is cancelled or cut off goes on from there.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import time
import tomllib
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..base.errors import SetupError
from ..base.files import disk_errors, partial_path
from ..base.language import Text
from ..base.messages import Reporter
from .nvidia import find_card

INDEXES = ("https://pypi.org/simple", "https://download.pytorch.org/whl/cpu")
PLATFORMS = {
    ("linux", "x86_64"): "linux-x64", ("win32", "amd64"): "windows-x64", ("darwin", "arm64"): "macos-arm64",
}
CARD = "-cuda"  # in the name of a lock that is for NVIDIA cards
RECORD = "curecon.json"  # in the finished folder: the digest of its lock
DATA = re.compile(r"^[^/]+\.data/(purelib|platlib)/")  # where a wheel may keep modules, too
POLL_SECONDS = 0.2
UNPACKING = 0.1  # of the time that the download takes, at a usual connection
LAST_WORDS = 600  # characters of pip's that an error tells


@dataclass(frozen=True)
class Wheel:
    """What of a lock's wheel pip has to know; `size` in bytes."""

    name: str
    version: str
    file: str
    sha256: str
    size: int


def lock_for(system: str | None, python: tuple[int, int], locks: Path, *, card: bool) -> Path | None:
    """The lock for a system and Python, if there is one: with `card` that for NVIDIA cards, where there is such."""
    names = [f"{system}{kind}-py{python[0]}{python[1]}.toml" for kind in ((CARD, "") if card else ("",))]
    return next((path for name in names if (path := locks / name).is_file()), None)


def lock_for_this_python(locks: Path, *, card: bool) -> Path | None:
    return lock_for(PLATFORMS.get((sys.platform, platform.machine().lower())), sys.version_info[:2], locks, card=card)


def wheels_of(lock: Path) -> list[Wheel]:
    """The wheels that a lock names."""
    entries = tomllib.loads(lock.read_text(encoding="utf-8"))["wheel"]
    return [Wheel(**{name: entry[name] for name in Wheel.__dataclass_fields__}) for entry in entries]


def is_made(folder: Path, lock: Path) -> bool:
    """Whether the folder holds just what the lock names."""
    try:
        record = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return bool(record == {"lock": _digest(lock)})


def make(
    folder: Path, locks: Path, indexes: tuple[str, ...], reporter: Reporter, *, processor: bool = False
) -> dict[str, Any]:
    """Make the folder of libraries; `indexes` are addresses of package indexes, or none for the usual ones. They are
    those for the NVIDIA card where there is one that they can use, unless `processor` is asked for. Does nothing where
    it is made already. Raises SetupError, WorkspaceError, Cancelled."""
    card = None if processor else find_card()
    lock = lock_for_this_python(locks, card=card is not None and card.usable)
    if lock is None:
        version = f"{sys.version_info.major}.{sys.version_info.minor}"
        raise SetupError(
            Text("There are no libraries for Python {} on this system ({}, {}).", version, platform.system(),
                 platform.machine()),
            remedy="Use Blender 4.5 or 5.2 from blender.org, or name a Worker Python that has torch and pycolmap.",
            path=sys.executable,
        )
    wheels = wheels_of(lock)
    summary = {"libraries": len(wheels), "bytes": sum(wheel.size for wheel in wheels), "folder": str(folder)}
    if is_made(folder, lock):
        return summary
    pip = _pip()
    kept, partial = folder / ".wheels", partial_path(folder)
    with disk_errors(folder):
        shutil.rmtree(_long(partial), ignore_errors=True)
        kept.mkdir(parents=True, exist_ok=True)
        reporter.begin({"download": 1.0, "unpack": UNPACKING})
        _download(pip, wheels, kept, indexes or INDEXES, reporter)
        _unpack(wheels, kept, partial, reporter)
        (partial / RECORD).write_text(json.dumps({"lock": _digest(lock)}), encoding="utf-8")
        shutil.rmtree(_long(folder))
        os.replace(partial, folder)
    return summary


def _download(
    pip: list[str], wheels: list[Wheel], kept: Path, indexes: tuple[str, ...], reporter: Reporter
) -> None:
    """Bring the wheels that are not there yet; progress in MiB."""
    reporter.stage("download")
    total = sum(wheel.size for wheel in wheels)
    fresh = [wheel for wheel in wheels if not _is_whole(kept / wheel.file, wheel)]
    done = total - sum(wheel.size for wheel in fresh)
    reporter.progress(done >> 20, total >> 20, fresh=False)
    options = ["--no-deps", "--only-binary", ":all:", "--require-hashes", "--dest", str(kept)]
    options += ["--index-url", indexes[0], *(f"--extra-index-url={index}" for index in indexes[1:])]
    for wheel in fresh:
        scratch = kept / ".partial"  # where pip keeps what is on its way
        shutil.rmtree(scratch, ignore_errors=True)
        scratch.mkdir()
        with _requirements(kept, [wheel]) as list_:
            for _ in _running([*pip, "download", *options, "-r", str(list_)], scratch, wheel.name):
                coming = min(_size_of(scratch), wheel.size)
                reporter.progress((done + coming) >> 20, total >> 20)
        shutil.rmtree(scratch, ignore_errors=True)
        done += wheel.size


def _unpack(wheels: list[Wheel], kept: Path, target: Path, reporter: Reporter) -> None:
    """Unpack the wheels into one folder, as Blender does with an extension's; progress in MiB. What they bring beside
    modules (scripts, headers) stays out."""
    reporter.stage("unpack")
    total, done = sum(wheel.size for wheel in wheels), 0
    for wheel in wheels:
        with zipfile.ZipFile(kept / wheel.file) as archive:
            for member in archive.infolist():
                reporter.progress(done >> 20, total >> 20)
                done += member.compress_size
                place = DATA.sub("", member.filename)
                if place.endswith("/") or ".data/" in place:
                    continue
                file = Path(_long(target / place))
                file.parent.mkdir(parents=True, exist_ok=True)
                with archive.open(member) as packed, open(file, "wb") as unpacked:
                    shutil.copyfileobj(packed, unpacked, 1 << 20)


def _long(path: Path) -> str:
    """A path that Windows takes though it has more than 259 characters: some of torch's licences lie that deep."""
    return f"\\\\?\\{os.path.abspath(path)}" if sys.platform == "win32" else str(path)


def _running(command: list[str], scratch: Path, what: str) -> Iterator[None]:
    """Yields while pip runs; ends it when the caller gives up. Raises SetupError with pip's words where it fails."""
    environment = os.environ | {
        "TMPDIR": str(scratch), "TEMP": str(scratch), "TMP": str(scratch), "PIP_DISABLE_PIP_VERSION_CHECK": "1",
        "PIP_NO_INPUT": "1", "PIP_NO_CACHE_DIR": "1",
    }
    environment.pop("PYTHONPATH", None)
    said = scratch / "pip.log"
    with open(said, "wb") as log:
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=environment,
                                   creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0))
        try:
            while process.poll() is None:
                yield
                time.sleep(POLL_SECONDS)
        finally:
            if process.poll() is None:
                process.terminate()
                process.wait()
    if process.returncode:
        words = said.read_text(encoding="utf-8", errors="replace").strip()
        print(words, file=sys.stderr, flush=True)
        raise _failed(what, words)


def _failed(what: str, words: str) -> SetupError:
    last = [line for line in words.splitlines() if line.startswith("ERROR")] or words.splitlines()[-1:]
    if "DO NOT MATCH THE HASHES" in words:
        return SetupError(
            Text("What the package index has for {} is not the file that this CU-Recon was made with.", what),
            remedy="Nothing of it was used. Try another package index, or another network.",
        )
    if "Could not find a version" in words or "No matching distribution" in words:
        return SetupError(
            Text("The package index could not be reached, or does not have {}.", what),
            remedy="Check the connection to the internet and, if one is set, the Package Index in the add-on's "
                   "preferences; then press again: what has come already is kept.",
        )
    return SetupError(
        Text("pip could not bring {}: {}", what, ' '.join(last)[-LAST_WORDS:]),
        remedy="Check the connection and the free disk space, then press again: what has come already is kept.",
    )


def _pip() -> list[str]:
    """The command of pip: this Python's own, or the one that Python carries to install it from."""
    if importlib.util.find_spec("pip") is not None:
        return [sys.executable, "-m", "pip"]
    if (carried := importlib.util.find_spec("ensurepip")) is not None and carried.origin is not None:
        for wheel in sorted((Path(carried.origin).parent / "_bundled").glob("pip-*.whl")):
            return [sys.executable, str(wheel / "pip")]
    raise SetupError(
        Text("The Python at {} comes without pip, which brings the libraries.", sys.executable),
        remedy="Use Blender from blender.org, or name a Worker Python that has torch and pycolmap.",
        path=sys.executable,
    )


@contextlib.contextmanager
def _requirements(folder: Path, wheels: list[Wheel]) -> Iterator[Path]:
    """pip's own list of what to bring; three equals signs keep 2.13.0 from being 2.13.0+cpu."""
    path = folder / "requirements.txt"
    lines = [f"{wheel.name}==={wheel.version} --hash=sha256:{wheel.sha256}\n" for wheel in wheels]
    path.write_text("".join(lines), encoding="utf-8")
    try:
        yield path
    finally:
        path.unlink(missing_ok=True)


def _is_whole(path: Path, wheel: Wheel) -> bool:
    return path.is_file() and path.stat().st_size == wheel.size and _digest(path) == wheel.sha256


def _size_of(folder: Path) -> int:
    """Bytes in a folder that is being written to."""
    size = 0
    for root, _, names in os.walk(folder):
        for name in names:
            with contextlib.suppress(OSError):  # it has been moved on
                size += os.stat(os.path.join(root, name)).st_size
    return size


def _digest(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
