# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Writing files so that a crash or a full disk never leaves half of one behind, and what a killed process left goes."""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

from .errors import WorkspaceError
from .language import Text
from .reading import build, read_json

Record = TypeVar("Record")

# Folders that a job makes in its workspace, and those for what is made of it: the user's photos may lie beside them.
JOB_FOLDERS = re.compile(r"sparse|undistorted|depth|stages|textured(_\d+)?|\..*")
PRESENTATION, DELIVERABLES = "presentation", "deliverables"
# What an operating system says of a drive that was unplugged, lost its network, or breaks.
_GONE = tuple(getattr(errno, name) for name in (
    "EIO", "ESTALE", "ENODEV", "ENXIO", "ENOTCONN", "ETIMEDOUT", "EHOSTDOWN", "EHOSTUNREACH", "EREMOTEIO",
) if hasattr(errno, name))


@contextmanager
def disk_errors(path: Path) -> Iterator[None]:
    """Turn the operating system's word on a full, read-only or vanished disk into an error with a remedy."""
    try:
        yield
    except OSError as error:
        if error.errno in _GONE or (isinstance(error, FileNotFoundError) and not path.parent.exists()):
            raise WorkspaceError(
                Text("{} could not be written: its folder is gone, or its drive does not answer ({}).", path,
                     error.strerror),
                remedy="Connect the drive again or put the folder back, then run it again: finished work is kept.",
                path=path,
            ) from error
        if error.errno == errno.EFBIG:
            raise WorkspaceError(
                Text("{} would be larger than its drive allows for one file.", path),
                remedy="Choose a workspace on another drive; memory cards and sticks often allow 4 GB.", path=path,
            ) from error
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise WorkspaceError(
                Text("The disk is full: {} could not be written.", path),
                remedy="Free some space, then run it again: finished work is kept.", path=path,
            ) from error
        if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
            raise WorkspaceError(
                Text("No permission to write {}.", path),
                remedy="Choose a workspace folder that you may write to.", path=path,
            ) from error
        raise


def partial_path(path: Path) -> Path:
    """What a file or folder is called until it is finished."""
    return path.with_name(f".{path.name}.partial")


def remove_partials(folder: Path) -> None:
    """Remove what a killed process left unfinished in a folder and below."""
    for partial in [*folder.rglob(".*.partial")]:
        if partial.is_dir():
            shutil.rmtree(partial, ignore_errors=True)
        else:
            partial.unlink(missing_ok=True)


@contextmanager
def atomic_write(path: Path) -> Iterator[BinaryIO]:
    """Open a file that takes `path`'s place only when the block ends well. Its folder is made where it is missing, but
    not the one above: a workspace that was removed meanwhile must not come back. Raises WorkspaceError."""
    partial = partial_path(path)
    with disk_errors(path):
        path.parent.mkdir(exist_ok=True)
        try:
            with open(partial, "wb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            os.replace(partial, path)
        finally:
            partial.unlink(missing_ok=True)


@contextmanager
def scratch_folder(place: Path) -> Iterator[Path]:
    """A folder beside `place`, named as unfinished, that is empty at the start and gone in the end."""
    folder = partial_path(place)
    shutil.rmtree(folder, ignore_errors=True)
    with disk_errors(folder):
        folder.mkdir()
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def read_record(kind: type[Record], path: Path) -> Record:
    """A dataclass that a stage has left as JSON. Raises WorkspaceError when it is missing or damaged."""
    try:
        record: Record = build(kind, read_json(path))
        return record
    except (OSError, ValueError) as error:
        raise WorkspaceError(
            Text("{} is missing or damaged ({}).", path, Text(str(error))),
            remedy="Run Reconstruct again in this workspace.", path=path
        ) from error


def write_json(path: Path, value: Any) -> None:
    with atomic_write(path) as file:
        # A file's name need be no text; what is none is written as JSON's escape.
        file.write((json.dumps(value, indent=1, ensure_ascii=False) + "\n").encode("utf-8", "backslashreplace"))
