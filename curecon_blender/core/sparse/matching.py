# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Features of every photo, pairs of photos worth matching, and their geometrically verified matches.

All of it lives in one COLMAP database, written a photo or a pair at a time, so that a job killed at any moment goes
on from there. Keypoints are in pixels of the original photo (EXIF orientation applied), pixel centres at .5.
"""

from __future__ import annotations

import os
import sqlite3
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations, islice
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
import pycolmap
import torch

from ..base.errors import WorkspaceError
from ..base.files import disk_errors, write_json
from ..base.graphs import spanning_tree
from ..base.images import read_rgb, readers
from ..base.reading import build, read_json
from ..base.records import Photo
from .placement import SHORTEST_BASELINE, gimbal_rotation, gps_enu

MAX_THREADS = 16
EXHAUSTIVE = 60  # photos; up to here every pair is matched when no GPS says which are near each other
RETRIEVED = 20  # most similar photos matched with each photo of a larger set without GPS
WINDOW = 10  # photos before and after in name order, likewise
WIDEST_ANGLE = 75.0  # degrees between optical axes; SIFT does not match beyond, but repeated façades seem to
_CHUNK = 512  # rows of a similarity matrix at a time: it stays in the cache

Pair = tuple[int, int]  # positions of two photos in the job's list, the smaller first
Step = Callable[[], None]  # called after every photo or pair; raises Cancelled
Item = TypeVar("Item")
Value = TypeVar("Value")


@dataclass(frozen=True, kw_only=True)
class FeatureSettings:
    """What the features in a database depend on: longest image side in pixels, most features a photo."""

    image_size: int
    max_features: int


def threads() -> int:
    """Cores that this process may use, within reason."""
    return min(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1, MAX_THREADS)


@contextmanager
def open_database(path: Path, photos: tuple[Photo, ...], settings: FeatureSettings) -> Iterator[pycolmap.Database]:
    """The COLMAP database at `path`, holding only features that these photos and settings still stand for.

    A database that is damaged, was made with other settings or from photos changed since is started afresh; photos
    that were added or left out since keep the others' features. Raises WorkspaceError when it cannot be written.
    """
    record = path.with_suffix(".json")
    wanted: dict[str, Any] = {
        "image_size": settings.image_size, "max_features": settings.max_features,
        "photos": {photo.name: _fingerprint(photo) for photo in photos},
    }
    known = _read_record(record)
    same_settings = all(known.get(key) == wanted[key] for key in ("image_size", "max_features"))
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
            f"The feature database {path} could not be written ({error}).",
            remedy="Free some space, or choose a workspace folder on a local disk that you may write to.", path=path,
        ) from error


def _fingerprint(photo: Photo) -> list[Any]:
    return [photo.digest, photo.width, photo.height, photo.camera, photo.focal_px]


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


# ---- features

def missing_features(database: pycolmap.Database, photos: tuple[Photo, ...]) -> list[Photo]:
    """The photos whose features are not in the database yet."""
    known = {image.name for image in database.read_all_images()}
    return [photo for photo in photos if photo.name not in known]


def extract_features(
    database: pycolmap.Database, photos: tuple[Photo, ...], settings: FeatureSettings, step: Step
) -> None:
    """RootSIFT features of every photo that has none in `database` yet, one transaction a photo."""
    cameras = _write_cameras(database, photos)
    rigs = {rig.ref_sensor_id.id: rig.rig_id for rig in database.read_all_rigs()}
    extractors = threading.local()

    def extract(photo: Photo) -> tuple[np.ndarray, pycolmap.FeatureDescriptors]:
        if not hasattr(extractors, "sift"):
            extractors.sift = _extractor(settings.max_features)
        grey = cv2.cvtColor(read_rgb(photo.path, settings.image_size), cv2.COLOR_RGB2GRAY)
        keypoints, descriptors = extractors.sift.extract_from_uint8_array(grey)
        matrix = pycolmap.keypoints_to_matrix(keypoints)
        height, width = grey.shape
        matrix[:, :2] *= (photo.width / width, photo.height / height)  # corners at 0: no half-pixel shift
        matrix[:, 2] *= photo.width / width
        return matrix, descriptors

    missing = missing_features(database, photos)
    largest = max((photo.width * photo.height for photo in missing), default=0)
    workers = readers(largest, _extraction_workers(settings.image_size))
    with closing(_in_order(extract, missing, workers)) as extracted:
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


def _extractor(max_features: int) -> pycolmap.FeatureExtractor:
    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu = False
    options.num_threads = 1  # one photo a thread
    options.sift.max_num_features = max_features
    return pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)


def _extraction_workers(image_size: int) -> int:
    # The scale space starts at twice the size: about 12 float32 layers of 2 x 2 image_size^2 x 3/4 pixels a worker.
    gib = 12 * 4 * 3 * image_size**2 / 2**30
    return max(1, min(threads(), int(8 / gib)))


def _in_order(
    function: Callable[[Item], Value], items: Iterable[Item], workers: int
) -> Generator[tuple[Item, Value], None, None]:
    """`function` of every item, in order, computed `workers` at a time and never far ahead of the consumer."""
    left = iter(items)
    with ThreadPoolExecutor(workers) as pool:
        running: list[tuple[Item, Future[Value]]] = [(i, pool.submit(function, i)) for i in islice(left, 2 * workers)]
        try:
            while running:
                item, future = running.pop(0)
                value = future.result()
                running += [(i, pool.submit(function, i)) for i in islice(left, 1)]
                yield item, value
        finally:
            for _, future in running:
                future.cancel()


def _camera_key(photo: Photo) -> tuple[str, int, int]:
    return photo.camera, photo.width, photo.height


def _write_cameras(
    database: pycolmap.Database, photos: tuple[Photo, ...]
) -> dict[tuple[str, int, int], pycolmap.Camera]:
    """One camera for all photos taken with it, written unless a photo of it is in the database already."""
    known = {image.name: image.camera_id for image in database.read_all_images()}
    cameras = {_camera_key(photo): database.read_camera(known[photo.name]) for photo in photos if photo.name in known}
    for photo in photos:
        key = _camera_key(photo)
        if key in cameras:
            continue
        focals = [p.focal_px for p in photos if _camera_key(p) == key and p.focal_px is not None]
        focal = float(np.median(focals)) if focals else 1.2 * max(photo.width, photo.height)
        camera = pycolmap.Camera.create_from_model_name(
            pycolmap.INVALID_CAMERA_ID, "SIMPLE_RADIAL", focal, photo.width, photo.height
        )
        camera.has_prior_focal_length = bool(focals)
        with pycolmap.DatabaseTransaction(database):
            camera.camera_id = database.write_camera(camera)
            rig = pycolmap.Rig()
            rig.add_ref_sensor(camera.sensor_id)
            database.write_rig(rig)
        cameras[key] = camera
    return cameras


# ---- pairs

def needs_retrieval(photos: tuple[Photo, ...]) -> bool:
    """Whether pairs have to be found by what photos look like: many photos, and no GPS to tell which are near."""
    return len(photos) > EXHAUSTIVE and not _located(photos)


def metadata_pairs(photos: tuple[Photo, ...]) -> set[Pair]:
    """Pairs worth matching as far as GPS, gimbal angles and the order of names tell.

    Photos with GPS: each with its nearest, and those next in order if they are near too. A pair whose optical axes
    diverge is left out: the sides of a round building look alike, and would match falsely. Without GPS: all pairs
    of a small set, else a window in name order.
    """
    everybody = range(len(photos))
    if not _located(photos):
        return set(combinations(everybody, 2)) if len(photos) <= EXHAUSTIVE else _window(len(photos), WINDOW)
    located = [i for i in everybody if photos[i].gps is not None]
    lost = set(everybody) - set(located)
    positions, _ = gps_enu([photos[i] for i in located])
    axes = np.array([
        (np.nan,) * 3 if gimbal is None else gimbal_rotation(gimbal)[:, 2]
        for gimbal in (photos[i].gimbal for i in located)
    ])
    pairs = {(located[a], located[b]) for a, b in near_pairs(positions, axes)}
    around = set(combinations(everybody, 2)) if len(photos) <= EXHAUSTIVE else _window(len(photos), WINDOW)
    return pairs | {pair for pair in around if lost & set(pair)}


def near_pairs(positions: np.ndarray, axes: np.ndarray) -> set[Pair]:
    """Pairs of neighbouring cameras that look the same way, from positions (N,3) and optical axes (N,3), NaN unknown.

    A minimum spanning tree keeps far groups joined.
    """
    count = len(positions)
    neighbours = min(max(count // 3, 6), 20, count - 1)
    distances = np.stack([np.linalg.norm(positions - position, axis=1) for position in positions])
    np.fill_diagonal(distances, np.inf)
    nearest = np.argsort(distances, axis=1)[:, :neighbours]
    pairs = {_ordered(i, int(j)) for i in range(count) for j in nearest[i]}
    pairs |= {(i, j) for i, j in spanning_tree(distances).tolist()}
    reach = 2 * float(np.median(distances[np.arange(count), nearest[:, -1]]))
    pairs |= {(i, j) for i, j in _window(count, 3) if distances[i, j] < reach}
    widest = np.cos(np.radians(WIDEST_ANGLE))
    return {(i, j) for i, j in pairs if not float(axes[i] @ axes[j]) < widest}  # NaN is not less: unknown stays


def _ordered(i: int, j: int) -> Pair:
    return (i, j) if i < j else (j, i)


def _located(photos: tuple[Photo, ...]) -> bool:
    located = [photo for photo in photos if photo.gps is not None]
    return (
        len(located) >= max(3, 0.9 * len(photos))
        and float(np.linalg.norm(np.ptp(gps_enu(located)[0], axis=0))) > SHORTEST_BASELINE
    )


def _window(count: int, width: int) -> set[Pair]:
    return {(i, j) for i in range(count) for j in range(i + 1, min(i + width + 1, count))}


def similar_pairs(database: pycolmap.Database, photos: tuple[Photo, ...], step: Step) -> set[Pair]:
    """Each photo with the photos most like it, by VLAD vectors over a vocabulary learnt from the photos themselves.

    (Jegou et al., CVPR 2010: residuals of local descriptors against their visual words, summed and normalised.)
    """
    rng = np.random.default_rng(0)
    ids = image_ids(database, photos)

    def descriptors(image_id: int, most: int) -> np.ndarray:
        data = database.read_descriptors(image_id).data
        chosen = data if len(data) <= most else data[rng.choice(len(data), most, replace=False)]
        return chosen.astype(np.float32)

    sample = np.concatenate([descriptors(i, max(50, 50_000 // len(ids))) for i in ids])
    if len(sample) < 64:
        return set()
    criteria = (cv2.TERM_CRITERIA_MAX_ITER, 15, 0.0)
    cv2.setRNGSeed(0)
    words = cv2.kmeans(sample, 64, None, criteria, 1, cv2.KMEANS_PP_CENTERS)[2]  # type: ignore[call-overload]
    signatures = np.zeros((len(ids), words.size), np.float32)
    for row, image_id in enumerate(ids):
        data = descriptors(image_id, 2000)
        nearest = np.argmin((words**2).sum(1) - 2 * data @ words.T, axis=1)
        residuals = np.zeros_like(words)
        np.add.at(residuals, nearest, data - words[nearest])
        residuals /= np.maximum(np.linalg.norm(residuals, axis=1, keepdims=True), 1e-9)
        signatures[row] = residuals.ravel() / max(float(np.linalg.norm(residuals)), 1e-9)
        step()
    similarity = signatures @ signatures.T
    np.fill_diagonal(similarity, -np.inf)
    best = np.argsort(-similarity, axis=1)[:, :RETRIEVED]
    return {_ordered(i, int(j)) for i in range(len(ids)) for j in best[i]}


# ---- matches

def unmatched(database: pycolmap.Database, photos: tuple[Photo, ...], pairs: set[Pair]) -> list[Pair]:
    """The pairs that the database has no verdict on yet, in an order that keeps neighbours together."""
    ids = image_ids(database, photos)
    return [(i, j) for i, j in sorted(pairs) if not database.exists_two_view_geometry(ids[i], ids[j])]


def match_pairs(
    database: pycolmap.Database, photos: tuple[Photo, ...], pairs: list[Pair], device: str, step: Step
) -> None:
    """Match every pair and verify it geometrically; a pair that fails is recorded too, without inliers.

    `device` is a torch device ("cpu", "cuda"...), used for the brute-force search.
    """
    ids = image_ids(database, photos)
    cameras = {image.image_id: database.read_camera(image.camera_id) for image in database.read_all_images()}

    @lru_cache(maxsize=256)  # about 1 MB a photo
    def features(photo: int) -> tuple[np.ndarray, torch.Tensor]:
        keypoints = database.read_keypoints(ids[photo])[:, :2].astype(np.float64)
        return keypoints, torch.from_numpy(database.read_descriptors(ids[photo]).data.copy()).to(device)

    options = pycolmap.TwoViewGeometryOptions()
    options.ransac.random_seed = 0

    def verified(task: _Task) -> pycolmap.TwoViewGeometry:
        (keypoints1, descriptors1), (keypoints2, descriptors2) = task.first, task.second
        matches = match_descriptors(descriptors1, descriptors2)
        if len(matches) < options.min_num_inliers:
            return pycolmap.TwoViewGeometry()
        camera1, camera2 = (cameras[ids[photo]] for photo in task.pair)
        return pycolmap.estimate_two_view_geometry(camera1, keypoints1, camera2, keypoints2, matches, options)

    tasks = (_Task(pair=pair, first=features(pair[0]), second=features(pair[1])) for pair in pairs)
    with _one_thread_a_task(), closing(_in_order(verified, tasks, threads())) as results:
        for task, geometry in results:
            with pycolmap.DatabaseTransaction(database):
                database.write_two_view_geometry(ids[task.pair[0]], ids[task.pair[1]], geometry)
            step()


@dataclass(frozen=True, kw_only=True)
class _Task:
    pair: Pair
    first: tuple[np.ndarray, torch.Tensor]  # keypoints, descriptors
    second: tuple[np.ndarray, torch.Tensor]


def match_descriptors(first: torch.Tensor, second: torch.Tensor) -> np.ndarray:
    """Mutual nearest neighbours (K,2) uint32 between uint8 RootSIFT descriptors (M,128) and (N,128).

    As COLMAP has it: the angle between descriptors below 0.7 rad and below 0.8 of the second nearest's.
    """
    if len(first) < 2 or len(second) < 2:
        return np.empty((0, 2), np.uint32)
    a, b = first.float() / 512, second.float() / 512  # COLMAP stores unit vectors as bytes, times 512
    rows, columns = [], []
    for start in range(0, len(a), _CHUNK):
        similarity, nearest = (a[start : start + _CHUNK] @ b.T).topk(2, dim=1)
        angle = torch.acos(similarity.clamp(max=1))
        row = ((angle[:, 0] < 0.7) & (angle[:, 0] < 0.8 * angle[:, 1])).nonzero()[:, 0]
        rows.append(row + start)
        columns.append(nearest[row, 0])
    row, column = torch.cat(rows), torch.cat(columns)
    back = [(b[column[s : s + _CHUNK]] @ a.T).argmax(dim=1) for s in range(0, len(column), _CHUNK)]
    mutual = torch.cat(back) == row if back else torch.zeros(0, dtype=torch.bool)
    return torch.stack([row[mutual], column[mutual]], dim=1).cpu().numpy().astype(np.uint32)


@contextmanager
def _one_thread_a_task() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
