# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""`precision.npz` beside a component's COLMAP model: how precisely its sparse points and cameras are known.

It holds the fields of Precision, float32 but for `datum`, and `counts` (3,): P, N, L.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..base.errors import WorkspaceError
from ..base.files import atomic_write
from ..base.language import Text
from ..base.reading import FARTHEST, Expected, read_arrays

PRECISION_FILE = "precision.npz"
_MOST = 1 << 28


@dataclass(frozen=True, kw_only=True)
class Precision:
    """Covariances of an adjusted component, in its frame's units, radians and pixels.

    Of the sparse points in the order of their numbers: `places` (P,3); `points` (P,3,3) in the frame, with its datum;
    `shapes` (P,3,3) within the site: after the best shift, turn and scale; `own` (P,3,3), the part that a point's own
    observations contribute, and how many these are, `rays` (P,). Of the cameras by their photos' names: `centres`
    (N,3,3), and sigmas of their `turns` (N,3). Sigmas of the `lenses` (L,9). `datum` (7,7) is of the shift of the
    points' `middle` (3,), of the turn and of the relative scale of the site as a whole. `sigma` is that of one
    observation, in pixels.

    `held` is False where nothing but the photos says where the site stands (a free network): then `points` and
    `centres` are of the shape too, and `datum` is 0.
    """

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

    def moved(self, scale: float, rotation: np.ndarray, translation: np.ndarray) -> Precision:
        """The same where places are taken to scale * rotation (3,3) @ place + translation (3,)."""
        turn = scale * rotation
        similarity = np.eye(7)
        similarity[:3, :3], similarity[3:6, 3:6] = turn, rotation
        return replace(
            self, places=self.places @ turn.T + translation, middle=turn @ self.middle + translation,
            datum=similarity @ self.datum @ similarity.T,
            **{name: turn @ getattr(self, name) @ turn.T for name in ("points", "shapes", "own", "centres")},
        )


def write_precision(folder: Path, record: Precision) -> None:
    """Write the record into a component's folder, whole or not at all. Raises WorkspaceError."""
    single = {name: getattr(record, name).astype(np.float32)
              for name in ("places", "points", "shapes", "own", "centres", "turns", "lenses", "middle")}
    counts = np.array([len(record.places), len(record.centres), len(record.lenses)])
    with atomic_write(folder / PRECISION_FILE) as file:
        np.savez(file, **single, rays=record.rays.astype(np.int32), datum=record.datum, sigma=np.float64(record.sigma),
                 held=np.int64(record.held), counts=counts)


def read_precision(folder: Path) -> Precision | None:
    """The record in a component's folder; None where there is none, as for cameras that were not adjusted. Raises
    WorkspaceError when it is damaged."""
    path = folder / PRECISION_FILE
    if not path.exists():
        return None
    try:
        points, photos, lenses = (int(count) for count in read_arrays(path, {"counts": Expected((3,), "i")})["counts"])
        if not (min(points, photos, lenses) >= 0 and 120 * points + 48 * photos < min(path.stat().st_size, _MOST)):
            raise ValueError("its counts are not those of its arrays")
        found = read_arrays(path, {
            "places": Expected((points, 3), "f"), "points": Expected((points, 3, 3), "f"),
            "shapes": Expected((points, 3, 3), "f"), "own": Expected((points, 3, 3), "f"),
            "rays": Expected((points,), "i"), "centres": Expected((photos, 3, 3), "f"),
            "turns": Expected((photos, 3), "f"), "lenses": Expected((lenses, 9), "f"), "datum": Expected((7, 7), "f"),
            "middle": Expected((3,), "f"), "sigma": Expected((), "f"), "held": Expected((), "i"),
        })
        if not all((np.abs(array) < FARTHEST).all() for array in found.values()):  # nor is what is no number
            raise ValueError("it holds values that are no numbers, or beyond reach")
        if any((np.diagonal(found[name], axis1=-2, axis2=-1) < 0).any()
               for name in ("points", "shapes", "own", "centres", "datum")) or (found["rays"] < 1).any() \
                or found["sigma"] < 1e-3:
            raise ValueError("it holds variances that are none")
    except (OSError, ValueError) as error:
        raise WorkspaceError(
            Text("{} is damaged ({}).", path, Text(str(error))),
            remedy="Run Reconstruct again in this workspace.", path=path
        ) from error
    sigma, held = float(found.pop("sigma")), bool(found.pop("held"))
    return Precision(**found, sigma=sigma, held=held)
