# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""One bundle adjustment of a placed model with the maker's calibration, the GPS and the gimbal's angles as priors.

A flight straight down at one height hardly tells the focal length from the height, and bends where the lens's
distortion is not known: what it does not determine stays with what the maker measured.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pycolmap

from ..base import rotations
from ..base.geodesy import geodetic_to_enu
from ..base.messages import Reporter
from ..base.records import Frame, Lens, Photo
from .bundle import LENS_PARAMETERS, Bundle, adjust

MOST_PHOTOS = 1500  # the reduced system is a full matrix: 0.7 GB, and some copies of it
# Beyond these a calibration is not this camera's: times the mapper's reprojection error, sigmas of the focal length.
WORSE, CONTRADICTED = 2.0, 5.0
# Of a maker's calibration: focal length and centre as shares of the focal length and the width.
_FOCAL_SIGMA, _CENTRE_SIGMA, _ASPECT_SIGMA = 0.003, 0.002, 0.001
_DISTORTION_SIGMAS = {"k1": 0.01, "k2": 0.02, "p1": 0.0005, "p2": 0.0005, "k3": 0.02}
_GPS_SIGMAS = 1.0, 2.0  # metres in plan and height of a receiver that states none; a worse one shows it
_GIMBAL_SIGMA = 3.0  # degrees
_HELD = 1e-9  # of a lens that is held fast


def adjust_to_calibration(
    model: pycolmap.Reconstruction, photos: Mapping[str, Photo], frame: Frame, reporter: Reporter
) -> bool:
    """Adjust a model in the site frame, in place. Its cameras are FULL_OPENCV afterwards.

    False where the model stays: its frame is not by GPS, or not every lens was calibrated by its maker. The user is
    told where a calibration does not fit the photos, or the photos are too many. Raises Cancelled.
    """
    lenses = _calibrations(model, photos)
    if frame.origin is None or not frame.north or lenses is None:
        return False
    if model.num_reg_images() > MOST_PHOTOS:
        reporter.warning(
            f"The maker's calibration of the camera is not used: that is for up to {MOST_PHOTOS:,} photos. Heights may "
            "be wrong if all photos look straight down from one height."
        )
        return False
    mapped = model.compute_mean_reprojection_error()
    bundle, progress = _bundle(model, photos, frame, lenses), reporter.check_cancelled
    # First with the lens as calibrated, from where it puts the cameras: from a wrong focal length the way is long.
    held = adjust(replace(bundle, lens_sigmas=np.full_like(bundle.lens_sigmas, _HELD)), progress)
    freed = replace(held, lens_sigmas=bundle.lens_sigmas, position_sigmas=bundle.position_sigmas)
    adjusted = adjust(freed, progress)
    off = float(np.median(np.linalg.norm(adjusted.residuals(), axis=1)))
    focal = np.abs(adjusted.lenses - bundle.known_lenses)[:, 0] / bundle.lens_sigmas[:, 0]
    if not off < WORSE * mapped or focal.max() > CONTRADICTED:
        reporter.warning(
            "The maker's calibration of the camera does not fit the photos and is not used: it is another lens's, or "
            "the pictures were edited. Heights may be wrong if all photos look straight down from one height."
        )
        return False
    _write_back(adjusted, model)
    return True


def _calibrations(model: pycolmap.Reconstruction, photos: Mapping[str, Photo]) -> dict[int, Lens] | None:
    """The lens of each camera of the model, by its id; None unless all of them are known."""
    found: dict[int, set[Lens | None]] = {}
    for image in _images(model):
        found.setdefault(image.camera_id, set()).add(photos[image.name].lens)
    known = {camera: lens for camera, told in found.items() if len(told) == 1 and (lens := next(iter(told)))}
    return known if len(known) == len(found) else None


def _images(model: pycolmap.Reconstruction) -> list[pycolmap.Image]:
    return sorted((model.image(i) for i in model.reg_image_ids()), key=lambda image: str(image.name))


def _bundle(
    model: pycolmap.Reconstruction, photos: Mapping[str, Photo], frame: Frame, lenses: Mapping[int, Lens]
) -> Bundle:
    images, cameras = _images(model), sorted(lenses)
    number = {image.image_id: n for n, image in enumerate(images)}
    points, photo, point, pixels = [], [], [], []
    for p, point_id in enumerate(sorted(model.point3D_ids())):
        points.append(model.point3D(point_id).xyz)
        for element in model.point3D(point_id).track.elements:
            photo.append(number[element.image_id])
            point.append(p)
            pixels.append(model.image(element.image_id).points2D[element.point2D_idx].xy)
    turns = np.array([image.cam_from_world().rotation.matrix() for image in images])
    centres = np.array([image.projection_center() for image in images])
    known = np.array([[getattr(lenses[camera], name) for name in LENS_PARAMETERS] for camera in cameras])
    centres = _moved_back(centres, turns, np.array(points), np.array(photo), np.array(point), np.array([
        lenses[image.camera_id].f / model.camera(image.camera_id).mean_focal_length() for image in images
    ]))
    positions, position_sigmas = _positions([photos[image.name] for image in images], frame)
    given = np.isfinite(position_sigmas[:, 0])
    shift = np.median((positions - centres)[given], axis=0)
    gimbals = [photos[image.name].gimbal for image in images]
    return Bundle(
        rotations=turns, centres=centres + shift, lens_of=np.array([cameras.index(i.camera_id) for i in images]),
        lenses=known, points=np.array(points) + shift, photo=np.array(photo), point=np.array(point),
        pixels=np.array(pixels), positions=positions, position_sigmas=position_sigmas,
        attitudes=np.array([turn if gimbal is None else rotations.from_gimbal(gimbal).T
                            for turn, gimbal in zip(turns, gimbals, strict=True)]),
        attitude_sigmas=np.array([np.inf if gimbal is None else np.radians(_GIMBAL_SIGMA) for gimbal in gimbals]),
        known_lenses=known, lens_sigmas=np.array([_lens_sigmas(lenses[c], model.camera(c).width) for c in cameras]),
    )


def _lens_sigmas(lens: Lens, width: int) -> list[float]:
    sigmas = {"f": _FOCAL_SIGMA * lens.f, "aspect": _ASPECT_SIGMA, "cx": _CENTRE_SIGMA * width,
              "cy": _CENTRE_SIGMA * width, **_DISTORTION_SIGMAS}
    return [sigmas[name] for name in LENS_PARAMETERS]


def _positions(photos: list[Photo], frame: Frame) -> tuple[np.ndarray, np.ndarray]:
    """GPS (N,3) in the frame and its sigmas, infinite for photos without."""
    positions, sigmas = np.zeros((len(photos), 3)), np.full((len(photos), 3), np.inf)
    assert frame.origin is not None
    for n, photo in enumerate(photos):
        if photo.gps is not None:
            place = np.array([[photo.gps.latitude, photo.gps.longitude, photo.gps.altitude]])
            positions[n] = geodetic_to_enu(place, frame.origin)[0]
            plan, height = photo.gps_sigmas or _GPS_SIGMAS
            sigmas[n] = plan, plan, height
    return positions, sigmas


def _moved_back(
    centres: np.ndarray, turns: np.ndarray, points: np.ndarray, photo: np.ndarray, point: np.ndarray,
    longer: np.ndarray,
) -> np.ndarray:
    """Centres (N,3) along their cameras' axes to where a focal length so many times as long (N,) sees the same."""
    axes = turns[:, 2]
    depths = ((points[point] - centres[photo]) * axes[photo]).sum(axis=1)
    typical = np.array([np.median(depths[photo == n]) if (photo == n).any() else 0.0 for n in range(len(centres))])
    return np.asarray(centres - axes * ((longer - 1) * typical)[:, None])


def _write_back(bundle: Bundle, model: pycolmap.Reconstruction) -> None:
    images = _images(model)
    for n, image in enumerate(images):
        turn, centre = bundle.rotations[n], bundle.centres[n]
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(turn), -turn @ centre)
        model.frame(image.frame_id).set_cam_from_world(image.camera_id, pose)
    for k, camera_id in enumerate(sorted({image.camera_id for image in images})):
        f, aspect, *rest = bundle.lenses[k].tolist()
        camera = model.camera(camera_id)
        camera.model = pycolmap.CameraModelId.FULL_OPENCV
        camera.params = [f, f * aspect, *rest, 0.0, 0.0, 0.0]
    for p, point_id in enumerate(sorted(model.point3D_ids())):
        model.point3D(point_id).xyz = bundle.points[p]
    model.update_point_3d_errors()
