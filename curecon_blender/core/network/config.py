# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The network's sizes, and where it departs from the paper."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


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
    # Confidence without refinement: weights of the logits of the levels' confidences, then the constant; fitted by
    # training/export.py.
    calibration: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 0.0)


PAPER = NetworkConfig(hypothesis_step=None, representation="unified", cosine=False, visibility=False, context=0,
                      refinement=0)
