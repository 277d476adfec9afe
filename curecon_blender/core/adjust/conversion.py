# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""COLMAP models as bundles for the adjustment, and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pycolmap

from ..base.records import GeoPosition, Photo
from .bundle import LENS_PARAMETERS, Bundle
from .priors import MAKER, LensPrior, gimbal_attitudes, gps_positions

_K1 = LENS_PARAMETERS.index("k1")


def registered(model: pycolmap.Reconstruction) -> list[pycolmap.Image]:
    """The model's images in the order of a bundle's photos: by name."""
    return sorted((model.image(i) for i in model.reg_image_ids()), key=lambda image: str(image.name))


def to_bundle(
    model: pycolmap.Reconstruction, photos: Mapping[str, Photo], lenses: Mapping[int, LensPrior],
    origin: GeoPosition | None,
) -> Bundle:
    """A mapped model in the frame of `origin` as a bundle, as the mapper has it; `lenses` by camera id. Without an
    origin nothing is known of places and attitudes."""
    images = registered(model)
    number = {image.image_id: n for n, image in enumerate(images)}
    points, photo, point, pixels = [], [], [], []
    for p, point_id in enumerate(sorted(model.point3D_ids())):
        points.append(model.point3D(point_id).xyz)
        for element in model.point3D(point_id).track.elements:
            photo.append(number[element.image_id])
            point.append(p)
            pixels.append(model.image(element.image_id).points2D[element.point2D_idx].xy)
    turns = np.array([image.cam_from_world().rotation.matrix() for image in images])
    taken = [photos[image.name] for image in images]
    positions, position_sigmas = gps_positions(taken, origin)
    attitudes, attitude_sigmas = gimbal_attitudes(taken, turns) if origin else (turns, np.full(len(turns), np.inf))
    cameras = sorted(lenses)
    return Bundle(
        rotations=turns, centres=np.array([image.projection_center() for image in images]),
        lens_of=np.array([cameras.index(image.camera_id) for image in images]),
        lenses=np.array([_mapped_lens(model.camera(camera)) for camera in cameras]), points=np.array(points),
        photo=np.array(photo), point=np.array(point), pixels=np.array(pixels),
        positions=positions, position_sigmas=position_sigmas,
        receivers=np.array([0 if one.gps_sigmas is None else 1 for one in taken]),
        attitudes=attitudes, attitude_sigmas=attitude_sigmas,
        known_lenses=np.array([lenses[camera].values for camera in cameras]),
        lens_sigmas=np.array([lenses[camera].sigmas for camera in cameras]),
    )


def _mapped_lens(camera: pycolmap.Camera) -> np.ndarray:
    """(9,) of a lens as the mapper has them: SIMPLE_RADIAL."""
    f, cx, cy, k1 = camera.params
    return np.array([f, 1.0, cx, cy, k1, 0.0, 0.0, 0.0, 0.0])


def started(bundle: Bundle, sources: list[str]) -> Bundle:
    """A mapped bundle begun from what is known of its lenses: from a wrong focal length the way is long, in a narrow
    curved valley. The cameras move back along their axes to where the known focal length sees the same."""
    lenses = bundle.known_lenses.copy()
    longer = lenses[:, 0] / bundle.lenses[:, 0]
    for k, source in enumerate(sources):
        if source != MAKER:
            lenses[k, _K1] = bundle.lenses[k, _K1] * longer[k] ** 2
    axes = bundle.rotations[:, 2]
    depths = ((bundle.points[bundle.point] - bundle.centres[bundle.photo]) * axes[bundle.photo]).sum(axis=1)
    typical = np.zeros(len(axes))
    for n in np.unique(bundle.photo):
        typical[n] = np.median(depths[bundle.photo == n])
    back = (longer[bundle.lens_of] - 1) * typical
    return replace(bundle, lenses=lenses, centres=bundle.centres - axes * back[:, None])


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
