# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Algorithm 1: how well a source view suits a reference, from the sparse points that both see."""

from __future__ import annotations

import numpy as np

BEST_ANGLE = 5.0  # theta0, degrees
SIGMA_BELOW, SIGMA_ABOVE = 1.0, 10.0  # degrees
BEYOND = 0.4  # of the points' own range, in inverse depth: how much further a deep sweep goes on


def matching_score(centre_ref: np.ndarray, centre_src: np.ndarray, points: np.ndarray) -> float:
    """S_i over the points (P,3) that both views see; camera centres (3,) in the same frame.

    Each point adds exp(-(theta - theta0)^2 / (2 sigma^2)) for the angle theta between its two rays. The paper prints
    theta - theta0^2; MVSNet's view selection, from which it comes, has the square outside.
    """
    to_ref, to_src = centre_ref - points, centre_src - points
    lengths = np.linalg.norm(to_ref, axis=1) * np.linalg.norm(to_src, axis=1)
    cosine = np.einsum("pi,pi->p", to_ref, to_src) / np.maximum(lengths, 1e-12)
    theta = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    sigma = np.where(theta <= BEST_ANGLE, SIGMA_BELOW, SIGMA_ABOVE)
    return float(np.exp(-((theta - BEST_ANGLE) ** 2) / (2 * sigma**2)).sum())


def depth_range(depths: np.ndarray) -> tuple[float, float]:
    """(near, far) for a sweep from the z-depths of a photo's sparse points: their 1st and 99th percentile, with a
    margin of 20 % of the nearest and farthest depth for what has no sparse point.

    Open ground towards the horizon has few points, and hypotheses uniform in inverse depth reach it cheaply: where the
    range is deep, the margin at its far end is two fifths of the points' own, up to six times the farthest depth.
    """
    near, far = np.percentile(depths, [1.0, 99.0])
    beyond = 1 / max(1 / far - BEYOND * (1 / near - 1 / far), 1 / (6 * far))
    return float(near / 1.2), float(max(far * 1.2, beyond))
