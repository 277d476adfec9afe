# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The surface that should be there, in patches: what photos measured, what was filled, and walls and roofs of which
nothing was found. With how well photos saw each, kept as a PLY."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..base.errors import WorkspaceError
from ..base.language import Text
from ..base.ply import column, read_ply, row_type, table, write_ply
from ..base.reading import FARTHEST
from .coverage import ENOUGH, LEAST_ANGLE, Eyes, Parts, Seen, Sight, seen, sightings

MEASURED, FILLED, ABSENT = 0, 1, 2  # what a patch is
COARSE = 2.0  # times the usual finest pixel: a photo whose pixel is larger measures too little to count
_BESIDE = 2.0  # metres from a block's wall within which a patch stands for it: blocks are drawn around a building
_ALIKE = 0.3  # cosine between the normals of such a patch and of the wall
_SOME = 20_000_000  # distances at once
_ROW = row_type([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("nx", "<f4"), ("ny", "<f4"), ("nz", "<f4"), ("area", "<f4"),
                 ("kind", "u1"), ("photos", "<u2"), ("angle", "<f4"), ("pixel", "<f4"), ("short", "u1")])


@dataclass(frozen=True)
class Patches:
    """Parts of a surface with the square metres (N,) that each stands for and what it is (N,) uint8: MEASURED, FILLED
    or ABSENT."""

    parts: Parts
    areas: np.ndarray
    kinds: np.ndarray

    def __len__(self) -> int:
        return len(self.areas)


@dataclass(frozen=True)
class Judged:
    """Patches, what photos see of them, the rays (N,ENOUGH,3) from each to the photos that count there, zero where
    there are fewer, and how many (N,) it lacks of ENOUGH."""

    patches: Patches
    seen: Seen
    rays: np.ndarray
    short: np.ndarray
    coarsest: float  # millimetres a pixel that still count

    @property
    def share(self) -> float:
        """The share of the area that lacks photos."""
        return float(self.patches.areas[self.short > 0].sum() / max(self.patches.areas.sum(), 1e-9))


def patches_of(places: np.ndarray, normals: np.ndarray, areas: np.ndarray, filled: np.ndarray, side: float) -> Patches:
    """Patches about `side` metres wide of many small places (N,3) with unit normals (N,3), areas (N,), and whether (N,)
    each is filled. Both sides of a wall are apart."""
    axis = np.abs(normals).argmax(axis=1)
    facing = 2 * axis + (np.take_along_axis(normals, axis[:, None], axis=1)[:, 0] > 0)
    cube = np.floor((places - places.min(axis=0)) / side).astype(np.int64)
    size = cube.max(axis=0) + 1
    key = ((cube[:, 0] * size[1] + cube[:, 1]) * size[2] + cube[:, 2]) * 6 + facing
    _, group = np.unique(key, return_inverse=True)
    total = np.bincount(group, areas)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.stack([np.bincount(group, areas * values[:, n]) for n in range(3)], axis=1) / total[:, None]

    normal = mean(normals)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    share = np.bincount(group, areas * filled) / total
    whole = total > 0.05 * side**2  # slivers stand for nothing
    kinds = np.where(share > 0.5, FILLED, MEASURED).astype(np.uint8)
    return Patches(Parts(mean(places)[whole], normal[whole]), total[whole], kinds[whole])


def absent(block: Parts, found: Patches) -> Parts:
    """The parts of a building's block that have no patch beside them which faces the same way."""
    lonely = np.ones(len(block.places), bool)
    step = max(1, _SOME // max(3 * len(found), 1))
    for begin in range(0, len(lonely), step):
        some = block.places[begin : begin + step, None] - found.parts.places
        alike = block.normals[begin : begin + step] @ found.parts.normals.T > _ALIKE
        lonely[begin : begin + step] = ~(alike & ((some**2).sum(axis=2) <= _BESIDE**2)).any(axis=1)
    return Parts(block.places[lonely], block.normals[lonely])


def with_absent(found: Patches, missing: Parts, area: float) -> Patches:
    """Patches together with parts of which nothing was found, each of so many square metres."""
    count = len(missing.places)
    return Patches(Parts(np.concatenate([found.parts.places, missing.places]),
                         np.concatenate([found.parts.normals, missing.normals])),
                   np.concatenate([found.areas, np.full(count, area)]),
                   np.concatenate([found.kinds, np.full(count, ABSENT, np.uint8)]))


def judge(patches: Patches, eyes: Eyes, sight: Sight) -> Judged:
    """How well photos see patches. Of what they did not measure none counts: whatever they saw there was not enough."""
    n, m, depth = sightings(patches.parts, eyes, sight)
    found = seen(patches.parts, eyes, (n, m, depth))
    coarsest = COARSE * found.usual_pixel
    judged = Judged(patches, found, np.zeros((len(patches), ENOUGH, 3)),
                    np.full(len(patches), ENOUGH, np.uint8), coarsest if np.isfinite(coarsest) else np.inf)
    counts = (patches.kinds[n] == MEASURED) & (1000 * depth / eyes.focals[m] <= judged.coarsest)
    for photo in range(len(eyes)):
        of = n[(m == photo) & counts]
        count_in(judged, of, eyes.centres[photo])
    return judged


def rays_to(places: np.ndarray, eye: np.ndarray) -> np.ndarray:
    """Unit rays (N,3) from places to an eye (3,)."""
    ray = eye - places
    unit: np.ndarray = ray / np.maximum(np.linalg.norm(ray, axis=1, keepdims=True), 1e-9)
    return unit


def news(judged: Judged, of: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Whether (K,) a ray (K,3) to each of patches `of` (K,) would count: one is lacking there, and it comes LEAST_ANGLE
    or more from beside all others."""
    cosine = np.einsum("kjx,kx->kj", judged.rays[of], rays)
    result: np.ndarray = (judged.short[of] > 0) & (cosine < np.cos(np.radians(LEAST_ANGLE))).all(axis=1)
    return result


def count_in(judged: Judged, of: np.ndarray, eye: np.ndarray) -> None:
    """Count a photo from `eye` (3,) in the patches `of` (K,) that it sees, where it is news."""
    rays = rays_to(judged.patches.parts.places[of], eye)
    new = news(judged, of, rays)
    of = of[new]
    judged.rays[of, ENOUGH - judged.short[of]] = rays[new]
    judged.short[of] -= 1


def write_patches(path: Path, judged: Judged, parts: Parts) -> None:
    """Write patches as PLY, at the places and with the normals of `parts`, which may be in another frame. Raises
    WorkspaceError."""
    write_ply(path, {"vertex": table(_ROW, {
        "x y z": parts.places, "nx ny nz": parts.normals, "area": judged.patches.areas, "kind": judged.patches.kinds,
        "photos": np.minimum(judged.seen.photos, 0xFFFF), "angle": judged.seen.angle,
        "pixel": np.where(judged.seen.photos > 0, judged.seen.pixel, 0), "short": judged.short,
    })}, ["CU-Recon"])


@dataclass(frozen=True)
class Kept:
    """Patches as their file has them: parts, square metres (N,), what they are (N,), and photos (N,) that they lack."""

    parts: Parts
    areas: np.ndarray
    kinds: np.ndarray
    short: np.ndarray


def read_patches(path: Path) -> Kept:
    """The patches that `write_patches` wrote. Raises WorkspaceError for a file that is missing or of another kind."""
    try:
        rows = read_ply(path, ["vertex"])[1]["vertex"]
        if rows.dtype != _ROW:
            raise ValueError("it holds no patches")
        places, normals = column(rows, "x y z"), column(rows, "nx ny nz")
        if not all((np.abs(values) < FARTHEST).all() for values in (places, normals, rows["area"])):
            raise ValueError("it holds what is no number")
        return Kept(Parts(places, normals), rows["area"].copy(), rows["kind"].copy(), rows["short"].copy())
    except (OSError, ValueError) as error:
        raise WorkspaceError(Text("{} cannot be read as gaps ({}).", path, Text(str(error))),
                             remedy="Find the gaps again.", path=path) from error
