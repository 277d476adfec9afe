# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The network's building blocks, and what makes them quick on a CPU: the values are those of torch's plain layers.

Shapes: B samples, C and K channels, m hypotheses, h rows, w columns. Pixel centres lie at .5. A layer of stride 2 has
an even kernel, which keeps the centre of an output pixel at the centre of the pixels it came from: a level's intrinsics
are the photo's, scaled, and depth is not pulled off by half a hypothesis.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

STRIP_PIXELS = 4 << 20  # of a picture whose features are computed at once, without gradients: 200 bytes each meanwhile
HALO = 40  # pixels beyond a strip that its features depend on, a multiple of 4


class Conv3d(nn.Conv3d):
    """Asks oneDNN itself on a CPU in fp32: for one sample of few channels and planes torch would choose a loop of its
    own, ten to twenty times as slow."""

    def _conv_forward(self, input: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
        if (input.device.type == "cpu" and input.dtype == torch.float32 and not torch.is_autocast_enabled("cpu")
                and torch.backends.mkldnn.is_available()):
            padding = cast(tuple[int, ...], self.padding)
            return torch.mkldnn_convolution(input, weight, bias, padding, self.stride, self.dilation, self.groups)
        return super()._conv_forward(input, weight, bias)


class UpConv3d(nn.ConvTranspose3d):
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


def conv2d_block(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    """Convolution, batch normalisation, ReLU."""
    kernel = 4 if stride == 2 else 3
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, kernel, stride, 1, bias=False), nn.BatchNorm2d(outputs), nn.ReLU(inplace=True)
    )


def conv3d_block(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    """Convolution, batch normalisation, ReLU."""
    kernel = 4 if stride == 2 else 3
    return nn.Sequential(
        Conv3d(inputs, outputs, kernel, stride, 1, bias=False), nn.BatchNorm3d(outputs), nn.ReLU(inplace=True)
    )


def up_conv3d_block(inputs: int, outputs: int) -> nn.Sequential:
    """Twice the size: transposed convolution, batch normalisation, ReLU."""
    return nn.Sequential(
        UpConv3d(inputs, outputs, 2, 2, bias=False), nn.BatchNorm3d(outputs), nn.ReLU(inplace=True)
    )


def upsample_add(up: nn.Sequential, x: Tensor, skip: Tensor) -> Tensor:
    """`up(x) + skip` for an up_conv3d_block: written into `skip` where nothing else needs that and the layout allows,
    or three volumes of full size would stand beside each other."""
    if (torch.is_grad_enabled() or not isinstance(up[1], nn.Identity)
            or not skip.is_contiguous(memory_format=torch.channels_last_3d)):
        total: Tensor = up(x) + skip
        return total
    blocks = up[2](cast(UpConv3d, up[0]).blocks(x))
    skip.permute(0, 2, 3, 4, 1).view(blocks.shape).add_(blocks)
    return skip


def upsample(x: Tensor) -> Tensor:
    """Twice the size, bilinear, pixel centres at .5."""
    return F.interpolate(x, scale_factor=2.0, mode="bilinear", align_corners=False)


def unit_length(features: Tensor) -> Tensor:
    """(B,C,h,w) with a root mean square of 1 over C: the mean of a product of two such is their cosine."""
    return features * torch.rsqrt(features.float().square().mean(1, keepdim=True) + 1e-4).to(features.dtype)


def in_strips(pyramid: Callable[[Tensor], tuple[Tensor, ...]], images: Tensor) -> tuple[Tensor, ...]:
    """`pyramid` of pictures (B,3,H,W): features (B,C_l,H/2^l,W/2^l) by level; those of large ones in strips, without
    gradients, since it takes seven times as much memory as it leaves."""
    b, _, height, width = images.shape
    rows = max(STRIP_PIXELS // (b * width) // 32, 1) * 32
    if torch.is_grad_enabled() or height <= rows:
        return pyramid(images)
    whole: list[Tensor] = []
    for top in range(0, height, rows):
        first = max(top - HALO, 0)
        strip = pyramid(images[:, :, first : top + rows + HALO])
        if not whole:
            whole = [torch.empty((b, level.shape[1], height >> i, width >> i), dtype=level.dtype, device=level.device,
                                 memory_format=torch.channels_last) for i, level in enumerate(strip)]
        for i, (into, level) in enumerate(zip(whole, strip, strict=True)):
            own = into[:, :, top >> i : (top + rows) >> i]
            own.copy_(level[:, :, (top - first) >> i :][:, :, : own.shape[2]])
    return tuple(whole)


def fold_batch_norm(network: nn.Module) -> None:
    """Merge every batch normalisation into the convolution before it, in place; for use, not for training."""
    for block in [m for m in network.modules() if isinstance(m, nn.Sequential)]:
        for i in range(len(block) - 1):
            if isinstance(block[i + 1], (nn.BatchNorm2d, nn.BatchNorm3d)):
                transposed = isinstance(block[i], nn.ConvTranspose3d)
                block[i] = fuse_conv_bn_eval(  # type: ignore[type-var]
                    block[i], block[i + 1], transpose=transposed)  # type: ignore[arg-type]
                block[i + 1] = nn.Identity()
