# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the sparse model tells of the photos: how well its points are tied, and what the lens leaves over."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap

from ..sparse.models import read_model

CELLS = 16  # along the longer side of a photo: the lens's residuals are averaged in them
FEWEST = 5  # residuals that a cell must have to show their mean


@dataclass(frozen=True, kw_only=True)
class TiePoints:
    """Points that photos share: their number, the observations of them, the median number of photos that see one, and
    the least and median number of points in a photo."""

    points: int
    observations: int
    photos: float
    fewest: int
    usual: float


@dataclass(frozen=True, kw_only=True)
class Pattern:
    """A camera's mean residuals over its picture: `mean` (R,C,2) in pixels, x right and y down, nan where there are
    too few. `photo` is one that it took, of `size` (width, height); `count` is their number, `rms` of all residuals."""

    photo: str
    size: tuple[int, int]
    count: int
    mean: np.ndarray
    rms: float


def observe(sparse: Path) -> tuple[TiePoints, list[Pattern]]:
    """The tie points of a component's model, and a pattern for each of its cameras, in the order of their numbers.
    Raises SparseError."""
    model = read_model(sparse)
    tracks = np.array([point.track.length() for point in model.points3D.values()])
    offs: dict[int, list[np.ndarray]] = {}
    first: dict[int, str] = {}
    seen = []
    for image in model.images.values():
        if not image.has_pose:
            continue
        pixels, off = _residuals(model, image)
        seen.append(len(pixels))
        first.setdefault(image.camera_id, image.name)
        offs.setdefault(image.camera_id, []).append(np.column_stack([pixels, off]))
    tied = TiePoints(
        points=len(tracks), observations=int(tracks.sum()), photos=float(np.median(tracks)) if len(tracks) else 0.0,
        fewest=min(seen, default=0), usual=float(np.median(seen)) if seen else 0.0,
    )
    return tied, [_pattern(first[camera], model.camera(camera), found) for camera, found in sorted(offs.items())]


def _residuals(model: pycolmap.Reconstruction, image: pycolmap.Image) -> tuple[np.ndarray, np.ndarray]:
    """Where a photo has its points (N,2), and how far they lie from where the model puts them."""
    observed = image.get_observation_points2D()
    pixels = np.array([point.xy for point in observed]).reshape(-1, 2)
    places = np.array([model.point3D(point.point3D_id).xyz for point in observed]).reshape(-1, 3)
    pose = image.cam_from_world()
    expected = np.asarray(model.camera(image.camera_id).img_from_cam(places @ pose.rotation.matrix().T
                                                                     + pose.translation)).reshape(-1, 2)
    known = np.isfinite(expected).all(axis=1)
    return pixels[known], (pixels - expected)[known]


def _pattern(photo: str, camera: pycolmap.Camera, found: list[np.ndarray]) -> Pattern:
    every = np.concatenate(found)
    width, height = int(camera.width), int(camera.height)
    cell = max(width, height) / CELLS
    columns, rows = max(1, round(width / cell)), max(1, round(height / cell))
    column = np.clip((every[:, 0] / width * columns).astype(int), 0, columns - 1)
    row = np.clip((every[:, 1] / height * rows).astype(int), 0, rows - 1)
    place = row * columns + column
    count = np.bincount(place, minlength=rows * columns)
    sums = np.stack([np.bincount(place, every[:, 2 + axis], rows * columns) for axis in range(2)], axis=1)
    mean = np.where(count[:, None] >= FEWEST, sums / np.maximum(count, 1)[:, None], np.nan)
    rms = float(np.sqrt((every[:, 2:] ** 2).sum(axis=1).mean())) if len(every) else 0.0
    return Pattern(photo=photo, size=(width, height), count=len(found), mean=mean.reshape(rows, columns, 2), rms=rms)
