# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The sparse stage: photos in, cameras and sparse points out, one COLMAP model a component, in the mapper's frame."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path

import numpy as np
import pycolmap
import torch

from ..base.errors import SparseError
from ..base.files import scratch_folder
from ..base.images import read_rgb
from ..base.messages import Reporter
from ..base.options import Options
from ..base.records import Photo, PhotoSet
from .features import FeatureSettings, extract_features, image_ids, missing_features, open_database
from .given import fit_to_photos, given_frame
from .matches import match_pairs, unmatched
from .models import MAPPED, find_models, listed, read_model, write_components
from .pairs import Pair, expected_pairs, metadata_pairs, near_pairs, needs_retrieval, similar_pairs
from .parallel import threads
from .record import FRAME_FILE

INCREMENTAL = 300  # photos; up to here "auto" takes the incremental mapper, which is the more robust
SMALLEST = 3  # photos in a component

# Rough seconds a photo or a pair takes, for progress and remaining time: their ratios matter, not their size.
_FEATURE_COST, _PAIR_COST, _MAPPING_COST = 2.0, 0.4, 3.0


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
        meter = _Meter(
            reporter, settings, features=len(photos), pairs=expected_pairs(photos, pairs), mapping=len(photos)
        )
        _extract(database, photos, settings, meter)
        if needs_retrieval(photos):
            pairs |= similar_pairs(database, photos, reporter.check_cancelled)
        _match(database, photos, pairs, options, meter)
    models = _components(_map(photos, options, workspace, meter))
    if not models:
        raise SparseError(
            f"The cameras could not be found: no three of the {len(photos)} photos overlap enough to be joined.",
            remedy="Take photos that share at least two thirds of their view with the next one, of a subject with "
                   "texture, and leave out blurred ones.",
        )
    _warn_of_gaps(models, photos, reporter)
    by_name = {photo.name: photo for photo in photos}
    for model in models:
        _colour(model, by_name, settings.image_size, reporter)
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
        reporter.warning(f"{len(unused)} photos are not in the model: {listed(sorted(unused))}.")
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


class _Meter:
    """The stage's progress over its three phases in per cent, weighed by rough seconds."""

    def __init__(
        self, reporter: Reporter, settings: FeatureSettings, *, features: int, pairs: int, mapping: int
    ) -> None:
        self.reporter = reporter
        self.feature = 100 * _FEATURE_COST * (settings.image_size / 1200) ** 2
        self.pair = 100 * _PAIR_COST * (settings.max_features / 8192) ** 2
        self.photo = 100 * _MAPPING_COST
        self._ends = np.cumsum([self.feature * features, self.pair * pairs, self.photo * mapping]).tolist()
        self._phase, self._done = 0, 0.0

    def enter(self, phase: int) -> None:
        """Begin matching (1) or mapping (2)."""
        self._phase, self._done = phase, self._ends[phase - 1]

    def advance(self, units: float, *, fresh: bool = True) -> None:
        self._done = min(self._done + units, self._ends[self._phase])
        self.reporter.progress(int(100 * self._done / max(self._ends[-1], 1)), 100, fresh=fresh)

    def finish(self) -> None:
        self.reporter.progress(100, 100)


def _extract(
    database: pycolmap.Database, photos: tuple[Photo, ...], settings: FeatureSettings, meter: _Meter
) -> None:
    found = len(photos) - len(missing_features(database, photos))
    if found:
        meter.advance(found * meter.feature, fresh=False)
    extract_features(database, photos, settings, lambda: meter.advance(meter.feature))


def _match(
    database: pycolmap.Database, photos: tuple[Photo, ...], pairs: set[Pair], options: Options, meter: _Meter
) -> None:
    meter.enter(1)
    left = unmatched(database, photos, pairs)
    if len(left) < len(pairs):
        meter.advance((len(pairs) - len(left)) * meter.pair, fresh=False)
    device = "cuda" if options.device in ("auto", "cuda") and torch.cuda.is_available() else "cpu"
    match_pairs(database, photos, left, device, lambda: meter.advance(meter.pair))


# ---- mapping

def _map(photos: tuple[Photo, ...], options: Options, workspace: Path, meter: _Meter) -> list[pycolmap.Reconstruction]:
    """The models that the mapper makes of the database, in no order."""
    meter.enter(2)
    mapper = options.mapper
    if mapper == "auto":
        mapper = "incremental" if len(photos) <= INCREMENTAL else "global"
    names = [photo.name for photo in photos]
    registered = [0]  # photos placed so far, told by the mapper's thread

    def count() -> None:
        registered[0] += 1

    def incremental(token: pycolmap.CancellationToken) -> list[pycolmap.Reconstruction]:
        settings = pycolmap.IncrementalPipelineOptions()
        settings.image_names, settings.extract_colors = names, False
        settings.min_model_size = SMALLEST
        settings.num_threads, settings.random_seed = threads(), 0
        return list(pycolmap.incremental_mapping(
            _database_path(workspace), workspace, output, settings,
            next_image_callback=count, cancellation_token=token,
        ).values())

    def at_once(_: pycolmap.CancellationToken) -> list[pycolmap.Reconstruction]:
        settings = pycolmap.GlobalPipelineOptions()
        settings.image_names, settings.min_model_size = names, SMALLEST
        settings.num_threads, settings.random_seed = threads(), 0
        return list(pycolmap.global_mapping(_database_path(workspace), workspace, output, settings).values())

    with scratch_folder(workspace / "sparse" / "mapper") as output:
        return _cancellable(incremental if mapper == "incremental" else at_once, registered, meter)


def _cancellable(
    call: Callable[[pycolmap.CancellationToken], list[pycolmap.Reconstruction]], registered: list[int], meter: _Meter
) -> list[pycolmap.Reconstruction]:
    """Run a long native call on a thread of its own, so that this one can report progress and pass on a cancel."""
    token = pycolmap.CancellationToken()
    told = 0
    with ThreadPoolExecutor(1, "mapper") as pool:
        future = pool.submit(call, token)
        try:
            while not future.done():
                wait([future], timeout=0.2)
                meter.reporter.check_cancelled()
                if registered[0] > told:
                    meter.advance((registered[0] - told) * meter.photo)
                    told = registered[0]
        finally:
            token.cancel()
        return future.result()


def _components(models: list[pycolmap.Reconstruction]) -> list[pycolmap.Reconstruction]:
    """The models by falling size, each photo only in the largest that has it, none below three photos."""
    taken: set[str] = set()
    components = []
    for model in sorted(models, key=lambda model: (-model.num_reg_images(), -model.num_points3D())):
        for image_id in model.reg_image_ids():
            if model.image(image_id).name in taken:
                model.deregister_frame(model.image(image_id).frame_id)
        if model.num_reg_images() >= SMALLEST and model.num_points3D() > 0:
            model.tear_down()
            taken |= {model.image(i).name for i in model.reg_image_ids()}
            components.append(model)
    return sorted(components, key=lambda model: -model.num_reg_images())


def _colour(model: pycolmap.Reconstruction, photos: dict[str, Photo], image_size: int, reporter: Reporter) -> None:
    """Give every sparse point the mean colour of the photos' pixels that see it."""
    sums: dict[int, np.ndarray] = {point_id: np.zeros(4) for point_id in model.point3D_ids()}
    for image_id in model.reg_image_ids():
        reporter.check_cancelled()
        image = model.image(image_id)
        photo = photos[image.name]
        rgb = read_rgb(photo.path, image_size)
        height, width = rgb.shape[:2]
        for point in image.get_observation_points2D():
            x, y = int(point.xy[0] * width / photo.width), int(point.xy[1] * height / photo.height)
            sums[point.point3D_id] += (*rgb[min(max(y, 0), height - 1), min(max(x, 0), width - 1)], 1)
    for point_id, total in sums.items():
        model.point3D(point_id).color = np.round(total[:3] / max(total[3], 1)).astype(np.uint8)


# ---- what the user must know

def _warn_of_gaps(models: list[pycolmap.Reconstruction], photos: tuple[Photo, ...], reporter: Reporter) -> None:
    placed = {model.image(i).name for model in models for i in model.reg_image_ids()}
    left = [photo.name for photo in photos if photo.name not in placed]
    if left:
        reporter.warning(
            f"{len(left)} of {len(photos)} photos could not be placed and are not used: {listed(left)}. "
            "They overlap too little with the others."
        )
    if len(models) > 1:
        sizes = ", ".join(str(model.num_reg_images()) for model in models)
        reporter.warning(
            f"The photos fall into {len(models)} separate parts ({sizes} photos) that could not be joined: each is "
            "reconstructed on its own. Photos that overlap both parts would join them."
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
        meter = _Meter(reporter, settings, features=len(photos), pairs=len(pairs), mapping=0)
        _extract(database, photos, settings, meter)
        _match(database, photos, pairs, options, meter)
        ids = image_ids(database, photos)
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
    _colour(result, {photo.name: photo for photo in photos}, settings.image_size, reporter)
    meter.finish()
    return result
