# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""LCM-MVSNet: cascade multi-view stereo whose cost volume weights each source view by its matching score.

Source: Li, Yang et al., "SD-3DR" (LCM-MVSNet), with the corrections noted at Eq. 2 and Eq. 3 below. This file goes in
the paper's order: feature pyramid, depth hypotheses, cost volume, regulariser, depth, cascade.

Shapes: B samples, V views (reference first), N = V - 1 sources, C channels, K groups, M depth hypotheses; level
l = 2, 1, 0 works at 1/4, 1/2, 1/1 of the photo. Pixel centres lie at .5. Depth is swept in the coordinate t in
[0, 1], uniform in inverse depth: t = 0 at `near`, t = 1 at `far`, growing with depth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from . import layers
from .config import NetworkConfig
from .cost_volume_cpu import CostVolumeInput, fused_cost_volume
from .homographies import homography_terms, level_intrinsics, mean_disparity, pixel_grid
from .layers import conv2d_block, conv3d_block, unit_length, up_conv3d_block, upsample, upsample_add
from .refinement import Proposal, Refinement, refined_depth

LEVELS = (2, 1, 0)  # coarse to fine
DECODER_REACH = 2  # hypotheses on each side of the likeliest that a linear decoder averages
MIN_HYPOTHESES, MAX_HYPOTHESES = 32, 256  # at the coarsest level
SLICE_BYTES = 64 << 20  # of warped features held at once, without gradients
MULTIPLE = 32  # heights and widths must divide by this: four scales of the regulariser at the coarsest level


@dataclass(frozen=True)
class Geometry:
    """Where a reference (view 0) and its source views stand, and what is swept.

    `K` (B,V,3,3) in pixels; `cam_from_world` (B,V,3,4); `near`, `far` (B,) z-depths in world units; `scores` (B,N)
    matching scores S_i of Algorithm 1, at least one positive; `extents` (B,N,2) each source's width and height in
    pixels: what its features hold to the right of it and below is padding, where it sees nothing.
    """

    K: Tensor
    cam_from_world: Tensor
    near: Tensor
    far: Tensor
    scores: Tensor
    extents: Tensor


@dataclass(frozen=True)
class LevelOutput:
    """One level's result at its own resolution (h, w).

    `logits` (B,M,h,w) of the probability volume P; `first` (B,1,h,w) is t where the first hypothesis' interval begins;
    `interval` is r in t; `t` (B,1,h,w) the estimate; `confidence` (B,1,h,w) in [0, 1], the share of P within one
    hypothesis of the likeliest.
    """

    logits: Tensor
    first: Tensor
    interval: float
    t: Tensor
    confidence: Tensor


# ---- feature pyramid

class FeaturePyramid(nn.Module):
    """(B,3,H,W) to features (B,C_l,H/2^l,W/2^l): an FPN, then PANet's bottom-up path (paper, section on features)."""

    def __init__(self, channels: tuple[int, int, int], bottom_up: bool) -> None:
        super().__init__()
        c0, c1, c2 = channels
        self.stem = nn.Sequential(conv2d_block(3, c0), conv2d_block(c0, c0))
        self.down1 = nn.Sequential(conv2d_block(c0, c1, stride=2), conv2d_block(c1, c1), conv2d_block(c1, c1))
        self.down2 = nn.Sequential(conv2d_block(c1, c2, stride=2), conv2d_block(c2, c2), conv2d_block(c2, c2))
        self.lateral2 = nn.Conv2d(c2, c2, 1)
        self.lateral1 = nn.Conv2d(c1, c2, 1)
        self.lateral0 = nn.Conv2d(c0, c2, 1)
        self.smooth1 = nn.Conv2d(c2, c1, 3, padding=1)
        self.smooth0 = nn.Conv2d(c2, c0, 3, padding=1)
        self.bottom_up = bottom_up
        if bottom_up:
            self.up1, self.fuse1 = conv2d_block(c0, c1, stride=2), nn.Conv2d(c1, c1, 3, padding=1)
            self.up2, self.fuse2 = conv2d_block(c1, c2, stride=2), nn.Conv2d(c2, c2, 3, padding=1)

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        x0 = self.stem(image)
        x1 = self.down1(x0)
        x2 = self.down2(x1)
        top2 = self.lateral2(x2)
        top1 = F.interpolate(top2, scale_factor=2.0, mode="nearest") + self.lateral1(x1)
        top0 = F.interpolate(top1, scale_factor=2.0, mode="nearest") + self.lateral0(x0)
        p0, p1, p2 = self.smooth0(top0), self.smooth1(top1), top2
        if self.bottom_up:
            p1 = self.fuse1(p1 + self.up1(p0))
            p2 = self.fuse2(p2 + self.up2(p1))
        return p0, p1, p2


# ---- depth hypotheses (Eq. 1, here uniform in inverse depth)

def depth_from_t(t: Tensor, near: Tensor, far: Tensor) -> Tensor:
    """z-depth at sweep coordinate t; `near` and `far` (B,) broadcast over the last three dimensions."""
    near, far = near.view(-1, 1, 1, 1), far.view(-1, 1, 1, 1)
    return 1.0 / (1.0 / near + t * (1.0 / far - 1.0 / near))


def t_from_depth(depth: Tensor, near: Tensor, far: Tensor) -> Tensor:
    """Inverse of depth_from_t; depth must be positive."""
    near, far = near.view(-1, 1, 1, 1), far.view(-1, 1, 1, 1)
    return (1.0 / depth - 1.0 / near) / (1.0 / far - 1.0 / near)


def first_hypothesis(coarser: LevelOutput | None, count: int, interval: float, reference: Tensor) -> Tensor:
    """t (B,1,h,w) where the first interval begins of a level whose reference has features (B,C,h,w): at 0 for the
    coarsest level, which sweeps all of it; elsewhere `count` intervals lie around the upsampled coarser estimate."""
    if coarser is None:
        return torch.zeros(reference.shape[0], 1, *reference.shape[2:], device=reference.device)
    return (upsample(coarser.t.detach()) - count * interval / 2).clamp(0.0, 1.0 - count * interval)


# ---- cost volume: the learnable cost metric (Eq. 2)

def warp(
    feature: Tensor, rotated: Tensor, shifted: Tensor, inverse_depth: Tensor, extent: Tensor
) -> tuple[Tensor, Tensor]:
    """Source features (B,C,hs,ws) seen from the reference at `inverse_depth` (B,M,h,w): (B,C,M,h,w), and where the
    source sees it, (B,1,M,h,w) bool: before it and within its `extent` (B,2), width and height. What falls outside the
    features, or behind the source, is zero."""
    b, m, h, w = inverse_depth.shape
    homogeneous = rotated.unsqueeze(2) + shifted.unsqueeze(2) * inverse_depth.reshape(b, 1, m, h * w)
    z = homogeneous[:, 2]
    size = torch.tensor([feature.shape[3], feature.shape[2]], dtype=z.dtype, device=z.device)
    grid = homogeneous[:, :2] / z.clamp_min(1e-6).unsqueeze(1) * (2.0 / size).view(1, 2, 1, 1) - 1.0
    grid = torch.where(z.unsqueeze(1) > 1e-6, grid, 2.0).clamp(-2.0, 2.0)
    end = (extent * (2.0 / size) - 1.0).view(b, 2, 1, 1)
    seen = ((grid > -1) & (grid < end)).all(1).view(b, 1, m, h, w)
    grid = grid.permute(0, 2, 3, 1).reshape(b, m * h, w, 2)
    warped = F.grid_sample(feature, grid, mode="bilinear", padding_mode="zeros", align_corners=False)
    return warped.reshape(b, -1, m, h, w), seen


def plain_cost_volume(inputs: CostVolumeInput, groups: int, alpha: Tensor, beta: Tensor | None) -> Tensor:
    """Eq. 2 in torch's own operations, for graphics cards: (B,K,M,h,w), alpha times the mean over the sources, by their
    weights, of the group-wise product of reference and warped source.

    With `beta` (visibility) a source's weight is multiplied by exp(beta * its cosine) at each voxel, and by 0 where it
    does not see the voxel. fused_cost_volume computes the same on a CPU.
    """
    b, c = inputs.reference.shape[:2]
    scaled = (inputs.reference * (groups / c)).unsqueeze(2)  # the mean over a group's channels becomes a sum
    total = norm = torch.zeros((), device=scaled.device)
    for i, (source, (rotated, shifted)) in enumerate(zip(inputs.sources, inputs.terms, strict=True)):
        warped, seen = warp(inputs.compared(source), rotated, shifted, inputs.inverse_depth, inputs.extents[:, i])
        product = (warped * scaled).reshape(b, groups, c // groups, *inputs.inverse_depth.shape[1:])
        similarity = product.sum(2) if c > groups else product[:, :, 0]
        weight = inputs.weights[:, i].view(-1, 1, 1, 1, 1)
        if beta is not None:
            weight = weight * seen * torch.exp(beta * similarity.mean(1, keepdim=True))
        total, norm = total + weight * seen * similarity, norm + weight
    return alpha * total / norm.clamp_min(1e-6)


# ---- regulariser

class CostRegulariser(nn.Module):
    """Four-scale 3D U-Net: cost volume (B,K,M,h,w), by way of `enter`, to logits (B,M,h,w). M, h, w divide by 8."""

    def __init__(self, inputs: int, base: int) -> None:
        super().__init__()
        c = [base, base * 2, base * 4, base * 8]
        self.enter = conv3d_block(inputs, c[0])
        self.down = nn.ModuleList(
            nn.Sequential(conv3d_block(c[i], c[i + 1], stride=2), conv3d_block(c[i + 1], c[i + 1])) for i in range(3)
        )
        self.up = nn.ModuleList(up_conv3d_block(c[i + 1], c[i]) for i in range(3))
        self.leave = layers.Conv3d(c[0], 1, 3, padding=1)
        nn.init.constant_(self.leave.bias, -2.5)  # type: ignore[arg-type]  # most hypotheses are wrong

    def forward(self, entered: Tensor) -> Tensor:
        """The logits, from what `enter` makes of a cost volume; without gradients that may be overwritten."""
        skips = [entered]
        for down in self.down:
            skips.append(down(skips[-1]))
        x = skips.pop()
        for up in reversed(self.up):
            x = upsample_add(cast(nn.Sequential, up), x, skips.pop())
        logits: Tensor = self.leave(x).squeeze(1)
        return logits


# ---- depth (Eq. 3) and each level's confidence

def decode_linear(logits: Tensor, first: Tensor, interval: float) -> tuple[Tensor, Tensor]:
    """Mean of t over the hypotheses within DECODER_REACH of the likeliest, and the share of P within one of it, each
    (B,1,h,w)."""
    probability = torch.softmax(logits, 1)
    index = probability.max(1, keepdim=True).indices  # a third of argmax's time across planes
    m = logits.shape[1]
    total = mean = confidence = torch.zeros_like(first)
    for o in range(-DECODER_REACH, DECODER_REACH + 1):
        inside = (index + o >= 0) & (index + o < m)
        p = torch.where(inside, probability.gather(1, (index + o).clamp(0, m - 1)), 0.0)
        total, mean = total + p, mean + p * o
        if abs(o) <= 1:
            confidence = confidence + p
    return first + interval * (index + 0.5 + mean / total), confidence


def decode_unified(logits: Tensor, first: Tensor, interval: float) -> tuple[Tensor, Tensor]:
    """Eq. 3: t = t_m* + r (1 - max P), and the share of P within one hypothesis of m*, each (B,1,h,w).

    The paper prints + r max P, which would contradict its own label, 1 - (d - d_m) / r. max P alone is no
    confidence, since a true depth late in its interval has a small label: what speaks for a depth is that P is
    gathered around m*.
    """
    probability = torch.sigmoid(logits)
    peak, index = probability.max(1, keepdim=True)
    t = first + interval * (index + 1.0 - peak)
    m = logits.shape[1]
    near_peak = sum(
        torch.where((index + o >= 0) & (index + o < m), probability.gather(1, (index + o).clamp(0, m - 1)), 0.0)
        for o in (-1, 0, 1)
    )
    return t, near_peak / probability.sum(1, keepdim=True).clamp_min(1e-6)


# ---- the cascade

class LCMMVSNet(nn.Module):
    """The whole network. `forward` takes colours in [0, 1] and returns the levels' outputs, coarse to fine."""

    def __init__(self, config: NetworkConfig | None = None) -> None:
        super().__init__()
        self.config = config or NetworkConfig()
        self.features = FeaturePyramid(self.config.channels, self.config.bottom_up)
        self.regularisers = nn.ModuleList(
            CostRegulariser(self.config.groups[level] + self.config.context, self.config.regulariser_channels)
            for level in range(3)
        )
        if self.config.context:
            self.context = nn.ModuleList(nn.Conv2d(c, self.config.context, 1) for c in self.config.channels)
        self.alpha = nn.Parameter(torch.ones(3))  # alpha_l of Eq. 2
        if self.config.visibility:
            self.beta = nn.Parameter(torch.full((3,), 2.0))  # how much more a cosine of 1 counts, as a logarithm
        if self.config.refinement:
            self.refinement = Refinement(self.config.refinement)

    def forward(
        self, images: Tensor, K: Tensor, cam_from_world: Tensor, near: Tensor, far: Tensor, scores: Tensor
    ) -> list[LevelOutput]:
        """Depth of the reference, view 0, of `images` (B,V,3,H,W) in [0, 1], H and W multiples of 32; the others are
        those of `Geometry`."""
        b, v = images.shape[:2]
        pyramid = self.pyramid(images.flatten(0, 1))
        views = [tuple(level.unflatten(0, (b, v))[:, i] for level in pyramid) for i in range(v)]
        count = self.coarse_hypotheses(K, cam_from_world, near, far, (images.shape[4], images.shape[3]))
        extents = K.new_tensor([images.shape[4], images.shape[3]]).expand(b, v - 1, 2)
        return self.sweep(views[0], views[1:], Geometry(K, cam_from_world, near, far, scores, extents), count)

    def pyramid(self, images: Tensor) -> tuple[Tensor, ...]:
        """Features of (B,3,H,W) colours in [0, 1], by level 0, 1, 2."""
        return layers.in_strips(lambda strip: self.features((strip - 0.45) / 0.25), images)

    def coarse_hypotheses(
        self, K: Tensor, cam_from_world: Tensor, near: Tensor, far: Tensor, size: tuple[int, int]
    ) -> int:
        """How many hypotheses the coarsest level sweeps, a multiple of 8, for a reference of `size` (W, H): as many
        as put neighbours `hypothesis_step` pixels of that level apart, for the sample that asks for most."""
        if self.config.hypothesis_step is None:
            return self.config.hypotheses[2]
        pixels = float(mean_disparity(K, cam_from_world, near, far, size).max()) / 4
        wanted = 8 * math.ceil(pixels / self.config.hypothesis_step / 8)
        return min(max(wanted, MIN_HYPOTHESES), MAX_HYPOTHESES)

    def sweep(
        self, reference: tuple[Tensor, ...], sources: list[tuple[Tensor, ...]], geometry: Geometry,
        coarse_hypotheses: int,
    ) -> list[LevelOutput]:
        """`forward` from ready features, by level 0, 1, 2, of each view, with so many hypotheses (a multiple of 8)
        at the coarsest level; the finer levels' intervals follow from its interval by the config's ratios."""
        config = self.config
        middle = 0.5 if config.representation == "linear" else 0.0  # where a hypothesis stands in its interval
        decode = decode_linear if config.representation == "linear" else decode_unified
        outputs: list[LevelOutput] = []
        for level in LEVELS:
            interval = config.interval_ratios[level] / config.interval_ratios[2] / coarse_hypotheses
            m = config.hypotheses[level] if outputs else coarse_hypotheses
            first = first_hypothesis(outputs[-1] if outputs else None, m, interval, reference[level])
            steps = (torch.arange(m, device=first.device, dtype=first.dtype).view(1, m, 1, 1) + middle) * interval
            regulariser = cast(CostRegulariser, self.regularisers[level])
            # Nothing of what made the cost volume is kept while it enters, nor the volume while the rest works.
            logits: Tensor = regulariser(regulariser.enter(self.regulariser_input(
                level, reference[level], [source[level] for source in sources], geometry,
                1.0 / depth_from_t(first + steps, geometry.near, geometry.far),
            ))).float()
            outputs.append(LevelOutput(logits, first, interval, *decode(logits, first, interval)))
        return outputs

    def regulariser_input(
        self, level: int, reference: Tensor, sources: list[Tensor], geometry: Geometry, inverse_depth: Tensor
    ) -> Tensor:
        """The cost volume of a level at `inverse_depth` (B,M,h,w) with the context behind it, (B,K+C,M,h,w), from the
        level's features (B,C_l,h,w)."""
        K = geometry.K
        pixels = pixel_grid(*(torch.arange(n, device=K.device, dtype=K.dtype) + 0.5
                              for n in reversed(inverse_depth.shape[2:])))
        terms = [homography_terms(level_intrinsics(K, level), geometry.cam_from_world, i + 1, pixels)
                 for i in range(len(sources))]
        compared = (lambda features: unit_length(features.float())) if self.config.cosine else Tensor.float
        weights = geometry.scores / geometry.scores.sum(1, keepdim=True)
        extents = geometry.extents * 0.5**level
        inputs = CostVolumeInput(compared(reference), sources, extents, terms, weights, inverse_depth, compared)
        context = (self.context[level](reference) if self.config.context else reference[:, :0]).unsqueeze(2)
        if torch.is_grad_enabled():
            repeated = context.expand(-1, -1, inverse_depth.shape[1], -1, -1)
            return torch.cat([self.cost_volume(level, inputs), repeated], 1)
        return self._filled(level, inputs, context)

    def cost_volume(self, level: int, inputs: CostVolumeInput, out: Tensor | None = None) -> Tensor:
        """Eq. 2: (B,K,M,h,w) from features and weights S_i / sum S, which `visibility` refines for each voxel. On a
        CPU, without gradients, it can be written to `out`."""
        beta = self.beta[level] if self.config.visibility else None
        groups, alpha = self.config.groups[level], self.alpha[level]
        if inputs.reference.device.type == "cpu":
            return fused_cost_volume(inputs, groups, alpha, beta, out)
        return plain_cost_volume(inputs, groups, alpha, beta)

    def _filled(self, level: int, inputs: CostVolumeInput, context: Tensor) -> Tensor:
        """The cost volume and the context (B,C,1,h,w) behind it without gradients: filled in place, in the type and
        layout that the regulariser takes."""
        b, m, h, w = inputs.inverse_depth.shape
        device, groups = context.device, self.config.groups[level]
        autocast = torch.is_autocast_enabled(device.type)
        filled = torch.empty(
            (b, groups + context.shape[1], m, h, w), device=device, memory_format=torch.channels_last_3d,
            dtype=torch.get_autocast_dtype(device.type) if autocast else inputs.inverse_depth.dtype,
        )
        filled[:, groups:] = context
        if device.type == "cpu":
            self.cost_volume(level, inputs, filled[:, :groups])
            return filled
        # Some hypotheses at a time: the warped features, not the volume, are what is large.
        step = max(1, SLICE_BYTES // (4 * self.config.channels[level] * h * w))
        for at in range(0, m, step):
            some = replace(inputs, inverse_depth=inputs.inverse_depth[:, at : at + step])
            filled[:, :groups, at : at + step] = self.cost_volume(level, some)
        return filled

    def estimate(self, image: Tensor, outputs: list[LevelOutput], points: Tensor) -> tuple[Tensor, Tensor]:
        """t and confidence in [0, 1], (B,1,H,W) each, from the reference's colours (B,3,H,W), the levels' outputs and
        sparse points (B,4,H/4,W/4) as refinement.rasterise_points has them; zeros where none are known.

        Confidence is the chance that the depth is within one interval (1/128 of the sweep).
        """
        if self.config.refinement:
            cascade = outputs[-1]
            t, logit = refined_depth(cascade.t, self.refine(image, outputs, points), cascade.interval)
            return t, torch.sigmoid(logit)
        *weights, constant = self.config.calibration
        total = torch.full_like(outputs[-1].confidence, constant)
        for weight, confidence in zip(weights, level_confidences(outputs).split(1, 1), strict=True):
            total += weight * torch.logit(confidence, eps=1e-4)
        return outputs[-1].t, torch.sigmoid(total)

    def refine(self, image: Tensor, outputs: list[LevelOutput], points: Tensor) -> Proposal:
        """What the refinement proposes in place of the cascade's outputs, which learn nothing from it; arguments as for
        `estimate`."""
        proposal: Proposal = self.refinement(
            image, outputs[-1].t.detach(), level_confidences(outputs), outputs[-1].interval, points)
        return proposal

    def channels_last(self) -> LCMMVSNet:
        """Lay the convolutions out channels-last in place, which CPUs want, and bf16 everywhere; returns self."""
        self.features.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        if self.config.refinement:
            self.refinement.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.regularisers.to(memory_format=torch.channels_last_3d)  # type: ignore[call-overload]
        return self

    def fold_batch_norm(self) -> LCMMVSNet:
        """Merge every batch normalisation into the convolution before it, in place; for use, not for training."""
        layers.fold_batch_norm(self)
        return self


def level_confidences(outputs: list[LevelOutput]) -> Tensor:
    """The levels' confidences at full resolution, (B,3,H,W) by level 0, 1, 2, without gradients."""
    size = outputs[-1].confidence.shape[2:]
    confidences = [F.interpolate(output.confidence.detach(), size, mode="bilinear", align_corners=False)
                   for output in reversed(outputs)]
    return torch.cat(confidences, 1)
