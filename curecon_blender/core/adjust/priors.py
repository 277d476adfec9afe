# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What is known of lenses, positions and attitudes before the adjustment, each with its sigma."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pycolmap

from ..base import rotations
from ..base.geodesy import geodetic_to_enu
from ..base.records import GeoPosition, Photo
from .bundle import LENS_PARAMETERS

MAKER, FOCAL, NOTHING = "calibration", "focal length", "nothing"  # what is known of a lens, the best first
# Of a maker's calibration: focal length and centre as shares of the focal length and the width.
_FOCAL_SIGMA, _CENTRE_SIGMA, _ASPECT_SIGMA = 0.003, 0.002, 0.001
_DISTORTION_SIGMAS = {"k1": 0.01, "k2": 0.02, "p1": 0.0005, "p2": 0.0005, "k3": 0.02}
# Of a lens of which at most the focal length is known, and of one of which that is not known either.
_ANY_CENTRE, _ANY_DISTORTION = 0.01, {"k1": 0.3, "k2": 0.3, "p1": 0.003, "p2": 0.003, "k3": 0.3}
_ANY_FOCAL = 0.5
_GPS_SIGMAS = 0.1, 0.1  # metres in plan and height: no receiver without RTK is better; a worse one shows it
# Degrees. An error of the gimbal is common to all photos, so that they count together like one.
_GIMBAL_SIGMA = 1.5


@dataclass(frozen=True, kw_only=True)
class LensPrior:
    """A camera's lens by LENS_PARAMETERS as far as it is known, `source` says from what: `values` and `sigmas` (9,)."""

    source: str
    values: np.ndarray
    sigmas: np.ndarray


def lens_priors(
    model: pycolmap.Reconstruction, photos: Mapping[str, Photo], best: str = MAKER
) -> dict[int, LensPrior]:
    """What is known of each camera of the model, by its id, from the source `best` on downwards."""
    taken: dict[int, list[Photo]] = {}
    for image_id in model.reg_image_ids():
        image = model.image(image_id)
        taken.setdefault(image.camera_id, []).append(photos[image.name])
    return {camera: _lens_prior(mine, model.camera(camera), best) for camera, mine in sorted(taken.items())}


def _lens_prior(photos: Sequence[Photo], camera: pycolmap.Camera, best: str) -> LensPrior:
    lens = photos[0].lens
    if best == MAKER and lens is not None and all(photo.lens == lens for photo in photos):
        sigmas = {"f": _FOCAL_SIGMA * lens.f, "aspect": _ASPECT_SIGMA, "cx": _CENTRE_SIGMA * camera.width,
                  "cy": _CENTRE_SIGMA * camera.width, **_DISTORTION_SIGMAS}
        return LensPrior(source=MAKER, values=np.array([getattr(lens, name) for name in LENS_PARAMETERS]),
                         sigmas=np.array([sigmas[name] for name in LENS_PARAMETERS]))
    known = [(photo.focal_px, photo.focal_sigma) for photo in photos if photo.focal_px and photo.focal_sigma]
    centre = photos[0].centre_px or (camera.width / 2, camera.height / 2)
    if best != NOTHING and known:
        source, focal, share = FOCAL, float(np.median([f for f, _ in known])), max(share for _, share in known)
    else:
        source, focal, share = NOTHING, camera.mean_focal_length(), _ANY_FOCAL
    sigmas = {"f": share * focal, "aspect": _ASPECT_SIGMA, "cx": _ANY_CENTRE * camera.width,
              "cy": _ANY_CENTRE * camera.width, **_ANY_DISTORTION}
    return LensPrior(source=source, values=np.array([focal, 1.0, *centre, 0.0, 0.0, 0.0, 0.0, 0.0]),
                     sigmas=np.array([sigmas[name] for name in LENS_PARAMETERS]))


def gps_positions(photos: Sequence[Photo], origin: GeoPosition | None) -> tuple[np.ndarray, np.ndarray]:
    """GPS (N,3) in metres east, north, up of the origin, and its sigmas (N,3), infinite where there is none, and
    for all where no origin is known."""
    positions, sigmas = np.zeros((len(photos), 3)), np.full((len(photos), 3), np.inf)
    if origin is None:
        return positions, sigmas
    for n, photo in enumerate(photos):
        if photo.gps is not None:
            altitude = photo.gps.altitude
            height_known = origin.altitude or 0.0 if altitude is None else altitude
            place = np.array([[photo.gps.latitude, photo.gps.longitude, height_known]])
            positions[n] = geodetic_to_enu(place, origin)[0]
            plan, height = photo.gps_sigmas or _GPS_SIGMAS
            sigmas[n] = plan, plan, height if altitude is not None else np.inf
    return positions, sigmas


def gimbal_attitudes(photos: Sequence[Photo], turns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The gimbals' attitudes (N,3,3) cam_from_world and their sigmas (N,) in radians, infinite for photos without,
    whose attitude is `turns` (N,3,3). Their common error in yaw, that of a compass, is taken out: the median against
    `turns`. Where no gimbal tells, level is where `turns` have it."""
    known = np.array([photo.gimbal is not None for photo in photos])
    if not known.any():
        return turns, np.full(len(photos), np.radians(_GIMBAL_SIGMA) * np.sqrt(len(photos)))
    attitudes = np.array([turn if photo.gimbal is None else rotations.from_gimbal(photo.gimbal).T
                          for photo, turn in zip(photos, turns, strict=True)])
    between = turns.transpose(0, 2, 1) @ attitudes  # in the world, from the gimbal's to the photo's own
    yaws = np.arctan2(between[:, 1, 0] - between[:, 0, 1], between[:, 0, 0] + between[:, 1, 1])[known]
    yaw = _middle_angle(yaws)
    c, s = np.cos(yaw), np.sin(yaw)
    attitudes[known] = attitudes[known] @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    return attitudes, np.where(known, np.radians(_GIMBAL_SIGMA) * np.sqrt(known.sum()), np.inf)


def _middle_angle(angles: np.ndarray) -> float:
    """The median of angles (n,) in radians, counted from their mean direction."""
    mean = np.arctan2(np.sin(angles).mean(), np.cos(angles).mean())
    return float(mean + np.median((angles - mean + np.pi) % (2 * np.pi) - np.pi))
