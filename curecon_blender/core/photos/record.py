# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""`photos.json` of a workspace: what the photo check found."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..base.errors import WorkspaceError
from ..base.files import write_json
from ..base.language import Text
from ..base.reading import build, read_json
from ..base.records import Photo, PhotoSet

FILE_NAME = "photos.json"


def write_photos(workspace: Path, photo_set: PhotoSet) -> None:
    """Write `photos.json` (atomically) into the workspace folder. Raises WorkspaceError."""
    write_json(workspace / FILE_NAME, {
        "photos": [_photo_to_json(photo) for photo in photo_set.photos],
        "skipped": [{**asdict(skip), "path": str(skip.path)} for skip in photo_set.skipped],
    })


def _photo_to_json(photo: Photo) -> dict[str, Any]:
    return {**asdict(photo), "path": str(photo.path), "masks": [str(mask) for mask in photo.masks]}


def read_photos(workspace: Path) -> PhotoSet:
    """The inverse of `write_photos`. Raises WorkspaceError when the record is missing or damaged."""
    path = workspace / FILE_NAME
    try:
        photo_set: PhotoSet = build(PhotoSet, read_json(path))
        if len({photo.name.casefold() for photo in photo_set.photos}) != len(photo_set.photos):
            raise ValueError("two photos have one name")
        return photo_set
    except FileNotFoundError as error:
        raise WorkspaceError(
            Text("{} is missing, so the photos' places and capture times are unknown.", path), path=path,
            remedy="Run Reconstruct with the photos in this workspace.",
        ) from error
    except (OSError, ValueError) as error:
        raise WorkspaceError(
            Text("{} is damaged ({}).", path, Text(str(error))), path=path,
            remedy=Text("Delete the folder {} and run Reconstruct again.", workspace / 'stages'),
        ) from error


def photo_finder(photos: Iterable[Photo]) -> Callable[[str], Photo | None]:
    """Finds the photo that a name in a model or a list means: by its path's end, its name in the job, whatever case.

    A name that could mean several photos means none of them.
    """
    tables: list[dict[str, list[Photo]]] = [{}, {}, {}, {}]
    for photo in photos:
        parts = photo.path.as_posix().split("/")
        for start in range(len(parts)):
            tables[0].setdefault("/".join(parts[start:]), []).append(photo)
        tables[1].setdefault(photo.name, []).append(photo)
        tables[2].setdefault(photo.path.name, []).append(photo)
        for name in {photo.name.casefold(), photo.path.name.casefold()}:
            tables[3].setdefault(name, []).append(photo)

    def find(name: str) -> Photo | None:
        name = name.replace("\\", "/")
        base = name.rsplit("/", 1)[-1]
        for table, key in zip(tables, (name, name, base, base.casefold()), strict=True):
            if len(table.get(key, ())) == 1:
                return table[key][0]
        return None

    return find
