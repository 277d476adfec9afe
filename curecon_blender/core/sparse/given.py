# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Given COLMAP models: fitted to the photos, and brought from far-off coordinates into a frame of the site's own."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap

from ..base.errors import SparseError
from ..base.geodesy import ecef_to_geodetic, enu_from_ecef, geodetic_to_enu
from ..base.language import Text
from ..base.messages import Reporter
from ..base.records import ELLIPSOID, Frame, GeoPosition, Photo, PhotoSet
from ..photos.record import photo_finder
from .models import listed
from .placement import cameras_of, middle_on_the_ground, points_of, up_from_cameras
from .record import FRAME_FILE, read_frame

SIZE_TOLERANCE = 0.01  # relative difference of aspect ratios that rounding to whole pixels can make
FAR = 1000.0, 20.0  # units, times the site's size: coordinates beyond both are of a country's grid or the Earth's
_EARTH = 6.33e6, 6.40e6  # metres from the Earth's middle to where a camera can be
_NEAR_GPS = 1000.0  # metres
_LEANING = 30.0  # degrees between up as cameras are held and up by the coordinates


def fit_to_photos(
    model: pycolmap.Reconstruction, photo_set: PhotoSet, folder: Path, reporter: Reporter
) -> pycolmap.Reconstruction:
    """A given model with its images named as the photos, at the photos' size, without images that have no photo, each
    image by itself where they were rigs.

    Poses are kept exactly, and so are cameras, unless the photos have another resolution. Raises SparseError when
    fewer than three photos are left, or a photo's size contradicts its camera.
    """
    find = photo_finder(photo_set.photos)
    matched: dict[int, Photo] = {}
    missing = []
    for image_id in sorted(model.reg_image_ids()):
        photo = find(model.image(image_id).name)
        if photo is None or photo in matched.values():
            missing.append(model.image(image_id).name)
        else:
            matched[image_id] = photo
    if len(matched) < 3:
        raise SparseError(
            Text("Only {} of the {} images in the model {} are among the photos.", len(matched), model.num_reg_images(),
                 folder),
            remedy="Choose the folder with the photos from which the model was made; their file names must agree.",
            path=folder,
        )
    if missing:
        reporter.warning(Text("{} images of the model have no photo and were left out: {}.", len(missing),
                              listed(missing)))
    model = _one_by_one(model, {image_id: photo.name for image_id, photo in matched.items()})
    _scale_to_photos(model, matched, folder)
    model.update_point_3d_errors()
    return model


def _scale_to_photos(model: pycolmap.Reconstruction, matched: dict[int, Photo], folder: Path) -> None:
    sizes: dict[int, tuple[int, int]] = {}
    for image_id, photo in matched.items():
        camera = model.camera(model.image(image_id).camera_id)
        ratio = (photo.width / camera.width) / (photo.height / camera.height)
        first = sizes.setdefault(camera.camera_id, (photo.width, photo.height))
        if abs(ratio - 1) > SIZE_TOLERANCE or first != (photo.width, photo.height):
            raise SparseError(
                Text("{} has {}x{} pixels, but its camera in the model {} has {}x{}.", photo.name, photo.width,
                     photo.height, folder, camera.width, camera.height),
                remedy="Use the photos from which the model was made (scaled evenly at most, not cropped or turned).",
                path=photo.path,
            )
    for image_id in matched:
        image = model.image(image_id)
        camera, (width, height) = model.camera(image.camera_id), sizes[image.camera_id]
        if (camera.width, camera.height) != (width, height):
            for point in image.points2D:
                point.xy = point.xy * (width / camera.width, height / camera.height)
    for camera_id, (width, height) in sizes.items():
        camera = model.camera(camera_id)
        if (camera.width, camera.height) != (width, height):
            camera.rescale(width, height)


def _one_by_one(model: pycolmap.Reconstruction, names: dict[int, str]) -> pycolmap.Reconstruction:
    """The images that `names` has, named so, each with a pose of its own: a rig's images come and go together, and some
    of them may have no photo."""
    made = pycolmap.Reconstruction()
    for camera_id in sorted({model.image(image_id).camera_id for image_id in names}):
        made.add_camera_with_trivial_rig(model.camera(camera_id))
    for image_id, name in names.items():
        image = model.image(image_id)
        pixels = np.array([point.xy for point in image.points2D]).reshape(-1, 2)
        copy = pycolmap.Image(name=name, keypoints=pixels, camera_id=image.camera_id, image_id=image_id)
        made.add_image_with_trivial_frame(copy, image.cam_from_world())
    for point_id in sorted(model.point3D_ids()):
        point, track = model.point3D(point_id), pycolmap.Track()
        for element in point.track.elements:
            if element.image_id in names:
                track.add_element(element.image_id, element.point2D_idx)
        if track.length() >= min(2, point.track.length()):
            made.add_point3D(point.xyz, track, point.color)
    return made


def given_frame(model: pycolmap.Reconstruction, photos: dict[str, Photo], folder: Path) -> Frame:
    """The frame of a given model: what its own record says, if it is one of ours, else that nothing is known of it.

    A model with far-off coordinates (UTM, a country's grid, earth-centred ones) is brought near its origin, in place:
    clouds, meshes and Blender count in single precision. The frame keeps the shift.
    """
    if (folder / FRAME_FILE).is_file():
        return read_frame(folder)
    kinds = Counter(model.camera(model.image(i).camera_id).model_name for i in model.reg_image_ids())
    lenses = ", ".join(sorted(kinds))
    frame = Frame(
        scale="unknown", up="given",
        note=f"Cameras, lenses ({lenses}) and frame are those of the given model; its scale and axes were taken as "
             "they are.",
    )
    cameras = cameras_of(model, photos)
    places = points_of(model) if model.num_points3D() else cameras.centres
    middle = np.median(places, axis=0)
    size = float(np.median(np.linalg.norm(places - middle, axis=1)))
    if np.linalg.norm(middle) < max(FAR[0], FAR[1] * size):
        return frame
    if _is_earth_centred(middle, cameras.centres, cameras.photos, up_from_cameras(cameras).up):
        return _to_local_axes(model, middle, lenses)
    shift = np.round(middle_on_the_ground(places))
    model.transform(pycolmap.Sim3d(1.0, pycolmap.Rotation3d(), -shift))
    x, y, z = shift.tolist()
    return replace(frame, shift=(x, y, z), note=(
        f"{frame.note} Its far-off coordinates are counted from the site's middle, so that they keep their digits; the "
        "frame keeps the shift."
    ))


def _is_earth_centred(middle: np.ndarray, centres: np.ndarray, photos: list[Photo], up: np.ndarray) -> bool:
    if not _EARTH[0] < np.linalg.norm(middle) < _EARTH[1]:
        return False
    located = [i for i, photo in enumerate(photos) if photo.gps is not None]
    if located:
        places = ecef_to_geodetic(centres[located])
        off = []
        for place, i in zip(places, located, strict=True):
            if (gps := photos[i].gps) is not None:
                off.append(np.linalg.norm(geodetic_to_enu(place[None], gps)[0, :2]))
        return bool(np.median(off) < _NEAR_GPS)
    return bool(up @ middle / np.linalg.norm(middle) > np.cos(np.radians(_LEANING)))


def _to_local_axes(model: pycolmap.Reconstruction, middle: np.ndarray, lenses: str) -> Frame:
    """Bring an earth-centred model, in place, to axes east, north and up of its middle on the ground."""
    for _ in range(2):  # first to see where the ground is
        latitude, longitude, altitude = ecef_to_geodetic(middle[None])[0].tolist()
        origin = GeoPosition(
            latitude=latitude, longitude=longitude, altitude=altitude, altitude_datum=ELLIPSOID
        )
        rotation, centre = enu_from_ecef(origin)
        places = np.array([point.xyz for point in model.points3D.values()]).reshape(-1, 3)
        if not len(places):
            break
        middle = centre + rotation.T @ middle_on_the_ground((places - centre) @ rotation.T)
    model.transform(pycolmap.Sim3d(1.0, pycolmap.Rotation3d(rotation), -rotation @ centre))
    x, y, z = centre.tolist()
    return Frame(
        scale="metres", up="given", north=True, origin=origin, shift=(x, y, z),
        note=f"Cameras and lenses ({lenses}) are those of the given model, whose earth-centred coordinates were turned "
             "to east, north and up of the site's middle.",
    )
