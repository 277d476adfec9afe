# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Eq. 2 on a CPU, with its gradients: every voxel in one go, so that no warped feature is ever written to memory.

`model.plain_cost_volume` computes the same in torch's own operations, which a graphics card runs well; a CPU spends
most of their time on moving the warped features of all hypotheses to and fro. tests/test_network.py holds the two
together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import exp
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .compiled import compiled, in_bands

_ZERO, _HALF, _ONE, _SMALL = np.float32(0), np.float32(0.5), np.float32(1), np.float32(1e-6)
_NOWHERE = np.float32(-9)  # a pixel outside every picture

BAND_BYTES = 4 << 20  # of float32 costs that a thread makes at once: what fits the processor's cache


@dataclass(frozen=True)
class CostVolumeInput:
    """What a cost volume is made of: the reference's features (B,C,h,w) as they are compared, each source's (B,C,hs,ws)
    before `compared`, the width and height (B,N,2) of what those show of the source (beyond is padding), the terms of
    each source's homographies (homographies.homography_terms), the sources' weights (B,N), and inverse depths
    (B,M,h,w). All sources as they are compared take more memory than all else: they are made one at a time."""

    reference: Tensor
    sources: list[Tensor]
    extents: Tensor
    terms: list[tuple[Tensor, Tensor]]
    weights: Tensor
    inverse_depth: Tensor
    compared: Callable[[Tensor], Tensor] = Tensor.float


def fused_cost_volume(
    inputs: CostVolumeInput, groups: int, alpha: Tensor, beta: Tensor | None, out: Tensor | None = None
) -> Tensor:
    """(B,K,M,h,w) for K groups. `alpha` and `beta` are the level's scalars; without `beta` no source has more say where
    it agrees better or less where it sees nothing. All on a CPU.

    The result is float32, laid out channels-last, and has gradients; or, without gradients, it is written to `out`, of
    any type, which is returned.
    """
    # A group's mean becomes a sum.
    scaled = (inputs.reference * (groups / inputs.reference.shape[1])).permute(0, 2, 3, 1).float()
    strength = alpha.new_zeros(()) if beta is None else beta
    volumes = []
    for i in range(len(scaled)):
        rotated = torch.stack([rotation[i] for rotation, _ in inputs.terms]).float()
        shifted = torch.stack([shift[i, :, 0] for _, shift in inputs.terms]).float()
        fixed = (inputs.extents[i].float(), rotated, shifted, inputs.inverse_depth[i].float(),
                 inputs.weights[i].float())
        own = [source[i] for source in inputs.sources]
        if out is not None:
            _fill(out[i].permute(1, 2, 3, 0),
                  _arguments(scaled[i], alpha, strength, fixed, beta is not None, own, inputs.compared))
            continue
        volume: Tensor = _Fused.apply(scaled[i], alpha, strength, fixed, groups, beta is not None,
                                      *(inputs.compared(source.unsqueeze(0))[0] for source in own))
        volumes.append(volume.permute(3, 0, 1, 2))
    return torch.stack(volumes) if out is None else out


def _fill(volume: Tensor, arguments: tuple[Any, ...]) -> None:
    """Write the volume (M,h,w,K) of any type, some rows at a time."""
    m, height, width, groups = volume.shape
    rows = max(1, BAND_BYTES // (4 * m * width * groups))

    def work(top: int, bottom: int, _: int) -> None:
        buffer = np.empty((m, min(rows, bottom - top), width, groups), np.float32)
        with torch.inference_mode(volume.is_inference()):  # a thread does not know its parent's mode
            for first in range(top, bottom, rows):
                last = min(first + rows, bottom)
                _volume(*arguments, buffer, first, last)
                volume[:, first:last] = torch.from_numpy(buffer[:, : last - first])

    in_bands(height, work)


class _Fused(torch.autograd.Function):
    """One sample: reference (h,w,C), sources (C,hs,ws) each as they are compared, to the volume (M,h,w,K)."""

    @staticmethod
    def forward(
        ctx: Any, reference: Tensor, alpha: Tensor, beta: Tensor, fixed: tuple[Tensor, ...], groups: int,
        visibility: bool, *sources: Tensor,
    ) -> Tensor:
        ctx.save_for_backward(reference, alpha, beta, *sources)
        ctx.fixed, ctx.visibility = fixed, visibility
        h, w = reference.shape[:2]
        volume = reference.new_empty((fixed[3].shape[0], h, w, groups))
        _fill(volume, _arguments(reference, alpha, beta, fixed, visibility, sources))
        return volume

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        reference, alpha, beta, *sources = ctx.saved_tensors
        arguments = _arguments(reference, alpha, beta, ctx.fixed, ctx.visibility, sources)
        upstream = np.ascontiguousarray(gradient.float().numpy())
        h, w, c = reference.shape
        to_reference = np.zeros((h, w, c), np.float32)
        bands = torch.get_num_threads()
        # Places of a source take from many voxels: each band adds to its own copy.
        to_sources = np.zeros((bands, *arguments[1].shape), np.float32)
        to_scalars = np.zeros((bands, 2), np.float64)
        in_bands(h, lambda top, bottom, band: _gradients(
            *arguments, upstream, to_reference, to_sources[band], to_scalars[band], top, bottom))
        total, scalars = to_sources.sum(0), to_scalars.sum(0)
        parts = np.split(total, arguments[2][1:, 2])
        spread = [torch.from_numpy(part).view(*source.shape[1:], c).permute(2, 0, 1)
                  for part, source in zip(parts, sources, strict=True)]
        return (torch.from_numpy(to_reference), alpha.new_tensor(scalars[0]), beta.new_tensor(scalars[1]),
                None, None, None, *spread)


def _arguments(
    reference: Tensor, alpha: Tensor, beta: Tensor, fixed: tuple[Tensor, ...], visibility: bool,
    sources: Sequence[Tensor], compared: Callable[[Tensor], Tensor] = Tensor.float,
) -> tuple[Any, ...]:
    """What both kernels begin with: reference (h,w,C), the pixels of all sources (P,C), from `sources` (C,hs,ws) each
    by way of `compared`, some rows at a time; sizes (N,3) as (hs, ws, first pixel), extents (N,2) as (width, height),
    rotated (N,3,h*w), shifted (N,3), inverse depth (M,h,w), weights (N,), alpha, beta, visibility."""
    sizes = np.array([source.shape[1:] for source in sources], np.int64)
    first = np.cumsum(sizes.prod(axis=1)) - sizes.prod(axis=1)
    together = np.empty((int(sizes.prod(axis=1).sum()), reference.shape[2]), np.float32)
    for at, (height, width), source in zip(first, sizes, sources, strict=True):
        rows = max(1, BAND_BYTES // (4 * width * reference.shape[2]))
        for top in range(0, height, rows):
            band = compared(source.detach()[None, :, top : top + rows])[0].permute(1, 2, 0)
            start = at + top * width
            together[start : start + band.shape[0] * width] = band.reshape(-1, band.shape[2]).numpy()
    places = np.column_stack([sizes, first])
    extents, rotated, shifted, inverse_depth, weights = (np.ascontiguousarray(each.numpy()) for each in fixed)
    return (np.ascontiguousarray(reference.detach().numpy()), together, places, extents, rotated, shifted,
            inverse_depth, weights, np.float32(alpha.item()), np.float32(beta.item()), visibility)


@compiled
def _taps(u: Any, v: Any, height: Any, width: Any, first: Any) -> Any:
    """Bilinear interpolation at (u, v), pixel centres at 0: four places, counted from the picture's first, and their
    shares, those outside zero."""
    left, top = np.floor(u), np.floor(v)
    a, b = u - left, v - top
    x0, y0 = int(left), int(top)
    x1, y1 = x0 + 1, y0 + 1
    left_share, right_share = _ONE - a, a
    top_share, bottom_share = _ONE - b, b
    if x0 < 0:
        left_share, x0 = _ZERO, 0
    if x1 >= width:
        right_share, x1 = _ZERO, width - 1
    if y0 < 0:
        top_share, y0 = _ZERO, 0
    if y1 >= height:
        bottom_share, y1 = _ZERO, height - 1
    y0, y1 = first + y0 * width, first + y1 * width
    return (y0 + x0, y0 + x1, y1 + x0, y1 + x1, left_share * top_share, right_share * top_share,
            left_share * bottom_share, right_share * bottom_share)


@compiled
def _volume(
    reference: Any, sources: Any, sizes: Any, extents: Any, rotated: Any, shifted: Any, inverse_depth: Any,
    weights: Any, alpha: Any, beta: Any, visibility: Any, volume: Any, top: Any, bottom: Any,
) -> None:
    """Rows [top, bottom) of the volume (M,h,w,K), to the first rows of `volume`."""
    width, channels = reference.shape[1:]
    groups = volume.shape[3]
    each = channels // groups
    count = inverse_depth.shape[0]
    sharpness = beta / np.float32(groups)
    total, product = np.empty((count, channels), np.float32), np.empty(channels, np.float32)
    norm, column, row = np.empty(count, np.float32), np.empty(count, np.float32), np.empty(count, np.float32)
    for y in range(top, bottom):
        for x in range(width):
            pixel = y * width + x
            total[:] = _ZERO
            norm[:] = _ZERO
            for n in range(sizes.shape[0]):
                u0, v0, z0 = rotated[n, 0, pixel], rotated[n, 1, pixel], rotated[n, 2, pixel]
                height_n, width_n, first_n = sizes[n, 0], sizes[n, 1], sizes[n, 2]
                right_n, bottom_n = extents[n, 0] - _HALF, extents[n, 1] - _HALF
                # Where a source sees all the hypotheses, first: a loop of its own runs in vector registers.
                for m in range(count):
                    nearness = inverse_depth[m, y, x]
                    z = z0 + shifted[n, 2] * nearness
                    column[m] = (u0 + shifted[n, 0] * nearness) / z - _HALF if z > _SMALL else _NOWHERE
                    row[m] = (v0 + shifted[n, 1] * nearness) / z - _HALF if z > _SMALL else _NOWHERE
                for m in range(count):
                    u, v = column[m], row[m]
                    if not (u > -_HALF and v > -_HALF and u < right_n and v < bottom_n):
                        if not visibility:
                            norm[m] += weights[n]
                        continue
                    p0, p1, p2, p3, s0, s1, s2, s3 = _taps(u, v, height_n, width_n, first_n)
                    agreement = _ZERO
                    for c in range(channels):
                        value = reference[y, x, c] * (s0 * sources[p0, c] + s1 * sources[p1, c]
                                                      + s2 * sources[p2, c] + s3 * sources[p3, c])
                        product[c] = value
                        agreement += value
                    weight = weights[n]
                    if visibility:
                        weight *= np.float32(exp(sharpness * agreement))
                    norm[m] += weight
                    for c in range(channels):
                        total[m, c] += weight * product[c]
            for m in range(count):
                scale = alpha / max(norm[m], _SMALL)
                for g in range(groups):
                    group = _ZERO
                    for c in range(g * each, (g + 1) * each):
                        group += total[m, c]
                    volume[m, y - top, x, g] = group * scale


# Long: one loop over the voxels computes all gradients, so that each warped feature is computed once.
@compiled
def _gradients(
    reference: Any, sources: Any, sizes: Any, extents: Any, rotated: Any, shifted: Any, inverse_depth: Any,
    weights: Any, alpha: Any, beta: Any, visibility: Any, upstream: Any, to_reference: Any, to_sources: Any,
    to_scalars: Any, top: Any, bottom: Any,
) -> None:
    """Add what rows [top, bottom) of the volume's gradient (M,h,w,K) mean for the reference, the sources, and alpha and
    beta (2,)."""
    width, channels = reference.shape[1:]
    groups = upstream.shape[3]
    each = channels // groups
    count = sizes.shape[0]
    warped, product = np.empty((count, channels), np.float32), np.empty((count, channels), np.float32)
    agreement, weight = np.empty(count, np.float32), np.empty(count, np.float32)
    seen = np.empty(count, np.bool_)
    place, share = np.empty((count, 4), np.int64), np.empty((count, 4), np.float32)
    # By channel, though a group's channels share their values: loops over channels run in vector registers.
    total, to_total = np.empty(channels, np.float32), np.empty(channels, np.float32)
    to_product, to_own = np.empty(channels, np.float32), np.empty(channels, np.float32)
    for y in range(top, bottom):
        for x in range(width):
            pixel = y * width + x
            for c in range(channels):
                to_own[c] = _ZERO
            for m in range(inverse_depth.shape[0]):
                nearness = inverse_depth[m, y, x]
                norm = _ZERO
                for c in range(channels):
                    total[c] = _ZERO
                for n in range(count):
                    z = rotated[n, 2, pixel] + shifted[n, 2] * nearness
                    seen[n] = z > _SMALL
                    u = v = _ZERO
                    if seen[n]:
                        u = (rotated[n, 0, pixel] + shifted[n, 0] * nearness) / z - _HALF
                        v = (rotated[n, 1, pixel] + shifted[n, 1] * nearness) / z - _HALF
                        seen[n] = (u > -_HALF and v > -_HALF
                                   and u < extents[n, 0] - _HALF and v < extents[n, 1] - _HALF)
                    if not seen[n]:
                        if not visibility:
                            norm += weights[n]
                        continue
                    p0, p1, p2, p3, s0, s1, s2, s3 = _taps(u, v, sizes[n, 0], sizes[n, 1], sizes[n, 2])
                    place[n, 0], place[n, 1], place[n, 2], place[n, 3] = p0, p1, p2, p3
                    share[n, 0], share[n, 1], share[n, 2], share[n, 3] = s0, s1, s2, s3
                    agrees = _ZERO
                    for c in range(channels):
                        value = (s0 * sources[p0, c] + s1 * sources[p1, c]
                                 + s2 * sources[p2, c] + s3 * sources[p3, c])
                        warped[n, c] = value
                        value *= reference[y, x, c]
                        product[n, c] = value
                        agrees += value
                    w = weights[n]
                    if visibility:
                        w *= np.float32(exp(beta * agrees / np.float32(groups)))
                    agreement[n], weight[n] = agrees, w
                    norm += w
                    for c in range(channels):
                        total[c] += w * product[n, c]
                scale = _ONE / max(norm, _SMALL)
                to_norm = _ZERO
                for g in range(groups):
                    group = _ZERO
                    for c in range(g * each, (g + 1) * each):
                        group += total[c]
                    group *= scale * upstream[m, y, x, g]
                    to_scalars[0] += group
                    to_norm -= group * alpha * scale
                    for c in range(g * each, (g + 1) * each):
                        to_total[c] = upstream[m, y, x, g] * alpha * scale
                if norm <= _SMALL:
                    to_norm = _ZERO
                for n in range(count):
                    if not seen[n]:
                        continue
                    through_weight = _ZERO
                    w = weight[n]
                    if visibility:
                        to_weight = to_norm
                        for c in range(channels):
                            to_weight += to_total[c] * product[n, c]
                        through_weight = to_weight * w / np.float32(groups)
                        to_scalars[1] += through_weight * agreement[n]
                        through_weight *= beta
                    for c in range(channels):
                        gradient = to_total[c] * w + through_weight
                        to_own[c] += gradient * warped[n, c]
                        to_product[c] = gradient * reference[y, x, c]
                    s0, s1, s2, s3 = share[n, 0], share[n, 1], share[n, 2], share[n, 3]
                    p0, p1, p2, p3 = place[n, 0], place[n, 1], place[n, 2], place[n, 3]
                    for c in range(channels):
                        to_sources[p0, c] += s0 * to_product[c]
                    for c in range(channels):
                        to_sources[p1, c] += s1 * to_product[c]
                    for c in range(channels):
                        to_sources[p2, c] += s2 * to_product[c]
                    for c in range(channels):
                        to_sources[p3, c] += s3 * to_product[c]
            for c in range(channels):
                to_reference[y, x, c] = to_own[c]
