# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""From photos to texture pages: one photo at a time adds its colours to the texels of the faces that it shows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from ..base.messages import Reporter
from .blending import Shares
from .charts import PADDING, Layout
from .levelling import Levelling
from .photo_sources import Source
from .rasterise import blend_photo, scan_convert
from .visibility import in_camera


@dataclass(frozen=True, kw_only=True)
class Bake:
    """All that is known before the photos are read at full size.

    `shares`, how much each photo counts for a face; `levelling`, the factors of the photos' sRGB values; `colours`
    (N,3) uint8, for the faces that no photo shows.
    """

    vertices: np.ndarray
    faces: np.ndarray
    shares: Shares
    layout: Layout
    levelling: Levelling
    colours: np.ndarray

    bytes_per_texel = 16 + 3 + 1 + 8  # sums of colours and of weights, the page, what is covered; filling of the gaps


def bake(
    plan: Bake, sources: list[Source], numbers: range, reporter: Reporter, progress: Callable[[int], None]
) -> Iterator[np.ndarray]:
    """Yield the pages `numbers` as (S,S,3) uint8 sRGB, row 0 at the top. `progress` is told the photos done."""
    layout = plan.layout
    size = layout.size
    total = np.zeros((len(numbers), size, size, 4), np.float32)
    here = (layout.page >= numbers.start) & (layout.page < numbers.stop)
    for number, source in enumerate(sources):
        progress(number)
        face, weight = plan.shares.of(number)
        mine = here[face]
        face, weight = face[mine], weight[mine]
        if not len(face):
            continue
        picture, K = source.read(layout.scale, reporter)
        points = in_camera(plan.vertices, source.view)[plan.faces[face]]
        blend_photo(layout.corners[face], layout.page[face] - numbers.start, layout.border[face], points, weight, K,
                    picture, plan.levelling.gains[number].astype(np.float32),
                    plan.levelling.lens[number].astype(np.float32), total)
    unseen = np.flatnonzero(here & ~plan.shares.seen)
    for index, page in enumerate(numbers):
        face = unseen[layout.page[unseen] == page]
        yield _finish(total[index], layout.corners[face], plan.colours[plan.faces[face]])


def _finish(total: np.ndarray, corners: np.ndarray, colours: np.ndarray) -> np.ndarray:
    """The page (S,S,3) of sums (S,S,4) of colours and weights, with the faces that no photo shows: their `corners`
    (n,3,2) on the page and `colours` (n,3,3) there."""
    size = len(total)
    mass = total[..., 3]
    covered = (mass > 0).astype(np.uint8)
    page = np.zeros((size, size, 3), np.uint8)
    for channel in range(3):
        page[..., channel] = np.clip(np.rint(total[..., channel] / np.maximum(mass, np.finfo(np.float32).tiny)), 0, 255)
    flat, known = page.reshape(-1, 3), covered.reshape(-1)
    x, y = np.clip(corners.mean(axis=1).T.astype(np.int64), 0, size - 1)
    alone = known[y * size + x] == 0  # a face has a texel of its own, be it smaller than one
    flat[(y * size + x)[alone]] = np.rint(colours.mean(axis=1))[alone]
    known[y * size + x] = 1
    for face, pixel, weights in scan_convert(corners, size, size):
        flat[pixel] = np.rint(np.einsum("nk,nkc->nc", weights, colours[face].astype(np.float32)))
        known[pixel] = 1
    return fill_gaps(page, covered)


def fill_gaps(page: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """Grow charts into their padding, then fill the rest with what is around, coarser the further: mipmaps and
    JPEG then see no foreign colour at a chart's edge. Changes and returns `page` (H,W,3) uint8."""
    for _ in range(PADDING):
        rim = np.flatnonzero(np.asarray(cv2.dilate(covered, np.ones((3, 3), np.uint8))) != covered)
        _average_neighbours(page, covered, rim)
    levels = [(page, covered)]
    while len(levels[-1][0]) > 2 and not levels[-1][1].all():
        levels.append(_halved(*levels[-1]))
    for (fine, known), (coarse, _) in zip(levels[-2::-1], levels[:0:-1], strict=True):
        gaps = known == 0
        fine[gaps] = cv2.resize(coarse, (fine.shape[1], fine.shape[0]), interpolation=cv2.INTER_NEAREST)[gaps]
    return page


def _average_neighbours(page: np.ndarray, covered: np.ndarray, texels: np.ndarray) -> None:
    """Give `texels` (n,), flat, the mean of their covered neighbours and cover them."""
    side = page.shape[1]
    y, x = np.divmod(texels, side)
    total, count = np.zeros((len(texels), 3), np.float32), np.zeros(len(texels), np.float32)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            v, u = np.clip(y + dy, 0, page.shape[0] - 1), np.clip(x + dx, 0, side - 1)
            known = covered[v, u].astype(np.float32)
            total += page[v, u] * known[:, None]
            count += known
    page[y, x] = np.rint(total / np.maximum(count, 1)[:, None])
    covered[y, x] = 1


def _halved(page: np.ndarray, covered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Half the size, the mean of what is covered."""
    odd = page.shape[0] % 2, page.shape[1] % 2
    if any(odd):
        page, covered = (cv2.copyMakeBorder(a, 0, odd[0], 0, odd[1], cv2.BORDER_REPLICATE) for a in (page, covered))
    count = np.zeros((page.shape[0] // 2, page.shape[1] // 2), np.uint16)
    total = np.zeros((*count.shape, 3), np.uint16)
    for dy in (0, 1):
        for dx in (0, 1):
            known = covered[dy::2, dx::2]
            count += known
            total += page[dy::2, dx::2] * known[..., None]
    return (total // np.maximum(count, 1)[..., None]).astype(np.uint8), (count > 0).astype(np.uint8)
