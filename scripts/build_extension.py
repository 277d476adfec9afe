# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Build dist/curecon_blender-VERSION.zip with Blender's own packager, and validate it.

    python scripts/build_extension.py [--output FOLDER]

Needs the bpy wheel in this Python for its packager (or BLENDER_EXT naming a blender_ext.py); starts no Blender.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def packager() -> Path:
    """Blender's blender_ext.py, a plain script."""
    if "BLENDER_EXT" in os.environ:
        return Path(os.environ["BLENDER_EXT"])
    spec = importlib.util.find_spec("bpy")  # finds the wheel without loading it
    if spec is None or spec.origin is None:
        raise SystemExit("This Python has no bpy. Install it, or set BLENDER_EXT to Blender's blender_ext.py.")
    found = sorted(Path(spec.origin).parent.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py"))
    if not found:
        raise SystemExit(f"{Path(spec.origin).parent} has no blender_ext.py. Set BLENDER_EXT to Blender's.")
    return found[-1]


def build(output: Path) -> Path:
    """Build the zip into the folder `output` and validate it; returns its path."""
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    output.mkdir(parents=True, exist_ok=True)
    archive = output / f"{manifest['id']}-{manifest['version']}.zip"
    tool = [sys.executable, str(packager())]
    subprocess.run([*tool, "build", "--source-dir", str(ROOT), "--output-filepath", str(archive)], check=True)
    subprocess.run([*tool, "validate", str(archive)], check=True)
    return archive


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=ROOT / "dist", help="folder for the zip (default: dist)")
    print(build(parser.parse_args().output))


if __name__ == "__main__":
    main()
