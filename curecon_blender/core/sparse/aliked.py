# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""ALIKED: keypoints and descriptors by a small network (Zhao et al., IEEE Trans. Instrum. Meas. 2023), its n16 form.

A convolutional encoder gives maps at 1, 1/2, 1/8 and 1/32 of the picture's size. Keypoints are the peaks of a score map
(DKD: refined by a soft argmax); a descriptor is gathered from 16 places around its keypoint that the network chooses
(SDDH). The maps are never brought to full size together, which would take 0.5 KB a pixel: the score head is linear in
them up to its first activation, and descriptors need them at a few places only.

Modules are named as in the authors' weights.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import nn

WIDTHS = 16, 32, 64, 128  # channels of the four maps
PART = 32  # channels that each map gives to a descriptor
PLACES = 16  # that a descriptor is gathered from
STRIDE = 32  # of the coarsest map: pictures are padded to a multiple
RADIUS = 2  # pixels around a peak with no other, and over which it is refined
TEMPERATURE = 0.1  # of the soft argmax
LEAST_SCORE = 0.2  # of a keypoint


class DeformableConv(nn.Module):
    """A 3x3 convolution whose nine taps move, pixel by pixel, by learnt offsets; zero outside (Dai et al., 2017)."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.offset_conv = nn.Conv2d(inputs, 18, 3, padding=1)
        self.regular_conv = nn.Conv2d(inputs, outputs, 3, padding=1, bias=False)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Maps (1,C,H,W) to (1,outputs,H,W)."""
        height, width = x.shape[2:]
        reach = max(height, width) / 4
        offsets = self.offset_conv(x).clamp(-reach, reach).view(9, 2, height, width)  # down, right
        rows = torch.arange(height, device=x.device, dtype=x.dtype).view(1, -1, 1)
        columns = torch.arange(width, device=x.device, dtype=x.dtype).view(1, 1, -1)
        tap = torch.arange(9, device=x.device).view(-1, 1, 1)
        down = rows + tap // 3 - 1 + offsets[:, 0]
        right = columns + tap % 3 - 1 + offsets[:, 1]
        taps = _sample(x, torch.stack([right, down], dim=-1).view(1, 9 * height, width, 2), (width, height))
        taps = taps.view(-1, height * width)  # (C*9, H*W)
        return (self.regular_conv.weight.flatten(1) @ taps).view(1, -1, height, width)


class Block(nn.Module):
    """Two 3x3 convolutions; with `residual`, around them a 1x1 convolution that is added."""

    def __init__(self, inputs: int, outputs: int, *, deformable: bool, residual: bool) -> None:
        super().__init__()
        kind = DeformableConv if deformable else _conv3
        self.conv1, self.bn1 = kind(inputs, outputs), nn.BatchNorm2d(outputs)
        self.conv2, self.bn2 = kind(outputs, outputs), nn.BatchNorm2d(outputs)
        self.downsample = nn.Conv2d(inputs, outputs, 1) if residual else None

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        y = F.selu(self.bn1(self.conv1(x)))
        y = self.bn2(self.conv2(y))
        return F.selu(y if self.downsample is None else y + self.downsample(x))


class DescriptorHead(nn.Module):
    """Sparse deformable descriptor head."""

    def __init__(self, width: int) -> None:
        super().__init__()
        count = 2 * PLACES
        self.offset_conv = nn.Sequential(nn.Conv2d(width, count, 3), nn.SELU(), nn.Conv2d(count, count, 1))
        self.sf_conv = nn.Conv2d(width, width, 1, bias=False)
        self.agg_weights = nn.Parameter(torch.empty(PLACES, width, width))

    def offsets(self, patches: torch.Tensor, reach: float) -> torch.Tensor:
        """Where to gather from (K,PLACES,2), in pixels from the keypoints, by the features around them (K,C,3,3)."""
        return self.offset_conv(patches).clamp(-reach, reach).view(-1, 2, PLACES).transpose(1, 2)

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """Unit descriptors (K,C) from the features (K,PLACES,C) at those places."""
        features = F.selu(features @ self.sf_conv.weight.flatten(1).T)
        return F.normalize(torch.einsum("kpc,pcd->kd", features, self.agg_weights), dim=1)


class Aliked(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        first, second, third, fourth = WIDTHS
        self.block1 = Block(3, first, deformable=False, residual=False)
        self.block2 = Block(first, second, deformable=False, residual=True)
        self.block3 = Block(second, third, deformable=True, residual=True)
        self.block4 = Block(third, fourth, deformable=True, residual=True)
        self.conv1, self.conv2, self.conv3, self.conv4 = (nn.Conv2d(width, PART, 1, bias=False) for width in WIDTHS)
        self.score_head = nn.Sequential(
            nn.Conv2d(4 * PART, 8, 1, bias=False), nn.SELU(), _conv3(8, 4), nn.SELU(), _conv3(4, 4), nn.SELU(),
            _conv3(4, 1),
        )
        self.desc_head = DescriptorHead(4 * PART)

    def forward(self, picture: torch.Tensor, most: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Keypoints (K,2) with pixel centres at integers, and unit descriptors (K,128), of a picture (1,3,H,W) in 0..1.

        The `most` highest peaks of the score map.
        """
        padded, size, origin = _padded(picture)
        maps = self._maps(padded)
        (width, height), (left, top) = size, origin
        keypoints = find_peaks(self._score(maps)[:, :, top : top + height, left : left + width], most)
        return keypoints, self._describe(maps, keypoints, size, origin)

    def describe(self, picture: torch.Tensor, keypoints: torch.Tensor) -> torch.Tensor:
        """Unit descriptors (K,128) at keypoints (K,2) that were found otherwise."""
        padded, size, origin = _padded(picture)
        return self._describe(self._maps(padded), keypoints, size, origin)

    def _maps(self, picture: torch.Tensor) -> list[torch.Tensor]:
        x1 = self.block1(picture)
        x2 = self.block2(F.avg_pool2d(x1, 2))
        x3 = self.block3(F.avg_pool2d(x2, 4))
        x4 = self.block4(F.avg_pool2d(x3, 4))
        convs = (self.conv1, self.conv2, self.conv3, self.conv4)
        return [F.selu(conv(x)) for conv, x in zip(convs, (x1, x2, x3, x4), strict=True)]

    def _score(self, maps: list[torch.Tensor]) -> torch.Tensor:
        """The score (1,1,H,W): the head's first convolution goes before the enlargement, which is linear like it."""
        size = maps[0].shape[2:]
        weights = torch.split(self.get_parameter("score_head.0.weight"), PART, dim=1)
        total = F.conv2d(maps[0], weights[0])
        for part, weight in zip(maps[1:], weights[1:], strict=True):
            total += F.interpolate(F.conv2d(part, weight), size, mode="bilinear", align_corners=True)
        return torch.sigmoid(self.score_head[1:](total))

    def _describe(
        self, maps: list[torch.Tensor], keypoints: torch.Tensor, size: tuple[int, int], origin: tuple[int, int]
    ) -> torch.Tensor:
        limits = keypoints.new_tensor(size) - 1
        start = keypoints.new_tensor(origin)

        def features(pixels: torch.Tensor) -> torch.Tensor:
            """Unit features (...,C) at whole pixels (...,2), zero outside the picture."""
            height, width = maps[0].shape[2:]
            places = (pixels + start).reshape(1, 1, -1, 2)
            found = torch.cat([_sample(part, places, (width, height)) for part in maps], dim=1)[0, :, 0].T
            inside = ((pixels >= 0) & (pixels <= limits)).all(-1, keepdim=True)
            return F.normalize(found, dim=1).view(*pixels.shape[:-1], -1) * inside

        steps = torch.arange(3, device=keypoints.device)
        around = torch.stack(torch.meshgrid(steps, steps, indexing="xy"), dim=-1)  # (3,3,2)
        corners = torch.minimum((keypoints.floor() - 1).clamp(min=0), limits - 3)
        patches = features(corners[:, None, None] + around).permute(0, 3, 1, 2)
        places = keypoints[:, None] + self.desc_head.offsets(patches, max(size) / 4)
        low = places.floor()
        gathered = torch.zeros((*places.shape[:-1], 4 * PART), device=places.device)
        for corner in around[:2, :2].reshape(4, 2):
            nearness = (1 - (places - low - corner).abs()).prod(-1, keepdim=True)
            gathered += nearness * features(low + corner)
        descriptors: torch.Tensor = self.desc_head(gathered)
        return descriptors


def find_peaks(score: torch.Tensor, most: int) -> torch.Tensor:
    """Keypoints (K,2) as right, down, of a score map (1,1,H,W): at most `most`, the highest first.

    A peak is the highest within RADIUS; what lies near one makes no second one. It moves to the mean of its
    surroundings, weighted by the exponent of their scores.
    """
    size = 2 * RADIUS + 1

    def highest(x: torch.Tensor) -> torch.Tensor:
        return F.max_pool2d(x, size, stride=1, padding=RADIUS)

    peaks = score == highest(score)
    for _ in range(2):  # peaks of what the first ones do not cover
        covered = highest(peaks.float()) > 0
        rest = score.masked_fill(covered, 0)
        peaks |= (rest == highest(rest)) & ~covered
    peaks[:, :, :RADIUS] = peaks[:, :, -RADIUS:] = False
    peaks[..., :RADIUS] = peaks[..., -RADIUS:] = False
    width = score.shape[3]
    places = (peaks & (score > LEAST_SCORE)).flatten().nonzero()[:, 0]
    places = places[score.flatten()[places].argsort(descending=True)[:most]]
    steps = torch.arange(-RADIUS, RADIUS + 1, device=score.device)
    around = torch.stack(torch.meshgrid(steps, steps, indexing="xy"), dim=-1).view(-1, 2)
    near = score.flatten()[places[:, None] + around[:, 1] * width + around[:, 0]]
    weights = torch.softmax(near / TEMPERATURE, dim=1)
    return torch.stack([places % width, places // width], dim=1) + weights @ around.to(score.dtype)


def _sample(x: torch.Tensor, places: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
    """Maps (1,C,h,w), whose corner pixels are those of a picture of `size`, at places (1,A,B,2) of that picture."""
    scale = places.new_tensor([2 / max(side - 1, 1) for side in size])
    return F.grid_sample(x, places * scale - 1, mode="bilinear", align_corners=True)


def _padded(picture: torch.Tensor) -> tuple[torch.Tensor, tuple[int, int], tuple[int, int]]:
    """A picture (1,3,H,W) with sides that STRIDE divides; its own size (W, H), and where that lies (left, top)."""
    height, width = picture.shape[2:]
    across, down = -width % STRIDE, -height % STRIDE
    left, top = across // 2, down // 2
    padded = F.pad(picture, (left, across - left, top, down - top), mode="replicate")
    return padded, (width, height), (left, top)


def _conv3(inputs: int, outputs: int) -> nn.Conv2d:
    return nn.Conv2d(inputs, outputs, 3, padding=1, bias=False)
