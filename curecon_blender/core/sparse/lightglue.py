# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""LightGlue: matches of two pictures' features by a transformer (Lindenberger et al., ICCV 2023).

Nine layers; in each, the features of a picture look at each other and then at the other picture's. After a layer in
which nearly all features are sure of their match, it stops.

Modules are named as in the authors' weights.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import nn

LAYERS, HEADS, WIDTH, INPUTS = 9, 4, 256, 128
LEAST_SCORE = 0.1  # of a match
SURE = 0.95  # share of the features that must be sure of their match


class PositionalEncoding(nn.Module):
    """Turns by which pairs of channels tell where a feature lies (rotary encoding with learnt frequencies)."""

    def __init__(self) -> None:
        super().__init__()
        self.Wr = nn.Linear(2, WIDTH // HEADS // 2, bias=False)

    def forward(self, places: torch.Tensor) -> torch.Tensor:
        """Cosines and sines (2,K,WIDTH/HEADS/2) of the turns at places (K,2)."""
        angles = self.Wr(places)
        return torch.stack([angles.cos(), angles.sin()])


def _message() -> nn.Sequential:
    double = 2 * WIDTH
    return nn.Sequential(nn.Linear(double, double), nn.LayerNorm(double), nn.GELU(), nn.Linear(double, WIDTH))


class SelfAttention(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.Wqkv, self.out_proj, self.ffn = nn.Linear(WIDTH, 3 * WIDTH), nn.Linear(WIDTH, WIDTH), _message()

    def forward(self, x: torch.Tensor, turns: torch.Tensor) -> torch.Tensor:
        query, key, value = self.Wqkv(x).view(len(x), HEADS, -1, 3).transpose(0, 1).unbind(-1)
        query, key = _turned(query, turns), _turned(key, turns)
        message = self.out_proj(_attention(query, key, value))
        updated: torch.Tensor = x + self.ffn(torch.cat([x, message], dim=1))
        return updated


class CrossAttention(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.to_qk, self.to_v, self.to_out = nn.Linear(WIDTH, WIDTH), nn.Linear(WIDTH, WIDTH), nn.Linear(WIDTH, WIDTH)
        self.ffn = _message()

    def forward(self, first: torch.Tensor, second: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        keys = [_by_head(self.to_qk(x)) for x in (first, second)]
        values = [_by_head(self.to_v(x)) for x in (first, second)]
        messages = [self.to_out(_attention(keys[i], keys[1 - i], values[1 - i])) for i in (0, 1)]
        updated = [x + self.ffn(torch.cat([x, y], dim=1)) for x, y in zip((first, second), messages, strict=True)]
        return updated[0], updated[1]


class Layer(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.self_attn, self.cross_attn = SelfAttention(), CrossAttention()

    def forward(
        self, first: torch.Tensor, second: torch.Tensor, turns: list[torch.Tensor]
    ) -> tuple[torch.Tensor, torch.Tensor]:
        attended: tuple[torch.Tensor, torch.Tensor] = self.cross_attn(
            self.self_attn(first, turns[0]), self.self_attn(second, turns[1])
        )
        return attended


class Assignment(nn.Module):
    """How likely features belong together, by the state that a layer leaves them in."""

    def __init__(self) -> None:
        super().__init__()
        self.matchability, self.final_proj = nn.Linear(WIDTH, 1), nn.Linear(WIDTH, WIDTH)

    def forward(self, first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
        """Logarithms (K,L) of the chance that two features match."""
        similarity = self.final_proj(first) @ self.final_proj(second).T / math.sqrt(WIDTH)
        known = F.logsigmoid(self.matchability(first)) + F.logsigmoid(self.matchability(second)).T
        return similarity.log_softmax(1) + similarity.log_softmax(0) + known


class Confidence(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.token = nn.Sequential(nn.Linear(WIDTH, 1), nn.Sigmoid())

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """(K,1) in 0..1: how sure each feature is of its match, or of having none."""
        confidence: torch.Tensor = self.token(x)
        return confidence


class LightGlue(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.input_proj, self.posenc = nn.Linear(INPUTS, WIDTH), PositionalEncoding()
        self.transformers = nn.ModuleList(Layer() for _ in range(LAYERS))
        self.log_assignment = nn.ModuleList(Assignment() for _ in range(LAYERS))
        self.token_confidence = nn.ModuleList(Confidence() for _ in range(LAYERS - 1))

    def forward(
        self, places: tuple[torch.Tensor, torch.Tensor], descriptors: tuple[torch.Tensor, torch.Tensor]
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Matches (M,2) and their scores (M,).

        `places` (K,2) are keypoints from the picture's middle, in halves of its longer side; `descriptors` (K,INPUTS).
        """
        if min(len(part) for part in places) == 0:
            return places[0].new_zeros((0, 2), dtype=torch.long), places[0].new_zeros(0)
        turns = [self.posenc(part) for part in places]
        first, second = (self.input_proj(part) for part in descriptors)
        for index, layer in enumerate(self.transformers):
            first, second = layer(first, second, turns)
            if index == LAYERS - 1 or self._sure(index, first, second):
                break
        return mutual_best(self.log_assignment[index](first, second))

    def _sure(self, index: int, first: torch.Tensor, second: torch.Tensor) -> bool:
        confidence = torch.cat([self.token_confidence[index](x) for x in (first, second)])
        least = 0.8 + 0.1 * math.exp(-4 * index / LAYERS)
        return bool((confidence >= least).float().mean() > SURE)


def mutual_best(chances: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Matches (M,2) that are each other's best by logarithms (K,L), with their scores (M,) of LEAST_SCORE or more."""
    best, back = chances.max(1), chances.argmax(0)
    rows = torch.arange(len(chances), device=chances.device)
    scores = best.values.exp()
    kept = (back[best.indices] == rows) & (scores > LEAST_SCORE)
    return torch.stack([rows[kept], best.indices[kept]], dim=1), scores[kept]


def _turned(x: torch.Tensor, turns: torch.Tensor) -> torch.Tensor:
    even, odd = x[..., 0::2], x[..., 1::2]
    cosine, sine = turns
    return torch.stack([even * cosine - odd * sine, odd * cosine + even * sine], dim=-1).flatten(-2)


def _by_head(x: torch.Tensor) -> torch.Tensor:
    return x.view(len(x), HEADS, -1).transpose(0, 1)


def _attention(query: torch.Tensor, key: torch.Tensor, value: torch.Tensor) -> torch.Tensor:
    """What each query (HEADS,K,C) gathers, (K,HEADS*C)."""
    gathered = F.scaled_dot_product_attention(query[None], key[None], value[None])[0]
    return gathered.transpose(0, 1).flatten(1)
