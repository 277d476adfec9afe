# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The report's tables: points, each kind by itself; cameras against their GPS; lenses against what was known."""

from __future__ import annotations

import numpy as np

from ..adjust.priors import FOCAL, MAKER, NOTHING
from ..adjust.record import PointResidual
from ..base.language import Text
from .document import Table, short
from .figures import Lens, Residuals

MOST_PHOTOS = 8  # that the table of GPS names: those farthest off
_SOURCES = {MAKER: Text("Maker's calibration"), FOCAL: Text("From the metadata"), NOTHING: Text("Assumed")}
_PARAMETERS = (
    (Text("Focal length (pixels)"), 2), (Text("Height of a pixel over its width"), 5),
    (Text("Principal point x (pixels)"), 2), (Text("Principal point y (pixels)"), 2), ("k1", 5), ("k2", 5), ("p1", 6),
    ("p2", 6), ("k3", 5),
)
_HELD = 1e-9  # a parameter whose sigma is below it was not adjusted


def points_table(title: Text, points: Residuals | None) -> Table | None:
    """What control or check points are off; None where there are none."""
    if points is None:
        return None
    rows = []
    for one in points.of:
        assert isinstance(one, PointResidual)
        rows.append((one.name, *_axes(one.off), str(one.marks), f"{one.pixels:.2f}"))
    return Table(
        title=title, rows=tuple(rows), total=(Text("RMS"), *_axes(points.rms), "", ""),
        head=(Text("Point"), Text("East, m"), Text("North, m"), Text("Up, m"), Text("In plan, m"), Text("Marks"),
              Text("Pixels")),
    )


def gps_table(gps: Residuals | None) -> Table | None:
    """What the cameras farthest from their GPS are off, and all of them; None where there is no GPS."""
    if gps is None:
        return None
    farthest = sorted(gps.of, key=lambda one: -float(np.linalg.norm(one.off)))[:MOST_PHOTOS]
    return Table(
        title=Text("Cameras against their GPS, those that are farthest off"),
        head=(Text("Photo"), Text("East, m"), Text("North, m"), Text("Up, m"), Text("In plan, m")),
        rows=tuple((one.name, *_axes(one.off)) for one in farthest),
        total=(Text("RMS of all {}", str(gps.count)), *_axes(gps.rms)),
    )


def _axes(off: tuple[float, float, float]) -> tuple[str, ...]:
    return *(f"{axis:.3f}" for axis in off), f"{np.hypot(off[0], off[1]):.3f}"


def lens_table(lens: Lens) -> Table | None:
    """A lens as adjusted beside what was known of it; None where it was not adjusted."""
    found = lens.found
    if found is None:
        return None
    rows = []
    for (name, digits), value, sigma, known in zip(_PARAMETERS, found.values, found.sigmas, found.known, strict=True):
        rows.append((name, f"{value:.{digits}f}", f"± {sigma:.{digits}f}" if sigma > _HELD else Text("held"),
                     f"{known:.{digits}f}"))
    return Table(title=Text("Lens of {}", short(lens.camera)), rows=tuple(rows),
                 head=(Text("Parameter"), Text("As adjusted"), Text("Standard deviation"),
                       _SOURCES.get(found.source, Text("Assumed"))))
