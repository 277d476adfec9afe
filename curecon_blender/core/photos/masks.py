# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks: what of a photo is left out, as pictures beside it, drawn in the workspace, or as the photo's own alpha.

Black is left out. Three conventions are read: COLMAP's (`photo.jpg.png`), OpenDroneMap's (`photo_mask.png`), each
beside the photo or in a folder `masks` below it, and alpha. Several masks of one photo add up.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from ..base import images
from ..base.errors import PhotoError
from ..base.language import Text
from ..base.messages import Reporter
from ..base.records import Photo, SkippedPhoto

FOLDERS = ("mask", "masks")  # whose pictures are masks, whatever they are called
DARK = 128  # of 255: JPEG and smoothed edges leave nothing quite black
SAME_SHAPE = 0.01  # relative difference of the sides' ratio
LEAST = 0.005  # of a photo that must be left, or it is left out as a whole
_GREY = ("1", "L", "LA", "P", "PA", "I;16")
_COLMAP = re.compile(r"(.+)\.png", re.IGNORECASE)
_ODM = re.compile(r"(.+)_mask", re.IGNORECASE)


@dataclass(frozen=True)
class Found:
    """Pictures without the masks among them, the masks of each photo, and masks whose photo is not there."""

    pictures: list[Path]
    masks: dict[Path, list[Path]]
    lone: list[Path]


def sort_out(pictures: list[Path]) -> Found:
    """Tell masks from photos, by their names; one without its photo is a mask if it is grey or there are others."""
    named = {path: _photo_names(path) for path in pictures}
    likely = {path for path, names in named.items() if names}
    photos = {key: path for path in pictures if path not in likely
              for key in (_key(path.parent / path.name), _key(path.parent / path.stem))}
    masks: dict[Path, list[Path]] = {}
    lone = []
    for mask in (path for path in pictures if path in likely):
        photo = next((photos[key] for key in map(_key, named[mask]) if key in photos), None)
        if photo is not None:
            masks.setdefault(photo, []).append(mask)
        else:
            lone.append(mask)
    lone = [path for path in lone if masks or path.parent.name.casefold() in FOLDERS or _is_grey(path)]
    gone = {*lone, *(mask for found in masks.values() for mask in found)}
    return Found([path for path in pictures if path not in gone], masks, lone)


def _photo_names(path: Path) -> list[Path]:
    """The photos, without or with their suffixes, that a picture may be the mask of; none for a photo's name."""
    inside = path.parent.name.casefold() in FOLDERS
    folders = [path.parent.parent, path.parent] if inside else [path.parent]
    names = []
    if (match := _COLMAP.fullmatch(path.name)) and Path(match[1]).suffix.lower() in images.SUFFIXES:
        names.append(match[1])
    if match := _ODM.fullmatch(path.stem):
        names.append(match[1])
    if inside:
        names.append(path.stem)
    return [folder / name for folder in folders for name in names]


def _key(path: Path) -> str:
    return path.as_posix().casefold()


def _is_grey(path: Path) -> bool:
    try:
        with images.open_image(path) as image:
            return image.mode in _GREY
    except PhotoError:
        return False


# ---- what masks leave of a photo


def kept(photo: Photo) -> np.ndarray | None:
    """What masks leave of a photo, (H,W) uint8 of its size, 0 where it is left out; None for one without a mask.
    Raises PhotoError."""
    return _joined(photo, [_read(mask, photo) for mask in photo.masks]) if photo.mask else None


def keeps(left: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Which of places (n,2) in pixels of a photo, centres at .5, lie in what masks leave of it (H,W); (n,) bool."""
    column, row = places.astype(np.int64).T
    height, width = left.shape
    inside: np.ndarray = left[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)] > 0
    return inside


def _joined(photo: Photo, parts: list[np.ndarray]) -> np.ndarray | None:
    """Of masks of one photo and its alpha, what all keep; None where they leave nothing out."""
    if (alpha := images.read_alpha(photo.path)) is not None and alpha.min() == 0:
        parts = [*parts, alpha]
    left = np.full((photo.height, photo.width), 255, np.uint8)
    for part in parts:
        left[part < DARK] = 0
    return None if left.all() else left


def _read(mask: Path, photo: Photo) -> np.ndarray:
    """A mask's file, (H,W) uint8 of its photo's size. Raises PhotoError for another shape."""
    grey = images.read_rgb(mask).max(axis=2)
    turn = images.orientation(photo.path)
    if turn >= 5 and grey.shape == (photo.width, photo.height):  # drawn over the photo as its file has it
        grey = images.upright(grey, turn)
    height, width = grey.shape
    if abs(width * photo.height / (height * photo.width) - 1) > SAME_SHAPE:
        raise PhotoError(
            Text("The mask {} has {}x{} pixels, its photo {}x{}.", images.shown(mask), width, height, photo.width,
                 photo.height),
            remedy="Make it as large as the photo, or take it away.", path=mask)
    size = photo.width, photo.height
    return grey if (width, height) == size else np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_NEAREST))


def applied(
    photos: Iterable[Photo], masks: dict[Path, list[Path]], drawn: Path | None, reporter: Reporter
) -> tuple[list[Photo], list[SkippedPhoto]]:
    """The photos with their masks, those of the folder `drawn` among them, and the photos of which nothing is left.

    A mask that cannot be used is named in a warning, and its photo used whole.
    """
    masked, skipped, count = [], [], 0
    for photo in photos:
        files = masks.get(photo.path, [])
        if drawn is not None and (own := drawn / f"{photo.name}.png").is_file():
            files = [*files, own]
        found = _with_masks(photo, files, reporter)
        if found.masked > 1 - LEAST:
            by = images.shown(found.masks[0]) if found.masks else "its own transparency"
            skipped.append(SkippedPhoto(path=photo.path, reason=f"{images.shown(photo.path)} is left out as a whole "
                                                                f"by {by}, in which black and transparent count."))
            reporter.warning(Text("Left out: {}", Text(skipped[-1].reason)))
        else:
            masked.append(found)
            count += bool(found.mask)
    if count:
        reporter.log(f"{count} photos have masks: what is black in these is left out.")
    return masked, skipped


def _with_masks(photo: Photo, files: list[Path], reporter: Reporter) -> Photo:
    used, parts = [], []
    for file in files:
        try:
            parts.append(_read(file, photo))
            used.append(file)
        except PhotoError as error:
            reporter.warning(Text("{} It is not used: {} is taken whole.", error.message, photo.name), photo.name)
    left = _joined(photo, parts)
    if left is None:
        return photo
    digest = hashlib.sha256(np.packbits(left > 0).tobytes()).hexdigest()
    return replace(photo, masks=tuple(used), mask=digest, masked=round(float((left == 0).mean()), 4))
