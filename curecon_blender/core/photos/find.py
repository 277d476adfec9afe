# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The files in a folder of photos: pictures to look at, and what is recognised beside them but cannot be read."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from ..base import images, raw
from ..base.errors import PhotoError
from ..base.files import DELIVERABLES, JOB_FOLDERS, PRESENTATION
from ..base.language import Text
from ..base.options import VIDEO_SUFFIXES
from ..base.records import SkippedPhoto
from . import masks

CARD = "dcim"  # a memory card's folder of folders of photos
_DEEPEST, _MOST_FOLDERS = 5, 2000  # of a search for the nearest folder with photos
_OTHER_KINDS = {
    **dict.fromkeys((".webp", ".avif", ".jxl", ".bmp", ".jp2", ".x3f"), "other picture"),
    **dict.fromkeys((*VIDEO_SUFFIXES, ".avi", ".mts", ".mkv", ".insv"), "video"),
}
_REMEDIES = {
    "other picture": "Export them as JPEG.",
    "video": "Take photos from MP4 and MOV with Frames from Video; save frames of others as JPEG.",
}


@dataclass(frozen=True)
class Files:
    """`pictures` are JPEG, PNG, TIFF, HEIC and raw files, `others` all else, both in natural order of names. A HEIC
    beside a picture of the same name is the same photo, and one of the others; so is a raw beside either.
    `masks` are those of each picture, `lone_masks` those whose photo is not there."""

    pictures: list[Path]
    others: list[Path]
    masks: dict[Path, list[Path]]
    lone_masks: list[Path]

    def unreadable(self) -> dict[str, list[SkippedPhoto]]:
        """Photos and videos that cannot be read, by kind; not those that lie beside a picture of the same name."""
        twins = {_without_suffix(path) for path in self.pictures}
        found: dict[str, list[SkippedPhoto]] = {}
        for path in self.others:
            kind = _OTHER_KINDS.get(path.suffix.lower())
            if kind is not None and _without_suffix(path) not in twins and images.is_text(path):
                what = "is a video" if kind == "video" else f"is a {path.suffix[1:].upper()} file"
                reason = f"{images.shown(path)} {what}, which is not read here."
                found.setdefault(kind, []).append(SkippedPhoto(path=path, reason=reason, kind=kind))
        return found


def remedy_for(kind: str) -> str:
    """What to do with files that `Files.unreadable` found."""
    return _REMEDIES[kind]


def find_photos(source: Path) -> list[Path]:
    """The picture files of `find_files`. Raises PhotoError."""
    return find_files(source).pictures


def find_files(source: Path) -> Files:
    """The files in `source`, one level below it (drones write 100MEDIA), and one level below a memory card's DCIM.

    Hidden files and folders are passed over. Raises PhotoError when there are no pictures.
    """
    if source.is_file():
        raise PhotoError(
            Text("{} is a single file: a reconstruction needs a folder of photos.", source),
            remedy="Choose the folder that holds all the photos of the site.", path=source,
        )
    if not source.is_dir():
        raise PhotoError(Text("The folder {} does not exist.", source),
                         remedy="Choose the folder of the photos.", path=source)
    folders = _visible(source, folders=True)
    if (source / "workspace.json").exists():  # the photos' folder is the workspace too: do not take up our own results
        own = (PRESENTATION, DELIVERABLES)
        folders = [f for f in folders if not JOB_FOLDERS.fullmatch(f.name) and f.name not in own]
    for card in [folder for folder in folders if folder.name.casefold() == CARD]:
        folders += _visible(card, folders=True)
    files = [
        path
        for folder in (source, *sorted(folders, key=lambda folder: _natural(folder.relative_to(source).as_posix())))
        for path in sorted(_visible(folder, folders=False), key=lambda path: _natural(path.name))
    ]
    found = [path for path in files if path.suffix.lower() in images.SUFFIXES]
    if not found:
        raise _none_found(source, files)
    sorted_out = masks.sort_out(found)
    found = sorted_out.pictures
    if not found:
        raise _none_found(source, files)
    best: dict[str, int] = {}
    for path in found:
        best[_without_suffix(path)] = min(_rank(path), best.get(_without_suffix(path), _rank(path)))
    pictures = [path for path in found if _rank(path) == best[_without_suffix(path)]]
    others = set(files) - {*pictures, *sorted_out.lone, *(mask for ones in sorted_out.masks.values() for mask in ones)}
    return Files(pictures, sorted(others, key=files.index), sorted_out.masks, sorted_out.lone)


def find_videos(source: Path) -> list[Path]:
    """The videos in `source` and one level below it. Raises PhotoError where it is no folder."""
    if not source.is_dir():
        raise PhotoError(Text("The folder {} does not exist.", source),
                         remedy="Choose the folder of the photos.", path=source)
    return [path for folder in (source, *_visible(source, folders=True)) for path in _visible(folder, folders=False)
            if path.suffix.lower() in VIDEO_SUFFIXES and images.is_text(path)]


def _without_suffix(path: Path) -> str:
    return path.with_suffix("").as_posix().casefold()


def _rank(path: Path) -> int:
    """Which of the files of one photo is taken: the camera's own JPEG first, a raw last."""
    suffix = path.suffix.lower()
    return 2 if suffix in raw.SUFFIXES else int(suffix in images.HEIC_SUFFIXES)


def _visible(folder: Path, *, folders: bool) -> list[Path]:
    """A folder's entries without hidden ones, among them macOS's `._` shadows of photos on memory cards."""
    try:
        entries = [entry for entry in folder.iterdir() if not entry.name.startswith(".")]
        return sorted(entry for entry in entries if (entry.is_dir() if folders else entry.is_file()))
    except FileNotFoundError:  # gone since it was listed
        return []
    except PermissionError as error:
        remedy = "Change its permissions, or copy the photos elsewhere."
        raise PhotoError(Text("No permission to read the folder {}.", folder), remedy=remedy, path=folder) from error


def _natural(name: str) -> list[tuple[int, str]]:
    """A sort key that puts DJI_2 before DJI_10."""
    parts = re.split(r"(\d+)", name.casefold())  # text at even places, digits at odd ones
    return [(int(part), "") if place % 2 else (0, part) for place, part in enumerate(parts)]


def _none_found(source: Path, files: list[Path]) -> PhotoError:
    choose = "Choose the folder that holds the photos themselves."
    kinds = Counter(path.suffix.lower() or "files without a suffix" for path in files)
    known = dict.fromkeys(_OTHER_KINDS[suffix] for suffix in kinds if suffix in _OTHER_KINDS)
    if not known and (nearest := _nearest(source)):
        folder, count = nearest
        photos = "1 photo lies" if count == 1 else f"{count} photos lie"
        return PhotoError(
            Text("There are no photos in {} nor one level below it, but {} deeper, in {}.", source, Text(photos),
                 folder),
            remedy=Text("Choose {}, or the folder above it.", folder), path=source,
        )
    if not files:
        return PhotoError(Text("The folder {} is empty.", source), remedy=choose, path=source)
    found = listed([f"{count} {kind.upper() if kind[0] == '.' else kind}" for kind, count in kinds.most_common()])
    remedy = " ".join(_REMEDIES[kind] for kind in known) or choose
    return PhotoError(
        Text("There are no JPEG, PNG, TIFF, HEIC or raw photos in {}, only other files: {}.", source,
             Text(found)), remedy=remedy,
        path=source,
    )


def _nearest(source: Path) -> tuple[Path, int] | None:
    """The folder with photos that lies least deep below `source`, and how many it holds."""
    level, looked_at = [source], 0
    for _ in range(_DEEPEST):
        below = []
        for folder in level:
            looked_at += 1
            if looked_at > _MOST_FOLDERS:
                return None
            try:
                below += _visible(folder, folders=True)
                count = sum(path.suffix.lower() in images.SUFFIXES for path in _visible(folder, folders=False))
            except PhotoError:  # somebody else's folder on the way
                continue
            if count:
                return folder, count
        level = below
    return None


def listed(items: list[str], separator: str = ",", most: int = 10) -> str:
    """The first few items, and how many more there are."""
    more = [f"and {len(items) - most} more"] if len(items) > most else []
    return f"{separator} ".join([*items[:most], *more])
