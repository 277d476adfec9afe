# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Other programs' results in Blender 4.5 LTS and 5.2 LTS."""

from __future__ import annotations

import sys
from pathlib import Path

from test_extension import blender, run_script  # noqa: F401


def test_a_compared_cloud_shows_how_far_it_lies(blender: Path, tmp_path: Path) -> None:  # noqa: F811
    (tmp_path / "work").mkdir()
    run_script(blender, "check_comparison.py", tmp_path / "work", Path(sys.executable), resources=tmp_path / "user")
