# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""`precision.npz` beside a component's COLMAP model: how precisely its sparse points and cameras are known.

Arrays, float32 unless said, in the site frame and its units: `places` (P,3) of the points by their number in the model;
`points` (P,3,3) their covariances, `shapes` (P,3,3) those within the site, `own` (P,3,3) the part of a point's own
observations, `rays` (P,) int32 how many these are; `centres` (N,3,3) and `turns` (N,3) of the cameras, by the photos'
names, in radians; `lenses` (L,9) sigmas by the cameras' numbers; `datum` (7,7) float64; `middle` (3,); `sigma` pixels;
`held` 1 where GPS or control hold the datum; `counts` (3,) int64: P, N, L.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..base.errors import WorkspaceError
from ..base.files import atomic_write
from ..base.reading import Expected, read_arrays

PRECISION_FILE = "precision.npz"
_MOST = 1 << 28


@dataclass(frozen=True, kw_only=True)
class PrecisionRecord:
    """What the file holds, see above."""

    places: np.ndarray
    points: np.ndarray
    shapes: np.ndarray
    own: np.ndarray
    rays: np.ndarray
    centres: np.ndarray
    turns: np.ndarray
    lenses: np.ndarray
    datum: np.ndarray
    middle: np.ndarray
    sigma: float
    held: bool

    @property
    def datum_sigmas(self) -> np.ndarray:
        """(7,) of the site as a whole: shift east, north, up in units, turn about x, y, z in radians, and scale."""
        return np.asarray(np.sqrt(np.diag(self.datum)))


def write_precision(folder: Path, record: PrecisionRecord) -> None:
    """Write the record into a component's folder, whole or not at all. Raises WorkspaceError."""
    single = {name: getattr(record, name).astype(np.float32)
              for name in ("places", "points", "shapes", "own", "centres", "turns", "lenses", "middle")}
    counts = np.array([len(record.places), len(record.centres), len(record.lenses)])
    with atomic_write(folder / PRECISION_FILE) as file:
        np.savez(file, **single, rays=record.rays.astype(np.int32), datum=record.datum, sigma=np.float64(record.sigma),
                 held=np.int64(record.held), counts=counts)


def read_precision(folder: Path) -> PrecisionRecord | None:
    """The record in a component's folder; None where there is none, as for cameras that were brought in or not adjusted.
    Raises WorkspaceError when it is damaged."""
    path = folder / PRECISION_FILE
    if not path.exists():
        return None
    try:
        points, photos, lenses = (int(count) for count in read_arrays(path, {"counts": Expected((3,), "i")})["counts"])
        if not (min(points, photos, lenses) >= 0 and 128 * points + 48 * photos < min(path.stat().st_size, _MOST)):
            raise ValueError("its counts are not those of its arrays")
        found = read_arrays(path, {
            "places": Expected((points, 3), "f"), "points": Expected((points, 3, 3), "f"),
            "shapes": Expected((points, 3, 3), "f"), "own": Expected((points, 3, 3), "f"),
            "rays": Expected((points,), "i"), "centres": Expected((photos, 3, 3), "f"),
            "turns": Expected((photos, 3), "f"), "lenses": Expected((lenses, 9), "f"), "datum": Expected((7, 7), "f"),
            "middle": Expected((3,), "f"), "sigma": Expected((), "f"), "held": Expected((), "i"),
        })
        if not all(np.isfinite(array).all() for array in found.values()):
            raise ValueError("it holds what is no number")
        if any((np.diagonal(found[name], axis1=-2, axis2=-1) < 0).any()
               for name in ("points", "shapes", "own", "centres", "datum")) or (found["rays"] < 1).any():
            raise ValueError("it holds variances below zero")
    except (OSError, ValueError) as error:
        raise WorkspaceError(
            f"{path} is damaged ({error}).", remedy="Run Reconstruct again in this workspace.", path=path
        ) from error
    sigma, held = float(found.pop("sigma")), bool(found.pop("held"))
    return PrecisionRecord(**found, sigma=sigma, held=held)
