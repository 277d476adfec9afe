# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What is known of lenses, positions and attitudes before the adjustment, each with its sigma."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pycolmap

from ..base.geodesy import geodetic_to_enu
from ..base.records import GeoPosition, Lens, Photo
from .bundle import LENS_PARAMETERS

# Of a maker's calibration: focal length and centre as shares of the focal length and the width.
_FOCAL_SIGMA, _CENTRE_SIGMA, _ASPECT_SIGMA = 0.003, 0.002, 0.001
_DISTORTION_SIGMAS = {"k1": 0.01, "k2": 0.02, "p1": 0.0005, "p2": 0.0005, "k3": 0.02}
_GPS_SIGMAS = 1.0, 2.0  # metres in plan and height of a receiver that states none; a worse one shows it


def calibrations(images: Sequence[pycolmap.Image], photos: Mapping[str, Photo]) -> dict[int, Lens] | None:
    """The maker's lens of each camera that took the images, by the camera's id; None unless all of them are known."""
    found: dict[int, set[Lens | None]] = {}
    for image in images:
        found.setdefault(image.camera_id, set()).add(photos[image.name].lens)
    known = {camera: lens for camera, told in found.items() if len(told) == 1 and (lens := next(iter(told)))}
    return known if len(known) == len(found) else None


def lens_sigmas(lens: Lens, width: int) -> list[float]:
    """(9,) by LENS_PARAMETERS, of a maker's calibration for pictures so wide."""
    sigmas = {"f": _FOCAL_SIGMA * lens.f, "aspect": _ASPECT_SIGMA, "cx": _CENTRE_SIGMA * width,
              "cy": _CENTRE_SIGMA * width, **_DISTORTION_SIGMAS}
    return [sigmas[name] for name in LENS_PARAMETERS]


def gps_positions(photos: Sequence[Photo], origin: GeoPosition) -> tuple[np.ndarray, np.ndarray]:
    """GPS (N,3) in metres east, north, up of the origin, and its sigmas (N,3), infinite where there is none."""
    positions, sigmas = np.zeros((len(photos), 3)), np.full((len(photos), 3), np.inf)
    for n, photo in enumerate(photos):
        if photo.gps is not None:
            altitude = photo.gps.altitude
            place = np.array([[photo.gps.latitude, photo.gps.longitude, altitude or origin.altitude or 0.0]])
            positions[n] = geodetic_to_enu(place, origin)[0]
            plan, height = photo.gps_sigmas or _GPS_SIGMAS
            sigmas[n] = plan, plan, height if altitude is not None else np.inf
    return positions, sigmas
