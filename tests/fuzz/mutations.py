# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Hypothesis strategies that spoil sound files: any bytes, the words of a text header, the values of JSON."""

from __future__ import annotations

import copy
import io
import json
import re
import struct
import zipfile
from collections.abc import Iterator
from typing import Any

from hypothesis import strategies as st

NUMBERS = (0, 1, 2, 3, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 1 << 40, (1 << 63) - 1,
           1 << 63, (1 << 64) - 1)
WORDS = ("0", "-1", "1e999", "nan", "inf", "9" * 30, "9" * 5000, "", "x", "vertex", "face", "property", "element",
         "list", "int", "double", "uchar", "end_header", "../../x", "/etc/passwd", "\u00b2", "\0", "4294967296")
VALUES: tuple[Any, ...] = (
    None, True, False, -1, 0, 1, 1e308, -1e308, 1e-320, 10**30, float("nan"), float("inf"), "", " ", "x", "../../x",
    "..", ".", "/etc/passwd", "C:\\x", "\\\\host\\share\\x", "a\0b", "a\nb", "\ud800", "x" * 100_000, [], {}, [[]],
    [0] * 1000, {"format": 1}, "0001-01-01T00:00:00", "9999-12-31T23:59:59-23:59",
)


@st.composite
def spoiled_bytes(draw: st.DrawFn, seed: bytes) -> bytes:
    """The seed with one to six places cut, moved, or set to odd values."""
    data = bytearray(seed)
    for _ in range(draw(st.integers(1, 6))):
        place = draw(st.integers(0, len(data)))
        kind = draw(st.integers(0, 5))
        if kind == 0:
            del data[place:]
        elif kind == 1:
            size = draw(st.sampled_from((1, 2, 4, 8)))
            value = draw(st.sampled_from(NUMBERS)) % (1 << (8 * size))
            data[place : place + size] = value.to_bytes(size, draw(st.sampled_from(("little", "big"))))
        elif kind == 2:
            data[place : place + 1] = bytes([draw(st.integers(0, 255))])
        elif kind == 3:
            data[place:place] = draw(st.binary(max_size=16))
        elif kind == 4:
            del data[place : place + draw(st.integers(1, 64))]
        else:
            number = draw(st.sampled_from((float("nan"), float("inf"), -1.0, 1e308)))
            data[place : place + 8] = struct.pack("<d", number)
    return bytes(data)


@st.composite
def spoiled_words(draw: st.DrawFn, seed: bytes, *, header: int | None = None) -> bytes:
    """The seed with words of its text (its first `header` bytes) replaced, repeated or taken out."""
    text, rest = seed[:header], seed[header:] if header is not None else b""
    words = re.split(rb"([ \n]+)", text)
    for _ in range(draw(st.integers(1, 3))):
        place = draw(st.integers(0, len(words) - 1))
        kind = draw(st.integers(0, 3))
        if kind <= 1:
            words[place] = draw(st.sampled_from(WORDS)).encode()
        elif kind == 2:
            words[place:place] = words[place : place + draw(st.integers(1, 8))] * draw(st.sampled_from((1, 2, 2000)))
        else:
            del words[place : place + draw(st.integers(1, 8))]
        words = words or [b""]
    return b"".join(words) + rest


@st.composite
def spoiled_json(draw: st.DrawFn, seed: Any) -> bytes:
    """The seed's JSON with one to three values replaced, removed, repeated, nested deeply or added."""
    value = [copy.deepcopy(seed)]
    for _ in range(draw(st.integers(1, 3))):
        holder, key = draw(st.sampled_from(list(_places(value))))
        kind = draw(st.integers(0, 9))
        if kind <= 5:
            holder[key] = copy.deepcopy(draw(st.sampled_from(VALUES)))
        elif kind == 6:
            holder[key] = draw(st.one_of(st.integers(), st.floats(), st.text(max_size=8), st.booleans()))
        elif kind == 7 and holder is not value:
            del holder[key]
        elif kind == 8 and isinstance(holder, list):
            holder.append(copy.deepcopy(holder[key]))
        elif isinstance(holder, dict):
            holder[draw(st.text(max_size=5))] = 1
    text = json.dumps(value[0] if value else None)
    if draw(st.integers(0, 19)) == 0:
        depth = draw(st.sampled_from((100, 5000, 300_000)))
        text = draw(st.sampled_from(("[" * depth, "[" * depth + "]" * depth, '{"a":' * depth, text[:-1] + ',"z":'
                                     + "[" * depth + "]" * depth + "}", "1" * depth)))
    encoded = text.encode("utf-8", "surrogatepass")
    return draw(spoiled_bytes(encoded)) if draw(st.integers(0, 9)) == 0 else encoded


def _places(value: Any) -> Iterator[tuple[Any, Any]]:
    for key in range(len(value)) if isinstance(value, list) else list(value):
        yield value, key
        if isinstance(value[key], list | dict):
            yield from _places(value[key])


@st.composite
def archives(draw: st.DrawFn, seed: dict[str, tuple[str, tuple[int, ...], bytes]]) -> bytes:
    """An .npz whose members (name: type, shape, bytes) promise other types, shapes, orders or sizes than they hold."""
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", draw(st.sampled_from((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)))) as archive:
        for name, (kind, shape, content) in seed.items():
            spoil = draw(st.integers(0, 7))
            if spoil == 0:
                kind = draw(st.sampled_from(("|O", "<f8", "<U99999999", "|V1000000000", "<M8[s]", "x", "<c16", "|u1")))
            elif spoil == 1:
                shape = tuple(draw(st.lists(st.sampled_from((-1, 0, 1, 3, 1 << 31, 1 << 62)), max_size=4)))
            elif spoil == 2:
                content = draw(st.sampled_from((b"", content[: len(content) // 2], bytes(3_000_000), content * 3)))
            elif spoil == 3:
                name = draw(st.sampled_from(("../../x", name + "2", "/x", "")))
            header = repr({"descr": kind, "fortran_order": draw(st.booleans()), "shape": shape})
            if spoil == 4:
                header = draw(st.sampled_from(("", "[" * 1000, header * 100, "{'descr': ().__class__}", "x" * 70_000)))
            packed = header.encode() + b"\n"
            version, size = draw(st.sampled_from(((1, "<H"), (1, "<H"), (2, "<I"), (3, "<I"), (9, "<I"))))
            length = len(packed) if size == "<I" else min(len(packed), 65535)
            archive.writestr(f"{name}.npy", b"\x93NUMPY" + bytes([version, 0]) + struct.pack(size, length) + packed
                             + content)
    whole = made.getvalue()
    return draw(spoiled_bytes(whole)) if draw(st.booleans()) else whole


@st.composite
def exif_blocks(draw: st.DrawFn, tags: tuple[int, ...]) -> bytes:
    """A TIFF structure of a few directories with odd types, counts, offsets and values, directories in a circle too."""
    order = draw(st.sampled_from("<>"))
    block = bytearray((b"II" if order == "<" else b"MM") + struct.pack(order + "HI", 42, 8))
    for _ in range(draw(st.integers(1, 3))):
        entries = draw(st.lists(st.tuples(
            st.sampled_from(tags), st.one_of(st.integers(0, 13), st.integers(0, 65535)),
            st.one_of(st.integers(0, 20), st.sampled_from(NUMBERS[:12])),
            st.one_of(st.integers(0, 400), st.sampled_from(NUMBERS[:12])),
        ), max_size=12))
        block += struct.pack(order + "H", len(entries))
        for tag, kind, count, value in entries:
            block += struct.pack(order + "HHII", tag, kind, count % (1 << 32), value % (1 << 32))
        block += struct.pack(order + "I", draw(st.sampled_from((0, 8, len(block) + 4))))
    return bytes(block) + draw(st.binary(max_size=200))
