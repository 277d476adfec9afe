# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the photos' colours are multiplied by to agree: a gain for each photo and channel, and what its lens takes from
the light towards the corners (falloff, or vignetting).

The falloff is one of each camera, the same in all its photos and channels. With r from the optical axis, 1 at the
farthest corner of the picture, its logarithm is -(p (r^2 - r^4 / 2) + q r^4 / 2): for p, q >= 0 it falls all the way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve

from ..base.records import View
from .candidates import CANDIDATES, Candidates
from .falloff import DARKEST_CORNER, corner, factor, off_axis_picture

_FACES = 40_000  # a sample of faces is plenty to tell exposures
_DARK, _BRIGHT = 8, 250  # of 255: colours beyond tell nothing
_GAIN_PRIOR = 1e-3
_PAIRS = 300_000  # a sample of colours of one face in two photos is plenty to tell the falloff
_FEW = 50  # faces: two photos that share fewer say little
_FALLOFF_PRIOR, _EXPOSURE_PRIOR = 0.2, 0.5  # standard deviations of p and q, and of a photo's logarithm
_ROUNDS = 10  # of least squares with new weights
_BLOCK = 1 << 17


@dataclass(frozen=True)
class Levelling:
    """Factors of V photos' sRGB values: `gains` (V,3) times what undoes the falloff of each one's `lens` (V,2), as
    falloff.py has it."""

    gains: np.ndarray
    lens: np.ndarray

    @classmethod
    def none(cls, photos: int) -> Levelling:
        return cls(np.ones((photos, 3)), np.zeros((photos, 2)))

    def factors(self, photo: int | np.ndarray, t: np.ndarray) -> np.ndarray:
        """Factors (...,3) at `t` (...) of one photo, or of a photo (...) for each."""
        result: np.ndarray = self.gains[photo] * factor(self.lens[photo], t)[..., None]
        return result

    def apply(self, candidates: Candidates, centroids: np.ndarray, views: Sequence[View]) -> None:
        """Level the colours of the faces' candidates, in place. `centroids` (M,3)."""
        for start in range(0, len(centroids), _BLOCK):
            block = slice(start, start + _BLOCK)
            view = candidates.view[block]
            levelled = candidates.colour[block] * self.factors(view, _off_axis(centroids[block], view, views))
            candidates.colour[block] = np.clip(np.rint(levelled), 0, 255)


def find_levelling(candidates: Candidates, centroids: np.ndarray, views: Sequence[View]) -> Levelling:
    """What makes the photos `views` agree best where they see the same faces; `centroids` (M,3). The gains are 1 on
    average over the photos, and with the lens over each picture.

    Both by medians, or robust least squares, of the ratios of pairs of photos, so that moving things and shine do not
    count.
    """
    seen = np.flatnonzero((candidates.quality > 0).sum(axis=1) > 1)
    if len(seen) > _FACES:
        seen = np.random.default_rng(0).choice(seen, _FACES, replace=False)
    view, colour = candidates.view[seen].astype(np.int64), candidates.colour[seen].astype(np.float32)
    usable = (candidates.quality[seen] > 0) & (colour.min(axis=2) > _DARK) & (colour.max(axis=2) < _BRIGHT)
    log = np.log(np.maximum(colour, 1))
    t = _off_axis(centroids[seen], view, views)
    lens = _lenses(view, usable, log.mean(axis=2), t, views)
    mean = np.array([factor(*pair).mean() for pair in zip(lens, (off_axis_picture(v, 8) for v in views), strict=True)])
    log += np.log(factor(lens[view], t) / mean[view])[..., None]
    return Levelling(_gains(view, usable, log, len(views)) / mean[:, None], lens)


def _off_axis(points: np.ndarray, view: np.ndarray, views: Sequence[View]) -> np.ndarray:
    """t (n,K) of points (n,3) in the photos `view` (n,K), at most that of the picture's farthest corner."""
    centres, axes = np.stack([v.centre for v in views]), np.stack([v.cam_from_world[2, :3] for v in views])
    ray = (points[:, None] - centres[view]).astype(np.float32)
    depth = np.einsum("nkc,nkc->nk", ray, axes.astype(np.float32)[view])
    square = np.einsum("nkc,nkc->nk", ray, ray)
    farthest = np.array([corner(v) for v in views], np.float32)
    result: np.ndarray = np.clip(square / np.maximum(depth**2, np.finfo(np.float32).tiny) - 1, 0, farthest[view])
    return result


def _gains(view: np.ndarray, usable: np.ndarray, log: np.ndarray, views: int) -> np.ndarray:
    """Gains (V,3) from the median ratio of every pair of photos: candidates `view` (n,K) whose colours' logarithms
    `log` (n,K,3) are `usable` (n,K)."""
    first, second = np.triu_indices(CANDIDATES, 1)
    row, pair = np.nonzero(usable[:, first] & usable[:, second])
    a, b = view[row, first[pair]], view[row, second[pair]]
    ratio = log[row, first[pair]] - log[row, second[pair]]
    swap = a > b
    a, b, ratio = np.where(swap, b, a), np.where(swap, a, b), np.where(swap[:, None], -ratio, ratio)
    key = a * views + b
    gains = np.zeros((views, 3))
    pairs, start, count = np.unique(np.sort(key), return_index=True, return_counts=True)
    if not len(pairs):
        return np.ones((views, 3))
    weight = np.sqrt(count)
    p, q = np.divmod(pairs, views)
    rows = np.repeat(np.arange(len(pairs)), 2)
    difference = sp.csr_array(
        (np.tile([1.0, -1.0], len(pairs)), (rows, np.stack([p, q], axis=1).ravel())), shape=(len(pairs), views)
    )
    normal = difference.T @ sp.diags_array(weight) @ difference
    normal = sp.csc_array(normal + sp.diags_array(np.full(views, _GAIN_PRIOR * max(weight.sum() / views, 1e-9))))
    for channel in range(3):
        order = np.lexsort((ratio[:, channel], key))
        median = ratio[order, channel][start + count // 2]
        gains[:, channel] = spsolve(normal, difference.T @ (weight * -median))
    return np.exp(gains - gains.mean(axis=0))


def _lenses(
    view: np.ndarray, usable: np.ndarray, log: np.ndarray, t: np.ndarray, views: Sequence[View]
) -> np.ndarray:
    """The lenses (V,2) from the ratios of pairs of photos at a face: candidates `view` (n,K) whose colours' logarithms
    `log` (n,K) are `usable` (n,K), at `t` (n,K). All falloffs and the photos' exposures are solved for at once.

    What two photos tell wrongly (shine, a shadow that moved), all their faces tell wrongly; so a pair of photos counts
    as one observation, however many faces it shares, and few of them do not move a lens far from having no falloff.
    """
    photos = len(views)
    keys = [(v.width, v.height, v.K.tobytes()) for v in views]
    cameras = {key: number for number, key in enumerate(dict.fromkeys(keys))}
    camera = np.array([cameras[key] for key in keys])
    farthest = np.array([corner(v) for v in views])
    first, second = np.triu_indices(CANDIDATES, 1)
    row, pair = np.nonzero(usable[:, first] & usable[:, second])
    if len(row) > _PAIRS:
        some = np.random.default_rng(0).choice(len(row), _PAIRS, replace=False)
        row, pair = row[some], pair[some]
    if not len(row):
        return np.zeros((photos, 2))
    rows, entries, columns = [], [], []
    for sign, slot in ((1, first[pair]), (-1, second[pair])):
        photo = view[row, slot]
        square = t[row, slot] / farthest[photo]
        rows += 3 * [np.arange(len(row))]
        columns += [photo, photos + 2 * camera[photo], photos + 2 * camera[photo] + 1]
        entries += [np.full(len(row), float(sign)), sign * (square**2 / 2 - square), sign * -(square**2) / 2]
    unknowns = photos + 2 * len(cameras)
    told = sp.csr_array(
        (np.concatenate(entries), (np.concatenate(rows), np.concatenate(columns))), shape=(len(row), unknowns))
    ratio = (log[row, first[pair]] - log[row, second[pair]]).astype(np.float64)
    key = np.sort(np.stack([columns[0], columns[3]]), axis=0)
    _, which, count = np.unique(key[0] * photos + key[1], return_inverse=True, return_counts=True)
    weight = 1 / (count + _FEW)[which]
    prior = np.full(unknowns, 1 / _EXPOSURE_PRIOR**2)
    prior[photos:] = 1 / _FALLOFF_PRIOR**2
    solution = np.zeros(unknowns)
    for _ in range(_ROUNDS):
        off = np.abs(ratio - told @ solution)
        noise = max(float(np.median(off)), 1e-3)
        weights = sp.diags_array(weight / (noise * np.maximum(off, 0.1 * noise)))
        normal = told.T @ weights @ told + sp.diags_array(prior)
        solution = _without_negatives(sp.csc_array(normal), told.T @ (weights @ ratio), photos)
    p, q = solution[photos:].reshape(-1, 2)[camera].T
    scale = np.minimum(1, -np.log(DARKEST_CORNER) / np.maximum((p + q) / 2, 1e-9))
    return np.stack([scale * p / farthest, scale * (q - p) / 2 / farthest**2], axis=1)


def _without_negatives(normal: sp.csc_array, right: np.ndarray, start: int) -> np.ndarray:
    """The solution of normal equations; unknowns from `start` on that came out negative are 0, and all solved again."""
    free = np.arange(len(right))
    while True:
        solution = np.zeros(len(right))
        solution[free] = spsolve(normal[free][:, free], right[free])
        negative = (free >= start) & (solution[free] < 0)
        if not negative.any():
            return solution
        free = free[~negative]
