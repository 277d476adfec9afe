# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Charts on texture pages: each keeps its gutter to itself, and ragged ones lie in each other's bays."""

from __future__ import annotations

import numpy as np
import pytest

from curecon_blender.core.texture.packing import Pages, Shape, shape

GUTTER = 2


def outline(*boxes: tuple[float, float, float, float]) -> np.ndarray:
    """Triangles (n,3,2) of boxes (left, top, right, bottom)."""
    return np.array([triangle for a, b, c, d in boxes
                     for triangle in ([(a, b), (c, b), (c, d)], [(a, b), (c, d), (a, d)])], np.float64)


def drawn(shapes: list[Shape], places: np.ndarray, turns: np.ndarray, side: int, pages: int) -> np.ndarray:
    """How many charts take each texel (pages,side,side), gutters included."""
    count = np.zeros((pages, side, side), int)
    for one, (column, row, page), turn in zip(shapes, places, turns, strict=True):
        for y, x, length in one.runs[turn]:
            count[page, row + y, column + x : column + x + length] += 1
    return count


@pytest.mark.parametrize("pages", [1, 3])
def test_no_two_charts_share_a_texel_or_a_gutter(pages: int) -> None:
    random = np.random.default_rng(3)
    charts = [outline(*(np.r_[low, low + random.uniform(0.5, 30, 2)] for low in random.uniform(-9, 9, (3, 2))))
              for _ in range(60)]
    shapes = [shape(chart, GUTTER) for chart in charts]
    side = int(np.sqrt(sum(one.texels for one in shapes) / pages / 0.55))
    placed = Pages(side, pages).place(shapes)
    assert placed is not None
    count = drawn(shapes, *placed, side, pages)
    assert count.max() == 1 and count.sum() == sum(one.texels for one in shapes)


def test_a_chart_lies_where_its_texels_are_with_a_gutter_around() -> None:
    triangle = np.array([[[10.2, 3.7], [14.9, 3.7], [10.2, 9.1]]])
    one = shape(triangle, GUTTER)
    (rows, firsts, lengths) = one.runs[0].T
    mask = np.zeros(one.size[::-1], int)
    for row, first, length in zip(rows, firsts, lengths, strict=True):
        mask[row, first : first + length] += 1
    x, y = np.meshgrid(np.arange(one.size[0]) + one.low[0] + 0.5, np.arange(one.size[1]) + one.low[1] + 0.5)
    inside = (x > 10.2) & (y > 3.7) & ((x - 10.2) / 4.7 + (y - 3.7) / 5.4 < 1)
    for row, column in zip(*np.nonzero(inside), strict=True):
        assert mask[row - GUTTER : row + GUTTER + 1, column - GUTTER : column + GUTTER + 1].all()
    assert not mask[-1, -1] and mask.max() == 1


def test_combs_lie_in_each_others_gaps() -> None:
    """Of their bounding boxes only two lie on the page."""
    comb = outline((0, 0, 128, 8), *((x, 8, x + 8, 60) for x in range(0, 121, 30)))
    shapes, side = [shape(comb, GUTTER)] * 4, 160
    assert side // min(shapes[0].size) == 2 and side // max(shapes[0].size) == 1
    assert Pages(side, 1).place(shapes) is not None


def test_what_does_not_fit_is_told() -> None:
    assert Pages(32, 2).place([shape(outline((0, 0, 30, 3)), GUTTER)]) is None
    assert Pages(32, 1).cells(200, 3) is None


def test_dots_go_where_nothing_lies() -> None:
    shapes = [shape(outline((0, 0, 20, 20), (20, 0, 40, 4)), GUTTER)]
    pages = Pages(64, 1)
    placed = pages.place(shapes)
    assert placed is not None
    cells = pages.cells(100, 3)
    assert cells is not None
    count = drawn(shapes, *placed, 64, 1)[0]
    for column, row, _ in cells:
        count[row : row + 3, column : column + 3] += 1
    assert count.max() == 1
