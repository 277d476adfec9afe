# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Features of every photo, in one COLMAP database.

It is written a photo at a time, so that a job killed at any moment goes on from there. Keypoints are in pixels of the
original photo (EXIF orientation applied), pixel centres at .5.
"""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap

from ..base.errors import WorkspaceError
from ..base.files import disk_errors, write_json
from ..base.images import read_rgb, readers
from ..base.language import Text
from ..base.reading import build, read_json
from ..base.records import Photo
from ..photos import masks
from .parallel import Step, in_order, threads

SAMPLING = 4 / 3  # of a photo's sides at the quality's image size, for the scale space's first octave


@dataclass(frozen=True, kw_only=True)
class FeatureSettings:
    """What the features in a database depend on: longest image side in pixels, most features a photo."""

    image_size: int
    max_features: int


@contextmanager
def open_database(path: Path, photos: tuple[Photo, ...], settings: FeatureSettings) -> Iterator[pycolmap.Database]:
    """The COLMAP database at `path`, holding only features that these photos and settings still stand for.

    A database that is damaged, was made with other settings or from photos changed since is started afresh; photos
    that were added or left out since keep the others' features. Raises WorkspaceError when it cannot be written.
    """
    record = path.with_suffix(".json")
    wanted: dict[str, Any] = {
        "sampling": SAMPLING, "image_size": settings.image_size, "max_features": settings.max_features,
        "photos": {photo.name: _fingerprint(photo) for photo in photos},
    }
    known = _read_record(record)
    same_settings = all(known.get(key) == wanted[key] for key in ("sampling", "image_size", "max_features"))
    unchanged = all(known.get("photos", {}).get(name, print_) == print_ for name, print_ in wanted["photos"].items())
    with disk_errors(path):
        path.parent.mkdir(exist_ok=True)
        if not (same_settings and unchanged and _intact(path)):
            for suffix in ("", "-wal", "-shm", "-journal"):
                path.with_name(path.name + suffix).unlink(missing_ok=True)
            known = {}
    wanted["photos"] = {**known.get("photos", {}), **wanted["photos"]}
    write_json(record, wanted)
    try:
        with pycolmap.Database.open(path) as database:
            yield database
    except RuntimeError as error:
        if "SQLite" not in str(error) and "database" not in str(error):
            raise
        raise WorkspaceError(
            Text("The feature database {} could not be written ({}).", path, Text(str(error))),
            remedy="Free some space, or choose a workspace folder on a local disk that you may write to.", path=path,
        ) from error


def _fingerprint(photo: Photo) -> list[Any]:
    masked = [photo.mask] if photo.mask else []
    return [photo.digest, photo.width, photo.height, photo.camera, photo.focal_px, *masked]


def _read_record(path: Path) -> dict[str, Any]:
    try:
        content = build(dict, read_json(path))
        build(dict, content.get("photos", {}))
    except (OSError, ValueError):  # never written, or damaged: both mean that nothing is known
        return {}
    return dict(content)


def _intact(path: Path) -> bool:
    if not path.exists():
        return False
    try:
        with closing(sqlite3.connect(path)) as connection:
            return bool(connection.execute("PRAGMA quick_check").fetchone() == ("ok",))
    except sqlite3.DatabaseError:
        return False


def image_ids(database: pycolmap.Database, photos: tuple[Photo, ...]) -> list[int]:
    """The database's image id of every photo."""
    ids = {image.name: image.image_id for image in database.read_all_images()}
    return [ids[photo.name] for photo in photos]


def missing_features(database: pycolmap.Database, photos: tuple[Photo, ...]) -> list[Photo]:
    """The photos whose features are not in the database yet."""
    known = {image.name for image in database.read_all_images()}
    return [photo for photo in photos if photo.name not in known]


def extract_features(
    database: pycolmap.Database, photos: tuple[Photo, ...], settings: FeatureSettings, step: Step
) -> None:
    """RootSIFT features of every photo that has none in `database` yet, one transaction a photo.

    The largest `max_features` are kept, since they match best. So the scale space starts at the photo sampled by
    SAMPLING, and not at twice the size as COLMAP has it: what lies below would be thrown away.
    """
    cameras = _write_cameras(database, photos)
    rigs = {rig.ref_sensor_id.id: rig.rig_id for rig in database.read_all_rigs()}
    extractors = threading.local()

    def extract(photo: Photo) -> tuple[np.ndarray, pycolmap.FeatureDescriptors]:
        if not hasattr(extractors, "sift"):
            extractors.sift = _extractor(settings.max_features)
        grey = _sampled(photo, settings.image_size)
        keypoints, descriptors = extractors.sift.extract_from_uint8_array(grey)
        matrix = pycolmap.keypoints_to_matrix(keypoints)
        height, width = grey.shape
        matrix[:, :2] *= (photo.width / width, photo.height / height)  # corners at 0: no half-pixel shift
        matrix[:, 2] *= photo.width / width
        if (left := masks.kept(photo)) is not None:
            inside = masks.keeps(left, matrix[:, :2])
            matrix = matrix[inside]
            descriptors.data = descriptors.data[inside]
        return matrix, descriptors

    missing = missing_features(database, photos)
    largest = max((photo.width * photo.height for photo in missing), default=0)
    workers = readers(largest, _extraction_workers(settings.image_size))
    with closing(in_order(extract, missing, workers)) as extracted:
        for photo, (keypoints, descriptors) in extracted:
            camera = cameras[_camera_key(photo)]
            with pycolmap.DatabaseTransaction(database):
                image = pycolmap.Image(name=photo.name, camera_id=camera.camera_id)
                image.image_id = database.write_image(image)
                frame = pycolmap.Frame()
                frame.rig_id = rigs[camera.camera_id]
                frame.add_data_id(image.data_id)
                database.write_frame(frame)
                database.write_keypoints(image.image_id, keypoints)
                database.write_descriptors(image.image_id, descriptors)
            step()


def _sampled(photo: Photo, image_size: int) -> np.ndarray:
    """The photo in grey, its longest side SAMPLING times `image_size`, but at most twice its own."""
    longest = max(photo.width, photo.height)
    size = min(round(SAMPLING * image_size), 2 * longest)
    grey = cv2.cvtColor(read_rgb(photo.path, size), cv2.COLOR_RGB2GRAY)
    if size <= longest:
        return grey
    scale = size / longest
    return cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)


def _extractor(max_features: int) -> pycolmap.FeatureExtractor:
    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu = False
    options.num_threads = 1  # one photo a thread
    options.sift.max_num_features = max_features
    options.sift.first_octave = 0
    return pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)


def _extraction_workers(image_size: int) -> int:
    # About 12 float32 layers of the sampled photo, 3 by 4, a worker.
    gib = 12 * 4 * 0.75 * (SAMPLING * image_size) ** 2 / 2**30
    return max(1, min(threads(), int(8 / gib)))


def _camera_key(photo: Photo) -> tuple[str, int, int, float | None]:
    return photo.camera, photo.width, photo.height, photo.focal_px


def _write_cameras(
    database: pycolmap.Database, photos: tuple[Photo, ...]
) -> dict[tuple[str, int, int, float | None], pycolmap.Camera]:
    """One camera for all photos taken with it at one focal length, written unless a photo of it is there already."""
    known = {image.name: image.camera_id for image in database.read_all_images()}
    cameras = {_camera_key(photo): database.read_camera(known[photo.name]) for photo in photos if photo.name in known}
    for photo in photos:
        key = _camera_key(photo)
        if key in cameras:
            continue
        focal = photo.focal_px or 1.2 * max(photo.width, photo.height)
        camera = pycolmap.Camera.create_from_model_name(
            pycolmap.INVALID_CAMERA_ID, "SIMPLE_RADIAL", focal, photo.width, photo.height
        )
        camera.has_prior_focal_length = photo.focal_px is not None
        with pycolmap.DatabaseTransaction(database):
            camera.camera_id = database.write_camera(camera)
            rig = pycolmap.Rig()
            rig.add_ref_sensor(camera.sensor_id)
            database.write_rig(rig)
        cameras[key] = camera
    return cameras
