# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The one path by which pictures are read and written: any JPEG, PNG, TIFF, HEIC or raw in, upright 8-bit sRGB out."""

from __future__ import annotations

import io
import os
import re
import struct
import warnings
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pillow_heif
from PIL import Image, ImageCms, UnidentifiedImageError

from . import raw
from .errors import PhotoError, ran_out_of_memory
from .files import atomic_write
from .language import Text

HEIC_SUFFIXES = (".heic", ".heif", ".hif")
SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", *HEIC_SUFFIXES, *raw.SUFFIXES)
MAX_PIXELS = 500_000_000  # four times the largest drone and phone cameras; above it a header is more likely damaged
# A file of a few kilobytes can unpack to gigabytes. No photo is packed that tightly: a black one has 100 pixels a byte.
BOMB_PIXELS, BOMB_PIXELS_PER_BYTE = 50_000_000, 250
MOST_SCANS = 200  # of a progressive JPEG; cameras write ten, and each costs as much as a decoding of the whole
DECODING_BYTES = 12  # of memory for each pixel of a picture while it is read, measured at 100 megapixels
DECODING_MEMORY = 6 << 30  # bytes for all that are read at the same time

# Pillow refuses pictures above 179 megapixels, as decompression bombs; MAX_PIXELS takes its place.
Image.MAX_IMAGE_PIXELS = None
pillow_heif.register_heif_opener(thumbnails=False)
# Pillow remarks on every odd tag on stderr; what matters of it comes back as an error or as a missing value.
warnings.filterwarnings("ignore", module=r"PIL\.")

_ORIENTATION = 0x0112
_MARKER = re.compile(rb"\xff[\x01-\xcf\xd8-\xfe]")  # of a JPEG, but for those in the midst of a scan's data
_SCAN, _END = 0xDA, 0xD9
_TRANSPOSITIONS = {
    2: Image.Transpose.FLIP_LEFT_RIGHT, 3: Image.Transpose.ROTATE_180, 4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE, 6: Image.Transpose.ROTATE_270, 7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_90,
}
# What Pillow's decoders and tag readers raise on damaged files.
NO_MEMORY_FOR = "There is not enough memory to read"
_DAMAGE = (
    OSError, SyntaxError, ValueError, TypeError, KeyError, IndexError, EOFError, ArithmeticError, RuntimeError,
    struct.error, zlib.error,
)


def read_rgb(path: Path, max_size: int | None = None) -> np.ndarray:
    """The picture as (H,W,3) uint8 sRGB, EXIF orientation applied, alpha dropped.

    With `max_size` (pixels) it is area-averaged down so that its longest side is at most that: see `scaled_size`.
    Raises PhotoError naming the file when it is missing, truncated, not a picture, or above MAX_PIXELS.
    """
    with open_image(path) as image:
        return decode(image, path, max_size)


def readers(pixels: int, most: int) -> int:
    """How many threads may each read a picture of so many pixels at the same time, at most `most`."""
    return max(1, min(most, DECODING_MEMORY // (DECODING_BYTES * max(pixels, 1))))


@contextmanager
def open_image(path: Path) -> Iterator[Image.Image]:
    """Open a JPEG, PNG, TIFF or HEIC, whatever its suffix says, or a raw photo by its suffix, without decoding it.
    Raises PhotoError as `read_rgb` does."""
    with ExitStack() as stack:
        with _photo_errors(path):
            # Opened by Python, not by OpenCV, which cannot open every name on Windows.
            file = stack.enter_context(open(path, "rb"))
            if path.suffix.lower() in raw.SUFFIXES:
                image: Image.Image = raw.open_raw(file, path, shown(path))
            else:
                image = Image.open(file, formats=("JPEG", "PNG", "TIFF", "HEIF"))
            size, pixels = os.fstat(file.fileno()).st_size, image.width * image.height
        if pixels > MAX_PIXELS:
            raise PhotoError(
                Text("{} has {:.0f} megapixels: at most {:.0f} can be read.", shown(path), pixels / 1e6,
                     MAX_PIXELS / 1e6),
                remedy="Scale it down, or cut it into single photos.", path=path,
            )
        if pixels > BOMB_PIXELS and pixels > BOMB_PIXELS_PER_BYTE * size:
            raise PhotoError(
                Text("{} unpacks to {:.0f} megapixels from {:.0f} kB, as no photo does.", shown(path), pixels / 1e6,
                     size / 1e3),
                remedy="Leave it out: it may have been made to stop programs that open it.", path=path,
            )
        yield image


def decode(image: Image.Image, path: Path, max_size: int | None = None) -> np.ndarray:
    """`read_rgb` for an image open in `open_image`. Decodes all of the file, so that damage anywhere is found."""
    size = scaled_size(*oriented_size(image), max_size)
    with _photo_errors(path):
        if (scans := _scans(image, path)) > MOST_SCANS:
            raise PhotoError(
                Text("{} is drawn over {} times as it is decoded, as no photo is.", shown(path), scans),
                remedy="Leave it out: it may have been made to stop programs that open it.", path=path,
            )
        _draft(image, max_size)
        image.load()
        profile = image.info.get("icc_profile")
        # Pillow turns a TIFF upright as it loads it.
        turn = None if image.format == "TIFF" else _TRANSPOSITIONS.get(_orientation(image))
        rgb = _to_rgb(image if turn is None else image.transpose(turn), profile)
    return rgb if size == (rgb.shape[1], rgb.shape[0]) else cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)


def read_alpha(path: Path) -> np.ndarray | None:
    """How opaque a picture is, (H,W) uint8, upright; None for one that cannot be transparent. Raises PhotoError."""
    with open_image(path) as image:
        if "A" not in image.getbands() and "transparency" not in image.info:
            return None
        with _photo_errors(path):
            alpha = np.array(image.convert("RGBA").getchannel("A"))
        return alpha if image.format == "TIFF" else upright(alpha, _orientation(image))


def upright(picture: np.ndarray, orientation: int) -> np.ndarray:
    """A picture (H,W) uint8 turned as EXIF's orientation has it."""
    turn = _TRANSPOSITIONS.get(orientation)
    return picture if turn is None else np.array(Image.fromarray(picture).transpose(turn))


def scaled_size(width: int, height: int, max_size: int | None) -> tuple[int, int]:
    """(width, height) in pixels after scaling down so that the longest side is at most `max_size`; never up."""
    longest = max(width, height)
    if max_size is None or longest <= max_size:
        return width, height
    return max(1, round(width * max_size / longest)), max(1, round(height * max_size / longest))


def oriented_size(image: Image.Image) -> tuple[int, int]:
    """(width, height) in pixels after the EXIF orientation, of an image that is open and not yet decoded."""
    if image.format != "TIFF" and _orientation(image) >= 5:
        return image.height, image.width
    return image.width, image.height


def exif_tags(image: Image.Image, ifd: int | None = None) -> dict[int, Any]:
    """The image's EXIF tags (of its main directory, or of `ifd`); a tag that cannot be read is left out."""
    try:
        exif = image.getexif()
        directory = exif if ifd is None else exif.get_ifd(ifd)
        keys = list(directory)
    except _DAMAGE:
        return {}
    tags = {}
    for key in keys:
        try:
            tags[key] = directory[key]
        except _DAMAGE:
            continue
    return tags


def write_jpeg(path: Path, rgb: np.ndarray, quality: int = 95) -> None:
    """Write (H,W,3) uint8 sRGB as a JPEG, atomically. Raises WorkspaceError when the disk is full or read-only."""
    # Encoded in memory first: Pillow's own error on a full disk does not tell that the disk is full.
    encoded = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(rgb)).save(encoded, "JPEG", quality=quality)
    with atomic_write(path) as file:
        file.write(encoded.getbuffer())


def encode_png(picture: np.ndarray) -> bytes:
    """A picture (H,W) uint8 as a PNG's content."""
    encoded = io.BytesIO()
    Image.fromarray(picture).save(encoded, "PNG")
    return encoded.getvalue()


def is_text(path: Path) -> bool:
    """Whether a path can be written down: Linux allows names of any bytes."""
    return not any("\ud800" <= letter <= "\udfff" for letter in str(path))


def shown(path: Path) -> str:
    """A file's name as it can stand in a one-line message."""
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in path.name)


@contextmanager
def _photo_errors(path: Path) -> Iterator[None]:
    """Turn what reading a picture can raise into an error for people."""
    try:
        yield
    except FileNotFoundError as error:
        raise PhotoError(
            Text("{} does not exist.", shown(path)),
            remedy="Put the photo back where it was, or check the photos again.",
            path=path,
        ) from error
    except PermissionError as error:
        raise PhotoError(
            Text("No permission to read {}.", shown(path)),
            remedy="Change the file's permissions, or leave it out.", path=path
        ) from error
    except UnidentifiedImageError as error:
        raise PhotoError(
            Text("{} is not a JPEG, PNG, TIFF or HEIC picture.", shown(path)),
            remedy="Leave it out, or export it again as JPEG.", path=path,
        ) from error
    except (MemoryError, *_DAMAGE) as error:
        if ran_out_of_memory(error):  # decoders tell it as damage, too
            raise PhotoError(
                Text("{} {}.", Text(NO_MEMORY_FOR), shown(path)),
                remedy="Close other programs, or scale it down.", path=path
            ) from error
        raise PhotoError(
            Text("{} is damaged or cut short ({}).", shown(path), Text(str(error))),
            remedy="Copy it from the camera again, or leave it out.", path=path,
        ) from error


def _scans(image: Image.Image, path: Path) -> int:
    """How many times a decoder must go over a JPEG, up to its end: phones put a video behind it."""
    if image.format not in ("JPEG", "MPO"):
        return 1
    content, place, scans = path.read_bytes(), 2, 0
    while (marker := _MARKER.search(content, place)) is not None and content[marker.end() - 1] != _END:
        place = marker.end() + int.from_bytes(content[marker.end() : marker.end() + 2], "big")
        scans += content[marker.end() - 1] == _SCAN
    return scans


def orientation(path: Path) -> int:
    """EXIF's orientation of a picture's file, 1 to 8, by which it is turned as it is read. Raises PhotoError."""
    with open_image(path) as image:
        return _orientation(image)


def _orientation(image: Image.Image) -> int:
    value = exif_tags(image).get(_ORIENTATION, 1)
    return value if isinstance(value, int) and 1 <= value <= 8 else 1


def _draft(image: Image.Image, max_size: int | None) -> None:
    """Let libjpeg average 2, 4 or 8 pixels as it decodes: several times faster. Only where that divides evenly, and
    what is left is scaled by nothing or by 2 and more: averaging twice by little would soften the picture. A raw photo
    is developed at half its size on the same terms."""
    if isinstance(image, raw.RawImage) and max_size is not None and max(image.size) >= 4 * max_size:
        image.halve()
    if max_size is None or image.format not in ("JPEG", "MPO"):
        return
    width, height = image.size
    for step in (8, 4, 2):
        longest = max(width, height) // step
        if width % step == 0 and height % step == 0 and (longest == max_size or longest >= 2 * max_size):
            image.draft(None, (width // step, height // step))
            return


def _to_rgb(image: Image.Image, profile: bytes | None) -> np.ndarray:
    if image.mode.startswith("I;16") or image.mode == "I":
        grey = np.asarray(image)
        if grey.min() < 0 or grey.max() > 65535:
            raise ValueError("its values go beyond 16 bits")
        return cv2.cvtColor(cv2.convertScaleAbs(grey.astype(np.uint16), alpha=1 / 257), cv2.COLOR_GRAY2RGB)
    if image.mode == "F":
        raise ValueError("it holds measurements in floating point, not a photo")
    if profile and image.mode in ("RGB", "CMYK"):
        image = _to_srgb(image, profile)
    return np.array(image if image.mode == "RGB" else image.convert("RGB"))


def _to_srgb(image: Image.Image, profile: bytes) -> Image.Image:
    """Convert from the embedded colour profile (Display P3, Adobe RGB, a press's CMYK...) to sRGB."""
    try:
        source = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        if "sRGB" in ImageCms.getProfileDescription(source):
            return image
        converted = ImageCms.profileToProfile(image, source, ImageCms.createProfile("sRGB"), outputMode="RGB")
    except (ImageCms.PyCMSError, OSError):  # a damaged profile says nothing of the colours: read them as they stand
        return image
    assert converted is not None  # it is None only for in-place conversion
    return converted
