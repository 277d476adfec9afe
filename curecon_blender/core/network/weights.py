# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The shipped weights: strict, checksummed loading of the network."""

from __future__ import annotations

import hashlib
from dataclasses import asdict
from pathlib import Path
from typing import Any

import safetensors.torch
import torch
from torch import Tensor

from ..base.errors import OutOfMemory, WeightsError, ran_out_of_memory
from ..base.files import write_json
from ..base.language import Text
from ..base.reading import build
from ..base.weights import FOLDER, REMEDY, read_record, read_weights
from .config import NetworkConfig
from .model import LCMMVSNet

SHIPPED = FOLDER / "lcm_mvsnet.safetensors"
_WIDEST = 512  # channels, groups, hypotheses


def describe(path: Path | None = None) -> dict[str, Any]:
    """The JSON record beside a weights file (None: the shipped one): sha256, config, samples seen.

    Raises WeightsError when it is missing or damaged.
    """
    weights = path or SHIPPED
    found = read_record(weights)
    try:
        build(dict, found["config"], "config")
    except (ValueError, KeyError) as error:
        record = weights.with_suffix(".json")
        raise WeightsError(Text("{} is damaged ({}).", record, Text(str(error))), remedy=REMEDY, path=record) from error
    return found


def load_network(path: Path | None = None) -> LCMMVSNet:
    """The network with its weights (None: the shipped ones), in evaluation mode on the CPU.

    Raises WeightsError when the file is missing, fails its checksum, or does not fit the network to the letter.
    """
    weights = path or SHIPPED
    record, content = describe(path), read_weights(weights)
    try:
        config, tensors = _config(record["config"]), safetensors.torch.load(content)
        with torch.device("meta"):  # takes no memory: whether they fit is known before any is asked for
            LCMMVSNet(config).load_state_dict(tensors, strict=True, assign=True)
        network = LCMMVSNet(config)
        network.load_state_dict(tensors, strict=True)
    except (RuntimeError, ValueError, TypeError, KeyError, safetensors.SafetensorError) as error:
        if ran_out_of_memory(error):
            raise OutOfMemory from error
        raise WeightsError(
            Text("{} holds the weights of another network: {}", weights, Text(str(error))), remedy=REMEDY, path=weights
        ) from error
    if not all(bool(tensor.isfinite().all()) for tensor in network.state_dict().values()):
        raise WeightsError(Text("{} holds weights that are no numbers.", weights), remedy=REMEDY, path=weights)
    return network.eval()


def _config(fields: Any) -> NetworkConfig:
    """Raises ValueError, for sizes that no computer could hold, too."""
    config: NetworkConfig = build(NetworkConfig, fields)
    sizes = (*config.channels, *config.groups, *config.hypotheses, *config.interval_ratios, config.regulariser_channels)
    extras = config.context, config.refinement
    if not all(0 < size <= _WIDEST for size in sizes) or not all(0 <= size <= _WIDEST for size in extras):
        raise ValueError(f"its sizes are not within 1 and {_WIDEST}")
    if config.hypothesis_step is not None and not 0.1 <= config.hypothesis_step <= 100:
        raise ValueError("its hypothesis_step is not within 0.1 and 100")
    return config


def save_network(network: LCMMVSNet, path: Path, facts: dict[str, Any]) -> None:
    """Write a weights file with its JSON record (checksum, config, and `facts` such as the samples seen)."""
    content = safetensors.torch.save({name: _stored(name, value) for name, value in network.state_dict().items()})
    path.write_bytes(content)
    write_json(path.with_suffix(".json"),
               {"sha256": hashlib.sha256(content).hexdigest(), "config": asdict(network.config), **facts})


def _stored(name: str, value: Tensor) -> Tensor:
    """A tensor as it is written: the refinement's kernels, most of all numbers, in float16, all others in float32."""
    if not value.is_floating_point():
        return value.cpu()
    kernel = name.startswith("refinement.") and value.dim() > 1
    return value.detach().cpu().to(torch.float16 if kernel else torch.float32).contiguous()
