# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether this Python and computer can do the work: the libraries' versions, the device, and a small reconstruction.

The scene is a house with a gable roof on flat ground, in metres, Z up, photographed from an arc around it.
"""

from __future__ import annotations

import importlib.metadata
import platform
import shutil
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import psutil
import torch

from ..base.errors import CuReconError, SetupError, SparseError
from ..base.language import Text
from ..base.messages import Reporter
from ..base.options import Options
from ..cloud.fuse import NoPointsError
from ..depth.estimate import choose_device
from ..depth.tiles import memory_budget
from .pipeline import reconstruct

LIBRARIES = ("numpy", "pillow", "psutil", "opencv-python-headless", "safetensors", "scipy", "torch", "pycolmap",
             "xatlas", "fast_simplification", "numba")
VIEWS, WIDTH, HEIGHT = 6, 480, 360
FOCAL = 1.2 * WIDTH  # pixels: what is taken for a photo that does not tell
DEPTH_SIZE = 320  # pixels, longest side of a depth map
FEWEST_POINTS = 10_000
# The house is where every normal . point <= offset: four walls and two slopes.
NORMALS = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0.6, 0.8], [0, -0.6, 0.8]])
OFFSETS = np.array([5.0, 5.0, 3.5, 3.5, 5.0, 5.0])


def self_check(device: str, reporter: Reporter) -> dict[str, Any]:
    """Reconstruct the synthetic views on the device; returns what the check found, as JSON takes it.

    Raises CuReconError with its remedy for whatever does not work.
    """
    started = time.monotonic()
    found = describe(device)
    with tempfile.TemporaryDirectory(prefix="curecon-check-", ignore_cleanup_errors=True) as folder:
        photos = Path(folder) / "photos"
        photos.mkdir()
        for index in range(VIEWS):
            cv2.imwrite(str(photos / f"view_{index}.png"), render(index)[..., ::-1])
        options = Options(
            photos=photos, workspace=Path(folder) / "workspace", quality="preview", max_image_size=DEPTH_SIZE,
            device=device,
        )
        try:
            summary = reconstruct(options, reporter)
        except (SparseError, NoPointsError) as error:
            raise _broken(error.message) from error
    if summary["registered"] < VIEWS or summary["points"] < FEWEST_POINTS:
        raise _broken(f"{summary['registered']} of {VIEWS} cameras were found, and {summary['points']} points.")
    return {**found, "synthetic_points": summary["points"], "seconds": round(time.monotonic() - started, 1)}


def describe(device: str) -> dict[str, Any]:
    """The worker's Python, its libraries' versions, the device and the memory (GiB) here. Raises DeviceError."""
    chosen = choose_device(device)
    names = {"cuda": lambda: torch.cuda.get_device_name(chosen), "mps": lambda: "Apple graphics"}
    memory = psutil.virtual_memory()
    budget = memory_budget(Options(workspace=Path(), photos=None, device=device), chosen)
    return {
        "python": f"{platform.python_version()} ({sys.executable})", "system": platform.platform(),
        "libraries": {name: importlib.metadata.version(name) for name in LIBRARIES},
        "device": names[chosen.type]() if chosen.type in names else platform.processor() or platform.machine(),
        "device_kind": chosen.type, "unused_card": chosen.type == "cpu" and shutil.which("nvidia-smi") is not None,
        "threads": torch.get_num_threads(),
        "memory_gib": round(memory.total / 2**30, 1), "free_memory_gib": round(memory.available / 2**30, 1),
        "budget_gib": round(budget / 2**30, 1),
    }


def render(index: int) -> np.ndarray:
    """The index-th view (HEIGHT,WIDTH,3) uint8 RGB."""
    azimuth, rise = np.radians(12.0 * (index - VIEWS // 2) - 60), np.radians(45.0)
    centre = 19.0 * np.array([np.cos(azimuth) * np.cos(rise), np.sin(azimuth) * np.cos(rise), np.sin(rise)])
    forward = np.array([0, 0, 2.0]) - centre
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    u, v = np.meshgrid(np.arange(WIDTH) + 0.5 - WIDTH / 2, np.arange(HEIGHT) + 0.5 - HEIGHT / 2)
    rays = u[..., None] * right + v[..., None] * np.cross(forward, right) + FOCAL * forward
    with np.errstate(divide="ignore"):
        slopes = rays @ NORMALS.T
        to_planes = (OFFSETS - NORMALS @ centre) / slopes
        enter = np.where(slopes < 0, to_planes, -np.inf)
        leave = np.where(slopes > 0, to_planes, np.inf).min(axis=-1)
    side = enter.argmax(axis=-1)
    enter = enter.max(axis=-1)
    ground = -centre[2] / rays[..., 2]
    on_house = (enter < leave) & (enter < ground)
    points = centre + rays * np.where(on_house, enter, ground)[..., None]
    shade = np.where(on_house, 0.65 + 0.07 * side, 0.6)
    return np.asarray(255 * shade[..., None] * _pattern(points), np.uint8)


def _pattern(points: np.ndarray) -> np.ndarray:
    """Colours (H,W,3) in 0..1 that belong to the places (H,W,3): noise, from coarse to fine."""
    noise = np.random.default_rng(7).random((256, 256, 3)).astype(np.float32)
    along = (points[..., 0] + 0.7 * points[..., 2]).astype(np.float32)
    across = (points[..., 1] + 0.4 * points[..., 2]).astype(np.float32)
    octaves = [cv2.remap(noise, scale * along % 255, scale * across % 255, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
               for scale in (1.0, 3.1, 9.7)]
    return np.clip(np.mean(octaves, axis=0) * 1.6 - 0.1, 0, 1)


def _broken(what: str) -> CuReconError:
    return SetupError(
        Text("The libraries load, but the synthetic views were not reconstructed as they should be. {}", Text(what)),
        remedy="Please report this with the diagnostics; another device or Worker Python may work.",
        path=sys.executable,
    )
