# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Laying another result on ours: by coordinates, by pairs of places that a person marked, or found alone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from ..base.language import Text
from ..base.options import COMPARE_WAYS
from ..base.reading import FARTHEST, read_bytes
from .geometry import Similarity, Thin, angle_of, fitted, thin_of, thinned
from .icp import Evidence, Fine, evidence, measured, refine, thickness
from .result import CompareError, Result
from .search import Coloured, differ, search

COORDINATES, PAIRS, FOUND = COMPARE_WAYS
LEAST_POINTS = 100
_FINE_POINTS, _LARGE = 15_000, 300_000  # of the fine step; of what the coarse step looks at
_REACH = 3.0  # spacings of the thinned clouds
_LITTLE, _ENOUGH = 0.15, 0.4  # shares of the other that have partners: too few to believe; enough to be sure
_RIVAL = 0.85  # of the best score: from there on another motion is as good, unless details decide:
_TELLING, _CLEAN = 2.0, 0.01  # so many times what the best one leaves off our surface, and this share more
_BETTER = 1.3  # how much better something else must fit
_OFF_SURFACE = 0.15  # of what is near our surface, that may lie before or behind it
_TRIED = 4  # other motions that are looked at closely
_WELL = 0.8  # of the other that lies on ours: from there on it is neither mirrored nor in another unit
_KNOWN_SCALES = {0.3048: "feet", 0.001: "millimetres", 0.01: "centimetres", 0.0254: "inches", 1000.0: "kilometres"}
_SCALE_STEPS, _SCALE_STEP = 4, 1.3  # to either side of the ratio of the extents, each a factor
_MIRROR = np.array([-1.0, 1, 1])
_MOST_PAIRS = 10_000
_KEPT = 2.0  # how much farther off than before pairs may come to lie by the fine step


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
    if len(pairs) > 3 and _rms(off) > max(5 * _rms(off_mirrored), 0.02 * size):
        raise _is_mirrored(other)
    source, target = _thin(other), _thin(ours)
    reach = _reach(source, target)
    found = measured(source, target, motion, reach)
    remarks = []
    if fine and found.share > 0:
        refined = refine(source, target, motion, max(reach, 2 * _rms(off)), scaled=scaled, wide=1.0)
        if _rms(np.linalg.norm(refined.motion.apply(theirs) - mine, axis=1)) < _KEPT * _rms(off) + found.reach / _REACH:
            found = refined
        else:
            remarks.append(f"The surfaces of {other.name} say otherwise than its pairs, which were kept.")
    worst = int(np.argmax(off))
    if len(pairs) > 3 and off[worst] > 0.05 * size:
        remarks.append(Text("Pair {} is off by {:.2f}: it may be marked wrongly.", worst + 1, off[worst]))
    if found.share <= _LITTLE:
        remarks.append(f"Only {100 * found.share:.0f} % of {other.name} lies near ours after that.")
    return replace(_laid(found, PAIRS, sure=not remarks, remarks=remarks), residuals=tuple(off.tolist()))


def find(ours: Result, other: Result, *, scaled: bool) -> Laid:
    """By their shapes alone, and their colours as far as both have them. Raises CompareError where it did not fit, or
    fits only in another unit or mirrored."""
    _enough(ours, other)
    mine, theirs = _side(ours), _side(other)
    ways = _ways(mine, theirs, scaled=scaled)
    remarks = _doubts(ways, other)
    if not ways or (remarks and ways[0].evidence.on < _WELL):
        _explain(mine, theirs, ways, other, scaled=scaled)
    if not ways or ways[0].evidence.on - ways[0].evidence.off < _LITTLE:
        raise CompareError(Text("{} did not fit on ours in any way.", other.name), path=other.name,
                           remedy="Mark three pairs or more, or check that both show the same building.")
    return _laid(ways[0].fine, FOUND, sure=not remarks, remarks=remarks)


@dataclass(frozen=True)
class _Side:
    """A cloud as the coarse step and as the fine step sees it; two halves of it lie `thick` off each other."""

    cloud: Coloured
    thin: Thin
    thick: float


def _side(result: Result) -> _Side:
    places = result.places.astype(np.float64)
    halves = (thin_of(thinned(places[first::2], _FINE_POINTS)) for first in (0, 1))
    return _Side(_looked_at(result), _thin(result), thickness(*halves))


@dataclass(frozen=True)
class _Way:
    """A motion, refined, with what speaks for and against it: `score` is the area on the surface less that off it."""

    fine: Fine
    evidence: Evidence
    score: float


def _ways(ours: _Side, other: _Side, *, scaled: bool) -> list[_Way]:
    """How the other may lie on ours, the best first."""
    a, b = other.cloud, ours.cloud
    found = search(a, b, _scales(a[0], b[0]) if scaled else [1.0], scaled=scaled)
    if found is None:
        return []
    reach = _reach(other.thin, ours.thin)
    made = []
    for guess in (found.best, *found.others[:_TRIED]):
        fine = refine(other.thin, ours.thin, guess.motion, reach, scaled=scaled)
        seen = evidence(other.thin, ours.thin, fine.motion, reach,
                        min(max(ours.thick, other.thick * fine.motion.scale), reach))
        made.append(_Way(fine, seen, (seen.on - seen.off) * fine.motion.scale**2 * guess.colours))
    return sorted(made, key=lambda way: -way.score)


def _doubts(ways: list[_Way], other: Result) -> list[str]:
    if not ways:
        return []
    best, middle = ways[0], other.places.mean(axis=0, dtype=np.float64)
    rivals = [way for way in ways[1:] if way.score > _RIVAL * best.score
              and way.evidence.off < _TELLING * best.evidence.off + _CLEAN
              and differ(way.fine.motion, best.fine.motion, middle, best.fine.reach)]
    remarks = []
    if rivals:
        turns = ", ".join(sorted({f"{angle_of(best.fine.motion.rotation.T @ way.fine.motion.rotation):.0f}°"
                                  for way in rivals}))
        remarks.append(f"{other.name} fits as well turned by {turns}, or moved: the building looks alike from "
                       "several sides. Mark three pairs to be sure.")
    on, off = best.evidence.on, best.evidence.off
    if off > _OFF_SURFACE * (on + off):
        remarks.append(f"{100 * off / (on + off):.0f} % of {other.name} near ours lies before or behind it: it may "
                       "belong elsewhere. Mark three pairs to be sure.")
    if on < _ENOUGH:
        remarks.append(f"Only {100 * on:.0f} % of {other.name} met ours: it may belong elsewhere. Mark "
                       "three pairs to be sure.")
    return remarks


def _explain(ours: _Side, theirs: _Side, ways: list[_Way], other: Result, *, scaled: bool) -> None:
    """Raises CompareError where a mirrored or scaled result would lie on ours nearly whole, much better, and without
    any doubt: halves of a building lie on each other mirrored, too."""
    least = _BETTER * (ways[0].score if ways else 0.0)
    points, tones = theirs.cloud
    thin = Thin(theirs.thin.points * _MIRROR, theirs.thin.normals * _MIRROR, cKDTree(theirs.thin.points * _MIRROR))
    mirrored = _ways(ours, _Side((points * _MIRROR, tones), thin, theirs.thick), scaled=scaled)
    if mirrored and mirrored[0].score > least and mirrored[0].evidence.on > _WELL and not _doubts(mirrored, other):
        raise CompareError(
            Text("{} fits on ours as a mirror image only: its axes were swapped, or it shows another side that looks "
                 "alike.", other.name), path=other.name,
            remedy="Export it again with its axes as they are. If they are, mark three pairs.")
    if scaled:
        return
    rescaled = _ways(ours, theirs, scaled=True)
    if rescaled and rescaled[0].score > least and rescaled[0].evidence.on > _WELL and not _doubts(rescaled, other):
        found = rescaled[0].fine.motion.scale
        unit = next((name for known, name in _KNOWN_SCALES.items() if abs(found / known - 1) < 0.03), None)
        words = Text("it seems to be in {}", Text(unit)) if unit else Text("its unit is another one, or unknown")
        raise CompareError(Text("{} fits on ours only when scaled by {:.4g}: {}.", other.name, found, words),
                           path=other.name, remedy="Let its scale be found as well (--scale), or export it in metres.")


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean()))


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
        raise CompareError(Text("{} cannot be read: {}.", path, Text(str(error))), path=path,
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
