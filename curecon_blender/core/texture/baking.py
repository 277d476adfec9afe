# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""From photos to texture pages: one photo at a time gives its colours to the texels of its faces."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from ..base.messages import Reporter
from ..base.sampling import sample
from .charts import PADDING, Layout
from .photo_sources import Source
from .rasterise import scan_convert
from .seams import Nodes
from .visibility import in_camera, project


@dataclass(frozen=True, kw_only=True)
class Bake:
    """All that is known before the photos are read at full size.

    `label` and `second` (M,) int16, the photos of each face, -1 for none; `weight` (M,3) of the second one;
    `origin` (N,) the vertices whose corrections the second one takes; `correction` (P,3) at the `nodes`; `gains` (V,3);
    `colours` (N,3) uint8, for the faces that no photo shows.
    """

    vertices: np.ndarray
    faces: np.ndarray
    label: np.ndarray
    second: np.ndarray
    weight: np.ndarray
    origin: np.ndarray
    layout: Layout
    nodes: Nodes
    correction: np.ndarray
    gains: np.ndarray
    colours: np.ndarray

    bytes_per_texel = 3 + 4 + 1 + 8  # both photos' colours, the weight, what is covered; and filling of the gaps


def bake(
    plan: Bake, sources: list[Source], numbers: range, reporter: Reporter, progress: Callable[[int], None]
) -> Iterator[np.ndarray]:
    """Yield the pages `numbers` as (S,S,3) uint8 sRGB, row 0 at the top. `progress` is told the photos done."""
    size = plan.layout.size
    first = np.zeros((len(numbers), size * size, 3), np.uint8)
    second = np.zeros((len(numbers), size * size, 4), np.uint8)
    covered = np.zeros((len(numbers), size * size), np.uint8)
    here = (plan.layout.page >= numbers.start) & (plan.layout.page < numbers.stop)
    for number, source in enumerate(sources):
        progress(number)
        own = np.flatnonzero(here & (plan.label == number))
        borrowed = np.flatnonzero(here & (plan.second == number))
        if not len(own) and not len(borrowed):
            continue
        picture, K = source.read(plan.layout.scale, reporter)
        for page, pixel, _, colour in _texels(plan, number, source, picture, K, own, plan.nodes.corner[own]):
            first[page - numbers.start, pixel] = colour
            covered[page - numbers.start, pixel] = 1
        node = plan.nodes.find(plan.origin[plan.faces[borrowed]], np.full((len(borrowed), 1), number))
        for page, pixel, weight, colour in _texels(plan, number, source, picture, K, borrowed, node):
            second[page - numbers.start, pixel, :3] = colour
            second[page - numbers.start, pixel, 3] = np.rint(255 * weight)
    unseen = np.flatnonzero(here & (plan.label < 0))
    for index, page in enumerate(numbers):
        face = unseen[plan.layout.page[unseen] == page]
        for which, pixel, weights in scan_convert(plan.layout.corners[face], size, size):
            colours = plan.colours[plan.faces[face[which]]].astype(np.float32)
            first[index, pixel] = np.rint(np.einsum("nk,nkc->nc", weights, colours))
            covered[index, pixel] = 1
        fade = np.flatnonzero(second[index, :, 3])
        share = second[index, fade, 3:].astype(np.float32) / 255
        first[index, fade] = np.rint(first[index, fade] * (1 - share) + second[index, fade, :3] * share)
        yield _fill_gaps(first[index].reshape(size, size, 3), covered[index].reshape(size, size))


def _texels(
    plan: Bake, number: int, source: Source, picture: np.ndarray, K: np.ndarray, faces: np.ndarray, node: np.ndarray
) -> Iterator[tuple[int, np.ndarray, np.ndarray, np.ndarray]]:
    """(page, texel (n,), weight of the second photo (n,), colour (n,3) uint8) of `faces` as photo `number` has them,
    levelled by the corrections at the nodes (len(faces),3), -1 for none."""
    size = plan.layout.size
    points = in_camera(plan.vertices[plan.faces[faces]].reshape(-1, 3), source.view).reshape(-1, 3, 3)
    correction = np.where((node >= 0)[..., None], plan.correction[np.maximum(node, 0)], 0).astype(np.float32)
    gain = plan.gains[number].astype(np.float32)
    for page in np.unique(plan.layout.page[faces]):
        here = np.flatnonzero(plan.layout.page[faces] == page)
        for which, pixel, weights in scan_convert(plan.layout.corners[faces[here]], size, size):
            face = here[which]
            # By way of the point in space: right also where a large face is seen at an angle.
            at = project(np.einsum("nk,nkc->nc", weights, points[face]), K)
            u, v = np.nan_to_num(at).T
            colour = sample(picture, u, v, cv2.INTER_CUBIC) * gain
            colour += np.einsum("nk,nkc->nc", weights, correction[face])
            weight = np.einsum("nk,nk->n", weights, plan.weight[faces[face]])
            yield int(page), pixel, weight, np.clip(np.rint(colour), 0, 255).astype(np.uint8)


def _fill_gaps(page: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """Grow charts into their padding, then fill the rest with what is around, coarser the further: mipmaps and
    JPEG then see no foreign colour at a chart's edge. Changes and returns `page` (S,S,3) uint8."""
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
    if page.shape[0] % 2:
        page, covered = (cv2.copyMakeBorder(a, 0, 1, 0, 1, cv2.BORDER_REPLICATE) for a in (page, covered))
    count = np.zeros((page.shape[0] // 2, page.shape[1] // 2), np.uint16)
    total = np.zeros((*count.shape, 3), np.uint16)
    for dy in (0, 1):
        for dx in (0, 1):
            known = covered[dy::2, dx::2]
            count += known
            total += page[dy::2, dx::2] * known[..., None]
    return (total // np.maximum(count, 1)[..., None]).astype(np.uint8), (count > 0).astype(np.uint8)
