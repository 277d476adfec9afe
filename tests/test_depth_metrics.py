# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The measures of depth on maps whose answers are known by hand, and every command's start."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from evaluated import answer, command

from curecon_blender.core.base.errors import WorkspaceError
from evaluation.depth_metrics import DepthRange, depth_errors


@pytest.mark.parametrize("module", ["depth_metrics", "cloud_metrics", "baselines", "site", "validation"])
def test_each_starts_as_a_command_and_explains_itself(module: str) -> None:
    done = subprocess.run([sys.executable, "-m", f"evaluation.{module}", "--help"], cwd=ROOT, capture_output=True,
                          text=True, timeout=120, check=True)
    assert f"python -m evaluation.{module}" in done.stdout and "--json" in done.stdout


def write_pfm(path: Path, depth: np.ndarray) -> None:
    header = f"Pf\n{depth.shape[1]} {depth.shape[0]}\n-1.0\n"
    path.write_bytes(header.encode() + depth[::-1].astype("<f4").tobytes())


def test_depth_off_by_two_intervals() -> None:
    """Range 10 to 138 m: 128 intervals of 1 m. A quarter of the pixels is 2 m off, a quarter 4 m, one has no truth."""
    truth = np.full((4, 4), 20.0)
    predicted = truth.copy()
    predicted[0] += 2
    predicted[1] -= 4
    truth[3, 3] = 0
    errors = depth_errors(predicted, truth, DepthRange.of(10, 138))
    assert errors.epe == pytest.approx((4 * 2 + 4 * 4) / 15)
    assert errors.e1 == pytest.approx(100 * 8 / 15)
    assert errors.e3 == pytest.approx(100 * 4 / 15)
    assert errors.abs_rel == pytest.approx(100 * (4 * 2 + 4 * 4) / 20 / 15)
    assert errors.coverage == 100
    assert errors.median == 2


def test_depth_counts_only_true_pixels_in_range_and_says_what_is_missing() -> None:
    truth = np.array([[20.0, 20.0, 5.0, np.nan]])
    errors = depth_errors(np.array([[21.0, 0.0, 50.0, 9.0]]), truth, DepthRange.of(10, 138))
    assert (errors.epe, errors.coverage) == (1.0, 50.0)
    nothing = depth_errors(np.zeros((1, 4)), truth, DepthRange.of(10, 138))
    assert nothing.coverage == 0 and np.isnan(nothing.epe)
    with pytest.raises(WorkspaceError, match="shape"):
        depth_errors(np.ones((2, 2)), truth, DepthRange.of(10, 138))


def test_depth_command_on_blendedmvs_files(tmp_path: Path) -> None:
    """PFM and cam.txt as that set has them; its own interval is the unit, and its range the limit."""
    for folder in ("rendered_depth_maps", "cams", "mine"):
        (tmp_path / folder).mkdir()
    truth = np.linspace(1.0, 2.0, 12, dtype=np.float32).reshape(3, 4)
    (tmp_path / "cams" / "00000000_cam.txt").write_text(
        "extrinsic\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n\nintrinsic\n9 0 2\n0 9 1.5\n0 0 1\n\n"
        "1.21079 0.00412819 128.0 1.7392 \n"
    )
    write_pfm(tmp_path / "rendered_depth_maps" / "00000000.pfm", truth)
    predicted = truth.copy()
    predicted[truth <= 1.7392] += 2 * 0.00412819
    predicted[truth > 1.7392] = 9
    np.savez(tmp_path / "mine" / "00000000.jpg.npz", depth=predicted, confidence=np.ones_like(truth))
    mean = answer("depth_metrics", tmp_path / "mine", tmp_path / "rendered_depth_maps",
                  "--cameras", tmp_path / "cams")["mean"]
    assert mean["epe"] == pytest.approx(2, abs=1e-3)
    assert (mean["e1"], mean["e3"], mean["coverage"]) == (100, 0, 100)


def test_depth_command_over_single_files_with_confidence(tmp_path: Path) -> None:
    truth = np.full((2, 2), 50.0, np.float32)
    np.save(tmp_path / "truth.npy", truth)
    np.savez(tmp_path / "mine.npz", depth=truth + [[0, 0], [3, 3]], confidence=[[0.9, 0.9], [0.1, 0.1]])
    files = tmp_path / "mine.npz", tmp_path / "truth.npy"
    assert answer("depth_metrics", *files, "--range", 0, 128)["mean"]["epe"] == 1.5
    sure = answer("depth_metrics", *files, "--range", 0, 128, "--min-confidence", 0.5)["mean"]
    assert (sure["epe"], sure["coverage"]) == (0, 50)
    shown = command("depth_metrics", *files, "--range", 0, 128)
    assert "EPE" in shown.stdout and "1.500" in shown.stdout


@pytest.mark.parametrize("case", ["no folder", "empty folder", "missing map", "not a map", "no confidence", "no range"])
def test_depth_command_explains_bad_input(tmp_path: Path, case: str) -> None:
    mine, truth = tmp_path / "mine", tmp_path / "truth"
    truth.mkdir()
    np.save(truth / "a.npy", np.ones((2, 2)))
    extra: tuple[object, ...] = ("--range", 0.5, 2)
    if case != "no folder":
        mine.mkdir()
    if case == "missing map":
        np.save(mine / "b.npy", np.ones((2, 2)))
    elif case == "not a map":
        (mine / "a.npy").write_text("hello")
    elif case == "no confidence":
        np.save(mine / "a.npy", np.ones((2, 2)))
        extra += ("--min-confidence", 0.3)
    elif case == "no range":
        np.save(mine / "a.npy", np.ones((2, 2)))
        (tmp_path / "a_cam.txt").write_text("nothing\n")
        extra = ("--cameras", tmp_path)
    done = command("depth_metrics", mine, truth, *extra)
    assert done.returncode == WorkspaceError.exit_code
    assert str(tmp_path) in done.stderr and "Traceback" not in done.stderr
