# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A film for everybody: an MP4 file in which whatever is not needed to play its pictures is blanked.

Boxes of MP4 (ISO/IEC 14496-12) hold each other. One that is not known to be needed becomes a `free` one of zeros, so
that nothing else moves; times of making and names of programs become zeros too.
"""

from __future__ import annotations

from collections.abc import Iterator

LARGEST = 200_000_000  # bytes: a phone would rather not load more
_NEEDED = {  # in which box which
    b"": (b"ftyp", b"moov", b"mdat"), b"moov": (b"mvhd", b"trak"), b"trak": (b"tkhd", b"edts", b"mdia"),
    b"mdia": (b"mdhd", b"hdlr", b"minf"),
}
_TIMED = (b"mvhd", b"tkhd", b"mdhd")
_KIND_AT, _NAME_AT = 8, 24  # of a handler: what it is for, and its name


def without_metadata(film: bytes) -> bytearray:
    """The film without what tells more than its pictures. Raises ValueError for what is no MP4 of pictures alone."""
    data = bytearray(film)
    kinds = [*_blanked(data, b"", 0, len(data))]
    if not kinds or set(kinds) != {b"vide"}:
        raise ValueError("it is no MP4 of pictures alone")
    return data


def _blanked(data: bytearray, inside: bytes, start: int, end: int) -> Iterator[bytes]:
    """Blank what is not needed among the boxes from byte `start` to `end`; the kinds of tracks that are there."""
    while start < end:
        size, kind, body = int.from_bytes(data[start : start + 4], "big"), bytes(data[start + 4 : start + 8]), start + 8
        if size == 1:
            size, body = int.from_bytes(data[body : body + 8], "big"), start + 16
        elif size == 0 and not inside:
            size = end - start  # to the file's end
        if not body - start <= size <= end - start:
            raise ValueError("it is cut off or damaged")
        if kind not in _NEEDED[inside]:
            data[start + 4 : start + 8] = b"free"
            data[body : start + size] = bytes(start + size - body)
        elif kind in _NEEDED:
            yield from _blanked(data, kind, body, start + size)
        elif kind in _TIMED:
            each = 8 if data[body : body + 1] == b"\1" else 4  # two times, after version and flags
            data[body + 4 : body + 4 + 2 * each] = bytes(2 * each)
        elif kind == b"hdlr":
            yield bytes(data[body + _KIND_AT : body + _KIND_AT + 4])
            data[body + _NAME_AT : start + size] = bytes(max(start + size - body - _NAME_AT, 0))
        start += size
