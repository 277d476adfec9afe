# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Sheets as PNG with the right number of pixels a metre, and as PDF at true size with lines and letters as outlines."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

from ..base.files import atomic_write
from .sheet import Picture, Sheet

POINTS_PER_MM = 72 / 25.4
GRID = 4  # samples a pixel's side, for smooth edges


def write_png(path: Path, sheet: Sheet, pixels_per_mm: int) -> None:
    """Write the sheet as PNG, 1000 times `pixels_per_mm` pixels to the metre (atomically). Raises WorkspaceError."""
    pixels = rasterise(sheet, pixels_per_mm)
    height, width = pixels.shape[:2]
    density = 1000 * pixels_per_mm
    with atomic_write(path) as file:
        file.write(b"\x89PNG\r\n\x1a\n")
        for kind, content in (
            (b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)), (b"sRGB", b"\0"),
            (b"pHYs", struct.pack(">IIB", density, density, 1)), (b"IDAT", _packed(pixels)), (b"IEND", b""),
        ):
            file.write(struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content)))


def write_pdf(path: Path, sheets: list[Sheet], title: str) -> None:
    """Write the sheets as the pages of a PDF, each of its paper's size (atomically). Raises WorkspaceError."""
    objects: list[bytes] = [b"", b""]  # the catalogue and the list of pages come last, when all numbers are known

    def add(content: bytes) -> int:
        objects.append(content)
        return len(objects)

    pages = []
    for sheet in sheets:
        images = [add(_image(picture)) for picture in sheet.pictures]
        content = add(_stream(zlib.compress(_drawing(sheet)), b"/Filter /FlateDecode"))
        names = b" ".join(b"/I%d %d 0 R" % (index, number) for index, number in enumerate(images))
        box = b"%.4f %.4f" % (sheet.width * POINTS_PER_MM, sheet.height * POINTS_PER_MM)
        pages.append(add(
            b"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 %s] /Contents %d 0 R /Resources << /XObject << %s >> >> >>"
            % (box, content, names)
        ))
    kids = b" ".join(b"%d 0 R" % page for page in pages)
    objects[0] = b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>"
    objects[1] = b"<< /Type /Pages /Kids [%s] /Count %d >>" % (kids, len(pages))
    named = b"\xfe\xff" + title.encode("utf-16-be")
    information = add(b"<< /Title <%s> /Producer (CU-Recon) >>" % named.hex().encode())
    with atomic_write(path) as file:
        file.write(b"%PDF-1.5\n%\xe2\xe3\xcf\xd3\n")
        places = []
        for number, entry in enumerate(objects, start=1):
            places.append(file.tell())
            file.write(b"%d 0 obj\n%s\nendobj\n" % (number, entry))
        start = file.tell()
        file.write(b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1))
        file.writelines(b"%010d 00000 n \n" % place for place in places)
        file.write(b"trailer\n<< /Size %d /Root 1 0 R /Info %d 0 R >>\nstartxref\n%d\n%%%%EOF\n"
                   % (len(objects) + 1, information, start))


def rasterise(sheet: Sheet, pixels_per_mm: float) -> np.ndarray:
    """The sheet as (H,W,3) sRGB bytes, top row first."""
    width, height = round(sheet.width * pixels_per_mm), round(sheet.height * pixels_per_mm)
    canvas = np.full((height, width, 3), 255, np.uint8)
    for picture in sheet.pictures:
        left, top = round(picture.x * pixels_per_mm), height - round((picture.y + picture.height) * pixels_per_mm)
        across, down = round(picture.width * pixels_per_mm), round(picture.height * pixels_per_mm)
        canvas[top : top + down, left : left + across] = _scaled(picture.pixels, across, down)
    for fill in sheet.fills:
        triangles = fill.triangles * [pixels_per_mm, -pixels_per_mm] + [0, height]
        (left, top), (right, bottom) = np.floor(triangles.min((0, 1))), np.ceil(triangles.max((0, 1)))
        part = canvas[int(top) : int(bottom), int(left) : int(right)]
        cover = _coverage(triangles - [left, top], part.shape[1], part.shape[0])[..., None]
        part[...] = np.rint(part * (1 - cover) + 255 * np.array(fill.colour) * cover)
    return canvas


def _coverage(triangles: np.ndarray, width: int, height: int) -> np.ndarray:
    """How much (H,W) of each pixel triangles (N,3,2) in pixels cover."""
    hits = np.zeros((height * GRID, width * GRID), bool)
    for corners in triangles * GRID:
        left, top = np.floor(corners.min(axis=0)).astype(int)
        right, bottom = np.ceil(corners.max(axis=0)).astype(int)
        x, y = np.arange(left, right) + 0.5, np.arange(top, bottom)[:, None] + 0.5
        sides = []
        for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            sides.append((x1 - x0) * (y - y0) - (y1 - y0) * (x - x0))
        signs = np.stack(np.broadcast_arrays(*sides))
        inside = np.all(signs >= 0, axis=0) | np.all(signs <= 0, axis=0)
        hits[top:bottom, left:right] |= inside[: hits.shape[0] - top, : hits.shape[1] - left]
    blocks: np.ndarray = hits.reshape(height, GRID, width, GRID).mean(axis=(1, 3))
    return blocks


def _scaled(pixels: np.ndarray, width: int, height: int) -> np.ndarray:
    """The picture at another size; means of what falls into a pixel where it shrinks."""
    if pixels.shape[:2] == (height, width):
        return pixels
    result = pixels.astype(np.float32)
    for axis, count in ((0, height), (1, width)):
        edges = np.linspace(0, result.shape[axis], count + 1)
        low = edges[:-1].astype(int)
        high = np.maximum(np.ceil(edges[1:]).astype(int), low + 1)
        total = np.concatenate([np.zeros_like(result.take([0], axis)), result.cumsum(axis, dtype=np.float64)], axis)
        shape = [1] * 3
        shape[axis] = count
        result = (total.take(high, axis) - total.take(low, axis)) / (high - low).reshape(shape)
    return np.rint(result).astype(np.uint8)


def _packed(pixels: np.ndarray) -> bytes:
    """Pixels (H,W,3) as PNG has them, and PDF, too: each row as its difference from the one above, compressed."""
    height, width = pixels.shape[:2]
    rows = np.full((height, 1 + 3 * width), 2, np.uint8)  # 2 is the filter's name
    flat = pixels.reshape(height, -1)
    rows[0, 1:] = flat[0]
    np.subtract(flat[1:], flat[:-1], out=rows[1:, 1:])
    return zlib.compress(rows.tobytes(), 6)


def _image(picture: Picture) -> bytes:
    height, width = picture.pixels.shape[:2]
    return _stream(
        _packed(picture.pixels),
        b"/Type /XObject /Subtype /Image /Width %d /Height %d /ColorSpace /DeviceRGB /BitsPerComponent 8 "
        b"/Filter /FlateDecode /DecodeParms << /Predictor 15 /Colors 3 /Columns %d >>" % (width, height, width),
    )


def _stream(content: bytes, entries: bytes) -> bytes:
    return b"<< %s /Length %d >>\nstream\n%s\nendstream" % (entries, len(content), content)


def _drawing(sheet: Sheet) -> bytes:
    """The page's content: pictures first, then fills, each as one path so that no seams show between triangles."""
    lines = [b"%.6f 0 0 %.6f 0 0 cm" % (POINTS_PER_MM, POINTS_PER_MM)]
    for index, picture in enumerate(sheet.pictures):
        lines.append(b"q %.4f 0 0 %.4f %.4f %.4f cm /I%d Do Q"
                     % (picture.width, picture.height, picture.x, picture.y, index))
    for fill in sheet.fills:
        lines.append(b"%.3f %.3f %.3f rg" % fill.colour)
        lines += [b"%.4f %.4f m %.4f %.4f l %.4f %.4f l h" % tuple(corners.ravel()) for corners in fill.triangles]
        lines.append(b"f")
    return b"\n".join(lines)
