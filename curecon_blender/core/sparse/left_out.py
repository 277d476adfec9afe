# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Photos that SIFT leaves out, or puts in a part of their own: matched by networks as well, and mapped once more.

Learned matches join look-alikes with ease. So they are asked for only where SIFT does not suffice, and a photo that
they place counts only where gimbal or GPS bear it out: its matches alone do not tell.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from itertools import combinations
from pathlib import Path

import numpy as np
import pycolmap

from ..base import rotations
from ..base.geodesy import gps_enu
from ..base.records import Photo
from .joint_matches import joint_database
from .lookalikes import (
    STAYED,
    STRONG,
    TRUSTED,
    Join,
    Placed,
    contradicted,
    find_joins,
    placed_photos,
    verified_matches,
)
from .mapping import SMALLEST, drop_loose
from .pairs import Pair, facing_alike
from .placement import BENT, CONTRADICTED, place, similarity, transformed
from .progress import Meter

MOST_PAIRS = 600  # matched by networks, about a second each
PARTNERS = 6  # of a photo, matched with each other, too: what they share gives it points to stand on
LOCATED = 4  # photos with GPS in a part, from which it tells something of one
USUAL, SHARP = 4.0, 1.0  # times what GPS is off in the median, and metres, up to which a photo stands near enough
HELD_BY = 2  # joins of a photo that a model keeps, if GPS tells nothing

Models = list[pycolmap.Reconstruction]


def place_left_out(
    database: Path, models: Models, photos: tuple[Photo, ...], pairs: set[Pair], device: str,
    remap: Callable[[Path], Models], meter: Meter,
) -> Models:
    """The models with photos that SIFT left out, as far as learned matches place them and nothing speaks against it;
    else the models as they are.

    `pairs` are those that SIFT matched, kept in `database`, which does not change; `remap` maps what a database holds.
    Raises Cancelled, WeightsError.
    """
    before = placed_photos(models, photos)
    whole = len(before) == len(photos) and len(models) == 1
    if whole or all(photo.gps is None and photo.gimbal is None for photo in photos):
        return models
    sift = {pair: len(matches) for pair, matches in verified_matches(database, photos)}
    apart = [(i, j) for i, j in pairs if i not in before or j not in before or before[i].model != before[j].model]
    apart = sorted(apart, key=lambda pair: (-sift.get(pair, 0), pair[1] - pair[0], pair))[:MOST_PAIRS]
    with joint_database(database, photos, device, meter) as joint:
        meter.expect_learned(len(apart))
        partners = _partners(joint.add(apart, meter.advance))
        if not any(len(found) >= HELD_BY for found in partners.values()):
            return models
        among = {pair for found in partners.values() for pair in combinations(sorted(found[:PARTNERS]), 2)}
        among = facing_alike(photos, among) - set(apart)
        meter.expect_learned(len(apart) + len(among))
        joint.add(sorted(among)[:MOST_PAIRS], meter.advance)
        return _better(models, before, remap(joint.path), photos, verified_matches(joint.path, photos))


def _partners(inliers: dict[Pair, int]) -> dict[int, list[int]]:
    """The photos that match a photo well, the best first."""
    partners: dict[int, list[int]] = defaultdict(list)
    for i, j in sorted(inliers, key=lambda pair: -inliers[pair]):
        if inliers[i, j] >= STRONG:
            partners[i].append(j)
            partners[j].append(i)
    return partners


# ---- whether the new models are better


def _better(
    models: Models, before: dict[int, Placed], after: Models, photos: tuple[Photo, ...],
    verified: list[tuple[Pair, np.ndarray]],
) -> Models:
    """The models after, without photos that nothing bears out, if they keep what was placed and join more; else those
    before."""
    while True:
        placed = placed_photos(after, photos)
        doubtful = _doubtful(after, before, placed, find_joins(placed, verified), photos)
        if doubtful & before.keys():
            return models
        if not doubtful:
            break
        _leave_out(after, {photos[i].name for i in doubtful})
    more = len(placed) > len(before) or (len(placed) == len(before) and len(after) < len(models))
    return after if more and _stay(before, placed) else models


def _stay(before: dict[int, Placed], after: dict[int, Placed]) -> bool:
    """Whether the photos of each model before stand to each other as they did."""
    for model in {photo.model for photo in before.values()}:
        old = [i for i, photo in before.items() if photo.model == model]
        if not set(old) <= after.keys() or len({after[i].model for i in old}) > 1:
            return False
        source, target = (np.array([there[i].centre for i in old]) for there in (before, after))
        off = np.linalg.norm(transformed(similarity(source, target), source) - target, axis=1)
        if off.max() > STAYED * np.linalg.norm(np.ptp(target, axis=0)):
            return False
    return True


def _doubtful(
    models: Models, before: dict[int, Placed], placed: dict[int, Placed], joins: list[Join], photos: tuple[Photo, ...]
) -> set[int]:
    """The photos that are new to a model, or that it took from another, and that are not borne out."""
    accused = {photo for pair in contradicted(placed, joins, photos) for photo in pair}
    doubtful = set()
    for index, model in enumerate(models):
        members = {i for i, photo in placed.items() if photo.model == index}
        old = [before[i].model for i in members if i in before]
        stem = max(set(old), key=old.count, default=-1)
        inside = [join for join in joins if members.issuperset(join.pair)]
        by_gimbal, by_gps = _by_gimbal(placed, inside, photos), _by_gps(model, sorted(members), photos)
        for i in members:
            if i in before and before[i].model == stem:
                continue
            own = [join for join in inside if i in join.pair]
            held, torn = sum(join.held for join in own), sum(join.torn for join in own)
            turned, located = by_gimbal.get(i), by_gps.get(i)
            # One window on it would be turned as the gimbal tells, too; and a few photos of their own may be bent.
            by_turn = turned is True and stem >= 0 and held >= HELD_BY and torn == 0
            against = i in accused or False in (turned, located) or held < torn
            if against or not (located is True or by_turn):
                doubtful.add(i)
    return doubtful


def _leave_out(models: Models, names: set[str]) -> None:
    for model in [*models]:
        for image in [model.image(i) for i in model.reg_image_ids()]:
            if image.name in names:
                model.deregister_frame(image.frame_id)
        drop_loose(model)
        if model.num_reg_images() < SMALLEST:
            models.remove(model)


def _by_gimbal(placed: dict[int, Placed], joins: list[Join], photos: tuple[Photo, ...]) -> dict[int, bool]:
    """Whether the gimbals bear a photo out: it is turned against those it is joined with as they tell. Gimbals that
    disagree with most joins tell nothing."""
    off: dict[int, list[float]] = defaultdict(list)
    for join in joins:
        i, j = join.pair
        first, second = photos[i].gimbal, photos[j].gimbal
        if join.held and first is not None and second is not None:
            by_model = placed[i].rotation @ placed[j].rotation.T
            by_gimbal = rotations.from_gimbal(first).T @ rotations.from_gimbal(second)
            cosine = np.clip((np.trace(by_model.T @ by_gimbal) - 1) / 2, -1, 1)
            off[i].append(float(np.degrees(np.arccos(cosine))))
            off[j].append(off[i][-1])
    if not off or np.median([value for values in off.values() for value in values]) > TRUSTED:
        return {}
    return {i: bool(np.median(values) < TRUSTED) for i, values in off.items()}


def _by_gps(model: pycolmap.Reconstruction, members: list[int], photos: tuple[Photo, ...]) -> dict[int, bool]:
    """Whether GPS bears a photo out: it stands as near as the others do, within a tenth of the flight's reach; or tells
    that it stands elsewhere, by more than GPS errs."""
    located = [i for i in members if photos[i].gps is not None]
    if len(located) < LOCATED:
        return {}
    off = place(model, {photos[i].name: photos[i] for i in members}).gps_residuals
    if not off:
        return {}
    places = gps_enu([photos[i] for i in located])[0]
    tenth = CONTRADICTED * float(np.median(np.linalg.norm(places - places.mean(0), axis=1)))
    near = min(tenth, max(USUAL * float(np.median([*off.values()])), SHARP))
    told = {i: off[photos[i].name] for i in located}
    return {i: metres < near for i, metres in told.items() if metres < near or metres > max(BENT, tenth)}
