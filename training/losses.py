# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Losses on each level's probability volume: cross-entropy with linear labels, or UniMVSNet's unified focal loss;
and the refinement's."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from curecon_blender.core.network.model import LevelOutput
from curecon_blender.core.network.refinement import PLANES, Refined

GAMMA = {2: 2.0, 1: 1.0, 0: 0.0}
ALPHA = {2: 0.75, 1: 0.5, 0: 0.25}
LEVEL_WEIGHT = {2: 0.5, 1: 1.0, 0: 2.0}
INTERVALS = 128  # of the sweep, as BlendedMVS counts its errors
NEAR = 40.0  # intervals of the finest level beyond which an error counts for little more
FAR_WEIGHT = 0.05  # of each further interval
PLANES_WEIGHT = 0.1
# Of the error to be expected from the candidates and their probabilities: in intervals of the sweep, and in
# INTERVALS-ths of the true depth, since an interval at a deep sweep's far end is many metres.
RISK_WEIGHT = 0.5
DEPTH_RISK_WEIGHT = 0.5
FARTHEST = 3.0  # times too deep: a guess beyond costs no more


def unified_label(t: Tensor, first: Tensor, interval: float, count: int) -> Tensor:
    """Labels (B,M,h,w): 1 - (t - t_m) / r for the hypothesis with t_m <= t < t_m + r, 0 for all others."""
    index = torch.arange(count, device=t.device, dtype=t.dtype).view(1, count, 1, 1)
    offset = (t - first) / interval - index
    return torch.where((offset >= 0) & (offset < 1), 1 - offset, 0.0)


def _dedicated(x: Tensor) -> Tensor:
    """UniMVSNet's range control: a sigmoid of base 5."""
    return 1.0 / (1.0 + torch.pow(5.0, -x))


def unified_focal_loss(output: LevelOutput, t: Tensor, valid: Tensor, level: int) -> Tensor:
    """Scalar loss of one level: `t` (B,1,h,w) true sweep coordinate, `valid` (B,1,h,w) bool."""
    label = unified_label(t, output.first, output.interval, output.logits.shape[1])
    probability = torch.sigmoid(output.logits)
    largest = label.max(1, keepdim=True).values.clamp_min(0.05)
    positive = label > 0
    gamma = GAMMA[level]
    error = (label - probability).abs() / largest
    weight_positive = ((_dedicated(error) - 0.5) * 4 + 1) ** gamma
    weight_negative = ALPHA[level] * ((_dedicated(probability / largest) - 0.5) * 2).clamp_min(1e-6) ** gamma
    weight = torch.where(positive, weight_positive, weight_negative).detach()
    bce = F.binary_cross_entropy_with_logits(output.logits, label, reduction="none")
    per_pixel = (weight * bce).sum(1, keepdim=True)
    return (per_pixel * valid).sum() / valid.sum().clamp_min(1)


def linear_label(t: Tensor, first: Tensor, interval: float, count: int) -> Tensor:
    """Labels (B,M,h,w) that sum to 1: t split between the two hypotheses (in the middle of their intervals) beside it,
    in proportion to how near they are."""
    index = torch.arange(count, device=t.device, dtype=t.dtype).view(1, count, 1, 1)
    position = ((t - first) / interval - 0.5).clamp(0, count - 1)
    return (1 - (position - index).abs()).clamp_min(0)


def cross_entropy(output: LevelOutput, t: Tensor, valid: Tensor) -> Tensor:
    """Scalar loss of one level over the pixels whose depth its hypotheses reach; arguments as unified_focal_loss."""
    count = output.logits.shape[1]
    reached = valid & (t >= output.first) & (t < output.first + count * output.interval)
    label = linear_label(t, output.first, output.interval, count)
    per_pixel = -(label * F.log_softmax(output.logits, 1)).sum(1, keepdim=True)
    return (per_pixel * reached).sum() / valid.sum().clamp_min(1)


def at_level(values: Tensor, level: int) -> Tensor:
    """(B,1,H,W) at a level's resolution: for each of its pixels a full one beside its centre."""
    step = 2**level
    return values[..., step // 2 :: step, step // 2 :: step]


def total_loss(outputs: list[LevelOutput], t: Tensor, valid: Tensor, representation: str) -> Tensor:
    """Levels together; `t`, `valid` (B,1,H,W) at full resolution; `representation` as in NetworkConfig."""
    loss = t.new_zeros(())
    for level, output in zip((2, 1, 0), outputs, strict=True):
        truth, counted = at_level(t, level), at_level(valid, level)
        if representation == "linear":
            loss = loss + cross_entropy(output, truth, counted)
        else:
            loss = loss + LEVEL_WEIGHT[level] * unified_focal_loss(output, truth, counted, level)
    return loss


def refinement_loss(
    refined: Refined, t: Tensor, valid: Tensor, whole: Tensor, interval: float, ratio: Tensor
) -> Tensor:
    """Of the choice between candidates, of the depth, and of its confidence (where there is no surface, it is wrong).

    `t`, `valid`, `whole` (B,1,H,W) at full resolution. Confidence learns only where the truth is whole, so that what is
    not valid is no surface: from what is sure alone it would learn to be sure. `interval` in t, of the finest level;
    `ratio` (B,) of the sweep's near to its far end. A candidate is as likely as it is near, by a Laplace distribution,
    where a large error counts not much more than a middling one; and those far off cost what they are off by, or a
    guess at what no source sees would be as often far away as near.
    """
    apart = (refined.candidates - t).abs() / interval
    close = -apart.clamp_max(NEAR) - FAR_WEIGHT * apart
    near = refined.probability.clamp_min(1e-8).log() + close
    error = (refined.t - t).abs()
    off = error / interval
    per_pixel = off.log1p() + FAR_WEIGHT * off - 0.5 * torch.logsumexp(near, 1, keepdim=True)
    slope = (ratio - 1).view(-1, 1, 1, 1)  # of inverse depth over t, in units of its value at the near end
    times = (1 + slope * t) / (1 + slope * refined.candidates)
    cost = RISK_WEIGHT * (refined.candidates - t).abs() + DEPTH_RISK_WEIGHT * (times.clamp_max(FARTHEST) - 1).abs()
    per_pixel = per_pixel + INTERVALS * (refined.probability * cost).sum(1, keepdim=True)
    # The planes across the picture part its surfaces among them, chosen or not: what is never near is never chosen.
    per_pixel = per_pixel - PLANES_WEIGHT * torch.logsumexp(close[:, -PLANES:], 1, keepdim=True)
    right = valid & (error.detach() * INTERVALS < 1)
    confidence = F.binary_cross_entropy_with_logits(refined.confidence_logit, right.float(), reduction="none")
    confident = (confidence * whole).sum() / whole.sum().clamp_min(1)
    return (per_pixel * valid).sum() / valid.sum().clamp_min(1) + 0.5 * confident
