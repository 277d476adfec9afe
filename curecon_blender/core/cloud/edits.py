# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Points that a user took out of a cloud, kept beside it; the cloud's own file is never changed.

`removed.npz` (`removed_1.npz` for the next component) holds one bit a point and a digest of the cloud that it was made
for: it means nothing for another.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path

import numpy as np

from ..base.errors import WorkspaceError
from ..base.files import atomic_write, disk_errors
from ..base.language import Text
from ..base.reading import Expected, read_arrays
from .ply import Cloud, cloud_blocks, point_count, read_cloud

_BLOCK, _BLOCKS = 1 << 16, 16  # bytes, and how many spread over the file, that its digest takes in


def removed_file(cloud: Path) -> Path:
    """Where the points taken out of a cloud file are kept."""
    return cloud.with_name(cloud.name.replace("cloud", "removed", 1)).with_suffix(".npz")


def read_removed(cloud: Path, count: int) -> np.ndarray | None:
    """Which of the `count` points of a cloud file were taken out: (count,) bool; None where none were, or where the
    file belongs to an earlier cloud (see `is_stale`). Raises WorkspaceError for a damaged file."""
    path = removed_file(cloud)
    try:
        if str(read_arrays(path, {"cloud": Expected((), "U")})["cloud"]) != digest(cloud):
            return None
        bits = read_arrays(path, {"bits": Expected((-(-count // 8),), "u")})["bits"]
        return np.unpackbits(bits.astype(np.uint8), count=count).astype(bool)
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise _damaged(path, error) from error


def is_stale(cloud: Path) -> bool:
    """Whether points are kept as taken out of an earlier cloud of that name."""
    path = removed_file(cloud)
    if not (path.is_file() and cloud.is_file()):
        return False
    try:
        return str(read_arrays(path, {"cloud": Expected((), "U")})["cloud"]) != digest(cloud)
    except (OSError, ValueError) as error:
        raise _damaged(path, error) from error


def write_removed(cloud: Path, removed: np.ndarray) -> None:
    """Keep which points (N,) bool of a cloud file are taken out; none need no file. Raises WorkspaceError."""
    path = removed_file(cloud)
    if not removed.any():
        with disk_errors(path):
            path.unlink(missing_ok=True)
        return
    with atomic_write(path) as file:
        np.savez_compressed(file, bits=np.packbits(removed), cloud=np.array(digest(cloud)))


def read_edited_cloud(path: Path) -> Cloud:
    """A cloud without the points that were taken out. Raises WorkspaceError."""
    cloud = read_cloud(path)
    removed = read_removed(path, len(cloud))
    return cloud if removed is None else Cloud(**{
        field.name: getattr(cloud, field.name)[~removed] for field in fields(Cloud)
    })


def edited_blocks(path: Path, size: int) -> Iterator[Cloud]:
    """A cloud without the points that were taken out, at most `size` points at once. Raises WorkspaceError."""
    removed, start = read_removed(path, point_count(path)), 0
    for block in cloud_blocks(path, size):
        yield block if removed is None else block.take(~removed[start : start + len(block)])
        start += len(block)


def edits_key(cloud: Path) -> str:
    """A digest of what was taken out of a cloud file; empty where nothing was."""
    path = removed_file(cloud)
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() and not is_stale(cloud) else ""


def _damaged(path: Path, error: Exception) -> WorkspaceError:
    return WorkspaceError(
        Text("{} is damaged ({}).", path, Text(str(error))),
        remedy="Delete that file and import again: all points come back.", path=path
    )


def digest(cloud: Path) -> str:
    """Of the file's size and of blocks spread over it: another cloud has another."""
    with open(cloud, "rb") as file:
        size = file.seek(0, 2)
        found = hashlib.sha256(str(size).encode())
        for index in range(_BLOCKS):
            file.seek(size * index // _BLOCKS)
            found.update(file.read(_BLOCK))
    return found.hexdigest()
