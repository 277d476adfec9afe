# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Visual words: a small vocabulary learnt from a job's own descriptors, by which photos and features are found."""

from __future__ import annotations

import cv2
import numpy as np
import pycolmap

WORDS = 64
_SAMPLE = 50_000  # descriptors that the vocabulary is learnt from


def learn_words(database: pycolmap.Database, ids: list[int]) -> np.ndarray:
    """The vocabulary (W,128) float32 of the features of some images: W is WORDS, or fewer where there are few."""
    rng = np.random.default_rng(0)
    most = max(50, _SAMPLE // len(ids))
    sample = np.concatenate([some_descriptors(database, image_id, most, rng) for image_id in ids])
    count = min(WORDS, len(sample))
    if count == 0:
        return np.zeros((1, 128), np.float32)
    criteria = (cv2.TERM_CRITERIA_MAX_ITER, 10, 0.0)
    cv2.setRNGSeed(0)
    words = cv2.kmeans(sample, count, None, criteria, 1, cv2.KMEANS_PP_CENTERS)[2]  # type: ignore[call-overload]
    return np.asarray(words)


def some_descriptors(
    database: pycolmap.Database, image_id: int, most: int, rng: np.random.Generator
) -> np.ndarray:
    """At most `most` of an image's descriptors, drawn at random; (N,128) float32."""
    data = database.read_descriptors(image_id).data
    chosen = data if len(data) <= most else data[rng.choice(len(data), most, replace=False)]
    return np.asarray(chosen.astype(np.float32))
