# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The sparse stage: photos in, cameras and sparse points out, one COLMAP model a component, in the mapper's frame."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pycolmap
import torch

from ..base.errors import SparseError
from ..base.images import read_rgb
from ..base.language import Text
from ..base.messages import Reporter
from ..base.options import Options
from ..base.records import Photo, PhotoSet
from .features import FeatureSettings, extract_features, image_ids, missing_features, open_database
from .given import fit_to_photos, given_frame
from .joint_matches import joint_database
from .left_out import place_left_out
from .lookalikes import without_lookalikes
from .mapping import map_photos
from .matches import match_pairs, unmatched
from .models import MAPPED, find_models, listed, read_model, write_components
from .pairs import Pair, expected_pairs, facing_alike, metadata_pairs, near_pairs, needs_retrieval, similar_pairs
from .progress import COLOURS, FEATURES, MAPPING, MATCHING, Meter
from .record import FRAME_FILE
from .words import learn_words


def reconstruct(photo_set: PhotoSet, options: Options, workspace: Path, reporter: Reporter) -> None:
    """Find the cameras of the photos; write each component to `workspace/sparse/mapped/N`, largest first.

    Features and matches are kept in `workspace/sparse/features.db` as they are found. Photos that could not be placed
    and several components are warned of. Raises SparseError when no three photos could be joined, Cancelled,
    WorkspaceError.
    """
    _quiet()
    photos = photo_set.photos
    settings = _feature_settings(options)
    with open_database(_database_path(workspace), photos, settings) as database:
        pairs = metadata_pairs(photos)
        meter = Meter(reporter, settings, photos=len(photos), pairs=expected_pairs(photos, pairs), maps=True)
        _extract(database, photos, settings, meter)
        words = learn_words(database, image_ids(database, photos))
        if needs_retrieval(photos):
            pairs |= facing_alike(photos, similar_pairs(database, photos, words, reporter.check_cancelled))
        _match(database, photos, pairs, words, options, meter)
    models = _map(photos, _database_path(workspace), pairs, options, meter)
    if not models:
        raise SparseError(
            Text("The cameras could not be found: no three of the {} photos overlap enough to be joined.", len(photos)),
            remedy="Take photos that share at least two thirds of their view with the next one, of a subject with "
                   "texture, and leave out blurred ones.",
        )
    _warn_of_gaps(models, photos, reporter)
    by_name = {photo.name: photo for photo in photos}
    meter.enter(COLOURS)
    for model in models:
        _colour(model, by_name, settings.image_size, meter)
    write_components(workspace, MAPPED, [(model, {}) for model in models])
    meter.finish()


def import_model(
    model_dir: Path, photo_set: PhotoSet, options: Options, workspace: Path, reporter: Reporter
) -> None:
    """Take a COLMAP model in place of the mapper's: cameras exactly as they are, with the record of their frame,
    which is moved near its origin where that is far off.

    A model without points gets points triangulated from its cameras, since source views and depth ranges need them.
    Raises SparseError when it is malformed or does not fit the photos.
    """
    _quiet()
    components = []
    for folder in find_models(model_dir):
        model = fit_to_photos(read_model(folder), photo_set, folder, reporter)
        frame = given_frame(model, {photo.name: photo for photo in photo_set.photos}, folder)
        if model.num_points3D() == 0:
            model = _triangulate(model, photo_set, options, workspace, reporter)
        components.append((model, {FRAME_FILE: frame}))
    unused = {photo.name for photo in photo_set.photos}
    for model, _ in components:
        unused -= {model.image(i).name for i in model.reg_image_ids()}
    if unused:
        reporter.warning(Text("{} photos are not in the model: {}.", len(unused), listed(sorted(unused))))
    components.sort(key=lambda component: -component[0].num_reg_images())
    write_components(workspace, MAPPED, components)


def _quiet() -> None:
    pycolmap.logging.minloglevel = int(pycolmap.logging.Level.ERROR)
    pycolmap.logging.logtostderr = True


def _database_path(workspace: Path) -> Path:
    return workspace / "sparse" / "features.db"


def _feature_settings(options: Options) -> FeatureSettings:
    return FeatureSettings(
        image_size=options.preset.sfm_image_size, max_features=options.preset.max_features
    )


def _extract(
    database: pycolmap.Database, photos: tuple[Photo, ...], settings: FeatureSettings, meter: Meter
) -> None:
    meter.enter(FEATURES, len(photos) - len(missing_features(database, photos)))
    extract_features(database, photos, settings, meter.advance)


def _match(
    database: pycolmap.Database, photos: tuple[Photo, ...], pairs: set[Pair], words: np.ndarray, options: Options,
    meter: Meter,
) -> None:
    left = unmatched(database, photos, pairs)
    found, inliers = len(pairs) - len(left), database.num_inlier_matches()
    meter.enter(MATCHING, found)

    def step(matches: int) -> None:
        nonlocal found, inliers
        found, inliers = found + 1, inliers + matches
        meter.expect_matches(len(pairs) * inliers / found)
        meter.advance()

    match_pairs(database, photos, left, words, _device(options), step)


def _map(
    photos: tuple[Photo, ...], database: Path, pairs: set[Pair], options: Options, meter: Meter
) -> list[pycolmap.Reconstruction]:
    """The models of the photos, without what only joins photos that look alike; with learned matches if wanted, or
    where SIFT's leave photos out."""
    names = [photo.name for photo in photos]

    def mapped(path: Path, placed: Callable[[int], None]) -> list[pycolmap.Reconstruction]:
        return map_photos(path, names, options.mapper, meter.reporter, placed)

    def once_more(path: Path) -> list[pycolmap.Reconstruction]:
        return mapped(path, lambda placed: None)

    def sound(path: Path, placed: Callable[[int], None]) -> list[pycolmap.Reconstruction]:
        return without_lookalikes(path, mapped(path, placed), photos, once_more, meter.reporter)

    if options.matches == "both":
        with joint_database(database, photos, _device(options), meter) as joint:
            meter.expect_learned(len(pairs))
            joint.add(sorted(pairs), meter.advance)
            meter.enter(MAPPING)
            return sound(joint.path, meter.advance)
    meter.enter(MAPPING)
    models = sound(database, meter.advance)
    if options.matches == "sift":
        return models
    return place_left_out(database, models, photos, pairs, _device(options), once_more, meter)


def _device(options: Options) -> str:
    return "cuda" if options.device in ("auto", "cuda") and torch.cuda.is_available() else "cpu"


def _colour(model: pycolmap.Reconstruction, photos: dict[str, Photo], image_size: int, meter: Meter) -> None:
    """Give every sparse point the mean colour of the photos' pixels that see it."""
    sums: dict[int, np.ndarray] = {point_id: np.zeros(4) for point_id in model.point3D_ids()}
    for image_id in model.reg_image_ids():
        image = model.image(image_id)
        photo = photos[image.name]
        rgb = read_rgb(photo.path, image_size)
        height, width = rgb.shape[:2]
        for point in image.get_observation_points2D():
            x, y = int(point.xy[0] * width / photo.width), int(point.xy[1] * height / photo.height)
            sums[point.point3D_id] += (*rgb[min(max(y, 0), height - 1), min(max(x, 0), width - 1)], 1)
        meter.advance()
    for point_id, total in sums.items():
        model.point3D(point_id).color = np.round(total[:3] / max(total[3], 1)).astype(np.uint8)


# ---- what the user must know

def _warn_of_gaps(models: list[pycolmap.Reconstruction], photos: tuple[Photo, ...], reporter: Reporter) -> None:
    placed = {model.image(i).name for model in models for i in model.reg_image_ids()}
    left = [photo.name for photo in photos if photo.name not in placed]
    if left:
        reporter.warning(
            Text("{} of {} photos could not be placed and are not used: {}. They overlap too little with the others.",
                 len(left), len(photos), listed(left))
        )
    if len(models) > 1:
        sizes = ", ".join(str(model.num_reg_images()) for model in models)
        reporter.warning(
            Text("The photos fall into {} separate parts ({} photos) that could not be joined: each is "
                 "reconstructed on its own. Photos that overlap both parts would join them.", len(models), sizes)
        )


# ---- points for a given model

def _triangulate(
    model: pycolmap.Reconstruction, photo_set: PhotoSet, options: Options, workspace: Path, reporter: Reporter
) -> pycolmap.Reconstruction:
    """The model's cameras with points, from matches between cameras that are near and look the same way.

    (Not pycolmap.triangulate_points: it wants the database's cameras to be the model's, and adjusts them.)
    """
    images = {model.image(i).name: model.image(i) for i in model.reg_image_ids()}
    photos = tuple(photo for photo in photo_set.photos if photo.name in images)
    settings = _feature_settings(options)
    centres = np.array([images[photo.name].projection_center() for photo in photos])
    axes = np.array([images[photo.name].viewing_direction() for photo in photos])
    result, matches = pycolmap.Reconstruction(), pycolmap.CorrespondenceGraph()
    for camera in model.cameras.values():
        result.add_camera_with_trivial_rig(camera)
    with open_database(_database_path(workspace), photos, settings) as database:
        pairs = near_pairs(centres, axes)
        meter = Meter(reporter, settings, photos=len(photos), pairs=len(pairs), maps=False)
        _extract(database, photos, settings, meter)
        ids = image_ids(database, photos)
        _match(database, photos, pairs, learn_words(database, ids), options, meter)
        for photo, image_id in zip(photos, ids, strict=True):
            given = images[photo.name]
            keypoints = database.read_keypoints(image_id)[:, :2].astype(np.float64)
            image = pycolmap.Image(photo.name, keypoints, given.camera_id, image_id)
            result.add_image_with_trivial_frame(image, given.cam_from_world())
            matches.add_image(image_id, len(keypoints))
        for first, second in sorted(pairs):
            geometry = database.read_two_view_geometry(ids[first], ids[second])
            matches.add_two_view_geometry(ids[first], ids[second], geometry)
    matches.finalize()
    observations = pycolmap.ObservationManager(result, matches)
    triangulator = pycolmap.IncrementalTriangulator(matches, result, observations)
    triangulation = pycolmap.IncrementalTriangulatorOptions()
    triangulation.random_seed = 0
    for image_id in ids:
        reporter.check_cancelled()
        triangulator.triangulate_image(triangulation, image_id)
    triangulator.complete_all_tracks(triangulation)
    triangulator.merge_all_tracks(triangulation)
    observations.filter_all_points3D(max_reproj_error=4.0, min_tri_angle=1.5)
    if result.num_points3D() == 0:
        raise SparseError(
            "No point could be triangulated from the given model's cameras: they do not fit the photos.",
            remedy="Check that the model was made from these very photos, and that its poses are cam_from_world.",
        )
    result.update_point_3d_errors()
    meter.enter(COLOURS)
    _colour(result, {photo.name: photo for photo in photos}, settings.image_size, meter)
    meter.finish()
    return result
