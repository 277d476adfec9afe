# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Geometrically verified matches of pairs of photos, written a pair at a time into the database of their features."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pycolmap
import torch

from ..base.records import Photo
from .features import image_ids
from .pairs import Pair
from .parallel import Step, in_order, threads

_CHUNK = 512  # rows of a similarity matrix at a time: it stays in the cache


def unmatched(database: pycolmap.Database, photos: tuple[Photo, ...], pairs: set[Pair]) -> list[Pair]:
    """The pairs that the database has no verdict on yet, in an order that keeps neighbours together."""
    ids = image_ids(database, photos)
    return [(i, j) for i, j in sorted(pairs) if not database.exists_two_view_geometry(ids[i], ids[j])]


def match_pairs(
    database: pycolmap.Database, photos: tuple[Photo, ...], pairs: list[Pair], device: str, step: Step
) -> None:
    """Match every pair and verify it geometrically; a pair that fails is recorded too, without inliers.

    `device` is a torch device ("cpu", "cuda"...), used for the brute-force search.
    """
    ids = image_ids(database, photos)
    cameras = {image.image_id: database.read_camera(image.camera_id) for image in database.read_all_images()}

    @lru_cache(maxsize=256)  # about 1 MB a photo
    def features(photo: int) -> tuple[np.ndarray, torch.Tensor]:
        keypoints = database.read_keypoints(ids[photo])[:, :2].astype(np.float64)
        return keypoints, torch.from_numpy(database.read_descriptors(ids[photo]).data.copy()).to(device)

    options = pycolmap.TwoViewGeometryOptions()
    options.ransac.random_seed = 0

    def verified(task: _Task) -> pycolmap.TwoViewGeometry:
        (keypoints1, descriptors1), (keypoints2, descriptors2) = task.first, task.second
        matches = match_descriptors(descriptors1, descriptors2)
        if len(matches) < options.min_num_inliers:
            return pycolmap.TwoViewGeometry()
        camera1, camera2 = (cameras[ids[photo]] for photo in task.pair)
        return pycolmap.estimate_two_view_geometry(camera1, keypoints1, camera2, keypoints2, matches, options)

    tasks = (_Task(pair=pair, first=features(pair[0]), second=features(pair[1])) for pair in pairs)
    with _one_thread_a_task(), closing(in_order(verified, tasks, threads())) as results:
        for task, geometry in results:
            with pycolmap.DatabaseTransaction(database):
                database.write_two_view_geometry(ids[task.pair[0]], ids[task.pair[1]], geometry)
            step()


@dataclass(frozen=True, kw_only=True)
class _Task:
    pair: Pair
    first: tuple[np.ndarray, torch.Tensor]  # keypoints, descriptors
    second: tuple[np.ndarray, torch.Tensor]


def match_descriptors(first: torch.Tensor, second: torch.Tensor) -> np.ndarray:
    """Mutual nearest neighbours (K,2) uint32 between uint8 RootSIFT descriptors (M,128) and (N,128).

    As COLMAP has it: the angle between descriptors below 0.7 rad and below 0.8 of the second nearest's.
    """
    if len(first) < 2 or len(second) < 2:
        return np.empty((0, 2), np.uint32)
    a, b = first.float() / 512, second.float() / 512  # COLMAP stores unit vectors as bytes, times 512
    rows, columns = [], []
    for start in range(0, len(a), _CHUNK):
        similarity, nearest = (a[start : start + _CHUNK] @ b.T).topk(2, dim=1)
        angle = torch.acos(similarity.clamp(max=1))
        row = ((angle[:, 0] < 0.7) & (angle[:, 0] < 0.8 * angle[:, 1])).nonzero()[:, 0]
        rows.append(row + start)
        columns.append(nearest[row, 0])
    row, column = torch.cat(rows), torch.cat(columns)
    back = [(b[column[s : s + _CHUNK]] @ a.T).argmax(dim=1) for s in range(0, len(column), _CHUNK)]
    mutual = torch.cat(back) == row if back else torch.zeros(0, dtype=torch.bool)
    return torch.stack([row[mutual], column[mutual]], dim=1).cpu().numpy().astype(np.uint32)


@contextmanager
def _one_thread_a_task() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
