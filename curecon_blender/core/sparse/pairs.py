# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Pairs of photos worth matching."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import pycolmap

from ..base import rotations
from ..base.geodesy import gps_enu
from ..base.graphs import spanning_tree
from ..base.records import Photo
from .features import image_ids
from .parallel import Step
from .placement import SHORTEST_BASELINE
from .words import some_descriptors

EXHAUSTIVE = 60  # photos; up to here every pair is matched when no GPS says which are near each other
RETRIEVED = 20  # most similar photos matched with each photo of a larger set without GPS
WINDOW = 10  # photos before and after in name order, likewise
WIDEST_ANGLE = 75.0  # degrees between optical axes; SIFT does not match beyond, but repeated façades seem to

Pair = tuple[int, int]  # positions of two photos in the job's list, the smaller first


def needs_retrieval(photos: tuple[Photo, ...]) -> bool:
    """Whether pairs have to be found by what photos look like: many photos, and no GPS to tell which are near."""
    return len(photos) > EXHAUSTIVE and not _located(photos)


def expected_pairs(photos: tuple[Photo, ...], known: set[Pair]) -> int:
    """How many pairs there will be, with those that `similar_pairs` is still to find besides the `known` ones."""
    return len(known) + (len(photos) * RETRIEVED // 2 if needs_retrieval(photos) else 0)


def metadata_pairs(photos: tuple[Photo, ...]) -> set[Pair]:
    """Pairs worth matching as far as GPS, gimbal angles and the order of names tell.

    Photos with GPS: each with its nearest, and those next in order if they are near too. Without GPS: all pairs of a
    small set, else a window in name order. A pair whose optical axes diverge by the gimbals is left out.
    """
    everybody = range(len(photos))
    if not _located(photos):
        pairs = set(combinations(everybody, 2)) if len(photos) <= EXHAUSTIVE else _window(len(photos), WINDOW)
        return facing_alike(photos, pairs)
    located = [i for i in everybody if photos[i].gps is not None]
    lost = set(everybody) - set(located)
    positions, _ = gps_enu([photos[i] for i in located])
    pairs = {(located[a], located[b]) for a, b in near_pairs(positions, _axes([photos[i] for i in located]))}
    around = set(combinations(everybody, 2)) if len(photos) <= EXHAUSTIVE else _window(len(photos), WINDOW)
    return pairs | facing_alike(photos, {pair for pair in around if lost & set(pair)})


def facing_alike(photos: tuple[Photo, ...], pairs: set[Pair]) -> set[Pair]:
    """The pairs without those whose optical axes diverge by the gimbals: the sides of a round building look alike, and
    would match falsely."""
    return _facing(_axes(photos), pairs)


def _axes(photos: Sequence[Photo]) -> np.ndarray:
    """Optical axes (N,3) by the gimbals, NaN where unknown."""
    return np.array([
        (np.nan,) * 3 if photo.gimbal is None else rotations.from_gimbal(photo.gimbal)[:, 2] for photo in photos
    ])


def _facing(axes: np.ndarray, pairs: set[Pair]) -> set[Pair]:
    widest = np.cos(np.radians(WIDEST_ANGLE))
    return {(i, j) for i, j in pairs if not float(axes[i] @ axes[j]) < widest}  # NaN is not less: unknown stays


def near_pairs(positions: np.ndarray, axes: np.ndarray) -> set[Pair]:
    """Pairs of neighbouring cameras that look the same way, from positions (N,3) and optical axes (N,3), NaN unknown.

    A minimum spanning tree keeps far groups joined.
    """
    count = len(positions)
    neighbours = min(max(count // 3, 6), 20, count - 1)
    distances = np.stack([np.linalg.norm(positions - position, axis=1) for position in positions])
    np.fill_diagonal(distances, np.inf)
    nearest = np.argsort(distances, axis=1)[:, :neighbours]
    pairs = {_ordered(i, int(j)) for i in range(count) for j in nearest[i]}
    pairs |= {(i, j) for i, j in spanning_tree(distances).tolist()}
    reach = 2 * float(np.median(distances[np.arange(count), nearest[:, -1]]))
    pairs |= {(i, j) for i, j in _window(count, 3) if distances[i, j] < reach}
    return _facing(axes, pairs)


def similar_pairs(
    database: pycolmap.Database, photos: tuple[Photo, ...], words: np.ndarray, step: Step
) -> set[Pair]:
    """Each photo with the photos most like it, by VLAD vectors over the vocabulary `words` of the photos themselves.

    (Jegou et al., CVPR 2010: residuals of local descriptors against their visual words, summed and normalised.)
    """
    rng = np.random.default_rng(0)
    ids = image_ids(database, photos)
    signatures = np.zeros((len(ids), words.size), np.float32)
    for row, image_id in enumerate(ids):
        data = some_descriptors(database, image_id, 2000, rng)
        nearest = np.argmin((words**2).sum(1) - 2 * data @ words.T, axis=1)
        residuals = np.zeros_like(words)
        np.add.at(residuals, nearest, data - words[nearest])
        residuals /= np.maximum(np.linalg.norm(residuals, axis=1, keepdims=True), 1e-9)
        signatures[row] = residuals.ravel() / max(float(np.linalg.norm(residuals)), 1e-9)
        step()
    similarity = signatures @ signatures.T
    np.fill_diagonal(similarity, -np.inf)
    best = np.argsort(-similarity, axis=1)[:, :RETRIEVED]
    return {_ordered(i, int(j)) for i in range(len(ids)) for j in best[i]}


def _ordered(i: int, j: int) -> Pair:
    return (i, j) if i < j else (j, i)


def _located(photos: tuple[Photo, ...]) -> bool:
    located = [photo for photo in photos if photo.gps is not None]
    return (
        len(located) >= max(3, 0.9 * len(photos))
        and float(np.linalg.norm(np.ptp(gps_enu(located)[0], axis=0))) > SHORTEST_BASELINE
    )


def _window(count: int, width: int) -> set[Pair]:
    return {(i, j) for i in range(count) for j in range(i + 1, min(i + width + 1, count))}
