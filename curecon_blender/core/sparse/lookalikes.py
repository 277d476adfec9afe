# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Photos of sides that look alike, joined as if they showed the same side: found in a model, and cut.

No sign alone is proof. A join of two photos is cut when two witnesses contradict it: what surrounds the matches (where
the model says that both photos show the same things, and those do not match), and one of the gimbal, GPS, and the
order of capture.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from scipy.spatial import cKDTree

from ..base import rotations
from ..base.files import scratch_folder
from ..base.geodesy import gps_enu
from ..base.language import Text
from ..base.messages import Reporter
from ..base.records import Photo
from .features import image_ids
from .models import listed
from .pairs import Pair

PATCHES = 8, 6  # across a photo, and down
STRONG = 30  # verified matches of a pair that surely overlaps
CLOSED = 0.8  # share of the features that come to the same feature by way of a third photo, where all three are right
HELD, TORN = 0.5, 0.2  # share of a pair's matches that the model has as one point: it relies on the pair, or tears it
TURNED = 35.0  # degrees by which gimbal and model may differ between two photos
TRUSTED = 12.0  # degrees, median: gimbals that differ more tell nothing
ELSEWHERE = 12.0, 0.5  # metres, and share of the distance by GPS, by which two photos may be nearer in the model
MISSED = 0.6  # of the usual share of patches that match; below, the surroundings contradict
WIDEST, FARTHEST = 30.0, 2.0  # degrees and ratio of distances up to which a point should be recognised
FEWEST_PATCHES, RICH = 6, 3  # patches to tell by, and features in one
ROUNDS = 3  # of cutting and mapping: what held a join may have hidden the next
FEWEST_TEARS, TEARS = 3, 0.1  # pairs of followers, and share of them, that a model tears where it is folded
OFF_PLACE = 0.05  # of the focal length, from where a model has a feature: models of a chain of photos drift
STAYED = 0.05  # of the cameras' extent, by which a photo may move and still stand where it stood


@dataclass(frozen=True, kw_only=True)
class Join:
    """Two photos (positions in the job's list) with verified matches (K,2), and how the models take them."""

    pair: Pair
    matches: np.ndarray
    kept: float  # share of the matches with a point that have the same point in both photos; nan with too few to tell

    @property
    def held(self) -> bool:
        return self.kept >= HELD

    @property
    def torn(self) -> bool:
        return len(self.matches) >= STRONG and self.kept < TORN


@dataclass(frozen=True, kw_only=True)
class Placed:
    """A photo in a model: its pose and lens, and its features with the points that they show."""

    model: int
    camera: pycolmap.Camera
    rotation: np.ndarray  # cam_from_world (3,3)
    centre: np.ndarray
    pixels: np.ndarray  # (F,2) of the features
    tracks: np.ndarray  # (F,) their points, -1 none
    scene: np.ndarray  # (F,3) where they lie, those without a point as deep as the nearest in the picture with one


def placed_photos(models: list[pycolmap.Reconstruction], photos: tuple[Photo, ...]) -> dict[int, Placed]:
    """The photos that the models have, by position in the job's list."""
    position = {photo.name: i for i, photo in enumerate(photos)}
    placed = {}
    for index, model in enumerate(models):
        for image_id in model.reg_image_ids():
            image = model.image(image_id)
            pixels = np.array([point.xy for point in image.points2D]).reshape(-1, 2)
            tracks = np.array([p.point3D_id if p.has_point3D() else -1 for p in image.points2D], np.int64)
            known = np.flatnonzero(tracks >= 0)
            if len(known) == 0:
                continue
            camera, pose = model.camera(image.camera_id), image.cam_from_world()
            rotation, centre = pose.rotation.matrix(), image.projection_center()
            depths = (np.array([model.point3D(i).xyz for i in tracks[known]]) - centre) @ rotation[2]
            depths = depths[cKDTree(pixels[known]).query(pixels)[1]]
            rays = np.concatenate([camera.cam_from_img(pixels), np.ones((len(pixels), 1))], axis=1)
            placed[position[image.name]] = Placed(
                model=index, camera=camera, rotation=rotation, centre=centre, pixels=pixels, tracks=tracks,
                scene=centre + (rays * depths[:, None]) @ rotation,
            )
    return placed


def find_joins(
    placed: dict[int, Placed], verified: Iterable[tuple[Pair, np.ndarray]]
) -> list[Join]:
    """Every pair with verified matches (K,2). A photo apart, or none of the models', shares no point."""
    joins = []
    for (i, j), matches in verified:
        if len(matches) == 0:
            continue
        if i not in placed or j not in placed or placed[i].model != placed[j].model:
            joins.append(Join(pair=(i, j), matches=matches, kept=0.0))
            continue
        first, second = placed[i].tracks[matches[:, 0]], placed[j].tracks[matches[:, 1]]
        known, same = (first >= 0) | (second >= 0), (first == second) & (first >= 0)
        kept = float(same.sum() / known.sum()) if known.sum() >= STRONG / 2 else float("nan")
        joins.append(Join(pair=(i, j), matches=matches, kept=kept))
    return joins


def patches_found(join: Join, placed: dict[int, Placed]) -> float:
    """Of the patches that both photos of a join should show, by the model, and in which both have features: the share
    in which any of them match; nan where the patches are few."""
    first, second = (placed[photo] for photo in join.pair)
    counts = _patches(first, second, join.matches[:, 0]) + _patches(second, first, join.matches[:, 1])
    return float(counts[0] / counts[1]) if counts[1] >= FEWEST_PATCHES else float("nan")


def _patches(source: Placed, target: Placed, matched: np.ndarray) -> np.ndarray:
    """Patches of the source with features that match, and of all that the target should show, too: (2,)."""
    to_source, to_target = source.scene - source.centre, source.scene - target.centre
    near, far = np.linalg.norm(to_source, axis=1), np.linalg.norm(to_target, axis=1)
    cosine = (to_source * to_target).sum(1) / np.maximum(near * far, 1e-12)
    alike = (cosine > np.cos(np.radians(WIDEST))) & (near < FARTHEST * far) & (far < FARTHEST * near)
    pixels = _seen(target, source.scene)
    with np.errstate(invalid="ignore"):
        alike &= (pixels >= 0).all(1) & (pixels < [target.camera.width, target.camera.height]).all(1)
    chosen = np.flatnonzero(alike)
    pixels = pixels[chosen]
    count = PATCHES[0] * PATCHES[1]
    own, there = _cells(source, source.pixels), _cells(target, pixels)
    rich = np.bincount(_cells(target, target.pixels), minlength=count) >= RICH
    shared = np.bincount(own[chosen][rich[there]], minlength=count) >= RICH
    found = np.zeros(count, bool)
    found[own[matched]] = True
    return np.array([(shared & found).sum(), shared.sum()])


def _seen(photo: Placed, places: np.ndarray) -> np.ndarray:
    """Pixels (N,2) at which a photo shows places (N,3) of its model; nan behind it."""
    local = (places - photo.centre) @ photo.rotation.T
    local[local[:, 2] < 1e-9] = np.nan
    return np.asarray(photo.camera.img_from_cam(local)).reshape(-1, 2)


def _cells(photo: Placed, pixels: np.ndarray) -> np.ndarray:
    """The patch (N,) of a photo in which each pixel lies."""
    cells = (pixels / [photo.camera.width, photo.camera.height] * PATCHES).astype(int)
    result: np.ndarray = cells.clip(0, np.array(PATCHES) - 1) @ [1, PATCHES[0]]
    return result


# ---- witnesses


def contradicted(placed: dict[int, Placed], joins: list[Join], photos: tuple[Photo, ...]) -> list[Pair]:
    """The pairs that a model relies on, and that two witnesses contradict."""
    rank, followers = _order_of_capture(photos), _followers(joins, photos)
    sure = [join for join in joins if join.held and join.pair in followers]
    doubtful = [join for join in joins if join.held and join.pair not in followers]
    turned, elsewhere = _by_gimbal(placed, sure, photos), _by_gps(placed, sure, photos)
    across = _by_order([join for join in joins if join.torn and join.pair in followers], rank)
    suspects = []
    for join in doubtful:
        witnesses = sum((turned(join.pair), elsewhere(join.pair), across(join.pair)))
        if witnesses:
            suspects.append((join, witnesses))
    if not suspects:
        return []
    shares = [patches_found(join, placed) for join in sure[:: len(sure) // 100 + 1]]
    known = [share for share in shares if share == share]
    least = MISSED * (float(np.median(known)) if known else 1.0)
    return [join.pair for join, witnesses in suspects if witnesses >= 2 or patches_found(join, placed) < least]


def _followers(joins: list[Join], photos: tuple[Photo, ...]) -> set[Pair]:
    """The pairs that surely show the same side: photos taken one after the other; and those with one between them where
    the way through it comes to the same features, or where there is none. Two photos apart, the next bay of a round
    building may match better than the true one."""
    rank = _order_of_capture(photos)
    between = {place: photo for photo, place in rank.items()}
    matches = {join.pair: join.matches for join in joins if len(join.matches) >= STRONG}
    matches |= {(j, i): found[:, ::-1] for (i, j), found in matches.items()}
    followers = set()
    for join in joins:
        first, last = sorted(rank[photo] for photo in join.pair)
        if last - first == 1:
            followers.add(join.pair)
        elif last - first == 2:
            i, j = join.pair
            there, on = matches.get((i, between[first + 1])), matches.get((between[first + 1], j))
            if there is None or on is None or _closed(join.matches, there, on):
                followers.add(join.pair)
    return followers


def _closed(straight: np.ndarray, there: np.ndarray, on: np.ndarray) -> bool:
    """Whether features come to the same by matches (K,2) between two photos as by those to a third and on from it."""
    _, a, b = np.intersect1d(there[:, 1], on[:, 0], return_indices=True)
    ways = np.stack([there[a, 0], on[b, 1]], axis=1)
    _, a, b = np.intersect1d(straight[:, 0], ways[:, 0], return_indices=True)
    return len(a) > 0 and float((straight[a, 1] == ways[b, 1]).mean()) >= CLOSED


def _by_order(torn: list[Join], rank: dict[int, int]) -> Callable[[Pair], bool]:
    """Whether the models tear apart what was taken from one photo to the other: followers that match well."""
    tears = [sorted(rank[photo] for photo in join.pair) for join in torn]

    def across(pair: Pair) -> bool:
        first, last = sorted(rank[photo] for photo in pair)
        return any(first <= low and high <= last for low, high in tears)

    return across


def _order_of_capture(photos: tuple[Photo, ...]) -> dict[int, int]:
    """Each photo's place in the order of time, or of names where a time is missing."""
    timed = all(photo.time is not None for photo in photos)
    order = sorted(range(len(photos)), key=lambda i: (photos[i].time if timed else "", photos[i].name))
    return {photo: rank for rank, photo in enumerate(order)}


def _by_gimbal(
    placed: dict[int, Placed], sure: list[Join], photos: tuple[Photo, ...]
) -> Callable[[Pair], bool]:
    """Whether two photos' gimbals contradict the rotation that a model gives between them."""
    held = {i: rotations.from_gimbal(gimbal) for i in placed if (gimbal := photos[i].gimbal) is not None}

    def difference(pair: Pair) -> float:
        i, j = pair
        if i not in held or j not in held:
            return 0.0
        by_model = placed[i].rotation @ placed[j].rotation.T
        cosine = (np.trace(by_model.T @ held[i].T @ held[j]) - 1) / 2
        return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))

    known = [difference(join.pair) for join in sure if set(join.pair) <= held.keys()]
    trusted = bool(known) and float(np.median(known)) < TRUSTED
    return lambda pair: trusted and difference(pair) > TURNED


def _by_gps(
    placed: dict[int, Placed], sure: list[Join], photos: tuple[Photo, ...]
) -> Callable[[Pair], bool]:
    """Whether two photos are much nearer in a model than by GPS."""
    located = [i for i in placed if photos[i].gps is not None]
    places = dict(zip(located, gps_enu([photos[i] for i in located])[0], strict=True)) if located else {}

    def distances(pair: Pair) -> tuple[float, float]:
        i, j = pair
        return (float(np.linalg.norm(places[i] - places[j])),
                float(np.linalg.norm(placed[i].centre - placed[j].centre)))

    scales: dict[int, float] = {}
    for model in {photo.model for photo in placed.values()}:
        pairs = [join.pair for join in sure if set(join.pair) <= places.keys() and placed[join.pair[0]].model == model]
        ratios = [by_gps / max(by_model, 1e-9) for by_gps, by_model in map(distances, pairs)]
        scales[model] = float(np.median(ratios)) if ratios else np.inf

    def contradicts(pair: Pair) -> bool:
        if not set(pair) <= places.keys():
            return False
        by_gps, by_model = distances(pair)
        return by_gps - scales[placed[pair[0]].model] * by_model > max(ELSEWHERE[0], ELSEWHERE[1] * by_gps)

    return contradicts


# ---- the mend


def without_lookalikes(
    database: Path, models: list[pycolmap.Reconstruction], photos: tuple[Photo, ...],
    remap: Callable[[Path], list[pycolmap.Reconstruction]], reporter: Reporter,
) -> list[pycolmap.Reconstruction]:
    """The models, mapped once more without the joins that two witnesses contradict where that changes them.

    `remap` maps what a database holds. The user is told which photos stood on a wrong side. Raises Cancelled.
    """
    verified = verified_matches(database, photos)
    before = now = _State(models, verified, photos)
    cut: set[Pair] = set()

    def without(pairs: set[Pair]) -> _State:
        reporter.check_cancelled()
        with scratch_folder(database.parent / "cut") as folder:
            copy_without(database, folder / database.name, photos, pairs)
            return _State(remap(folder / database.name), verified, photos)

    for _ in range(ROUNDS):
        doubtful = set(contradicted(now.placed, now.joins, photos)) - cut
        if not doubtful:
            break
        cut |= doubtful
        now = without(cut)
    if now.tears >= max(FEWEST_TEARS, TEARS * now.strong):
        # The order of capture as the first witness, and the model that it gives as the second.
        others = {join.pair for join in now.joins} - now.followers
        chain = without(others)
        apart = {join.pair for join in chain.joins if join.pair in others and not _agrees(join, chain.placed)}
        joined = without(apart)
        if joined.tears < now.tears:
            now, cut = joined, apart
    moved = [photos[i].name for i in _moved(before.placed, now.placed)] if cut else []
    if not moved or 2 * now.tears > before.tears or len(now.placed) < len(before.placed):
        return models
    reporter.warning(Text(
        "{} photos seemed to stand on the wrong side of the building, where another side looks like their own: {}. {} "
        "joins of photos that their surroundings, the gimbal, GPS or the order of capture contradict were cut, and the "
        "cameras found once more. Look at the cameras before you trust the model.",
        len(moved), listed(moved), len(cut)))
    return now.models


class _State:
    """Models with what they make of the verified matches."""

    def __init__(self, models: list[pycolmap.Reconstruction], verified: list[tuple[Pair, np.ndarray]],
                 photos: tuple[Photo, ...]) -> None:
        self.models = models
        self.placed = placed_photos(models, photos)
        self.joins = find_joins(self.placed, verified)
        self.followers = _followers(self.joins, photos)
        strong = [join for join in self.joins if join.pair in self.followers and len(join.matches) >= STRONG]
        self.strong, self.tears = len(strong), sum(join.torn for join in strong)


def _agrees(join: Join, placed: dict[int, Placed]) -> bool:
    """Whether most of a join's matches are what a model has in their place: not the same one bay on."""
    if not set(join.pair) <= placed.keys() or placed[join.pair[0]].model != placed[join.pair[1]].model:
        return False
    first, second = (placed[photo] for photo in join.pair)
    off = [
        np.abs(_seen(there, here.scene[mine]) - there.pixels[other]).max(axis=1) / there.camera.mean_focal_length()
        for here, there, mine, other in ((first, second, *join.matches.T), (second, first, *join.matches.T[::-1]))
    ]
    return bool(np.nanmedian(np.concatenate(off)) < OFF_PLACE)


def verified_matches(database: Path, photos: tuple[Photo, ...]) -> list[tuple[Pair, np.ndarray]]:
    """Every pair of photos with its verified matches (K,2)."""
    with pycolmap.Database.open(database) as opened:
        position = {image_id: i for i, image_id in enumerate(image_ids(opened, photos))}
        pairs, geometries = opened.read_two_view_geometries()
    both = zip(map(pycolmap.pair_id_to_image_pair, pairs), geometries, strict=True)
    return [
        ((position[i], position[j]), geometry.inlier_matches) for (i, j), geometry in both
        if i in position and j in position
    ]


def copy_without(database: Path, copy: Path, photos: tuple[Photo, ...], cut: set[Pair]) -> None:
    """Copy what mapping reads of a database, but for some pairs of photos."""
    with pycolmap.Database.open(database) as opened:
        ids = image_ids(opened, photos)
    with pycolmap.Database.open(copy):  # its tables
        pass
    with closing(sqlite3.connect(copy)) as connection, connection:
        connection.execute("ATTACH ? AS whole", (str(database),))
        for table in ("rigs", "rig_sensors", "cameras", "frames", "frame_data", "images", "keypoints",
                      "two_view_geometries"):
            connection.execute(f"INSERT INTO main.{table} SELECT * FROM whole.{table}")
        connection.executemany(
            "DELETE FROM main.two_view_geometries WHERE pair_id = ?",
            [(pycolmap.image_pair_to_pair_id(ids[i], ids[j]),) for i, j in cut],
        )


def _moved(before: dict[int, Placed], after: dict[int, Placed]) -> list[int]:
    """Photos that stand elsewhere, against the others, than before."""
    moved = []
    for model in {photo.model for photo in before.values()}:
        old = [i for i, photo in before.items() if photo.model == model]
        homes = [after[i].model for i in old if i in after]
        home = max(set(homes), key=homes.count, default=-1)
        both = [i for i in old if i in after and after[i].model == home]
        options = pycolmap.RANSACOptions()
        options.random_seed = 0
        source, target = (np.array([there[i].centre for i in both]).reshape(-1, 3) for there in (before, after))
        options.max_error = STAYED * float(np.linalg.norm(np.ptp(target, axis=0))) if both else 1.0
        fit = pycolmap.estimate_sim3d_robust(source, target, options) if len(both) >= 3 else None
        if fit is None:
            moved += old
            continue
        moves: Any = fit  # a dictionary, whatever pycolmap's stubs say
        off = np.linalg.norm(np.array([moves["tgt_from_src"] * place for place in source]) - target, axis=1)
        stayed = {i for i, distance in zip(both, off, strict=True) if distance < options.max_error}
        moved += [i for i in old if i not in stayed]
    return sorted(moved)
