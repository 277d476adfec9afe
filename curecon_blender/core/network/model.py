# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""LCM-MVSNet: cascade multi-view stereo whose cost volume weights each source view by its matching score.

Source: Li, Yang et al., "SD-3DR" (LCM-MVSNet), with the corrections noted at Eq. 2 and Eq. 3 below.

Shapes: B samples, V views (reference first), N = V - 1 sources, C channels, K groups, M depth hypotheses; level
l = 2, 1, 0 works at 1/4, 1/2, 1/1 of the photo. Pixel centres lie at .5. Depth is swept in the coordinate t in
[0, 1], uniform in inverse depth: t = 0 at `near`, t = 1 at `far`, growing with depth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from .cost_volume_cpu import Matching, fused_cost_volume
from .refinement import Proposal, Refinement, choose

LEVELS = (2, 1, 0)  # coarse to fine
LOCAL = 2  # hypotheses on each side of the likeliest that a linear decoder averages
FEWEST_HYPOTHESES, MOST_HYPOTHESES = 32, 256  # at the coarsest level
SLICE_BYTES = 64 << 20  # of warped features held at once, without gradients
MULTIPLE = 32  # heights and widths must divide by this: four scales of the regulariser at the coarsest level


@dataclass(frozen=True, kw_only=True)
class NetworkConfig:
    """Sizes of the network, by level 0, 1, 2, and where it departs from the paper (`PAPER` is the plain model).

    `hypothesis_step`: how far apart neighbouring hypotheses lie, in pixels of their level, in the mean of the sources;
    the coarsest level gets as many as the range then needs. None: always `hypotheses[2]`, as in the paper.
    `representation`: "linear" splits a depth between the two hypotheses around it and decodes a local mean, which
    stays unbiased where the network is unsure; "unified" is the paper's (Eq. 3).
    `cosine`: features are scaled to unit length, so that a match is worth as much in shade as in the sun.
    `visibility`: a source that agrees better at a voxel has more say there, by a learned factor, and one that does not
    see the voxel has none: beside an edge the sources that look behind it are outvoted.
    `context`: channels of the reference's own features that each level's regulariser sees beside the cost volume, so
    that it knows where a surface may end and what no source can tell. 0: none, as in the paper.
    `refinement`: channels of the refinement after the cascade (refinement.py). 0: none, as in the paper.
    """

    channels: tuple[int, int, int] = (8, 16, 32)
    groups: tuple[int, int, int] = (8, 8, 8)
    hypotheses: tuple[int, int, int] = (8, 16, 48)
    interval_ratios: tuple[int, int, int] = (1, 2, 4)
    regulariser_channels: int = 8
    bottom_up: bool = True
    hypothesis_step: float | None = 1.0
    representation: Literal["linear", "unified"] = "linear"
    cosine: bool = True
    visibility: bool = True
    context: int = 4
    refinement: int = 48
    # Confidence without refinement: weights of the levels' logit shares, then the constant; fitted by
    # training/export.py.
    calibration: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 0.0)


PAPER = NetworkConfig(hypothesis_step=None, representation="unified", cosine=False, visibility=False, context=0,
                      refinement=0)


@dataclass(frozen=True)
class LevelOutput:
    """One level's result at its own resolution (h, w).

    `logits` (B,M,h,w) of the probability volume P; `first` (B,1,h,w) is t where the first hypothesis' interval begins;
    `interval` is r in t; `t` (B,1,h,w) the estimate; `share` (B,1,h,w) in [0, 1], how much of P is gathered there.
    """

    logits: Tensor
    first: Tensor
    interval: float
    t: Tensor
    share: Tensor


def depth_from_t(t: Tensor, near: Tensor, far: Tensor) -> Tensor:
    """z-depth at sweep coordinate t; `near` and `far` (B,) broadcast over the last three dimensions."""
    near, far = near.view(-1, 1, 1, 1), far.view(-1, 1, 1, 1)
    return 1.0 / (1.0 / near + t * (1.0 / far - 1.0 / near))


def t_from_depth(depth: Tensor, near: Tensor, far: Tensor) -> Tensor:
    """Inverse of depth_from_t; depth must be positive."""
    near, far = near.view(-1, 1, 1, 1), far.view(-1, 1, 1, 1)
    return (1.0 / depth - 1.0 / near) / (1.0 / far - 1.0 / near)


def _conv2d(inputs: int, outputs: int, kernel: int = 3, stride: int = 1) -> nn.Sequential:
    # Even kernels for stride 2 keep the centre of an output pixel at the centre of the pixels it came from, so that
    # a level's intrinsics are the photo's, scaled.
    kernel = 4 if stride == 2 else kernel
    padding = 1 if stride == 2 else kernel // 2
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, kernel, stride, padding, bias=False), nn.BatchNorm2d(outputs), nn.ReLU(inplace=True)
    )


class _Conv3d(nn.Conv3d):
    """Asks oneDNN itself on a CPU in fp32: for one sample of few channels and planes torch would choose a loop of its
    own, ten to twenty times as slow."""

    def _conv_forward(self, input: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
        if (input.device.type == "cpu" and input.dtype == torch.float32 and not torch.is_autocast_enabled("cpu")
                and torch.backends.mkldnn.is_available()):
            padding = cast(tuple[int, ...], self.padding)
            return torch.mkldnn_convolution(input, weight, bias, padding, self.stride, self.dilation, self.groups)
        return super()._conv_forward(input, weight, bias)


class _Doubling(nn.ConvTranspose3d):
    """Twice the size in all three directions. Its blocks of 2x2x2 do not overlap, so it is one product of matrices: a
    third of the time of torch's own loop for one sample on a CPU."""

    def forward(self, input: Tensor, output_size: list[int] | None = None) -> Tensor:
        b, _, m, h, w = input.shape
        return self.blocks(input).reshape(b, 2 * m, 2 * h, 2 * w, -1).permute(0, 4, 1, 2, 3)

    def blocks(self, input: Tensor) -> Tensor:
        """From (B,C,m,h,w): each voxel's block where it belongs, (B,m,2,h,2,w,2*K), two neighbours along a row together
        with their K channels."""
        weight = self.weight.permute(2, 3, 4, 1, 0).flatten(0, 3)
        bias = None if self.bias is None else self.bias.repeat(8)
        blocks = F.linear(input.permute(0, 2, 3, 4, 1), weight, bias)
        return blocks.unflatten(-1, (2, 2, -1)).permute(0, 1, 4, 2, 5, 3, 6)


def _raised(up: nn.Sequential, x: Tensor, skip: Tensor) -> Tensor:
    """x doubled, and added to what is there at its size: in place where nothing else needs it and the layout allows, or
    three volumes of full size would stand beside each other."""
    if (torch.is_grad_enabled() or not isinstance(up[1], nn.Identity)
            or not skip.is_contiguous(memory_format=torch.channels_last_3d)):
        raised: Tensor = up(x) + skip
        return raised
    blocks = up[2](cast(_Doubling, up[0]).blocks(x))
    skip.permute(0, 2, 3, 4, 1).view(blocks.shape).add_(blocks)
    return skip


def _conv3d(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    kernel = 4 if stride == 2 else 3  # as in two dimensions; an odd kernel would pull depth off by half a hypothesis
    return nn.Sequential(
        _Conv3d(inputs, outputs, kernel, stride, 1, bias=False), nn.BatchNorm3d(outputs), nn.ReLU(inplace=True)
    )


class FeaturePyramid(nn.Module):
    """(B,3,H,W) to features (B,C_l,H/2^l,W/2^l): an FPN, then PANet's bottom-up path (paper, section on features)."""

    def __init__(self, channels: tuple[int, int, int], bottom_up: bool) -> None:
        super().__init__()
        c0, c1, c2 = channels
        self.stem = nn.Sequential(_conv2d(3, c0), _conv2d(c0, c0))
        self.down1 = nn.Sequential(_conv2d(c0, c1, stride=2), _conv2d(c1, c1), _conv2d(c1, c1))
        self.down2 = nn.Sequential(_conv2d(c1, c2, stride=2), _conv2d(c2, c2), _conv2d(c2, c2))
        self.lateral2 = nn.Conv2d(c2, c2, 1)
        self.lateral1 = nn.Conv2d(c1, c2, 1)
        self.lateral0 = nn.Conv2d(c0, c2, 1)
        self.smooth1 = nn.Conv2d(c2, c1, 3, padding=1)
        self.smooth0 = nn.Conv2d(c2, c0, 3, padding=1)
        self.bottom_up = bottom_up
        if bottom_up:
            self.up1, self.fuse1 = _conv2d(c0, c1, stride=2), nn.Conv2d(c1, c1, 3, padding=1)
            self.up2, self.fuse2 = _conv2d(c1, c2, stride=2), nn.Conv2d(c2, c2, 3, padding=1)

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


class CostRegulariser(nn.Module):
    """Four-scale 3D U-Net: cost volume (B,K,M,h,w), by way of `enter`, to logits (B,M,h,w). M, h, w divide by 8."""

    def __init__(self, inputs: int, base: int) -> None:
        super().__init__()
        c = [base, base * 2, base * 4, base * 8]
        self.enter = _conv3d(inputs, c[0])
        self.down = nn.ModuleList(
            nn.Sequential(_conv3d(c[i], c[i + 1], stride=2), _conv3d(c[i + 1], c[i + 1])) for i in range(3)
        )
        self.up = nn.ModuleList(
            nn.Sequential(
                _Doubling(c[i + 1], c[i], 2, 2, bias=False), nn.BatchNorm3d(c[i]), nn.ReLU(inplace=True)
            )
            for i in range(3)
        )
        self.leave = _Conv3d(c[0], 1, 3, padding=1)
        nn.init.constant_(self.leave.bias, -2.5)  # type: ignore[arg-type]  # most hypotheses are wrong

    def forward(self, entered: Tensor) -> Tensor:
        """The logits, from what `enter` makes of a cost volume; without gradients that may be overwritten."""
        skips = [entered]
        for down in self.down:
            skips.append(down(skips[-1]))
        x = skips.pop()
        for up in reversed(self.up):
            x = _raised(cast(nn.Sequential, up), x, skips.pop())
        logits: Tensor = self.leave(x).squeeze(1)
        return logits


def level_intrinsics(K: Tensor, level: int) -> Tensor:
    """Intrinsics (...,3,3) of a level: pixel centres at .5 make it a plain scaling of the first two rows."""
    scale = torch.tensor([0.5**level, 0.5**level, 1.0], dtype=K.dtype, device=K.device)
    return K * scale.view(3, 1)


def homography_terms(K: Tensor, cam_from_world: Tensor, source: int, pixels: Tensor) -> tuple[Tensor, Tensor]:
    """Terms of the plane homographies from view 0 to view `source`, for (B,V,3,3) intrinsics and (B,V,3,4) poses.

    A pixel of `pixels` (1,3,P), homogeneous, at inverse depth w maps to rotated + w * shifted: (B,3,P) and (B,3,1).
    """
    # Autocast would multiply these matrices in bf16, whose eight bits put a source several pixels off its place.
    with torch.autocast(K.device.type, enabled=False):
        src_from_ref = relative_pose(cam_from_world[:, source], cam_from_world[:, 0])
        rotated = K[:, source] @ src_from_ref[:, :, :3] @ torch.linalg.inv(K[:, 0]) @ pixels
        shifted = K[:, source] @ src_from_ref[:, :, 3:]
    return rotated, shifted


def pixel_grid(x: Tensor, y: Tensor) -> Tensor:
    """(1,3,h*w) homogeneous pixels of the columns x (w,) and rows y (h,)."""
    rows, columns = torch.meshgrid(y, x, indexing="ij")
    return torch.stack([columns, rows, torch.ones_like(rows)]).reshape(1, 3, -1)


def warp(feature: Tensor, rotated: Tensor, shifted: Tensor, inverse_depth: Tensor) -> tuple[Tensor, Tensor]:
    """Source features (B,C,hs,ws) seen from the reference at `inverse_depth` (B,M,h,w): (B,C,M,h,w), and where the
    source sees it, (B,1,M,h,w) bool. What falls outside the source, or behind it, is zero.
    """
    b, m, h, w = inverse_depth.shape
    homogeneous = rotated.unsqueeze(2) + shifted.unsqueeze(2) * inverse_depth.reshape(b, 1, m, h * w)
    z = homogeneous[:, 2]
    size = torch.tensor([feature.shape[3], feature.shape[2]], dtype=z.dtype, device=z.device)
    grid = homogeneous[:, :2] / z.clamp_min(1e-6).unsqueeze(1) * (2.0 / size).view(1, 2, 1, 1) - 1.0
    grid = torch.where(z.unsqueeze(1) > 1e-6, grid, 2.0).clamp(-2.0, 2.0)
    seen = (grid.abs() < 1).all(1).view(b, 1, m, h, w)
    grid = grid.permute(0, 2, 3, 1).reshape(b, m * h, w, 2)
    warped = F.grid_sample(feature, grid, mode="bilinear", padding_mode="zeros", align_corners=False)
    return warped.reshape(b, -1, m, h, w), seen


def plain_cost_volume(given: Matching, groups: int, alpha: Tensor, beta: Tensor | None) -> Tensor:
    """What fused_cost_volume computes, arguments as there, in torch's own operations: for graphics cards."""
    b, c = given.reference.shape[:2]
    scaled = (given.reference * (groups / c)).unsqueeze(2)  # the mean over a group's channels becomes a sum
    total = norm = torch.zeros((), device=scaled.device)
    for i, (source, (rotated, shifted)) in enumerate(zip(given.sources, given.terms, strict=True)):
        warped, seen = warp(source, rotated, shifted, given.inverse_depth)
        product = (warped * scaled).reshape(b, groups, c // groups, *given.inverse_depth.shape[1:])
        similarity = product.sum(2) if c > groups else product[:, :, 0]
        weight = given.weights[:, i].view(-1, 1, 1, 1, 1)
        if beta is not None:
            weight = weight * seen * torch.exp(beta * similarity.mean(1, keepdim=True))
        total, norm = total + weight * seen * similarity, norm + weight
    return alpha * total / norm.clamp_min(1e-6)


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

    def channels_last(self) -> LCMMVSNet:
        """Lay the convolutions out channels-last in place, which CPUs want, and bf16 everywhere; returns self."""
        self.features.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        if self.config.refinement:
            self.refinement.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.regularisers.to(memory_format=torch.channels_last_3d)  # type: ignore[call-overload]
        return self

    def fold_batch_norm(self) -> LCMMVSNet:
        """Merge every batch normalisation into the convolution before it, in place; for use, not for training."""
        for block in [m for m in self.modules() if isinstance(m, nn.Sequential)]:
            for i in range(len(block) - 1):
                if isinstance(block[i + 1], (nn.BatchNorm2d, nn.BatchNorm3d)):
                    transposed = isinstance(block[i], nn.ConvTranspose3d)
                    block[i] = fuse_conv_bn_eval(  # type: ignore[type-var]
                        block[i], block[i + 1], transpose=transposed)  # type: ignore[arg-type]
                    block[i + 1] = nn.Identity()
        return self

    def pyramid(self, images: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Features of (B,3,H,W) colours in [0, 1], by level 0, 1, 2."""
        features: tuple[Tensor, Tensor, Tensor] = self.features((images - 0.45) / 0.25)
        return features

    def cost_volume(self, level: int, given: Matching, out: Tensor | None = None) -> Tensor:
        """Eq. 2, the learnable cost metric: (B,K,M,h,w) from features and weights S_i / sum S, which `visibility`
        refines for each voxel. On a CPU, without gradients, it can be written to `out`."""
        beta = self.beta[level] if self.config.visibility else None
        groups, alpha = self.config.groups[level], self.alpha[level]
        if given.reference.device.type == "cpu":
            return fused_cost_volume(given, groups, alpha, beta, out)
        return plain_cost_volume(given, groups, alpha, beta)

    def regularisers_input(
        self,
        level: int,
        reference: Tensor,
        sources: list[Tensor],
        K: Tensor,
        cam_from_world: Tensor,
        weights: Tensor,
        inverse_depth: Tensor,
    ) -> Tensor:
        """The cost volume of a level with the context behind it, (B,K+C,M,h,w), from its features (B,C_l,h,w)."""
        b, m, h, w = inverse_depth.shape
        context = self.context[level](reference) if self.config.context else reference[:, :0]
        context = context.unsqueeze(2)
        pixels = pixel_grid(*(torch.arange(n, device=K.device, dtype=K.dtype) + 0.5 for n in (w, h)))
        terms = [homography_terms(level_intrinsics(K, level), cam_from_world, i + 1, pixels)
                 for i in range(len(sources))]
        matched = [features.float() for features in (reference, *sources)]
        if self.config.cosine:
            matched = [_unit(features) for features in matched]
        given = Matching(matched[0], matched[1:], terms, weights, inverse_depth)
        if torch.is_grad_enabled():
            return torch.cat([self.cost_volume(level, given), context.expand(-1, -1, m, -1, -1)], 1)
        # Filled in place, in the type and layout that the regulariser takes.
        device, groups = context.device, self.config.groups[level]
        autocast = torch.is_autocast_enabled(device.type)
        filled = torch.empty(
            (b, groups + context.shape[1], m, h, w), device=device, memory_format=torch.channels_last_3d,
            dtype=torch.get_autocast_dtype(device.type) if autocast else inverse_depth.dtype,
        )
        filled[:, groups:] = context
        if device.type == "cpu":
            self.cost_volume(level, given, filled[:, :groups])
            return filled
        # Some hypotheses at a time: the warped features, not the volume, are what is large.
        step = max(1, SLICE_BYTES // (4 * self.config.channels[level] * h * w))
        for at in range(0, m, step):
            some = replace(given, inverse_depth=inverse_depth[:, at : at + step])
            filled[:, :groups, at : at + step] = self.cost_volume(level, some)
        return filled

    def forward(
        self, images: Tensor, K: Tensor, cam_from_world: Tensor, near: Tensor, far: Tensor, scores: Tensor
    ) -> list[LevelOutput]:
        """Depth of the reference, view 0.

        `images` (B,V,3,H,W) in [0, 1], H and W multiples of 32; `K` (B,V,3,3); `cam_from_world` (B,V,3,4);
        `near`, `far` (B,) world units; `scores` (B,N) matching scores S_i of Algorithm 1, at least one positive.
        """
        b, v = images.shape[:2]
        pyramid = self.pyramid(images.flatten(0, 1))
        views = [tuple(level.unflatten(0, (b, v))[:, i] for level in pyramid) for i in range(v)]
        count = self.coarse_hypotheses(K, cam_from_world, near, far, (images.shape[4], images.shape[3]))
        return self.sweep(views[0], views[1:], K, cam_from_world, near, far, scores, count)

    def coarse_hypotheses(
        self, K: Tensor, cam_from_world: Tensor, near: Tensor, far: Tensor, size: tuple[int, int]
    ) -> int:
        """How many hypotheses the coarsest level sweeps, a multiple of 8, for a reference of `size` (W, H): as many
        as put neighbours `hypothesis_step` pixels of that level apart, for the sample that asks for most."""
        if self.config.hypothesis_step is None:
            return self.config.hypotheses[2]
        pixels = float(mean_disparity(K, cam_from_world, near, far, size).max()) / 4
        wanted = 8 * math.ceil(pixels / self.config.hypothesis_step / 8)
        return min(max(wanted, FEWEST_HYPOTHESES), MOST_HYPOTHESES)

    def sweep(
        self,
        reference: tuple[Tensor, ...],
        sources: list[tuple[Tensor, ...]],
        K: Tensor,
        cam_from_world: Tensor,
        near: Tensor,
        far: Tensor,
        scores: Tensor,
        coarse_hypotheses: int,
    ) -> list[LevelOutput]:
        """`forward` from ready features, by level 0, 1, 2, of each view, with so many hypotheses (a multiple of 8)
        at the coarsest level; the finer levels' intervals follow from its interval by the config's ratios."""
        config = self.config
        middle = 0.5 if config.representation == "linear" else 0.0  # where a hypothesis stands in its interval
        weights = scores / scores.sum(1, keepdim=True)
        outputs: list[LevelOutput] = []
        for level in LEVELS:
            h, w = reference[level].shape[2:]
            interval = config.interval_ratios[level] / config.interval_ratios[2] / coarse_hypotheses
            m = config.hypotheses[level] if outputs else coarse_hypotheses
            if outputs:  # a window around the upsampled coarser estimate
                first = (upsample(outputs[-1].t.detach()) - m * interval / 2).clamp(0.0, 1.0 - m * interval)
            else:
                first = torch.zeros(reference[level].shape[0], 1, h, w, device=reference[level].device)
            steps = (torch.arange(m, device=first.device, dtype=first.dtype).view(1, m, 1, 1) + middle) * interval
            regulariser = cast(CostRegulariser, self.regularisers[level])
            # Nothing of what made the cost volume is kept while it enters, nor the volume while the rest works.
            logits: Tensor = regulariser(regulariser.enter(self.regularisers_input(
                level, reference[level], [source[level] for source in sources], K, cam_from_world, weights,
                1.0 / depth_from_t(first + steps, near, far),
            ))).float()
            decode = decode_linear if config.representation == "linear" else decode_unified
            outputs.append(LevelOutput(logits, first, interval, *decode(logits, first, interval)))
        return outputs

    def estimate(self, image: Tensor, outputs: list[LevelOutput], points: Tensor) -> tuple[Tensor, Tensor]:
        """t and confidence in [0, 1], (B,1,H,W) each, from the reference's colours (B,3,H,W), the levels' outputs and
        sparse points (B,4,H/4,W/4) as refinement.rasterised has them; zeros where none are known.

        Confidence is the chance that the depth is within one interval (1/128 of the sweep).
        """
        if self.config.refinement:
            cascade = outputs[-1]
            t, sure = choose(cascade.t, self.refine(image, outputs, points), cascade.interval)
            return t, torch.sigmoid(sure)
        *weights, constant = self.config.calibration
        total = torch.full_like(outputs[-1].share, constant)
        for weight, share in zip(weights, full_shares(outputs).split(1, 1), strict=True):
            total += weight * torch.logit(share, eps=1e-4)
        return outputs[-1].t, torch.sigmoid(total)

    def refine(self, image: Tensor, outputs: list[LevelOutput], points: Tensor) -> Proposal:
        """What the refinement proposes in place of the cascade's outputs, which learn nothing from it; arguments as for
        `estimate`."""
        proposal: Proposal = self.refinement(
            image, outputs[-1].t.detach(), full_shares(outputs), outputs[-1].interval, points)
        return proposal


def full_shares(outputs: list[LevelOutput]) -> Tensor:
    """The levels' shares at full resolution, (B,3,H,W) by level 0, 1, 2, without gradients."""
    size = outputs[-1].share.shape[2:]
    shares = [F.interpolate(output.share.detach(), size, mode="bilinear", align_corners=False)
              for output in reversed(outputs)]
    return torch.cat(shares, 1)


def relative_pose(cam_from_world: Tensor, ref_from_world: Tensor) -> Tensor:
    """cam_from_ref (B,3,4) of two poses (B,3,4)."""
    rotation = cam_from_world[:, :, :3] @ ref_from_world[:, :, :3].transpose(1, 2)
    translation = cam_from_world[:, :, 3:] - rotation @ ref_from_world[:, :, 3:]
    return torch.cat([rotation, translation], 2)


def upsample(x: Tensor) -> Tensor:
    """Twice the size, bilinear, pixel centres at .5."""
    return F.interpolate(x, scale_factor=2.0, mode="bilinear", align_corners=False)


def _unit(features: Tensor) -> Tensor:
    """(B,C,h,w) with a root mean square of 1 over C: the mean of a product of two such is their cosine."""
    return features * torch.rsqrt(features.float().square().mean(1, keepdim=True) + 1e-4).to(features.dtype)


def mean_disparity(
    K: Tensor, cam_from_world: Tensor, near: Tensor, far: Tensor, size: tuple[int, int]
) -> Tensor:
    """(B,) pixels of a source that the sweep from near to far passes over, in the mean of the sources.

    Measured by the speed at the middle of the sweep, at nine pixels of a reference of `size` (W, H), since the ends
    of a sweep often lie outside or behind a source. Shapes as for LCMMVSNet.forward.
    """
    pixels = pixel_grid(*(torch.tensor([0.2, 0.5, 0.8], device=K.device) * length for length in size))
    middle, span = (1 / near + 1 / far) / 2, 1 / near - 1 / far
    speeds = []
    for i in range(1, K.shape[1]):
        rotated, shifted = homography_terms(K, cam_from_world, i, pixels)
        homogeneous = rotated + middle.view(-1, 1, 1) * shifted
        z = homogeneous[:, 2:]
        velocity = (shifted[:, :2] - homogeneous[:, :2] / z * shifted[:, 2:]) / z
        speed = torch.where(z[:, 0] > 1e-3, velocity.norm(dim=1), 0.0)  # 0 behind the source
        speeds.append(speed.median(1).values * span)
    return torch.stack(speeds).mean(0)


def decode_linear(logits: Tensor, first: Tensor, interval: float) -> tuple[Tensor, Tensor]:
    """Mean of t over the hypotheses within LOCAL of the likeliest, and P's share within one of it, each (B,1,h,w)."""
    probability = torch.softmax(logits, 1)
    index = probability.max(1, keepdim=True).indices  # a third of argmax's time across planes
    m = logits.shape[1]
    total = mean = share = torch.zeros_like(first)
    for o in range(-LOCAL, LOCAL + 1):
        inside = (index + o >= 0) & (index + o < m)
        p = torch.where(inside, probability.gather(1, (index + o).clamp(0, m - 1)), 0.0)
        total, mean = total + p, mean + p * o
        if abs(o) <= 1:
            share = share + p
    return first + interval * (index + 0.5 + mean / total), share


def decode_unified(logits: Tensor, first: Tensor, interval: float) -> tuple[Tensor, Tensor]:
    """Eq. 3: t = t_m* + r (1 - max P), and P's share within one hypothesis of m*, each (B,1,h,w).

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
