# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""COLMAP models as bundles for the adjustment, and back."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pycolmap

from ..base import rotations
from ..base.records import GeoPosition, Lens, Photo
from .bundle import LENS_PARAMETERS, Bundle
from .priors import gps_positions, lens_sigmas

_GIMBAL_SIGMA = 3.0  # degrees


def registered(model: pycolmap.Reconstruction) -> list[pycolmap.Image]:
    """The model's images in the order of a bundle's photos: by name."""
    return sorted((model.image(i) for i in model.reg_image_ids()), key=lambda image: str(image.name))


def to_bundle(
    model: pycolmap.Reconstruction, photos: Mapping[str, Photo], origin: GeoPosition, lenses: Mapping[int, Lens]
) -> Bundle:
    """A model in the frame of `origin` as a bundle, from the lenses (by camera id) that their maker measured."""
    images, cameras = registered(model), sorted(lenses)
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
    positions, position_sigmas = gps_positions([photos[image.name] for image in images], origin)
    off = np.where(np.isfinite(position_sigmas), positions - centres, np.nan)
    shift = np.array([np.median(told[np.isfinite(told)]) if np.isfinite(told).any() else 0.0 for told in off.T])
    gimbals = [photos[image.name].gimbal for image in images]
    return Bundle(
        rotations=turns, centres=centres + shift, lens_of=np.array([cameras.index(i.camera_id) for i in images]),
        lenses=known, points=np.array(points) + shift, photo=np.array(photo), point=np.array(point),
        pixels=np.array(pixels), positions=positions, position_sigmas=position_sigmas,
        attitudes=np.array([turn if gimbal is None else rotations.from_gimbal(gimbal).T
                            for turn, gimbal in zip(turns, gimbals, strict=True)]),
        attitude_sigmas=np.array([np.inf if gimbal is None else np.radians(_GIMBAL_SIGMA) for gimbal in gimbals]),
        known_lenses=known, lens_sigmas=np.array([lens_sigmas(lenses[c], model.camera(c).width) for c in cameras]),
    )


def _moved_back(
    centres: np.ndarray, turns: np.ndarray, points: np.ndarray, photo: np.ndarray, point: np.ndarray,
    longer: np.ndarray,
) -> np.ndarray:
    """Centres (N,3) along their cameras' axes to where a focal length so many times as long (N,) sees the same."""
    axes = turns[:, 2]
    depths = ((points[point] - centres[photo]) * axes[photo]).sum(axis=1)
    typical = np.array([np.median(depths[photo == n]) if (photo == n).any() else 0.0 for n in range(len(centres))])
    return np.asarray(centres - axes * ((longer - 1) * typical)[:, None])


def write_back(bundle: Bundle, model: pycolmap.Reconstruction) -> None:
    """Put an adjusted bundle into the model that it was made of. Its cameras are FULL_OPENCV afterwards."""
    images = registered(model)
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
