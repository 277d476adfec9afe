# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Pairs of photos matched by SIFT and by networks together: one set of keypoints a photo, verified as one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pycolmap

from ..base.files import scratch_folder
from ..base.records import Photo
from .features import image_ids
from .learned import LearnedMatcher
from .lookalikes import copy_without
from .pairs import Pair
from .parallel import Step
from .progress import LEARNED, Meter


@contextmanager
def joint_database(
    database: Path, photos: tuple[Photo, ...], device: str, meter: Meter
) -> Iterator[JointMatches]:
    """A copy of a database with SIFT's matches, to which learned ones can be added, for as long as it is needed.

    Raises WeightsError.
    """
    meter.enter(LEARNED)
    matcher = LearnedMatcher(photos, device)
    with scratch_folder(database.parent / "joint") as folder:
        copy_without(database, folder / database.name, photos, set())
        with pycolmap.Database.open(folder / database.name) as opened:
            yield JointMatches(folder / database.name, opened, photos, matcher)


class JointMatches:
    """Adds learned matches to a database with SIFT's. A photo's learned keypoints come after its own."""

    def __init__(
        self, path: Path, database: pycolmap.Database, photos: tuple[Photo, ...], matcher: LearnedMatcher
    ) -> None:
        self.path, self._database, self._matcher = path, database, matcher
        self._ids = image_ids(database, photos)
        self._cameras = {image.image_id: database.read_camera(image.camera_id) for image in database.read_all_images()}
        self._own: dict[int, int] = {}  # SIFT's keypoints of the photos that have learned ones, too
        self._options = pycolmap.TwoViewGeometryOptions()
        self._options.ransac.random_seed = 0

    def add(self, pairs: Iterable[Pair], step: Step) -> dict[Pair, int]:
        """Match the pairs anew; how many matches of both kinds were verified. `step` raises Cancelled."""
        return {pair: self._match(pair, step) for pair in pairs}

    def _match(self, pair: Pair, step: Step) -> int:
        ids = [self._ids[photo] for photo in pair]
        offsets = np.array([self._learned_from(photo) for photo in pair], np.uint32)
        matches = self._matcher.matches(pair) + offsets
        known = self._database.exists_two_view_geometry(*ids)
        if known:
            sift = self._database.read_two_view_geometry(*ids).inlier_matches.reshape(-1, 2)
            matches = np.concatenate([sift, matches]).astype(np.uint32)
        geometry = pycolmap.TwoViewGeometry()
        if len(matches) >= self._options.min_num_inliers:
            first, second = (self._database.read_keypoints(i)[:, :2].astype(np.float64) for i in ids)
            geometry = pycolmap.estimate_two_view_geometry(
                self._cameras[ids[0]], first, self._cameras[ids[1]], second, matches, self._options
            )
        with pycolmap.DatabaseTransaction(self._database):
            if known:
                self._database.delete_two_view_geometry(*ids)
            self._database.write_two_view_geometry(ids[0], ids[1], geometry)
        step()
        return len(geometry.inlier_matches)

    def _learned_from(self, photo: int) -> int:
        """The index of a photo's first learned keypoint, in the database by now."""
        if photo not in self._own:
            sift = self._database.read_keypoints(self._ids[photo])[:, :2]
            self._database.update_keypoints(
                self._ids[photo], np.concatenate([sift, self._matcher.keypoints(photo)]).astype(np.float32)
            )
            self._own[photo] = len(sift)
        return self._own[photo]
