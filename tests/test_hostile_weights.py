# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Weights that a stranger made to do harm are refused, and bring no code."""

from __future__ import annotations

import hashlib
import io
import pickle
from pathlib import Path
from typing import Any

import pytest
from hostile import HUGE, Harm, change, refused

from curecon_blender.core.base.errors import WeightsError
from curecon_blender.core.network import weights
from tests.fuzz import model_targets


@pytest.fixture
def own(tmp_path: Path) -> Path:
    model_targets.make_weights(tmp_path)
    return tmp_path / "own.safetensors"


def with_content(path: Path, content: bytes) -> None:
    """Other weights, with their checksum, as whoever made both would have it."""
    path.write_bytes(content)
    change(path.with_suffix(".json"), "sha256", value=hashlib.sha256(content).hexdigest())


def test_weights_bring_no_code(own: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import torch

    monkeypatch.chdir(own.parent)
    made = io.BytesIO()
    torch.save({"x": Harm()}, made)
    for content in (made.getvalue(), pickle.dumps(Harm()), b"", HUGE, b"\xff" * 100):
        with_content(own, content)
        refused(WeightsError, own, lambda: weights.load_network(own))
    assert not (own.parent / "harmed").exists()


@pytest.mark.parametrize(("keys", "value"), [
    (("config", "channels"), [1 << 40] * 3), (("config", "channels"), [400, 400, 400]),
    (("config", "groups"), [0, 0, 0]), (("config", "hypotheses"), "many"), (("config", "regulariser_channels"), -1),
    (("config",), None), (("sha256",), 5), (("config", "hypothesis_step"), 1e-300),
    (("config", "representation"), "__class__"), (("config", "context"), 10**30),
], ids=str)
def test_a_network_beyond_reason(own: Path, keys: tuple[str, ...], value: Any) -> None:
    change(own.with_suffix(".json"), *keys, value=value)
    error = refused(WeightsError, Path("own"), lambda: weights.load_network(own))
    assert error.path is not None


def test_weights_of_a_terabyte_are_not_read(own: Path) -> None:
    with open(own, "r+b") as file:
        file.truncate(1 << 40)  # a hole
    refused(WeightsError, own, lambda: weights.load_network(own))


def test_no_more_memory_is_asked_for_than_a_file_has(own: Path) -> None:
    """Found by fuzzing: reading at most N bytes takes N bytes at once."""
    import tracemalloc

    tracemalloc.start()
    weights.load_network(own)
    weights.describe(own)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 32 << 20


def test_weights_that_are_no_numbers(own: Path) -> None:
    import safetensors.torch

    tensors = safetensors.torch.load(own.read_bytes())
    name = next(name for name, value in tensors.items() if value.is_floating_point())
    tensors[name] = tensors[name] * float("nan")
    with_content(own, safetensors.torch.save(tensors))
    refused(WeightsError, own, lambda: weights.load_network(own))
