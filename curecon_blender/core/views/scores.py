# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Algorithm 1: how well a source view suits a reference, from the sparse points that both see."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

BEST_ANGLE = 5.0  # theta0, degrees
SIGMA_BELOW, SIGMA_ABOVE = 1.0, 10.0  # degrees
BEYOND = 0.4  # of the points' own range, in inverse depth: how much further a deep sweep goes on
SUPPORT = 6  # other sparse points that make a near one credible
SUPPORT_REACH = 0.05, 0.1  # how close they are: of the picture's width, and in relative depth
LONGEST = 3.0  # times the sweep without them: how far they may lengthen it


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


def nearest_supported(points: np.ndarray, width: int) -> float:
    """The nearest z-depth of sparse points (P,4; sparse_points.py) in a picture so many pixels wide that SUPPORT others
    share; infinite where there is none. Points that only other photos matched count: what lies nearer than all that
    the photo matched cannot hide behind it."""
    column, row, depth = points[:, :3].T
    reach, relative = SUPPORT_REACH
    place = np.column_stack([column / (reach * width), row / (reach * width), np.log(depth) / relative])
    with_itself = cKDTree(place).query_ball_point(place, 1.0, return_length=True)
    return float(np.min(depth[with_itself > SUPPORT], initial=np.inf))


def depth_range(depths: np.ndarray, nearest: float = np.inf) -> tuple[float, float]:
    """(near, far) for a sweep from the z-depths of a photo's sparse points: their 1st and 99th percentile, with a
    margin of 20 % of the nearest and farthest depth for what has no sparse point.

    Open ground towards the horizon has few points, and hypotheses uniform in inverse depth reach it cheaply: where the
    range is deep, the margin at its far end is two fifths of the points' own, up to six times the farthest depth. The
    foreground may have fewer than the first percentile: where the `nearest` that is credible lies before it, the sweep
    begins there, if that makes it no more than LONGEST times as long.
    """
    first, last = np.percentile(depths, [1.0, 99.0])
    beyond = 1 / max(1 / last - BEYOND * (1 / first - 1 / last), 1 / (6 * last))
    near, far = float(first / 1.2), float(max(last * 1.2, beyond))
    longest = 1 / (1 / far + LONGEST * (1 / near - 1 / far))
    return min(near, max(nearest / 1.05, longest)), far
