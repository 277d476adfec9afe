# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The refinement after the cascade: where a pixel's own estimate is poor, its sure neighbours' planes are at hand.

What no source sees, or what is too plain to match, mostly goes on as the surface beside it. Planes are straight in
inverse depth, so one is fitted in closed form through the sure pixels of windows of three sizes, around each pixel and
to its four sides. A small 2D U-Net at a quarter of the photo, which sees the photo, the cascade's estimate and how
sure it is, chooses between a pixel's own estimate and what those planes say there, and tells how sure the choice is.
It goes beyond the paper; see ARCHITECTURE.md.

Shapes as in network.py; a quarter is h, w = H/4, W/4.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

STEP = 4  # pixels of the photo to one of the U-Net's
RADII = (2, 5, 12)  # of the windows, in pixels of a quarter
SIDES = ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))  # where a window lies from its pixel, x and y
ASIDE = 0.75  # of a window's width, from a pixel to the middle of a window at its side
CANDIDATES = 1 + len(RADII) * len(SIDES)  # the pixel's own estimate first
ALIKE = 2.0  # intervals from a candidate within which others say the same
_COORDINATE = 50.0  # pixels of a quarter to one unit of the fits' coordinates, so that sums stay near 1
_RIDGE = 1e-4  # of a window's spread, in those units squared: a window with one sure pixel gives a level plane
_WIDTHS = (1, 2, 2, 2)  # of the U-Net at each scale, times its channels


@dataclass(frozen=True)
class Refined:
    """`t` (B,1,H,W) sweep coordinate; `sure` (B,1,H,W) logit of the chance that it is within 1/128 of the sweep;
    `candidates` (B,C,H,W) sweep coordinates and `probability` (B,C,H,W) of each, from which `t` comes."""

    t: Tensor
    sure: Tensor
    candidates: Tensor
    probability: Tensor


class Refinement(nn.Module):
    """`channels` of the U-Net at its finest scale."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        seen = 7 * STEP**2  # colours, the estimate's detail and three shares of a block of pixels
        c = channels
        self.weigh = nn.Sequential(nn.Conv2d(seen, c, 1), nn.ReLU(), _conv(c), nn.Conv2d(c, 1, 1))
        self.enter = nn.Sequential(nn.Conv2d(seen + CANDIDATES, c, 1), nn.ReLU())
        widths = [width * c for width in _WIDTHS]
        steps = list(pairwise(widths))
        self.at = nn.ModuleList(nn.Sequential(_conv(w), _conv(w)) for w in widths)
        self.down = nn.ModuleList(_conv(w, wider, stride=2) for w, wider in steps)
        self.up = nn.ModuleList(nn.ConvTranspose2d(wider, w, 2, 2) for w, wider in steps[::-1])
        self.merge = nn.ModuleList(_conv(w) for w in widths[-2::-1])
        self.leave = nn.Conv2d(c, (CANDIDATES + 2) * STEP**2, 1)
        with torch.no_grad():  # begins by keeping every pixel's own estimate
            self.leave.weight.zero_()
            self.leave.bias.zero_()  # type: ignore[union-attr]
            self.leave.bias[: STEP**2] = 3.0  # type: ignore[index]

    def forward(self, image: Tensor, t: Tensor, shares: Tensor, interval: float) -> Refined:
        """From the reference's colours (B,3,H,W) in [0, 1], the cascade's t (B,1,H,W), its three shares (B,3,H,W) by
        level 0, 1, 2, and the finest level's interval in t. H and W must divide by 32."""
        quarter = F.avg_pool2d(t, STEP)
        detail = ((t - _enlarged(quarter)) / interval).clamp(-4, 4) / 4
        seen = F.pixel_unshuffle(torch.cat([(image - 0.45) / 0.25, detail, shares * 2 - 1], 1), STEP)
        worth = self.weigh(seen).float()
        weight = torch.sigmoid(worth) * F.avg_pool2d(shares[:, :1], STEP) ** 2 + 1e-5
        candidates = torch.cat([t, *plane_candidates(quarter, weight)], 1)
        apart = (F.avg_pool2d(candidates[:, 1:], STEP) - quarter) / interval
        x = self.enter(torch.cat([seen, worth.clamp(-4, 4) / 4, apart.sign() * apart.abs().log1p() / 2], 1))
        skips = []
        for scale, at in enumerate(self.at):
            x = at(self.down[scale - 1](x) if scale else x)
            skips.append(x)
        x = skips.pop()
        for up, merge in zip(self.up, self.merge, strict=True):
            x = merge(up(x) + skips.pop())
        choice, offset, sure = F.pixel_shuffle(self.leave(x).float(), STEP).split([CANDIDATES, 1, 1], 1)
        probability = torch.softmax(choice, 1)
        likeliest = candidates.gather(1, _choice(candidates, probability, ALIKE * interval))
        alike = ((candidates - likeliest).abs() < ALIKE * interval) * probability
        mean = (alike * candidates).sum(1, keepdim=True) / alike.sum(1, keepdim=True)
        return Refined((mean + interval * torch.tanh(offset)).clamp(0, 1), sure, candidates, probability)


def _choice(candidates: Tensor, probability: Tensor, reach: float) -> Tensor:
    """Which candidate (B,1,H,W) has most of the probability (B,C,H,W) within reach of it: several that say nearly the
    same outvote one. Counted where no candidate has half of it alone."""
    best, choice = probability.max(1, keepdim=True)
    torn = best[:, 0] < 0.5
    c, p = (values.movedim(1, -1)[torn] for values in (candidates, probability))
    votes = [(((c - c[:, i : i + 1]).abs() < reach) * p).sum(1) for i in range(CANDIDATES)]
    choice[:, 0][torn] = torch.stack(votes).argmax(0)
    return choice


def plane_candidates(t: Tensor, weight: Tensor) -> list[Tensor]:
    """What the planes about each pixel say there, each (B,1,4h,4w), from t and the weights (B,1,h,w) of a quarter."""
    h, w = t.shape[2:]
    rows, columns = (torch.arange(n, device=t.device, dtype=t.dtype) / _COORDINATE for n in (h, w))
    y, x = (a[None, None] for a in torch.meshgrid(rows, columns, indexing="ij"))
    fine = [((torch.arange(n * STEP, device=t.device, dtype=t.dtype) + 0.5) / STEP - 0.5) / _COORDINATE
            for n in (h, w)]
    fine_y, fine_x = (a[None, None] for a in torch.meshgrid(*fine, indexing="ij"))
    moments = weight * torch.cat([a.expand_as(t) for a in (torch.ones_like(t), x, y, x * x, x * y, y * y)]
                                 + [t, t * x, t * y], 1)
    found = []
    for radius in RADII:
        plane = _fit(F.avg_pool2d(moments, 2 * radius + 1, 1, radius))
        aside = int(ASIDE * (2 * radius + 1))
        around = F.pad(plane, (aside,) * 4, mode="replicate")
        for dx, dy in SIDES:
            top, left = aside * (1 + dy), aside * (1 + dx)
            level, along_x, along_y = _enlarged(around[:, :, top : top + h, left : left + w]).split(1, 1)
            found.append((level + along_x * fine_x + along_y * fine_y).clamp(0, 1))
    return found


def _fit(moments: Tensor) -> Tensor:
    """Planes t = level + a x + b y (B,3,h,w) by weighted least squares, from the nine mean moments (B,9,h,w)."""
    total, *others = moments.split(1, 1)
    mx, my, mxx, mxy, myy, mt, mtx, mty = (m / (total + 1e-6) for m in others)
    xx, yy, xy = mxx - mx * mx + _RIDGE, myy - my * my + _RIDGE, mxy - mx * my
    tx, ty = mtx - mt * mx, mty - mt * my
    determinant = (xx * yy - xy * xy).clamp_min(_RIDGE**2 / 2)
    a, b = (tx * yy - ty * xy) / determinant, (ty * xx - tx * xy) / determinant
    return torch.cat([mt - a * mx - b * my, a, b], 1)


def _enlarged(quarter: Tensor) -> Tensor:
    return F.interpolate(quarter, scale_factor=float(STEP), mode="nearest")


def _conv(inputs: int, outputs: int | None = None, stride: int = 1) -> nn.Sequential:
    # An even kernel keeps centres where they are, as in network.py.
    kernel = 4 if stride == 2 else 3
    return nn.Sequential(nn.Conv2d(inputs, outputs or inputs, kernel, stride, 1), nn.ReLU())
