# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Charts packed on pages by their shapes: what photos see is ragged, and fills four tenths of its bounding boxes.

Each chart is the texels that it touches, grown by its gutter, as runs in rows. The largest first, each goes to the
lowest place where none of its texels is taken, turned by the quarters that lie lowest, so that small ones fill the bays
and holes of large ones. Texels move by whole numbers and turn by quarters: they stay as a photo has them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

_ALIKE = 4  # texels: boxes whose sides differ by less find place from about the same row on
_TURNS = 4  # quarters that a chart may be turned by
_compiled: Any = njit(nogil=True, error_model="numpy")


@dataclass(frozen=True)
class Shape:
    """A chart's texels: `low` (2,) the whole numbers to subtract from its corners, so that it lies with its gutter in a
    box from 0 on; `size` (2,) of that box, width and height; `runs`, for each turn (n,3) int32 rows, first texels and
    lengths, the longest first; `texels`, how many they are."""

    low: np.ndarray
    size: tuple[int, int]
    runs: tuple[np.ndarray, ...]
    texels: int


def shape(corners: np.ndarray, gutter: int) -> Shape:
    """Of a chart's triangles (n,3,2) in texels."""
    low = np.floor(corners.min(axis=(0, 1))).astype(np.int64) - gutter
    width, height = (np.floor(corners.max(axis=(0, 1))).astype(np.int64) + gutter + 1 - low).tolist()
    mask = np.zeros((height, width), np.uint8)
    _touch(np.ascontiguousarray(corners - low, np.float64), mask)
    mask = _grown(mask, gutter)
    runs = [_runs(np.ascontiguousarray(np.rot90(mask, turn))) for turn in range(_TURNS)]
    longest = tuple(run[np.argsort(-run[:, 2], kind="stable")] for run in runs)
    return Shape(low, (width, height), longest, int(mask.sum()))


class Pages:
    """So many square pages of `side` texels, one below the other, filled from the top."""

    def __init__(self, side: int, pages: int) -> None:
        self._side = side
        self._taken = np.zeros((side * pages, -(-side // 64)), np.uint64)
        self._free = np.full(side * pages, side, np.int32)  # the longest free run of each row
        beyond = self._taken.shape[1] * 64 - side
        _stamp(self._taken, self._free, np.array([[row, side, beyond] for row in range(side * pages)]), 0, 0)

    def place(self, shapes: Sequence[Shape]) -> tuple[np.ndarray, np.ndarray] | None:
        """The places (n,3) int64 (column, row, page) of the low corners of the shapes' turned boxes, and their turns
        (n,) int64; None when they do not fit."""
        places, turns = np.zeros((len(shapes), 3), np.int64), np.zeros(len(shapes), np.int64)
        begin: dict[tuple[int, int, int], int] = {}  # the row above which a box of about that size found no place
        for number in sorted(range(len(shapes)), key=lambda number: -max(shapes[number].size)):
            at = shapes[number]
            lowest = len(self._taken) + 1
            for turn, runs in enumerate(at.runs):
                width, height = at.size if turn % 2 == 0 else at.size[::-1]
                alike = turn, width // _ALIKE, height // _ALIKE
                row, column = _find(self._taken, self._free, runs, width, height, self._side, begin.get(alike, 0),
                                    lowest - height)
                begin[alike] = row if row >= 0 else max(lowest - height, begin.get(alike, 0))
                if row >= 0:
                    lowest, turns[number] = row + height, turn
                    places[number] = column, row, 0
            if lowest > len(self._taken):
                return None
            column, row, _ = places[number]
            _stamp(self._taken, self._free, at.runs[turns[number]], row, column)
        places[:, 2], places[:, 1] = np.divmod(places[:, 1], self._side)
        return places, turns

    def cells(self, count: int, cell: int) -> np.ndarray | None:
        """Low corners (count,3) int64 (column, row, page) of free squares of `cell` texels a side, now taken;
        None where there are fewer."""
        corners = np.empty((count, 2), np.int64)
        if _take_cells(self._taken, self._side, cell, corners) < count:
            return None
        page, row = np.divmod(corners[:, 1], self._side)
        return np.stack([corners[:, 0], row, page], axis=1)


@_compiled
def _touch(corners, mask):  # type: ignore[no-untyped-def]
    """Mark the texels of `mask` (H,W) that triangles (n,3,2) touch."""
    for face in range(len(corners)):
        triangle = corners[face]
        y0, y1, y2 = triangle[0, 1], triangle[1, 1], triangle[2, 1]
        for row in range(int(min(y0, y1, y2)), int(max(y0, y1, y2)) + 1):
            left, right = np.inf, -np.inf
            for k in range(3):
                ax, ay = triangle[k, 0], triangle[k, 1]
                bx, by = triangle[(k + 1) % 3, 0], triangle[(k + 1) % 3, 1]
                low, high = max(min(ay, by), row), min(max(ay, by), row + 1)
                if low > high:
                    continue
                for y in (low, high):
                    x = ax if ay == by else ax + (y - ay) * ((bx - ax) / (by - ay))
                    x = min(max(x, min(ax, bx)), max(ax, bx))
                    left, right = min(left, x), max(right, x)
                if ay == by:
                    left, right = min(left, ax, bx), max(right, ax, bx)
            for column in range(int(min(left, mask.shape[1])), int(max(right, -1)) + 1):
                mask[row, column] = 1


@_compiled
def _grown(mask, by):  # type: ignore[no-untyped-def]
    """A mask (H,W) with all texels within `by` columns and rows of its own."""
    height, width = mask.shape
    wide, result = np.zeros_like(mask), np.zeros_like(mask)
    for row in range(height):
        for column in range(width):
            if mask[row, column]:
                wide[row, max(column - by, 0) : column + by + 1] = 1
    for row in range(height):
        for near in range(max(row - by, 0), min(row + by + 1, height)):
            for column in range(width):
                result[row, column] |= wide[near, column]
    return result


@_compiled
def _runs(mask):  # type: ignore[no-untyped-def]
    """Rows, first columns and lengths (n,3) of the runs of a mask (H,W)."""
    height, width = mask.shape
    runs = np.empty((height * (width // 2 + 1), 3), np.int32)
    count = 0
    for row in range(height):
        column = 0
        while column < width:
            if mask[row, column]:
                first = column
                while column < width and mask[row, column]:
                    column += 1
                runs[count, 0], runs[count, 1], runs[count, 2] = row, first, column - first
                count += 1
            column += 1
    return runs[:count].copy()


@_compiled
def _last_taken(words, first, end):  # type: ignore[no-untyped-def]
    """The last taken texel of [first, end) in a row of 64 a word, or -1."""
    word = (end - 1) >> 6
    bits = words[word] & (np.uint64(0xFFFFFFFFFFFFFFFF) >> np.uint64(63 - ((end - 1) & 63)))
    lowest = first >> 6
    while word > lowest and bits == 0:
        word -= 1
        bits = words[word]
    if word == lowest:
        bits = (bits >> np.uint64(first & 63)) << np.uint64(first & 63)
    if bits == 0:
        return -1
    bit = 0
    for half in (32, 16, 8, 4, 2, 1):
        if bits >> np.uint64(half):
            bits >>= np.uint64(half)
            bit += half
    return (word << 6) + bit


@_compiled
def _find(taken, free, runs, width, height, side, start, end):  # type: ignore[no-untyped-def]
    """The first row below `end`, and the first column, at which none of the runs (n,3) of a box is taken; -1, -1."""
    if width > side or height > side:
        return -1, -1
    row = start
    while row < min(end, len(taken) - height + 1):
        over = row % side + height - side
        if over > 0:  # across the end of a page
            row += height - over
            continue
        column, run, passed = 0, 0, 0
        while run < len(runs) and free[row + runs[run, 0]] >= runs[run, 2]:
            run += 1
        if run < len(runs):
            row += 1
            continue
        run = 0
        while passed < len(runs):
            first = column + runs[run, 1]
            last = _last_taken(taken[row + runs[run, 0]], first, first + runs[run, 2])
            if last < 0:
                passed += 1
                run = run + 1 if run + 1 < len(runs) else 0
                continue
            passed = 0
            column = last + 1 - runs[run, 1]
            if column + width > side:
                break
        if passed == len(runs):
            return row, column
        row += 1
    return -1, -1


@_compiled
def _stamp(taken, free, runs, row, column):  # type: ignore[no-untyped-def]
    """Take the texels of runs (n,3) of a box whose low corner lies there, and keep `free` (H,) true."""
    for run in range(len(runs)):
        for x in range(column + runs[run, 1], column + runs[run, 1] + runs[run, 2]):
            taken[row + runs[run, 0], x >> 6] |= np.uint64(1) << np.uint64(x & 63)
    for run in range(len(runs)):
        y = row + runs[run, 0]
        if free[y] >= 0:
            free[y] = -free[y] - 1  # asked below
    for run in range(len(runs)):
        y = row + runs[run, 0]
        if free[y] >= 0:
            continue
        longest, first, width = 0, 0, 64 * taken.shape[1]
        while first < width and longest < -free[y] - 1:
            word = taken[y, first >> 6]
            if word == np.uint64(0xFFFFFFFFFFFFFFFF):
                first = ((first >> 6) + 1) << 6
                continue
            if (word >> np.uint64(first & 63)) & np.uint64(1):
                first += 1
                continue
            end = first
            while end < width and not (taken[y, end >> 6] >> np.uint64(end & 63)) & np.uint64(1):
                end += 1
            longest, first = max(longest, end - first), end + 1
        free[y] = longest


@_compiled
def _take_cells(taken, side, cell, corners):  # type: ignore[no-untyped-def]
    """Take free squares of `cell` texels and write their low corners; returns how many."""
    count = 0
    for row in range(len(taken) - cell + 1):
        if row % side + cell > side:
            continue
        column = 0
        while column + cell <= side and count < len(corners):
            last = -1
            for y in range(row, row + cell):
                last = max(last, _last_taken(taken[y], column, column + cell))
            if last >= 0:
                column = last + 1
                continue
            corners[count, 0], corners[count, 1] = column, row
            count += 1
            for y in range(row, row + cell):
                for x in range(column, column + cell):
                    taken[y, x >> 6] |= np.uint64(1) << np.uint64(x & 63)
            column += cell
    return count
