# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Turn a training run's averaged weights into the file that ships.

    python -m training.export --run DIR [--out curecon_blender/weights/lcm_mvsnet.safetensors]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch

from curecon_blender.core.weights import SHIPPED, save_network
from training.train import start


def main() -> None:
    parser = argparse.ArgumentParser(description="Export a run's EMA weights as safetensors with their record.")
    parser.add_argument("--run", type=Path, required=True)
    parser.add_argument("--out", type=Path, default=SHIPPED)
    options = parser.parse_args()
    if not (options.run / "state.pt").exists():
        parser.error(f"{options.run} holds no state.pt")
    state = start(options.run, torch.device("cpu"))
    save_network(state.ema, options.out, {"samples": state.samples, "steps": state.steps})
    print(f"{options.out}: {state.samples} samples seen")


if __name__ == "__main__":
    main()
