# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which pictures are no photos of the job: thermal ones and single bands beside colour photos, panoramas, maps,
screenshots, copies.

A picture is left out for what it says of itself, or for how it differs from the others; never where all are alike. A
file's name counts only together with what is in the file.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import ExifTags, Image

from ..base.images import shown
from ..base.records import Photo
from .values import number, text
from .xmp import Xmp

THERMAL, BAND, PANORAMA, MAP = "thermal picture", "single band", "panorama", "map"
SCREENSHOT, DRAWING, COPY = "screenshot", "picture without a camera", "copy"
SURPLUS = (THERMAL, BAND, PANORAMA, MAP, SCREENSHOT, DRAWING, COPY)
WIDEST = 2.4  # width over height; cameras and phones stay below
FEWEST = 3  # photos that a picture must differ from
MOST_HAVE = 0.6  # share of the others that have a camera's metadata where its lack counts
PREVIEW = 96  # pixels, longest side, of what pictures are compared by
LARGEST_TILE = 640  # pixels
SMALL = 0.6  # of the usual longest side: below it a picture may be a preview of another
SAME, SAME_EDITED, SAME_PART = 0.985, 0.9, 0.85  # correlations of previews
_GEOTIFF = (33550, 33922, 34264, 34735)  # tags that place a picture on a map
_THERMAL_NAME = re.compile(r"(.+?)[_-](?:t|thrm|thermal|ir)", re.IGNORECASE)
_SCREENSHOT_NAME = re.compile(
    r"(screen[ _-]?shot|bildschirmfoto|capture d.{1,3}cran|截屏|截图|屏幕截图)", re.IGNORECASE
)
_EDITED = re.compile(  # what follows an original's name in that of a copy
    r"[ _.-]*(\(\d{1,3}\)|.{0,20}(edit|copy|kopie|crop|retouch|bearbeitet|small|preview|thumb|web|副本|编辑|修改).{0,20})"  # noqa: E501
)


@dataclass(frozen=True, kw_only=True)
class Hints:
    """What a picture's metadata tell of its kind. `kind` is "" where they tell nothing; `moment` is the same for two
    pictures only if they are of one exposure, None where that is not told."""

    kind: str
    has_camera: bool
    moment: tuple[Any, ...] | None
    software: str


def read_hints(image: Image.Image, main: Mapping[int, Any], exif: Mapping[int, Any], xmp: Xmp) -> Hints:
    """The hints of an image that is open and not yet decoded."""
    source = xmp.drone.get("ImageSource", "").casefold()
    bands = [band for band in xmp.drone.get("BandName", "").casefold().split(",") if band.strip()]
    kind = ""
    if "infrared" in source or "thermal" in source or bands == ["lwir"]:
        kind = THERMAL
    elif len(bands) == 1 and bands[0] not in ("rgb", "d", "visible"):
        kind = BAND
    elif xmp.tags.get("GPano:ProjectionType") or max(image.size) > WIDEST * min(image.size):
        kind = PANORAMA
    elif image.format == "TIFF" and any(tag in main for tag in _GEOTIFF):
        kind = MAP
    elif "screenshot" in _comment(exif).casefold():
        kind = SCREENSHOT
    exposure = [number(exif.get(tag)) for tag in (
        ExifTags.Base.ExposureTime, ExifTags.Base.FNumber, ExifTags.Base.FocalLength,
        ExifTags.Base.FocalLengthIn35mmFilm, ExifTags.Base.DigitalZoomRatio,
    )]
    taken, model = text(exif.get(ExifTags.Base.DateTimeOriginal)), text(main.get(ExifTags.Base.Model))
    told = [taken, text(exif.get(ExifTags.Base.SubsecTimeOriginal)), model, *exposure]
    return Hints(
        kind=kind, software=text(main.get(ExifTags.Base.Software)),
        has_camera=bool(model or exposure[0] or exposure[2] or exposure[3]),
        moment=tuple(told) if taken and model and exposure[0] else None,
    )


def _comment(exif: Mapping[int, Any]) -> str:
    comment = exif.get(ExifTags.Base.UserComment)
    # Eight letters name its character code.
    return text(comment[8:]) if isinstance(comment, bytes | str) and len(comment) > 8 else ""


@dataclass(frozen=True, kw_only=True, eq=False)
class Examined:
    """A picture that can be read: `preview` (h,w) uint8 grey, PREVIEW pixels along its longest side; `body` is
    the same for pictures of one camera and lens, whatever the digital zoom."""

    photo: Photo
    hints: Hints
    xmp_fault: str
    zoom: float
    preview: np.ndarray
    body: tuple[Any, ...]

    @property
    def stem(self) -> str:
        return self.photo.path.stem

    @property
    def aspect(self) -> float:
        """Longest over shortest side."""
        return max(self.photo.width, self.photo.height) / min(self.photo.width, self.photo.height)


def preview_of(rgb: np.ndarray) -> np.ndarray:
    height, width = rgb.shape[:2]
    scale = PREVIEW / max(height, width)
    size = max(1, round(width * scale)), max(1, round(height * scale))
    return cv2.resize(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), size, interpolation=cv2.INTER_AREA)


@dataclass(frozen=True)
class Surplus:
    kind: str
    reason: str


def find_surplus(pictures: Sequence[Examined]) -> dict[Path, Surplus]:
    """The pictures that are no photos of the job, by path, with what they are and why."""
    found: dict[Path, Surplus] = {}
    for rule in (_by_themselves, _beside_colour, _without_camera, _copies):
        left = [picture for picture in pictures if picture.photo.path not in found]
        for picture, kind, why in rule(left):
            found.setdefault(picture.photo.path, Surplus(kind, f"{shown(picture.photo.path)} {why}."))
    return found


Found = Iterator[tuple[Examined, str, str]]


def _by_themselves(pictures: list[Examined]) -> Found:
    sizes = Counter((picture.photo.width, picture.photo.height) for picture in pictures)
    for picture in pictures:
        hints, size = picture.hints, (picture.photo.width, picture.photo.height)
        if hints.kind == PANORAMA or (size[0] == 2 * size[1] and picture.photo.focal_px is None
                                      and sizes[size] < len(pictures) / 2):
            yield picture, PANORAMA, f"is a panorama of {size[0]}x{size[1]} pixels, stitched from several photos"
        elif hints.kind == MAP:
            yield picture, MAP, "is a map (GeoTIFF)"
        elif hints.kind == SCREENSHOT or (_SCREENSHOT_NAME.match(picture.stem) and not hints.has_camera):
            yield picture, SCREENSHOT, "is a screenshot"


def _beside_colour(pictures: list[Examined]) -> Found:
    """Thermal pictures and single bands: they are of another camera, and show the site in other colours."""
    stems = {picture.stem.casefold(): picture for picture in pictures}
    told: list[tuple[Examined, str, str]] = []
    for picture in pictures:
        if picture.hints.kind == THERMAL:
            told.append((picture, THERMAL, "is a thermal picture beside colour photos"))
        elif picture.hints.kind == BAND:
            told.append((picture, BAND, "is a single band of a multispectral camera beside colour photos"))
        elif match := _THERMAL_NAME.fullmatch(picture.stem):
            others = (stems.get(match[1].casefold() + end) for end in ("", "_v", "_w", "_z", "_s", "_rgb", "_wide"))
            partner = next((other for other in others if other is not None), None)
            if partner is not None and partner.photo.camera != picture.photo.camera:
                told.append((picture, THERMAL, f"is a thermal picture beside {shown(partner.photo.path)}"))
    if len(pictures) - len(told) >= FEWEST:
        yield from told


def _without_camera(pictures: list[Examined]) -> Found:
    """Map tiles, drawings, screenshots: no camera's metadata where the others have it, and another shape. Larger ones
    of one size may be frames of a video."""
    with_camera = [picture for picture in pictures if picture.hints.has_camera]
    if len(with_camera) < max(FEWEST, MOST_HAVE * len(pictures)):
        return
    shapes = np.array(sorted({picture.aspect for picture in with_camera}))
    sizes = Counter((picture.photo.width, picture.photo.height) for picture in pictures)
    for picture in pictures:
        photo = picture.photo
        if picture.hints.has_camera or photo.gps or photo.time or photo.gimbal:
            continue
        is_series = sizes[photo.width, photo.height] >= FEWEST and _longest(picture) > LARGEST_TILE
        if np.abs(shapes / picture.aspect - 1).min() > 0.02 and not is_series:
            yield picture, DRAWING, (f"has no camera's metadata and another shape ({photo.width}x{photo.height}) than "
                                     "the photos: a screenshot, a map tile or a drawing")


# ---- copies of another picture


def _copies(pictures: list[Examined]) -> Found:
    usual = float(np.median([_longest(picture) for picture in pictures])) if pictures else 0.0
    moments: dict[Any, list[Examined]] = {}
    for picture in pictures:
        if picture.hints.moment is not None:
            moments.setdefault((picture.hints.moment, picture.photo.gps), []).append(picture)
    stems: dict[str, list[Examined]] = {}
    for picture in pictures:
        stems.setdefault(picture.stem.casefold(), []).append(picture)
    for picture in pictures:
        for other in moments.get((picture.hints.moment, picture.photo.gps), ()):
            if _pixels(other) > _pixels(picture):
                yield picture, COPY, f"is a cropped or scaled copy of {shown(other.photo.path)}"
            elif (_pixels(other) == _pixels(picture) and other.hints.software != picture.hints.software
                  and len(other.stem) < len(picture.stem) and _alike(picture, other) >= SAME_EDITED):
                yield picture, COPY, f"is an edited copy of {shown(other.photo.path)}"
        for other in (other for stem in _stems_before(picture.stem) for other in stems.get(stem, ())):
            if _alike(picture, other) >= SAME_EDITED or _shows_part_of(picture, other):
                yield picture, COPY, f"is an edited copy of {shown(other.photo.path)}"
        if _longest(picture) < SMALL * usual:
            for other in pictures:
                if _longest(other) > _longest(picture) / SMALL and _alike(picture, other) >= SAME:
                    yield picture, COPY, f"is a small copy of {shown(other.photo.path)}"


def _longest(picture: Examined) -> int:
    return max(picture.photo.width, picture.photo.height)


def _pixels(picture: Examined) -> int:
    return picture.photo.width * picture.photo.height


def _stems_before(stem: str) -> list[str]:
    """What the name of a copy says that its original is called: "DJI_1-edited" is of "DJI_1", Apple's "IMG_E1" of
    "IMG_1"."""
    stem = stem.casefold()
    before = [stem[:end] for end in range(1, len(stem)) if not stem[end].isalnum() and _EDITED.fullmatch(stem[end:])]
    return [*before, *([f"img_{apple[1]}"] if (apple := re.fullmatch(r"img_e(\d+)", stem)) else [])]


def _alike(picture: Examined, other: Examined) -> float:
    """Correlation of two pictures of one shape; 0 for others."""
    if abs(picture.photo.width * other.photo.height / (picture.photo.height * other.photo.width) - 1) > 0.03:
        return 0.0
    height, width = other.preview.shape
    return _correlation(cv2.resize(picture.preview, (width, height), interpolation=cv2.INTER_AREA), other.preview)


def _shows_part_of(picture: Examined, other: Examined) -> bool:
    """Whether a picture is cut out of another one."""
    height, width = picture.preview.shape
    for share in np.arange(0.3, 1.0, 0.05):
        scale = share * max(other.preview.shape) / max(height, width)
        size = round(width * scale), round(height * scale)
        if size[0] <= other.preview.shape[1] and size[1] <= other.preview.shape[0]:
            cut = cv2.resize(picture.preview, size, interpolation=cv2.INTER_AREA)
            if float(cv2.matchTemplate(other.preview, cut, cv2.TM_CCOEFF_NORMED).max()) >= SAME_PART:
                return True
    return False


def _correlation(first: np.ndarray, second: np.ndarray) -> float:
    return float(cv2.matchTemplate(first, second, cv2.TM_CCOEFF_NORMED)[0, 0])
