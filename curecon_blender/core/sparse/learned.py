# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Matches by networks, ALIKED and LightGlue: they join photos taken farther apart than SIFT can, and look-alikes too.

LightGlue knows upright pictures only. Where the gimbals tell that a pair is turned against each other, the second photo
is described once more in its nearest quarter turn, at the same keypoints.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import TypeVar

import numpy as np
import safetensors.torch
import torch
from torch import nn

from ..base import rotations
from ..base.errors import WeightsError
from ..base.images import read_rgb
from ..base.language import Text
from ..base.records import Photo
from ..base.weights import FOLDER, REMEDY, read_weights
from ..photos import masks
from .aliked import Aliked
from .lightglue import LightGlue
from .pairs import Pair

IMAGE_SIZE = 1024  # longest side of the pictures in pixels: that of the authors' training
MOST_FEATURES = 1024  # a photo; with twice as many a pair takes four times as long
_KEPT = 64  # photos whose descriptors in another turn stay in memory, half a megabyte each

Network = TypeVar("Network", bound=nn.Module)


class LearnedMatcher:
    """Keypoints of photos and matches of pairs (positions in `photos`), on a torch device. Raises WeightsError."""

    def __init__(self, photos: tuple[Photo, ...], device: str) -> None:
        self._photos, self._device = photos, device
        self._detector = load_weights(Aliked(), FOLDER / "aliked.safetensors").to(device)
        self._matcher = load_weights(LightGlue(), FOLDER / "lightglue.safetensors").to(device)
        self._held = [None if p.gimbal is None else rotations.from_gimbal(p.gimbal) for p in photos]
        self._found: dict[int, tuple[torch.Tensor, torch.Tensor, tuple[int, int]]] = {}
        self._turned = lru_cache(maxsize=_KEPT)(self._described_turned)

    def keypoints(self, photo: int) -> np.ndarray:
        """(K,2) float32 in pixels of the photo, pixel centres at .5, the most distinct first."""
        places, _, size = self._features(photo)
        original = self._photos[photo].width, self._photos[photo].height
        scaled: np.ndarray = (places.cpu().numpy() + 0.5) * np.divide(original, size)
        return scaled.astype(np.float32)

    def matches(self, pair: Pair) -> np.ndarray:
        """Matches (M,2) uint32 between the keypoints of two photos, not verified."""
        first, second = pair
        quarters = self._quarters(pair)
        there = self._turned(second, quarters) if quarters else self._features(second)
        features = self._features(first), there
        with torch.inference_mode():
            places = [(at + 0.5 - at.new_tensor(size) / 2) / (max(size) / 2) for at, _, size in features]
            found, _ = self._matcher((places[0], places[1]), (features[0][1], features[1][1]))
        return np.asarray(found.cpu().numpy().astype(np.uint32))

    def _features(self, photo: int) -> tuple[torch.Tensor, torch.Tensor, tuple[int, int]]:
        """Keypoints (K,2) with pixel centres at integers, descriptors (K,128), and the picture's size."""
        if photo not in self._found:
            picture = read_rgb(self._photos[photo].path, IMAGE_SIZE)
            with torch.inference_mode():
                found = self._detector(self._tensor(picture), MOST_FEATURES)
            size = picture.shape[1], picture.shape[0]
            self._found[photo] = *self._unmasked(photo, found, size), size
        return self._found[photo]

    def _unmasked(
        self, photo: int, found: tuple[torch.Tensor, torch.Tensor], size: tuple[int, int]
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Keypoints and descriptors without those that lie in what a mask leaves out."""
        original, (places, descriptors) = self._photos[photo], found
        if (left := masks.kept(original)) is None:
            return found
        scale = np.divide((original.width, original.height), size)
        inside = torch.from_numpy(masks.keeps(left, (places.cpu().numpy() + 0.5) * scale)).to(places.device)
        return places[inside], descriptors[inside]

    def _described_turned(self, photo: int, quarters: int) -> tuple[torch.Tensor, torch.Tensor, tuple[int, int]]:
        """The same features in the picture turned by quarters against the clock."""
        places, _, (width, height) = self._features(photo)
        picture = np.rot90(read_rgb(self._photos[photo].path, IMAGE_SIZE), quarters)
        for _ in range(quarters):
            places = torch.stack([places[:, 1], width - 1 - places[:, 0]], dim=1)
            width, height = height, width
        with torch.inference_mode():
            return places, self._detector.describe(self._tensor(picture), places), (width, height)

    def _tensor(self, picture: np.ndarray) -> torch.Tensor:
        """(1,3,H,W) in 0..1."""
        return torch.from_numpy(np.ascontiguousarray(picture)).to(self._device).permute(2, 0, 1)[None].float() / 255

    def _quarters(self, pair: Pair) -> int:
        """Quarter turns that bring the second photo upright with the first, as far as the gimbals tell."""
        first, second = (self._held[photo] for photo in pair)
        if first is None or second is None:
            return 0
        turn = second.T @ first
        return round(float(np.degrees(np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1]))) / 90) % 4


def load_weights(network: Network, path: Path) -> Network:
    """The network with the weights at `path`, which must fit to the letter, in evaluation mode on the CPU.

    Raises WeightsError when they are missing, fail the checksum of their record, or are another network's.
    """
    content = read_weights(path)
    try:
        tensors = safetensors.torch.load(content)
        network.load_state_dict({name: tensor.float() for name, tensor in tensors.items()}, strict=True)
    except (RuntimeError, ValueError, safetensors.SafetensorError) as error:
        raise WeightsError(
            Text("{} holds the weights of another network: {}", path, Text(str(error))), remedy=REMEDY, path=path
        ) from error
    return network.eval()
