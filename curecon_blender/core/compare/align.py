# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Laying another result on ours: by coordinates, by pairs of places that a person marked, or found alone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..base.language import Text
from ..base.options import COMPARE_WAYS
from ..base.reading import FARTHEST, read_bytes
from .geometry import Similarity, Thin, angle_of, fitted, thin_of, thinned
from .icp import Fine, measured, refine
from .result import CompareError, Result
from .search import Coloured, Found, search

COORDINATES, PAIRS, FOUND = COMPARE_WAYS
LEAST_POINTS = 100
_FINE_POINTS, _LARGE = 15_000, 300_000  # of the fine step; of what the coarse step looks at
_REACH = 3.0  # spacings of the thinned clouds
_LITTLE, _ENOUGH = 0.15, 0.4  # shares of the other that have partners: too few to believe; enough to be sure
_RIVAL = 0.75  # of the best score: from there on another motion is as good, unless details decide:
_CLEAN, _UNCLEAN = 0.003, 0.01  # nearly nothing lies off the surface by the best one, and something by the other
_WELL, _BETTER = 0.8, 1.3  # partners from which on nothing else is tried; how much better something else must fit
_OFF_SURFACE = 0.15  # of what has partners, that may lie before or behind our surface
_KNOWN_SCALES = {0.3048: "feet", 0.001: "millimetres", 0.01: "centimetres", 0.0254: "inches", 1000.0: "kilometres"}
_SCALE_STEPS, _SCALE_STEP = 4, 1.3  # to either side of the ratio of the extents, each a factor
_MIRROR = np.array([-1.0, 1, 1])
_MOST_PAIRS = 10_000


@dataclass(frozen=True, kw_only=True)
class Laid:
    """How another result lies on ours. `motion` takes its coordinates about its own offset to ours about ours; `share`
    is the part of it with a partner within `reach`, `our_share` the part of ours; `rms` that of the partners'
    distances along the normal, in our units. `residuals` (n,) are of marked pairs. Where not `sure`, the `remarks` say
    why."""

    motion: Similarity
    way: str
    share: float
    our_share: float
    rms: float
    reach: float
    sure: bool
    remarks: tuple[str, ...] = ()
    residuals: tuple[float, ...] = ()


def by_coordinates(ours: Result, other: Result) -> Laid:
    """As the coordinates of both say. Raises CompareError where they do not meet."""
    _enough(ours, other)
    motion = Similarity(1.0, np.eye(3), other.offset - ours.offset)
    a, b = motion.apply(other.places), ours.places.astype(np.float64)
    low, high = (np.maximum(np.percentile(a, q, axis=0), np.percentile(b, q, axis=0)) if q < 50 else
                 np.minimum(np.percentile(a, q, axis=0), np.percentile(b, q, axis=0)) for q in (0.5, 99.5))
    size = float(np.linalg.norm(np.ptp(b, axis=0)))
    if (high - low < -0.05 * size).any():
        apart = float(np.linalg.norm(np.median(a, axis=0) - np.median(b, axis=0)))
        if _degrees(other) or _degrees(ours):
            raise CompareError("One of the two is in degrees of latitude and longitude.", path=other.name,
                               remedy="Export it in metres, such as UTM.")
        raise CompareError(
            Text("The coordinates of {} lie {:,.0f} from ours: they do not overlap.", other.name, apart),
            path=other.name,
            remedy="They may be in different coordinate systems. Lay it on by pairs, or let it be found.")
    source, target = _thin(other), _thin(ours)
    fine = measured(source, target, motion, _reach(source, target))
    remarks = [] if fine.share > _LITTLE else [
        f"Only {100 * fine.share:.0f} % of {other.name} lies near ours: its height may count from elsewhere."]
    return _laid(fine, COORDINATES, sure=not remarks, remarks=remarks)


def by_pairs(ours: Result, other: Result, pairs: np.ndarray, *, scaled: bool, fine: bool = True) -> Laid:
    """By places (n,6) that somebody marked: x, y, z in the other's coordinates, and in ours; then `fine` by all points.
    Raises CompareError for pairs that fix nothing."""
    _enough(ours, other)
    if len(pairs) < 3:
        raise CompareError(Text("{} pairs do not fix how {} lies.", len(pairs), other.name),
                           remedy="Mark three pairs or more.")
    theirs, mine = pairs[:, :3] - other.offset, pairs[:, 3:] - ours.offset
    for places in (theirs, mine):
        spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
        if spread[1] < 1e-3 * spread[0] or spread[0] == 0:
            raise CompareError("The pairs lie on one line, so that the result may turn about it.",
                               remedy="Mark another pair off that line.")
    motion = fitted(theirs, mine, scaled=scaled)
    off = np.linalg.norm(motion.apply(theirs) - mine, axis=1)
    mirrored = fitted(theirs * _MIRROR, mine, scaled=scaled)
    off_mirrored = np.linalg.norm(mirrored.apply(theirs * _MIRROR) - mine, axis=1)
    size = float(np.linalg.norm(np.ptp(mine, axis=0)))
    if len(pairs) > 3 and np.sqrt((off**2).mean()) > max(5 * np.sqrt((off_mirrored**2).mean()), 0.02 * size):
        raise _is_mirrored(other)
    source, target = _thin(other), _thin(ours)
    reach = _reach(source, target)
    near = max(reach, 2 * float(np.sqrt((off**2).mean())))
    found = refine(source, target, motion, near, scaled=scaled) if fine else measured(source, target, motion, reach)
    if fine and found.share <= _LITTLE:
        found = measured(source, target, motion, reach)
    remarks = []
    worst = int(np.argmax(off))
    if len(pairs) > 3 and off[worst] > 0.05 * size:
        remarks.append(f"Pair {worst + 1} is off by {off[worst]:.2f}: it may be marked wrongly.")
    if found.share <= _LITTLE:
        remarks.append(f"Only {100 * found.share:.0f} % of {other.name} lies near ours after that.")
    return replace(_laid(found, PAIRS, sure=not remarks, remarks=remarks), residuals=tuple(off.tolist()))


def find(ours: Result, other: Result, *, scaled: bool) -> Laid:
    """By their shapes alone, and their colours as far as both have them. Raises CompareError where it did not fit, or
    fits only in another unit or mirrored."""
    _enough(ours, other)
    a, b = _looked_at(other), _looked_at(ours)
    scales = _scales(a[0], b[0]) if scaled else [1.0]
    found = search(a, b, scales, scaled=scaled)
    if found is None or found.best.partners < _WELL:
        _explain(a, b, found, other, scaled=scaled)
    if found is None or found.best.partners - found.best.against < _LITTLE:
        raise CompareError(Text("{} did not fit on ours in any way.", other.name), path=other.name,
                           remedy="Mark three pairs or more, or check that both show the same building.")
    source, target = _thin(other), _thin(ours)
    coarse = refine(source, target, found.best.motion, found.voxel, scaled=scaled)
    fine = refine(source, target, coarse.motion, _reach(source, target), scaled=scaled)
    remarks = _doubts(found, other)
    return _laid(fine, FOUND, sure=not remarks, remarks=remarks)


def _doubts(found: Found, other: Result) -> list[str]:
    best = found.best
    rivals = [one for one in found.others if one.score > _RIVAL * best.score
              and not (best.against < _CLEAN and one.against > _UNCLEAN)]
    remarks = []
    if rivals:
        turns = ", ".join(sorted({f"{angle_of(best.motion.rotation.T @ one.motion.rotation):.0f}°"
                                  for one in rivals[:6]}))
        remarks.append(f"{other.name} fits as well turned by {turns}, or moved: the building looks alike from "
                       "several sides. Mark three pairs to be sure.")
    if best.against > _OFF_SURFACE * best.partners:
        remarks.append(f"{100 * best.against:.0f} % of {other.name} lies before or behind ours: it may belong "
                       "elsewhere. Mark three pairs to be sure.")
    if best.partners < _ENOUGH:
        remarks.append(f"Only {100 * best.partners:.0f} % of {other.name} met ours: it may belong elsewhere. Mark "
                       "three pairs to be sure.")
    return remarks


def _explain(a: Coloured, b: Coloured, found: Found | None, other: Result, *, scaled: bool) -> None:
    """Raises CompareError where a mirrored or scaled result would fit much better than what was found."""
    least = _BETTER * (0.0 if found is None else found.best.score)
    scale = 1.0 if found is None else found.best.motion.scale
    mirrored = search((a[0] * _MIRROR, a[1]), b, [scale], scaled=scaled)
    if mirrored is not None and mirrored.best.score > least and mirrored.best.partners > _ENOUGH:
        raise _is_mirrored(other)
    if scaled or (found is not None and found.best.partners >= _ENOUGH):
        return
    rescaled = search(a, b, _scales(a[0], b[0]), scaled=True)
    if rescaled is not None and rescaled.best.score > least and rescaled.best.partners > _ENOUGH:
        found_scale = rescaled.best.motion.scale
        unit = next((name for known, name in _KNOWN_SCALES.items() if abs(found_scale / known - 1) < 0.03), None)
        words = f"it seems to be in {unit}" if unit else "its unit is another one, or unknown"
        raise CompareError(Text("{} fits on ours only when scaled by {:.4g}: {}.", other.name, found_scale, words),
                           path=other.name, remedy="Let its scale be found as well (--scale), or export it in metres.")


def _is_mirrored(other: Result) -> CompareError:
    return CompareError(Text("{} is a mirror image of ours.", other.name), path=other.name,
                        remedy="Export it again with its axes as they are: right-handed, x and y not swapped.")


def _scales(a: np.ndarray, b: np.ndarray) -> list[float]:
    """From the ratio of the extents outwards."""
    ratio = float(np.linalg.norm(np.ptp(np.percentile(b, (2, 98), axis=0), axis=0)) /
                  np.linalg.norm(np.ptp(np.percentile(a, (2, 98), axis=0), axis=0)))
    return [ratio * _SCALE_STEP**step for step in sorted(range(-_SCALE_STEPS, _SCALE_STEPS + 1), key=abs)]


def _laid(fine: Fine, way: str, *, sure: bool, remarks: list[str]) -> Laid:
    return Laid(motion=fine.motion, way=way, share=fine.share, our_share=fine.target_share, rms=fine.rms,
                reach=fine.reach, sure=sure, remarks=tuple(remarks))


def _thin(result: Result) -> Thin:
    return thin_of(thinned(result.places.astype(np.float64), _FINE_POINTS))


def _looked_at(result: Result) -> Coloured:
    every = max(len(result) // _LARGE, 1)
    return (result.places[::every].astype(np.float64), None if result.colours is None else result.colours[::every])


def _reach(source: Thin, target: Thin) -> float:
    return _REACH * max(target.spacing, 1e-9)


def _enough(*results: Result) -> None:
    for result in results:
        if len(result) < LEAST_POINTS:
            raise CompareError(Text("{} has only {} points.", result.name, len(result)), path=result.name,
                               remedy="Choose a denser cloud.")
        if not (np.ptp(result.places, axis=0) > 0).any():
            raise CompareError(Text("All points of {} are in one place.", result.name), path=result.name,
                               remedy="Export it again.")


def _degrees(result: Result) -> bool:
    whole = result.about(np.zeros(3))
    return bool((np.abs(whole[:, :2]) <= 180).all() and (np.ptp(whole[:, :2], axis=0) < 0.1).all()
                and np.ptp(whole[:, 2]) > 0.5)


def read_pairs(path: Path) -> np.ndarray:
    """Pairs (n,6) of a text file: six numbers a line, the other's x, y, z and ours, with comma, semicolon or spaces
    between them; other lines are taken as headings. Raises CompareError."""
    try:
        text = read_bytes(path, 1 << 20).decode("utf-8-sig")
    except (OSError, ValueError) as error:
        raise CompareError(Text("{} cannot be read: {}.", path, str(error)), path=path,
                           remedy="Give a text file of pairs.") from error
    rows = []
    for line in text.splitlines()[:_MOST_PAIRS]:
        try:
            numbers = [float(word) for word in line.replace(";", " ").replace(",", " ").split()]
        except ValueError:
            continue
        if len(numbers) == 6:
            rows.append(numbers)
    pairs = np.array(rows).reshape(-1, 6)
    if not len(pairs) or not (np.abs(pairs) < FARTHEST).all():
        raise CompareError(Text("{} has no line of six numbers.", path), path=path,
                           remedy="Write x, y, z in the other's coordinates, then in ours, a line for each pair.")
    return pairs
