# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What is drawn over the picture of a sheet: hatching where nothing was measured, and the lines of edges.

All lengths are in millimetres on the paper, so that every scale and quality gets the same drawing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

HATCH, THICK = 2.5, 0.22  # from line to line, and a line's width
RIM = 0.15  # of white on both sides of a line, so that it shows on dark walls, too
SPECK = 2.5  # side of the square in which the greater part decides: on less no line of a hatching would show
CRACK = 1.5  # a gap this narrow does not open what it leads to
STEP = 0.7  # in depth, from which on an edge is drawn
CREASE = 0.7  # sine of the angle between surfaces, about, from which on their edge is drawn
SMOOTH = 0.8  # side of the square over which normals are averaged
SHORT = 2.5  # lines shorter than it are left out, about
_INK = 24  # sRGB


@dataclass(frozen=True)
class Facts:
    """What each pixel (H,W) of a drawing shows: `shown`, whether there is any surface; `depth` in pixels, away from the
    viewer; `normals` (H,W,2), the parts of the unit normal to the right and up; `filled`, no photo measured it;
    `unseen`, no photo shows its colour."""

    shown: np.ndarray
    depth: np.ndarray
    normals: np.ndarray
    filled: np.ndarray
    unseen: np.ndarray


@dataclass(frozen=True)
class Hatching:
    """What is hatched: `unmeasured` (H,W), filled surface and gaps within the outline; `unseen` (H,W)."""

    unmeasured: np.ndarray
    unseen: np.ndarray


def hatching(facts: Facts, pixels_per_mm: float) -> Hatching:
    """What of a drawing was not measured, and what no photo shows, without specks."""
    gap = enclosed(facts.shown, round(CRACK * pixels_per_mm)) & ~facts.shown
    side = round(SPECK * pixels_per_mm)
    return Hatching(
        *(_blurred(mark.astype(np.float32), side) > 0.5 for mark in (gap | facts.shown & facts.filled,
                                                                      facts.shown & facts.unseen))
    )


def hatch(pixels: np.ndarray, marked: Hatching, pixels_per_mm: float) -> np.ndarray:
    """The picture (H,W,3) uint8 with what was not measured hatched upwards, and what no photo shows downwards. Between
    the lines it is as it was."""
    result = pixels.copy()
    for wide, colour in ((THICK + 2 * RIM, 255), (THICK, _INK)):
        for where, slope in ((marked.unmeasured, 1), (marked.unseen, -1)):
            result[where & stripes(pixels.shape[:2], slope, wide, pixels_per_mm)] = colour
    return result


def stripes(shape: tuple[int, ...], slope: int, wide: float, pixels_per_mm: float) -> np.ndarray:
    """Lines (H,W) bool at 45 degrees, so many millimetres wide; slope 1 rises to the right, as paper has it, -1
    falls."""
    row, column = np.ogrid[: shape[0], : shape[1]]
    every, wide = (max(1, round(length * np.sqrt(2) * pixels_per_mm)) for length in (HATCH, wide))  # all lines alike
    result: np.ndarray = (column + slope * row + wide // 2) % every < wide
    return result


def enclosed(shown: np.ndarray, reach: int) -> np.ndarray:
    """`shown` (H,W) bool with all that it encloses, be its outline open by no more than about 2 `reach` pixels."""
    framed = np.pad(shown, reach + 1)
    outside = ~_widened(framed, reach)
    reached = np.zeros_like(outside)
    reached[[0, -1]] = reached[:, [0, -1]] = True
    while True:
        before = int(reached.sum())
        for turned in (False, True):
            free, found = (a.T if turned else a for a in (outside, reached))
            found[...] = _along_rows(free, found)
        if int(reached.sum()) == before:
            break
    whole = ~_widened(reached, reach)
    inside: np.ndarray = whole[reach + 1 : -reach - 1, reach + 1 : -reach - 1] | shown
    return inside


def edges(facts: Facts, pixels_per_mm: float) -> np.ndarray:
    """Lines (H,W) bool where the surface ends, steps back or turns."""
    far = facts.depth[facts.shown].max(initial=0) + 1e6
    depth = np.where(facts.shown, facts.depth, far)
    step, reach = STEP * pixels_per_mm, max(1, round(SMOOTH * pixels_per_mm / 2))
    lines = np.zeros(facts.shown.shape, bool)
    # On the nearer side of a step; a slope, however steep, is none.
    lines[1:-1] |= depth[:-2] + depth[2:] - 2 * depth[1:-1] > step
    lines[:, 1:-1] |= depth[:, :-2] + depth[:, 2:] - 2 * depth[:, 1:-1] > step
    toward = np.sqrt(np.maximum(1 - (facts.normals**2).sum(axis=2), 0))
    weight = _blurred(facts.shown.astype(np.float32), 2 * reach + 1)
    smooth = np.stack([
        _blurred(np.where(facts.shown, part, 0).astype(np.float32), 2 * reach + 1)
        for part in (facts.normals[..., 0], facts.normals[..., 1], toward)
    ], axis=2) / np.maximum(weight, 1e-6)[..., None]
    for axis in (0, 1):
        turn = np.linalg.norm(np.roll(smooth, -reach, axis) - np.roll(smooth, reach, axis), axis=2)
        turn *= _unbroken(depth, axis, reach, step)
        highest = turn
        for shift in range(1, reach + 1):
            highest = np.maximum(highest, np.maximum(np.roll(turn, shift, axis), np.roll(turn, -shift, axis)))
        lines |= (turn >= highest) & (turn > CREASE)
    lines &= facts.shown
    thick = _widened(lines, max(0, round((THICK * pixels_per_mm - 1) / 2)))
    side = round(SHORT * pixels_per_mm)
    long = _blurred(lines.astype(np.float32), side) * side**2 > 0.7 * side
    result: np.ndarray = thick & _widened(lines & long, side // 2)
    return result


def draw_edges(pixels: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """The picture (H,W,3) uint8 with `lines` (H,W) in ink."""
    result = pixels.copy()
    result[lines] = _INK
    return result


def _unbroken(depth: np.ndarray, axis: int, reach: int, step: float) -> np.ndarray:
    """Where one surface goes on (H,W) bool for 2 `reach` pixels along the axis: normals across a step tell no edge."""
    ahead, behind = np.roll(depth, -reach, axis), np.roll(depth, reach, axis)
    result: np.ndarray = np.abs(ahead + behind - 2 * depth) < step + reach
    return result


def _along_rows(free: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Each run of `free` pixels in a row, whole, that touches a `found` one; both (H,W) bool."""
    run = np.cumsum(np.diff(free, axis=1, prepend=~free[:, :1]), axis=1)
    run += (np.cumsum(run[:, -1] + 1) - run[:, -1] - 1)[:, None]
    touched = np.zeros(int(run[-1, -1]) + 1, bool)
    touched[run[found & free]] = True
    result: np.ndarray = (touched[run] & free) | found
    return result


def _blurred(values: np.ndarray, side: int) -> np.ndarray:
    """Means (H,W) over squares of about `side` pixels; beyond the picture all is as at its edge."""
    reach = max(side // 2, 0)
    result = values.astype(np.float64)
    for axis in (0, 1):
        padding = [(0, 0), (0, 0)]
        padding[axis] = (reach + 1, reach)
        total = np.cumsum(np.pad(result, padding, mode="edge"), axis=axis)
        count = result.shape[axis]
        ahead, behind = (np.take(total, np.arange(count) + shift, axis) for shift in (2 * reach + 1, 0))
        result = (ahead - behind) / (2 * reach + 1)
    return result


def _widened(mask: np.ndarray, reach: int) -> np.ndarray:
    """The mask (H,W) bool, `reach` pixels wider on all sides."""
    result: np.ndarray = _blurred(mask.astype(np.float32), 2 * reach + 1) > 1e-9 if reach else mask
    return result
