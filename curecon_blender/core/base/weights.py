# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A network's weights as files: safetensors, with a JSON record beside them that holds their checksum."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from .errors import WeightsError
from .language import Text
from .reading import build, read_bytes, read_json

FOLDER = Path(__file__).parents[2] / "weights"  # of what ships
REMEDY = "Install CU-Recon again, or choose a weights file that came with its .json beside it."
_MOST_BYTES = 1 << 30  # of a weights file; the largest shipped ones have 24 MB


def read_record(weights: Path) -> dict[str, Any]:
    """The JSON record beside a weights file, with its sha256. Raises WeightsError when it is missing or damaged."""
    record = weights.with_suffix(".json")
    try:
        found: dict[str, Any] = build(dict, read_json(record, 1 << 20))
        build(str, found["sha256"], "sha256")
        return found
    except FileNotFoundError as error:
        raise WeightsError(Text("{} is missing.", record), remedy=REMEDY, path=record) from error
    except (OSError, ValueError, KeyError) as error:
        raise WeightsError(Text("{} is damaged ({}).", record, Text(str(error))), remedy=REMEDY, path=record) from error


def read_weights(weights: Path) -> bytes:
    """A weights file's content. Raises WeightsError when it is missing or is not what its record says."""
    digest = read_record(weights)["sha256"]
    try:
        content = read_bytes(weights, _MOST_BYTES)
    except OSError as error:
        missing = Text("The network's weights {} are missing.", weights)
        raise WeightsError(missing, remedy=REMEDY, path=weights) from error
    except ValueError as error:
        raise WeightsError(
            Text("The network's weights {}: {}.", weights, Text(str(error))), remedy=REMEDY, path=weights
        ) from error
    if hashlib.sha256(content).hexdigest() != digest:
        raise WeightsError(
            Text("The network's weights {} are corrupted (their checksum is wrong).", weights),
            remedy=REMEDY, path=weights,
        )
    return content
