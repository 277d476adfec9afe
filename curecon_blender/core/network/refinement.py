# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The refinement after the cascade: where a pixel's own estimate is poor, its confident neighbours' planes are at hand.

What no source sees, or what is too plain to match, mostly goes on as the surface beside it; and the site's sparse
points lie on it, for some photo of the flight has seen what the four source views have not. Planes are straight in
inverse depth, so one is fitted in closed form through the confident pixels and the points of windows of three sizes,
around each pixel and to its four sides, and through the points alone around it. A small 2D U-Net at a quarter of the
photo sees the photo, the cascade's estimate with its confidence, and the points; at all but its finest scale it looks
over the whole picture. It selects the pixels of a few planes that reach across the picture (the ground behind a
building is the ground before it), chooses between a pixel's own estimate and the values of all those planes there, and
predicts the choice's confidence. It goes beyond the paper; see docs/design/network.md.

Shapes as in model.py; a quarter is h, w = H/4, W/4.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import cast

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .choice_cpu import fused_refined_depth

STEP = 4  # pixels of the photo to one of the U-Net's
RADII = (2, 5, 12)  # of the windows, in pixels of a quarter
SIDES = ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))  # where a window lies from its pixel, x and y
SIDE_OFFSET = 0.75  # of a window's width, from a pixel to the middle of a window at its side
PLANES = 2  # across the whole picture
WINDOWS = len(RADII) * len(SIDES) + len(RADII)  # fitted to pixels and points, then to points alone
CANDIDATES = 1 + WINDOWS + PLANES  # the pixel's own estimate first
POINT_KINDS = 2  # sparse points that lie in the picture, though they may be hidden in it; those it has matched
AGREEMENT = 2.0  # intervals within which two candidates agree
_COORDINATE = 50.0  # pixels of a quarter to one unit of the fits' coordinates, so that sums stay near 1
_MIN_WEIGHT = 1e-5  # of a pixel without any confidence
_RIDGE = 1e-4  # of a window's spread, in those units squared: a window with one confident pixel gives a level plane
_WIDTHS = (1, 2, 2, 2)  # of the U-Net at each scale, times its channels
# What looks over the whole picture at the U-Net's scales, the coarsest first and not at the finest: its channels, and
# its blocks' dilations in pixels of the scale.
_SURROUNDINGS = ((128, (1, 2, 4) * 4), (128, (1, 2, 4, 8) * 2), (64, (1, 2, 4, 8)))


@dataclass(frozen=True)
class Proposal:
    """`planes` (B,P,3,h,w): t at the origin and its slopes along x and y of each plane at a quarter's pixel, in the
    coordinates of _grid; `logits` (B,(P+3)*16,h,w), for the 16 pixels of each block: of the candidates (the pixel's own
    estimate first), of a shift within an interval, and of the choice's confidence."""

    planes: Tensor
    logits: Tensor


@dataclass(frozen=True)
class Refined:
    """`t` (B,1,H,W) sweep coordinate; `confidence_logit` (B,1,H,W), of the chance that it is within 1/128 of the sweep;
    `candidates` (B,C,H,W) sweep coordinates and `probability` (B,C,H,W) of each, from which `t` comes."""

    t: Tensor
    confidence_logit: Tensor
    candidates: Tensor
    probability: Tensor


class Refinement(nn.Module):
    """`channels` of the U-Net at its finest scale."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        # Of a block of pixels: colours, the estimate's detail, three confidences; its points, and how far off they are.
        inputs = 7 * STEP**2 + 2 * POINT_KINDS
        c = channels
        self.weigh = nn.Sequential(nn.Conv2d(inputs, c, 1), nn.ReLU(), _conv(c), nn.Conv2d(c, 1 + POINT_KINDS, 1))
        self.enter = nn.Sequential(nn.Conv2d(inputs + WINDOWS + 1 + POINT_KINDS, c, 1), nn.ReLU())
        widths = [width * c for width in _WIDTHS]
        steps = list(pairwise(widths))
        self.at = nn.ModuleList(nn.Sequential(_conv(w), _conv(w)) for w in widths)
        self.down = nn.ModuleList(_conv(w, wider, stride=2) for w, wider in steps)
        self.up = nn.ModuleList(nn.ConvTranspose2d(wider, w, 2, 2) for w, wider in steps[::-1])
        self.merge = nn.ModuleList(_conv(w) for w in widths[-2::-1])
        self.surroundings = nn.ModuleList(Surroundings(width, 3 + 2 * POINT_KINDS, *sizes)
                                          for width, sizes in zip(widths[:0:-1], _SURROUNDINGS, strict=True))
        self.belong = nn.Conv2d(c, PLANES, 1)
        self.leave = nn.Conv2d(c, (CANDIDATES + 2) * STEP**2, 1)
        with torch.no_grad():  # begins by keeping every pixel's own estimate
            self.leave.weight.zero_()
            self.leave.bias.zero_()  # type: ignore[union-attr]
            self.leave.bias[: STEP**2] = 3.0  # type: ignore[index]

    def forward(self, image: Tensor, t: Tensor, confidences: Tensor, interval: float, points: Tensor) -> Proposal:
        """From the reference's colours (B,3,H,W) in [0, 1], the cascade's t (B,1,H,W), its confidences (B,3,H,W) by
        level 0, 1, 2, the finest level's interval in t, and sparse points (B,2*POINT_KINDS,h,w) as `rasterise_points`
        has them. H and W must divide by 32."""
        quarter = F.avg_pool2d(t, STEP)
        detail = ((t - _enlarged(quarter)) / interval).clamp(-4, 4) / 4
        point_t, has_point = points.split(POINT_KINDS, 1)
        inputs = torch.cat([
            F.pixel_unshuffle(torch.cat([(image - 0.45) / 0.25, detail, confidences * 2 - 1], 1), STEP),
            has_point, has_point * _intervals(point_t - quarter, interval),
        ], 1)
        weight_logits = self.weigh(inputs).float()
        confidence = F.avg_pool2d(confidences[:, :1], STEP) ** 2
        plane_terms = moments(quarter)
        windows = _window_planes_of(plane_terms, confidence, point_t, has_point, torch.sigmoid(weight_logits))
        difference = _intervals(evaluate_planes(windows, 1) - quarter, interval)
        depths = torch.cat([quarter, quarter * confidence, confidence, points], 1)
        features = self._u_net(self.enter(torch.cat([inputs, weight_logits.clamp(-4, 4) / 4, difference], 1)), depths)
        membership = torch.sigmoid(self.belong(features).float()) * confidence + _MIN_WEIGHT
        across = torch.stack(picture_planes(plane_terms, membership), 1).expand(-1, -1, -1, *quarter.shape[2:])
        return Proposal(torch.cat([windows, across], 1), self.leave(features).float())

    def _u_net(self, x: Tensor, depths: Tensor) -> Tensor:
        skips = []
        for scale, at in enumerate(self.at):
            x = at(self.down[scale - 1](x) if scale else x)
            skips.append(x)
        x = self.surroundings[0](skips.pop(), depths)
        for up, merge, surroundings in zip(self.up, self.merge, (*self.surroundings[1:], None), strict=True):
            x = merge(up(x) + skips.pop())
            x = surroundings(x, depths) if surroundings else x
        return x


class Surroundings(nn.Module):
    """Adds to the features (B,C,h,w) of one of the U-Net's scales what the whole picture says of each pixel, from those
    and from `depths` (B,D,H,W) of the finest scale, how deep it lies. Within are `channels` and a block for each of
    the dilations. Begins by adding nothing, so that weights from before it are good weights to begin with."""

    def __init__(self, features: int, depths: int, channels: int, dilations: tuple[int, ...]) -> None:
        super().__init__()
        c = channels
        self.enter = nn.Sequential(nn.Conv2d(features + depths, c, 1), nn.ReLU())
        self.blocks = nn.ModuleList(nn.Sequential(_dilated(c, dilation), nn.ReLU(), _dilated(c, dilation))
                                    for dilation in dilations)
        self.overall = nn.ModuleList(nn.Conv2d(c, c, 1) for _ in dilations)
        self.leave = nn.Conv2d(c, features, 1)
        for silent in (*(cast(nn.Sequential, block)[-1] for block in self.blocks), *self.overall, self.leave):
            for parameter in silent.parameters():
                nn.init.zeros_(parameter)

    def forward(self, features: Tensor, depths: Tensor) -> Tensor:
        h, w = features.shape[2:]
        x = self.enter(torch.cat([features, F.adaptive_avg_pool2d(depths, (h, w))], 1))
        for block, overall in zip(self.blocks, self.overall, strict=True):
            x = F.relu(x + block(x) + overall(x.mean((2, 3), keepdim=True)))
        told: Tensor = features + self.leave(x)
        return told


def refined_depth(t: Tensor, proposal: Proposal, interval: float) -> tuple[Tensor, Tensor]:
    """t and confidence_logit, as `Refined` has them, of the cascade's t (B,1,H,W) and what the refinement proposes;
    without gradients."""
    if t.device.type == "cpu":
        return fused_refined_depth(t, proposal.planes, proposal.logits, interval, AGREEMENT * interval, _COORDINATE)
    refined = plain_refined_depth(t, proposal, interval)
    return refined.t, refined.confidence_logit


def plain_refined_depth(t: Tensor, proposal: Proposal, interval: float) -> Refined:
    """What `refined_depth` computes, and what it rests on, in torch's own operations: for graphics cards and for
    training."""
    return _chosen(t, proposal.logits, evaluate_planes(proposal.planes, STEP), interval)


def sampled_refined_depth(t: Tensor, proposal: Proposal, interval: float, first: tuple[int, int]) -> Refined:
    """`plain_refined_depth` at every second pixel alone, both ways: those from `first` (column, row), each 0 or 1. For
    training, whose time mostly goes into candidates: pixels side by side teach much the same."""
    column, row = first
    per_block = proposal.logits.unflatten(1, (-1, STEP, STEP))[:, :, row::2, column::2]
    planes = proposal.planes
    shifts = [(at - 0.5) / STEP / _COORDINATE for at in first]
    level = planes[:, :, :1] + planes[:, :, 1:2] * shifts[0] + planes[:, :, 2:] * shifts[1]
    values = evaluate_planes(torch.cat([level, planes[:, :, 1:]], 2), STEP // 2)
    return _chosen(t[..., row::2, column::2], per_block.flatten(1, 3), values, interval)


def _chosen(t: Tensor, logits: Tensor, values: Tensor, interval: float) -> Refined:
    """What is chosen between t (B,1,H,W) and the planes' values (B,C-1,H,W) by the logits of blocks of pixels."""
    candidates = torch.cat([t, values], 1)
    block = values.shape[-1] // logits.shape[-1]
    choice, offset, confidence_logit = F.pixel_shuffle(logits, block).split([CANDIDATES, 1, 1], 1)
    probability = torch.softmax(choice, 1)
    likeliest = candidates.gather(1, _likeliest(candidates, probability, AGREEMENT * interval))
    agreeing = ((candidates - likeliest).abs() < AGREEMENT * interval) * probability
    mean = (agreeing * candidates).sum(1, keepdim=True) / agreeing.sum(1, keepdim=True)
    refined_t = (mean + interval * torch.tanh(offset)).clamp(0, 1)
    return Refined(refined_t, confidence_logit, candidates, probability)


def rasterise_points(points: np.ndarray, near: float, far: float, size: tuple[int, int]) -> np.ndarray:
    """Sparse points as the refinement takes them, (2*POINT_KINDS,h,w) float32 for a photo of `size` (W, H) that divides
    by 4: t of the nearest in each block, for each kind, then whether there is one.

    `points` (P,4) are columns, rows, z-depths, and whether the photo itself is among those that a point comes from.
    What lies outside the photo or the sweep from `near` to `far` is left out.
    """
    width, height = size
    column, row, depth, matched = points.T
    t = (1 / depth - 1 / near) / (1 / far - 1 / near)
    inside = (t >= 0) & (t < 1) & (column >= 0) & (row >= 0) & (column < width) & (row < height)
    grid = np.zeros((2 * POINT_KINDS, height // STEP, width // STEP), np.float32)
    for kind, chosen in enumerate((inside, inside & (matched > 0))):
        order = np.flatnonzero(chosen)[np.argsort(-t[chosen])]  # the nearest last, which stays
        block = (row[order] // STEP).astype(int), (column[order] // STEP).astype(int)
        grid[kind][block], grid[POINT_KINDS + kind][block] = t[order], 1
    return grid


def _likeliest(candidates: Tensor, probability: Tensor, reach: float) -> Tensor:
    """Which candidate (B,1,H,W) has most of the probability (B,C,H,W) within reach of it: several that agree outvote
    one. Counted where no candidate has half of it alone."""
    best, choice = probability.max(1, keepdim=True)
    undecided = best[:, 0] < 0.5
    c, p = (values.movedim(1, -1)[undecided] for values in (candidates, probability))
    votes = [(((c - c[:, i : i + 1]).abs() < reach) * p).sum(1) for i in range(CANDIDATES)]
    choice[:, 0][undecided] = torch.stack(votes).argmax(0)
    return choice


def moments(t: Tensor) -> Tensor:
    """What a fit of planes to a quarter's t (B,1,h,w) sums up, (B,9,h,w): 1, x, y, xx, xy, yy, t, tx, ty."""
    x, y = _grid(t, 1)
    return torch.cat([a.expand_as(t) for a in (torch.ones_like(t), x, y, x * x, x * y, y * y)] + [t, t * x, t * y], 1)


def _window_planes_of(
    plane_terms: Tensor, confidence: Tensor, point_t: Tensor, has_point: Tensor, weights: Tensor
) -> Tensor:
    """All window planes (B,WINDOWS,3,h,w): fitted to pixels, by their learned weight and confidence (B,1,h,w), and to
    points; then to points alone. `plane_terms` are the pixels' moments; `weights` (B,1+POINT_KINDS,h,w) are of the
    pixels and of each kind of point."""
    pixel_weight, *point_weights = weights.split(1, 1)
    point_terms = sum(moments(point_t[:, i : i + 1]) * (has_point[:, i : i + 1] * weight)
                      for i, weight in enumerate(point_weights))
    return torch.stack([
        *window_planes(plane_terms * (pixel_weight * confidence + _MIN_WEIGHT) + point_terms, SIDES),
        *window_planes(plane_terms * _MIN_WEIGHT + point_terms, SIDES[:1]),
    ], 1)


def window_planes(weighted: Tensor, sides: tuple[tuple[int, int], ...]) -> list[Tensor]:
    """The planes (B,3,h,w) of the windows to some sides of each pixel, from weighted moments (B,9,h,w)."""
    h, w = weighted.shape[2:]
    found = []
    for radius in RADII:
        width = 2 * radius + 1
        rows = F.avg_pool2d(weighted, (1, width), 1, (0, radius))
        plane = _fit(F.avg_pool2d(rows, (width, 1), 1, (radius, 0)))
        offset = int(SIDE_OFFSET * width)
        around = F.pad(plane, (offset,) * 4, mode="replicate")
        for dx, dy in sides:
            top, left = offset * (1 + dy), offset * (1 + dx)
            found.append(around[:, :, top : top + h, left : left + w])
    return found


def picture_planes(plane_terms: Tensor, weights: Tensor) -> list[Tensor]:
    """Planes (B,3,1,1) across the whole picture: one for each of the weights (B,P,h,w) of its moments (B,9,h,w)."""
    return [_fit((plane_terms * weight).mean((2, 3), keepdim=True)) for weight in weights.split(1, 1)]


def evaluate_planes(planes: Tensor, step: int) -> Tensor:
    """t of planes (B,P,3,h,w), (B,P,h*step,w*step), at the centres of the step x step parts of a quarter's pixels."""
    x, y = _grid(planes, step)
    values = []
    for plane in planes.unbind(1):
        level, along_x, along_y = F.interpolate(plane, scale_factor=float(step), mode="nearest").split(1, 1)
        values.append((level + along_x * x + along_y * y).clamp(0, 1))
    return torch.cat(values, 1)


def _grid(quarter: Tensor, step: int) -> tuple[Tensor, Tensor]:
    """x and y, (1,1,1,w*step) and (1,1,h*step,1), of the parts of a quarter's pixels in the coordinates of its fits."""
    y, x = (((torch.arange(n * step, device=quarter.device, dtype=quarter.dtype) + 0.5) / step - 0.5) / _COORDINATE
            for n in quarter.shape[-2:])
    return x[None, None, None], y[None, None, :, None]


def _fit(weighted: Tensor) -> Tensor:
    """Planes t = level + a x + b y (B,3,h,w) by weighted least squares, from the nine mean moments (B,9,h,w)."""
    total, *others = weighted.split(1, 1)
    mx, my, mxx, mxy, myy, mt, mtx, mty = (m / (total + 1e-6) for m in others)
    xx, yy, xy = mxx - mx * mx + _RIDGE, myy - my * my + _RIDGE, mxy - mx * my
    tx, ty = mtx - mt * mx, mty - mt * my
    determinant = (xx * yy - xy * xy).clamp_min(_RIDGE**2 / 2)
    a, b = (tx * yy - ty * xy) / determinant, (ty * xx - tx * xy) / determinant
    return torch.cat([mt - a * mx - b * my, a, b], 1)


def _intervals(difference: Tensor, interval: float) -> Tensor:
    """A difference in t as the U-Net sees it: in intervals, on a logarithmic scale with its sign."""
    intervals = difference / interval
    return intervals.sign() * intervals.abs().log1p() / 2


def _enlarged(quarter: Tensor) -> Tensor:
    return F.interpolate(quarter, scale_factor=float(STEP), mode="nearest")


def _dilated(channels: int, dilation: int) -> nn.Conv2d:
    return nn.Conv2d(channels, channels, 3, 1, dilation, dilation)


def _conv(inputs: int, outputs: int | None = None, stride: int = 1) -> nn.Sequential:
    # An even kernel keeps centres where they are, as in layers.py.
    kernel = 4 if stride == 2 else 3
    return nn.Sequential(nn.Conv2d(inputs, outputs or inputs, kernel, stride, 1), nn.ReLU())
