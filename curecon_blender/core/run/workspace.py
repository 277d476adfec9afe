# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""One folder a job: who may use it, which stages are done, and for which options and inputs."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import shutil
import sys
import time
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Annotated, Any

from ..base.errors import WorkspaceError
from ..base.files import JOB_FOLDERS, disk_errors, remove_partials, write_json
from ..base.language import Text
from ..base.reading import FARTHEST, INSIDE, Within, build, read_json

FORMAT = 1
# What a job writes, beside which the photos may lie.
_OWN_FILES = re.compile(r"\.(json|ply|npz|lock|log|partial)$")
LOCK_PATIENCE = 5.0  # seconds; a worker whose Blender was killed needs less to end
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL)


def key_of(value: Any) -> str:
    """A short digest of anything JSON can say: the key of a stage's done-marker."""
    text = json.dumps(value, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:20]


@dataclass(frozen=True, kw_only=True)
class StageRecord:
    """A stage's done-marker: the key it was done for, what it took, and the files it made, below the workspace."""

    key: str
    seconds: Annotated[float, Within(0, FARTHEST)]
    peak_gib: Annotated[float, Within(0, FARTHEST)]
    files: tuple[Annotated[str, INSIDE], ...] = ()


def require_workspace(folder: Path) -> None:
    """Refuse a folder in which there is nothing to go on from. Raises WorkspaceError."""
    if not (folder / "workspace.json").is_file():
        raise WorkspaceError(
            Text("{} is not a workspace of CU-Recon.", folder), path=folder,
            remedy="Choose the folder that Reconstruct made, or run Reconstruct first.",
        )


class Workspace:
    """An open workspace folder, locked against a second job for as long as the `with` block runs.

    What a killed job left half-written is removed. Raises WorkspaceError when the folder cannot be made or written, is
    in use, or was made by a newer version.
    """

    def __init__(self, root: Path) -> None:
        self.root = root.absolute()

    def __enter__(self) -> Workspace:
        marker = self.root / "workspace.json"
        with disk_errors(self.root):
            try:
                self.root.mkdir(parents=True, exist_ok=True)
            except (FileExistsError, NotADirectoryError) as error:
                raise WorkspaceError(
                    Text("The workspace {} cannot be a folder: a file is in the way.", self.root),
                    remedy="Choose another workspace folder.", path=self.root,
                ) from error
            refuse_links(self.root)
            self._lock = open(self.root / "workspace.lock", "a+b")
        _lock(self._lock, self.root)
        try:
            if marker.exists():
                _check_format(marker)
            else:
                write_json(marker, {"format": FORMAT, "made_by": "CU-Recon"})
            with disk_errors(self.root):
                remove_partials(self.root)
        except WorkspaceError:
            self._lock.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._lock.close()  # the operating system lets go of the lock, as it does when the process is killed
        if value is not None and not self.root.is_dir():  # whatever else was found missing, this is why
            raise WorkspaceError(
                Text("The workspace {} is gone: it was moved or deleted, or its drive does not answer.", self.root),
                remedy="Connect the drive again or put the folder back, then run it again: finished work is kept.",
                path=self.root,
            ) from value

    def record(self, stage: str) -> StageRecord | None:
        """The stage's done-marker, if it has one and all its files are still there."""
        path = self._marker(stage)
        try:
            record: StageRecord = build(StageRecord, read_json(path))
        except (OSError, ValueError):
            return None  # never finished, or the marker is damaged: the stage runs again
        return record if all((self.root / file).exists() for file in record.files) else None

    def is_done(self, stage: str, key: str) -> bool:
        record = self.record(stage)
        return record is not None and record.key == key

    def mark_done(self, stage: str, record: StageRecord) -> None:
        write_json(self._marker(stage), asdict(record))

    def reopen(self, stage: str) -> None:
        """Take back a done-marker before its stage's files are touched."""
        self._marker(stage).unlink(missing_ok=True)

    def require_space(self, bytes_needed: int) -> None:
        """Refuse early what the disk cannot hold. Raises WorkspaceError."""
        free = shutil.disk_usage(self.root).free
        if free < bytes_needed:
            raise WorkspaceError(
                Text("The disk of {} has {:.1f} GiB free; this job needs about {:.1f} GiB.", self.root, free / 2**30,
                     bytes_needed / 2**30),
                remedy="Free some space, choose a workspace on another disk, or a lower quality.", path=self.root,
            )

    def _marker(self, stage: str) -> Path:
        return self.root / "stages" / f"{stage}.json"


def refuse_links(root: Path) -> None:
    """A workspace from a stranger may hold links by which what is written into it would land elsewhere. Raises
    WorkspaceError for one that leads out of the workspace; of what else lies beside its files, such as the photos,
    nothing is written."""
    real = os.path.realpath(root)
    for folder, folders, files in os.walk(root):
        if Path(folder) == root:
            folders[:] = [name for name in folders if JOB_FOLDERS.fullmatch(name)]
            files = [name for name in files if _OWN_FILES.search(name) or JOB_FOLDERS.fullmatch(name)]
        # A junction of Windows is a folder that only its real path gives away.
        links = [name for name in files if os.path.islink(os.path.join(folder, name))]
        for path in (Path(folder, name) for name in [*folders, *links]):
            if not Path(os.path.realpath(path)).is_relative_to(real):
                raise WorkspaceError(
                    Text("{} is a link that leads out of the workspace: files would be changed elsewhere.", path),
                    remedy="Remove that link if somebody gave you this workspace, or put the folder itself there.",
                    path=path,
                )


def _check_format(marker: Path) -> None:
    try:
        found = build(int, build(dict, read_json(marker)).get("format"), "format")
    except (OSError, ValueError) as error:
        raise WorkspaceError(
            Text("{} is damaged ({}).", marker, Text(str(error))), path=marker,
            remedy="Choose a new workspace folder; your photos are untouched.",
        ) from error
    if found > FORMAT:
        raise WorkspaceError(
            Text("The workspace {} was made by a newer version of CU-Recon.", marker.parent),
            remedy="Update CU-Recon, or choose another workspace folder.", path=marker.parent,
        )


def _lock(file: IO[bytes], root: Path) -> None:
    """Take an exclusive lock that the operating system gives back when the process ends, however it ends."""
    deadline = time.monotonic() + LOCK_PATIENCE
    while True:
        try:
            try_lock(file)
            return
        except OSError as error:
            if error.errno not in _NO_LOCKS and time.monotonic() < deadline:
                time.sleep(0.1)
                continue
            file.close()
            if error.errno in _NO_LOCKS:
                raise WorkspaceError(
                    Text("The drive of {} cannot lock files, so two jobs could spoil each other's work.", root),
                    remedy="Choose a workspace folder on a local drive.", path=root,
                ) from error
            raise WorkspaceError(
                Text("Another CU-Recon job is using the workspace {}.", root),
                remedy="Wait for it, cancel it, or choose another workspace folder.", path=root,
            ) from error


def try_lock(file: IO[bytes]) -> None:
    """Lock a file for this process, or raise OSError where another one holds it."""
    if sys.platform == "win32":
        import msvcrt

        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
    else:
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def folder_bytes(root: Path) -> int:
    """Bytes of all files below a folder; a link counts as itself, and what goes meanwhile counts nothing."""
    total = 0
    for folder, _, files in os.walk(root):
        for name in files:
            with suppress(FileNotFoundError):
                total += os.lstat(os.path.join(folder, name)).st_size
    return total
