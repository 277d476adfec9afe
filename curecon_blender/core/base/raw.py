# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Raw photos (DNG and what cameras write in its place) as Pillow's pictures, developed by LibRaw.

All photos are developed alike: the camera's white balance and colour matrix, sRGB, no brightening of each by itself, so
that neighbours match. Orientation stays a tag, as in other pictures.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np
import rawpy
from PIL import ExifTags, Image, ImageFile

from .errors import PhotoError
from .language import Text

SUFFIXES = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2", ".pef", ".srw")
_TURNS = {0: 1, 3: 3, 5: 8, 6: 6}  # LibRaw's flips as EXIF's orientation
_PACKET = 700  # the tag of TIFF that holds XMP
_REMEDY = "Export it as JPEG with its maker's program, or leave it out."


class RawImage(ImageFile.ImageFile):
    """A raw photo that is open and not yet developed; `halve` makes that four times faster."""

    format = "RAW"

    def _open(self) -> None:
        assert self.fp is not None
        self._raw, self._half = rawpy.imread(cast(BinaryIO, self.fp)), False
        self._size, self._mode = (self._raw.sizes.width, self._raw.sizes.height), "RGB"
        self._tags = self._read_tags()
        self._tags[ExifTags.Base.Orientation] = _TURNS.get(self._raw.sizes.flip, 1)
        if isinstance(packet := self._tags.get(_PACKET), bytes | str):
            self.info["xmp"] = packet

    def _read_tags(self) -> Image.Exif:
        """Those of the file, where it is a TIFF inside, or else of the JPEG that the camera put into it."""
        assert self.fp is not None
        tags = Image.Exif()
        try:
            self.fp.seek(0)
            tags.load_from_fp(self.fp)
        except (OSError, SyntaxError, ValueError):
            tags = Image.Exif()  # no TIFF inside, or a damaged one
        if ExifTags.Base.Make in tags:
            return tags
        try:
            thumbnail = self._raw.extract_thumb()
            if thumbnail.format != rawpy.ThumbFormat.JPEG:
                return tags
            return Image.open(io.BytesIO(bytes(thumbnail.data))).getexif()
        except (rawpy.LibRawError, OSError):
            return tags  # no thumbnail, or none that can be read: a photo without tags is used as any other

    def getexif(self) -> Image.Exif:
        return self._tags

    def halve(self) -> None:
        self._half = True

    def load(self) -> Any:
        if self._im is None:
            try:
                developed = self._raw.postprocess(
                    use_camera_wb=True, no_auto_bright=True, output_bps=8, output_color=rawpy.ColorSpace.sRGB,
                    gamma=(2.4, 12.92), user_flip=0, half_size=self._half)
            except rawpy.LibRawError as error:
                raise OSError(_words(error)) from error
            self._raw.close()
            self._size = developed.shape[1], developed.shape[0]
            self.im = Image.fromarray(np.ascontiguousarray(developed)).im
        return Image.Image.load(self)


def open_raw(file: BinaryIO, path: Path, name: str) -> RawImage:
    """Open a raw photo by its file; `name` is what it is called in messages. Raises PhotoError for a camera that LibRaw
    does not know, and OSError for damage."""
    try:
        return RawImage(file, str(path))
    except (rawpy.LibRawFileUnsupportedError, rawpy.LibRawNotImplementedError) as error:
        raise PhotoError(Text("{} is no raw photo, or of a camera that is not known here.", name), remedy=_REMEDY,
                         path=path) from error
    except rawpy.LibRawError as error:
        raise OSError(_words(error)) from error


def _words(error: Exception) -> str:
    """LibRaw's own words, which come as bytes."""
    said = error.args[0] if error.args else ""
    return said.decode(errors="replace") if isinstance(said, bytes) else str(said)
