# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The refinement's choice on a CPU without gradients: every pixel in one go, so that the values of twenty planes at
each pixel of a photo are never written to memory.

`refinement.plain_refined_depth` computes the same in torch's own operations, for graphics cards and for training.
tests/test_refinement.py holds the two together.
"""

from __future__ import annotations

from math import exp, tanh
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .compiled import compiled, in_bands

_ZERO, _HALF, _ONE = np.float32(0), np.float32(0.5), np.float32(1)


def fused_refined_depth(
    t: Tensor, planes: Tensor, logits: Tensor, interval: float, reach: float, coordinate: float
) -> tuple[Tensor, Tensor]:
    """t and confidence_logit, (B,1,H,W) each; arguments as for refinement.plain_refined_depth, all on a CPU;
    `coordinate` is how many pixels of a quarter are one unit of the planes' coordinates."""
    chosen, confidence = (torch.empty_like(t, memory_format=torch.contiguous_format) for _ in range(2))
    for i in range(len(t)):
        # All that is known of one of a quarter's pixels lies together.
        arguments = (t[i, 0].float().contiguous().numpy(), planes[i].permute(2, 3, 0, 1).float().contiguous().numpy(),
                     logits[i].permute(1, 2, 0).float().contiguous().numpy(), np.float32(interval), np.float32(reach),
                     np.float32(coordinate), chosen[i, 0].numpy(), confidence[i, 0].numpy())

        def work(top: int, bottom: int, _: int, arguments: tuple[Any, ...] = arguments) -> None:
            _choose(*arguments, top, bottom)

        in_bands(planes.shape[3], work)
    return chosen, confidence


# Long: one loop over the pixels, whose candidates stay in the processor's registers.
@compiled
def _choose(
    t: Any, planes: Any, logits: Any, interval: Any, reach: Any, coordinate: Any, chosen: Any, confidence: Any,
    top: Any, bottom: Any,
) -> None:
    """Rows [top, bottom) of a quarter: t, chosen, confidence (H,W), planes (h,w,P,3), logits (h,w,(P+3)*step*step). The
    pixels of a block side by side: loops over them run in vector registers."""
    count = planes.shape[2] + 1
    step = t.shape[0] // planes.shape[0]
    block = step * step
    value, share = np.empty((count, block), np.float32), np.empty((count, block), np.float32)
    column, row = np.empty(block, np.float32), np.empty(block, np.float32)
    peak, total = np.empty(block, np.float32), np.empty(block, np.float32)
    most, agreed = np.empty(block, np.float32), np.empty(block, np.float32)
    best, mean = np.empty(block, np.float32), np.empty(block, np.float32)
    for y in range(top, bottom):
        for x in range(planes.shape[1]):
            for s in range(block):
                column[s] = (np.float32(x) + (np.float32(s % step) + _HALF) / np.float32(step) - _HALF) / coordinate
                row[s] = (np.float32(y) + (np.float32(s // step) + _HALF) / np.float32(step) - _HALF) / coordinate
                value[0, s] = t[y * step + s // step, x * step + s % step]
                peak[s] = logits[y, x, s]
                total[s] = _ZERO
            for c in range(1, count):
                level, along_x, along_y = planes[y, x, c - 1, 0], planes[y, x, c - 1, 1], planes[y, x, c - 1, 2]
                for s in range(block):
                    value[c, s] = min(max(level + along_x * column[s] + along_y * row[s], _ZERO), _ONE)
                    peak[s] = max(peak[s], logits[y, x, c * block + s])
            for c in range(count):
                for s in range(block):
                    share[c, s] = np.float32(exp(logits[y, x, c * block + s] - peak[s]))
                    total[s] += share[c, s]
            # The candidate that alone has half the probability, or else the one with most of it within reach.
            for s in range(block):
                best[s], most[s] = value[0, s], share[0, s]
            for c in range(1, count):
                for s in range(block):
                    if share[c, s] > most[s]:
                        best[s], most[s] = value[c, s], share[c, s]
            undecided = False
            for s in range(block):
                if most[s] < _HALF * total[s]:
                    undecided = True
                    most[s] = _ZERO
                else:
                    most[s] = np.float32(2) * total[s]  # nothing outvotes it
            if undecided:
                for c in range(count):
                    agreed[:] = _ZERO
                    for other in range(count):
                        for s in range(block):
                            agreed[s] += share[other, s] if abs(value[other, s] - value[c, s]) < reach else _ZERO
                    for s in range(block):
                        if agreed[s] > most[s]:
                            best[s], most[s] = value[c, s], agreed[s]
            total[:] = _ZERO
            mean[:] = _ZERO
            for c in range(count):
                for s in range(block):
                    agreeing = share[c, s] if abs(value[c, s] - best[s]) < reach else _ZERO
                    total[s] += agreeing
                    mean[s] += agreeing * value[c, s]
            for s in range(block):
                offset = np.float32(tanh(logits[y, x, count * block + s]))
                i, j = y * step + s // step, x * step + s % step
                chosen[i, j] = min(max(mean[s] / total[s] + interval * offset, _ZERO), _ONE)
                confidence[i, j] = logits[y, x, (count + 1) * block + s]
