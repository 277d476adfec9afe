# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which photos colour each face of a mesh, and by which one it is laid out: exposure, consensus, and large patches.

Every face keeps the few photos that see it best (`Candidates`), so memory does not grow with the number of photos. The
choice minimises an energy as in Lempitsky and Ivanov 2007 and Waechter et al. 2014 ("Let There Be Color!"): a cost for
a photo that is poorer than the face's best one or that disagrees with the others, and one for each edge between two
photos. It is minimised by mean-field annealing over the face graph, all faces at once.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..base.graphs import connected_components
from .candidates import UNSEEN, Candidates

_NOTHING = -2  # stands beside the photos as a choice: no photo at all
_NOTHING_COST = 1.5  # for a face that no photo measured
_STRANGE_COST = 3.0  # for a photo that shows there what was measured nowhere about it
_OUTLIER = 24.0  # of 255: a photo whose colour for a face is this far from the others' median is doubted
_OUTLIER_COST = 3.0  # of one that is twice that far, where 1 is the cost of a photo that is worth nothing
_USELESS, _USELESS_COST = 0.1, 2.0  # below this share of the best quality a photo is avoided, whatever its surroundings
_WELL = 1.0  # cost, above that of a face's best photo, up to which another one counts for its colour
_SHARPER = 3  # power of the quality by which photos count for a face's colour
_COARSE = 0.1  # share of the best quality that a photo needs to lay out a face of a small patch
_GOOD_ENOUGH = 0.25  # and one at the edge of a patch
_EDGE = 0.5  # cost of an edge between two photos
_TEMPERATURES = np.geomspace(0.6, 0.05, 12)
_CLEAN_UP, _ROUNDS = 10, 10  # of absorbing small patches, and of smoothing edges
_SMALL = 100  # faces: patches below it go to a neighbour that can take them
_BLOCK = 1 << 17


def choose_photos(
    candidates: Candidates, anchor: np.ndarray, trusted: np.ndarray, neighbours: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The photo that each face is laid out by, (M,) int16, UNSEEN where there is none; and how much each of its
    candidates counts for its colour, (M,K) float32, 0 for those that show it poorly or otherwise than the others do.
    A face for which none counts is unseen, even where it is laid out as its neighbours are.

    `anchor` (M,3) uint8 sRGB is what the fused cloud says of each face's colour; it votes as one more photo where
    `trusted` (M,). A face that is not `trusted` (no photo measured it) and looks like none of what was measured about
    it is left unseen: most often that is sky behind a bulge of the surface.
    """
    cost = np.where(candidates.quality > 0, 0, np.float32(np.inf)).astype(np.float32)
    for start in range(0, len(cost), _BLOCK):
        block = slice(start, start + _BLOCK)
        cost[block] += _data_cost(candidates, block, anchor[block], trusted[block])
    # No photo at all is one more choice, so that smoothing rounds off the outlines of unseen parts too.
    nothing = np.where(np.isfinite(cost).any(axis=1), np.where(trusted, np.inf, _NOTHING_COST), 0)
    cost = np.column_stack([cost, nothing.astype(np.float32)])
    view = np.column_stack([candidates.view, np.full(len(cost), _NOTHING, np.int16)])
    slot = _anneal(cost, neighbours, _shared_slots(view, neighbours))
    seen = view[np.arange(len(view)), slot] >= 0
    good = seen[:, None] & (cost[:, :-1] < cost[:, :-1].min(axis=1, keepdims=True) + _WELL)
    label = _large_patches(np.maximum(view[np.arange(len(view)), slot], UNSEEN), candidates, neighbours)
    worth = np.where(good, candidates.quality, 0)
    return label, (worth / np.maximum(worth.max(axis=1, keepdims=True), np.finfo(np.float32).tiny)) ** _SHARPER


def _data_cost(candidates: Candidates, block: slice, anchor: np.ndarray, trusted: np.ndarray) -> np.ndarray:
    quality = candidates.quality[block]
    valid = quality > 0
    share = np.maximum(quality, 0) / np.maximum(quality.max(axis=1, keepdims=True), 1e-30)
    poorer = 1 - share + np.float32(_USELESS_COST) * np.maximum(1 - share / _USELESS, 0)
    colour = candidates.colour[block].astype(np.float32)
    votes = np.concatenate([np.where(valid[..., None], colour, np.inf),
                            np.where(trusted[:, None, None], anchor[:, None].astype(np.float32), np.inf)], axis=1)
    count = valid.sum(axis=1) + trusted
    votes.sort(axis=1)
    rows = np.arange(len(votes))
    low, high = votes[rows, np.maximum(count - 1, 0) // 2], votes[rows, count // 2 - (count == votes.shape[1])]
    median = np.where((count % 2 == 1)[:, None], low, (low + high) / 2)
    with np.errstate(invalid="ignore"):
        off = np.abs(colour - median[:, None]).max(axis=2)
        spread = np.abs(np.where(np.isfinite(votes), votes, np.nan) - median[:, None]).max(axis=2)
        spread = np.nan_to_num(spread, nan=np.inf)
        spread.sort(axis=1)
    typical = spread[rows, np.maximum(count - 1, 0) // 2]
    limit = np.maximum(_OUTLIER, 2.5 * np.where(np.isfinite(typical), typical, 0))[:, None]
    doubt = np.where((count >= 3)[:, None], np.clip(off / limit - 1, 0, 1.5), 0)
    cost = poorer + np.float32(_OUTLIER_COST) * doubt
    strange = np.abs(colour - anchor[:, None]).max(axis=2) > 2.5 * _OUTLIER
    cost[~trusted[:, None] & strange] += _STRANGE_COST
    cost[~valid] = np.inf
    result: np.ndarray = cost.astype(np.float32)
    return result


def _shared_slots(view: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
    """For each face, edge and slot, the neighbour's slot with the same photo, (M,3,K) int8, or -1."""
    slots = np.full((*neighbours.shape, view.shape[1]), -1, np.int8)
    for start in range(0, len(view), _BLOCK):
        block = slice(start, start + _BLOCK)
        for edge in range(3):
            other = view[neighbours[block, edge]]
            same = view[block, :, None] == other[:, None, :]
            same &= (view[block, :, None] != UNSEEN) & (neighbours[block, edge] >= 0)[:, None, None]
            slots[block, edge] = np.where(same.any(axis=2), same.argmax(axis=2), -1)
    return slots


def _anneal(cost: np.ndarray, neighbours: np.ndarray, transfer: np.ndarray) -> np.ndarray:
    """The slot of each face (M,) int8."""
    belief = _softmax(cost, _TEMPERATURES[0])
    for temperature in _TEMPERATURES:
        updated = np.empty_like(belief)
        for start in range(0, len(cost), _BLOCK):
            block = slice(start, start + _BLOCK)
            agreement = np.zeros_like(cost[block])
            for edge in range(3):
                slot = transfer[block, edge]
                theirs = np.take_along_axis(belief[neighbours[block, edge]], np.maximum(slot, 0), axis=1)
                agreement += np.where(slot >= 0, theirs, 0)
            updated[block] = _softmax(cost[block] - _EDGE * agreement, temperature)
        # Half a step: with all faces at once a full one can swing between two states.
        belief = 0.5 * (belief + updated)
    return belief.argmax(axis=1).astype(np.int8)


def _softmax(cost: np.ndarray, temperature: float) -> np.ndarray:
    lowest = cost.min(axis=1, keepdims=True)
    with np.errstate(invalid="ignore"):
        weight = np.exp((np.where(np.isfinite(lowest), lowest, 0) - cost) / np.float32(temperature))
    total = weight.sum(axis=1, keepdims=True)
    result: np.ndarray = weight / np.maximum(total, np.finfo(np.float32).tiny)
    return result


def patches(label: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
    """Numbers (M,) int32 from 0 of the connected patches of faces with the same label (M,)."""
    face, edge = np.nonzero((neighbours >= 0) & (label[neighbours] == label[:, None]))
    return connected_components(np.stack([face, neighbours[face, edge]], axis=1), len(label))


def _large_patches(label: np.ndarray, candidates: Candidates, neighbours: np.ndarray) -> np.ndarray:
    """The photo that each face is laid out by, (M,) int16: where a neighbour's photo shows a face, too, it is laid out
    by that, if it is of a small patch or at a ragged edge. Gutters then take less room."""
    quality = np.abs(candidates.quality)
    share = quality / np.maximum(quality.max(axis=1, keepdims=True), np.finfo(np.float32).tiny)

    def worth(face: np.ndarray, photo: np.ndarray) -> np.ndarray:
        match = (candidates.view[face] == photo[:, None]) & (photo != UNSEEN)[:, None]
        result: np.ndarray = np.where(match, share[face], 0).max(axis=1)
        return result

    label = _smooth_edges(label, neighbours, worth)
    for _ in range(_CLEAN_UP):
        patch = patches(label, neighbours)
        size = np.bincount(patch)
        face = np.flatnonzero(size[patch] < _SMALL)
        theirs = neighbours[face]
        larger = (theirs >= 0) & (size[patch[theirs]] > size[patch[face]][:, None])
        offered = np.where(larger, label[theirs], UNSEEN)
        value = np.stack([worth(face, photo) for photo in offered.T], axis=1)
        best = value.argmax(axis=1)[:, None]
        moves = np.take_along_axis(value, best, axis=1)[:, 0] > _COARSE
        if not moves.any():
            break
        label[face[moves]] = np.take_along_axis(offered, best, axis=1)[moves, 0]
    return _smooth_edges(label, neighbours, worth)


def _smooth_edges(
    label: np.ndarray, neighbours: np.ndarray, worth: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> np.ndarray:
    """Labels (M,) of which those that two neighbours have take the place of the third's, every other face at a time."""
    label = label.copy()
    for start in range(_ROUNDS):
        face = np.arange(start % 2, len(label), 2)
        a, b, c = np.where(neighbours[face] >= 0, label[neighbours[face]], UNSEEN).T
        common = np.where((a == b) | (a == c), a, np.where(b == c, b, UNSEEN))
        differs = (common != UNSEEN) & (common != label[face])
        face, common = face[differs], common[differs]
        moves = worth(face, common) > _GOOD_ENOUGH
        if not moves.any():
            break
        label[face[moves]] = common[moves]
    return label
