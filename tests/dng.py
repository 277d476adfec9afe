# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Raw photos made for the tests: small DNG files, as a camera's mosaic or as demosaiced linear light."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np

# Of sRGB's primaries, D65: what a camera of just these would have (XYZ to camera).
MATRIX = (3.2406, -1.5372, -0.4986, -0.9689, 1.8758, 0.0415, 0.0557, -0.2040, 1.0570)
_FORMATS = {1: "B", 2: "s", 3: "H", 4: "I", 5: "II", 10: "ii"}


def write_dng(
    path: Path, picture: np.ndarray, *, bits: int = 16, linear: bool = False, orientation: int = 1,
    model: str = "FC9999", camera: dict[int, tuple[int, Any]] | None = None,
    gps: dict[int, tuple[int, Any]] | None = None, keep: float = 1.0,
) -> Path:
    """Write a picture (H,W,3) uint8 sRGB as a camera sees it, without noise; only the first `keep` of the file."""
    light = np.where(picture <= 10, picture / 3294.6, ((picture / 255 + 0.055) / 1.055) ** 2.4)
    values = np.rint(light * (2**bits - 1)).astype("<u2")
    height, width = values.shape[:2]
    if not linear:  # RGGB
        mosaic = values[..., 1].copy()
        mosaic[::2, ::2], mosaic[1::2, 1::2] = values[::2, ::2, 0], values[1::2, 1::2, 2]
        values = mosaic
    planes = 3 if linear else 1
    rational = [(round(v * 10000), 10000) for v in MATRIX]
    tags: dict[int, tuple[int, Any]] = {
        254: (4, [0]), 256: (4, [width]), 257: (4, [height]), 258: (3, [16] * planes), 259: (3, [1]),
        262: (3, [34892 if linear else 32803]), 271: (2, "DJI"), 272: (2, model), 273: (4, [0]),
        274: (3, [orientation]),
        277: (3, [planes]), 278: (4, [height]), 279: (4, [values.nbytes]), 284: (3, [1]),
        50706: (1, [1, 4, 0, 0]), 50707: (1, [1, 1, 0, 0]), 50708: (2, f"DJI {model}"),
        50717: (4, [2**bits - 1] * planes), 50721: (10, rational), 50728: (5, [(1, 1)] * 3), 50778: (3, [21]),
    }
    if not linear:
        tags |= {33421: (3, [2, 2]), 33422: (1, [0, 1, 1, 2])}
    for pointer, directory in ((34665, camera), (34853, gps)):
        if directory:
            tags[pointer] = (4, [0])
    head = bytearray(struct.pack("<2sHI", b"II", 42, 8))
    places = _directory(head, tags)
    for pointer, directory in ((34665, camera), (34853, gps)):
        if directory:
            struct.pack_into("<I", head, places[pointer], len(head))
            _directory(head, directory)
    struct.pack_into("<I", head, places[273], len(head))
    content = bytes(head) + values.tobytes()
    path.write_bytes(content[: int(keep * len(content))])
    return path


def _directory(head: bytearray, tags: dict[int, tuple[int, Any]]) -> dict[int, int]:
    """Append a directory of TIFF with its values; returns where each tag's value stands."""
    start, places = len(head), {}
    table = bytearray(2 + 12 * len(tags) + 4)
    struct.pack_into("<H", table, 0, len(tags))
    rest = bytearray()
    for row, (tag, (kind, value)) in enumerate(sorted(tags.items())):
        if kind == 2:
            packed, count = value.encode() + b"\0", len(value) + 1
        else:
            flat = [number for item in value for number in (item if isinstance(item, tuple) else (item,))]
            packed, count = struct.pack(f"<{len(flat)}{_FORMATS[kind][0]}", *flat), len(value)
        at = 2 + 12 * row
        struct.pack_into("<HHI", table, at, tag, kind, count)
        if len(packed) <= 4:
            table[at + 8 : at + 8 + len(packed)] = packed
            places[tag] = start + at + 8
        else:
            places[tag] = start + len(table) + len(rest)
            struct.pack_into("<I", table, at + 8, places[tag])
            rest += packed + bytes(len(packed) % 2)
    head += table + rest
    return places
