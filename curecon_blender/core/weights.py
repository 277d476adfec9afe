# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The shipped weights: strict, checksummed loading of the network."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import safetensors.torch
import torch

from .errors import WeightsError
from .files import write_json
from .network import LCMMVSNet, NetworkConfig

SHIPPED = Path(__file__).parent.parent / "weights" / "lcm_mvsnet.safetensors"
_REMEDY = "Install CU-Recon again, or choose a weights file that came with its .json beside it."


def describe(path: Path | None = None) -> dict[str, Any]:
    """The JSON record beside a weights file (None: the shipped one): sha256, config, samples seen.

    Raises WeightsError when it is missing or damaged.
    """
    weights = path or SHIPPED
    record = weights.with_suffix(".json")
    try:
        found: dict[str, Any] = json.loads(record.read_text(encoding="utf-8"))
        found["sha256"], found["config"]
        return found
    except FileNotFoundError as error:
        raise WeightsError(f"{record} is missing.", remedy=_REMEDY, path=record) from error
    except (json.JSONDecodeError, KeyError, TypeError, UnicodeDecodeError) as error:
        raise WeightsError(f"{record} is damaged.", remedy=_REMEDY, path=record) from error


def load_network(path: Path | None = None) -> LCMMVSNet:
    """The network with its weights (None: the shipped ones), in evaluation mode on the CPU.

    Raises WeightsError when the file is missing, fails its checksum, or does not fit the network to the letter.
    """
    weights = path or SHIPPED
    record = describe(path)
    try:
        content = weights.read_bytes()
    except FileNotFoundError as error:
        raise WeightsError(f"The network's weights {weights} are missing.", remedy=_REMEDY, path=weights) from error
    if hashlib.sha256(content).hexdigest() != record["sha256"]:
        raise WeightsError(
            f"The network's weights {weights} are corrupted (their checksum is wrong).", remedy=_REMEDY, path=weights
        )
    try:
        fields: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in record["config"].items()}
        config = NetworkConfig(**fields)
        network = LCMMVSNet(config)
        network.load_state_dict(safetensors.torch.load(content), strict=True)
    except (RuntimeError, TypeError, safetensors.SafetensorError) as error:
        raise WeightsError(
            f"{weights} holds the weights of another network: {error}", remedy=_REMEDY, path=weights
        ) from error
    return network.eval()


def save_network(network: LCMMVSNet, path: Path, facts: dict[str, Any]) -> None:
    """Write a weights file with its JSON record (checksum, config, and `facts` such as the samples seen)."""
    tensors = {
        name: value.detach().cpu().contiguous() if value.dim() else value.detach().cpu()
        for name, value in network.state_dict().items()
    }
    content = safetensors.torch.save({n: t.to(torch.float32) if t.is_floating_point() else t
                                      for n, t in tensors.items()})
    path.write_bytes(content)
    write_json(path.with_suffix(".json"),
               {"sha256": hashlib.sha256(content).hexdigest(), "config": asdict(network.config), **facts})
