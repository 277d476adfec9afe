# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Comparing results, from files to figures: each laid on ours, measured against a reference, and written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ..base.files import disk_errors, write_json
from ..base.language import Text
from ..base.messages import Reporter
from ..base.ply import row_type, table, write_ply
from . import align, distances
from .align import Laid
from .distances import Shares
from .geometry import one_a_voxel
from .read import read_result
from .result import CompareError, Result
from .sheet import MOST_RESULTS, Shown, write_sheet

FILE, SUFFIX = "compare.json", ".compared.ply"
_ROW = row_type([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1"),
                 ("distance", "<f4"), ("limit", "<f4")])
_HISTOGRAM = 40  # bars
_WIDTH, _DEPTH = 3.0, 12.0  # of M3C2's cylinders, in spacings of its places


@dataclass(frozen=True, kw_only=True)
class Wishes:
    """How to compare. `by` is one of COMPARE_WAYS; `pairs` a file for each other result; `thresholds` in our units;
    `minutes` what each result took, ours first, as far as known. With `change` the others are later dates of ours."""

    by: str = align.COORDINATES
    pairs: tuple[Path, ...] = ()
    scaled: bool = False
    thresholds: tuple[float, ...] = (0.05, 0.1)
    names: tuple[str, ...] = ()
    minutes: tuple[float, ...] = ()
    change: bool = False
    registration: float | None = None


@dataclass(frozen=True, kw_only=True)
class Figures:
    """One result against the reference; None or empty where it is the reference."""

    name: str
    points: int
    minutes: float | None
    shares: tuple[Shares, ...]
    noise: float
    density: float
    laid: Laid | None
    remarks: tuple[str, ...]
    histogram: tuple[int, ...] = ()


def compare(
    ours: Path, others: Sequence[Path], truth: Path | None, folder: Path, wishes: Wishes, reporter: Reporter
) -> dict[str, Any]:
    """Write compare.json, sheet.png, sheet.pdf and a cloud with distances for each result into a folder; the figures.
    Raises CompareError, WorkspaceError, SetupError, Cancelled."""
    if not 1 <= len(others) + (truth is not None) < MOST_RESULTS:
        raise CompareError(Text("One to {} results can stand beside ours.", MOST_RESULTS - 1), remedy="Choose fewer.")
    if wishes.by == align.PAIRS and len(wishes.pairs) != len(others):
        raise CompareError("Each other result needs its file of pairs.", remedy="Give --pairs once for each.")
    names = list(wishes.names) + [""] * (len(others) + 1 - len(wishes.names))
    reporter.begin({"read": 1.0, "lay": 2.0, "measure": 3.0})
    reporter.stage("read")
    base = read_result(ours, names[0])
    results = [read_result(path, name) for path, name in zip(others, names[1:], strict=False)]
    reference = base if truth is None else read_result(truth)
    reporter.stage("lay")
    laid = []
    for number, one in enumerate(results):
        laid.append(_lay(base, one, wishes, number))
        for remark in laid[-1].remarks:
            reporter.warning(remark)
        reporter.progress(number + 1, len(results))
    reporter.stage("measure")
    voxel = min(wishes.thresholds) / 2
    placed = [_placed(one, base, how, voxel) for one, how in zip([base, *results], [None, *laid], strict=True)]
    against = placed[0] if truth is None else _placed(reference, base, None, voxel)
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    made: list[Figures] = []
    shown: list[Shown] = []
    flat = distances.flat_places(against.places, 2 * max(wishes.thresholds))
    entries = list(zip([base, *results], [None, *laid], placed, strict=True))
    if truth is not None:
        entries.append((reference, None, against))
    for number, (result, how, cloud) in enumerate(entries):
        minutes = wishes.minutes[number] if number < len(wishes.minutes) else None
        figures, to_reference = _figures(result, how, cloud, against, flat, wishes, minutes)
        made.append(figures)
        shown.append(Shown(result.name, cloud.places, cloud.colours, None if cloud is against else to_reference,
                           _cells(figures, wishes)))
        if cloud is not against and not wishes.change:
            _write_cloud(_file_of(folder, result.name, number), cloud, base.offset, to_reference,
                         np.zeros(len(to_reference)))
        reporter.progress(number + 1, len(entries))
    record: dict[str, Any] = {"reference": reference.name, "results": [_plain(one) for one in made]}
    if wishes.change:
        record["changes"] = [_change(base, one, how, folder, wishes, number + 1)
                             for number, (one, how) in enumerate(zip(results, laid, strict=True))]
    notes = [remark for one in made for remark in one.remarks]
    title = f"{base.name} beside {', '.join(one.name for one in results) or reference.name}"
    png, pdf = write_sheet(folder, shown, against.places, _head(wishes), title, notes[:4],
                           2 * max(wishes.thresholds), "m")
    write_json(folder / FILE, record)
    clouds = [str(_file_of(folder, result.name, number)) for number, (result, how, cloud) in enumerate(entries)
              if (how is not None if wishes.change else cloud is not against)]
    return {"compare": record, "sheet": str(png), "files": [str(png), str(pdf), str(folder / FILE)], "clouds": clouds,
            "warnings": reporter.warnings}


def _lay(base: Result, other: Result, wishes: Wishes, number: int) -> Laid:
    if wishes.by == align.COORDINATES:
        return align.by_coordinates(base, other)
    if wishes.by == align.PAIRS:
        return align.by_pairs(base, other, align.read_pairs(wishes.pairs[number]), scaled=wishes.scaled)
    return align.find(base, other, scaled=wishes.scaled)


@dataclass(frozen=True)
class _Placed:
    """Points in our frame about our offset: all of them (a mesh's are spread over it), and one a voxel."""

    whole: np.ndarray
    places: np.ndarray
    colours: np.ndarray | None
    is_mesh: bool


def _placed(result: Result, base: Result, how: Laid | None, voxel: float) -> _Placed:
    whole = result.about(base.offset) if how is None else how.motion.apply(result.places)
    colours, is_mesh = result.colours, result.faces is not None and len(result.faces) > 0
    if result.faces is not None and is_mesh:
        whole, colours = distances.sampled(whole, result.faces, voxel / 2), None
    which = one_a_voxel(whole, voxel)
    return _Placed(whole, whole[which], None if colours is None else colours[which], is_mesh)


def _figures(
    result: Result, how: Laid | None, cloud: _Placed, against: _Placed, flat: np.ndarray, wishes: Wishes,
    minutes: float | None,
) -> tuple[Figures, np.ndarray]:
    """The figures, and the distance (N,) of each place from the reference, NaN where it does not reach. Shares are of
    the others."""
    radius = 2 * max(wishes.thresholds)
    noise, density = distances.noise_and_density(cloud.whole, flat, radius)
    figures = Figures(name=result.name, points=len(result), minutes=minutes, shares=(), noise=noise,
                      density=float("nan") if cloud.is_mesh else density, laid=how,
                      remarks=(*result.remarks, *(how.remarks if how else ())))
    if cloud is against:
        return figures, np.zeros(len(cloud.places))
    inside = distances.reached(cloud.places, against.places, radius / 2)
    if not inside.any():
        raise CompareError(Text("{} does not overlap the reference.", result.name), path=result.name,
                           remedy="Lay it on by pairs, or let it be found.")
    to_reference = np.full(len(cloud.places), np.nan)
    to_reference[inside] = distances.to_cloud(cloud.places[inside], against.places)
    back = distances.to_cloud(against.places, cloud.places)
    bars = np.histogram(np.minimum(to_reference[inside], radius), _HISTOGRAM, (0, radius))[0]
    return replace(figures, histogram=tuple(bars.tolist()),
                   shares=distances.shares(to_reference[inside], back, wishes.thresholds)), to_reference


def _change(base: Result, other: Result, how: Laid, folder: Path, wishes: Wishes, number: int) -> dict[str, Any]:
    """What differs between ours and a later result, with what of it is significant; and a cloud of it."""
    ours, theirs = base.places.astype(np.float64), how.motion.apply(other.places)
    spacing = 2 * max(min(wishes.thresholds), _median_spacing(ours), _median_spacing(theirs))
    places, normals = distances.cores_of(ours, base.normals, spacing)
    registration = wishes.registration if wishes.registration is not None else _registration(how)
    found = distances.signed(ours, theirs, places=places, normals=normals, width=_WIDTH * spacing,
                             depth=_DEPTH * spacing, registration=registration)
    core = _Placed(places, places, None, False)
    _write_cloud(_file_of(folder, other.name, number), core, base.offset, found.distance, found.limit)
    known = found.known
    return {
        "name": other.name, "places": len(places), "comparable": _share(known), "registration": registration,
        "significant": _share(found.significant[known]), "width": _WIDTH * spacing, "depth": _DEPTH * spacing,
        "median_limit": float(np.median(found.limit[known])) if known.any() else None,
        "changes": [asdict(one) for one in distances.changes(found, min(wishes.thresholds), spacing)],
    }


def _registration(how: Laid) -> float:
    """The systematic part of how one lies on the other: a tenth of what the fine step left. Its random part, over the
    root of many thousand places, is nearly nothing."""
    return 0.1 * how.rms if np.isfinite(how.rms) else 0.0


def _median_spacing(points: np.ndarray) -> float:
    tree = cKDTree(points)
    some = points[:: max(len(points) // 2000, 1)]
    return float(np.median(tree.query(some, k=2)[0][:, 1]))


def _share(which: np.ndarray) -> float:
    return float(which.mean()) if len(which) else 0.0


def _write_cloud(path: Path, cloud: _Placed, offset: np.ndarray, distance: np.ndarray, limit: np.ndarray) -> None:
    """`offset` (3,) is what to add to come back to our coordinates."""
    colours = np.full((len(cloud.places), 3), 255, np.uint8) if cloud.colours is None else cloud.colours
    rows = table(_ROW, {"x y z": cloud.places, "red green blue": colours, "distance": distance, "limit": limit})
    write_ply(path, {"vertex": rows}, ["CU-Recon", "shift " + " ".join(f"{number:.4f}" for number in offset)])


def _file_of(folder: Path, name: str, number: int) -> Path:
    plain = "".join(letter if letter.isalnum() and letter.isascii() else "_" for letter in name)[:40].strip("_")
    return folder / f"{number}_{plain or 'result'}{SUFFIX}"


def _head(wishes: Wishes) -> list[str]:
    shares = [f"{word} {threshold:g}" for threshold in wishes.thresholds for word in ("precision", "complete")]
    return ["points", "minutes", *shares, "noise mm", "points/m²", "laid by"]


def _cells(figures: Figures, wishes: Wishes) -> tuple[str, ...]:
    shares = [f"{100 * value:.1f} %" for one in figures.shares for value in (one.precision, one.completeness)]
    return (f"{figures.points:,}", _figure(figures.minutes, 0), *(shares or ["–"] * (2 * len(wishes.thresholds))),
            _figure(1000 * figures.noise, 1), _figure(figures.density, 0), _laid_by(figures.laid))


def _laid_by(laid: Laid | None) -> str:
    return "–" if laid is None else laid.way if laid.sure else f"{laid.way}?"


def _figure(value: float | None, digits: int) -> str:
    return "–" if value is None or not np.isfinite(value) else f"{value:,.{digits}f}"


def _plain(figures: Figures) -> dict[str, Any]:
    """As JSON has it."""
    made = {key: value for key, value in asdict(figures).items() if key != "laid"}
    made |= {key: value if np.isfinite(value) else None for key, value in made.items() if isinstance(value, float)}
    if figures.laid is not None:
        motion = figures.laid.motion
        made["laid"] = {"way": figures.laid.way, "sure": figures.laid.sure, "share": figures.laid.share,
                        "our_share": figures.laid.our_share, "reach": figures.laid.reach,
                        "rms": figures.laid.rms if np.isfinite(figures.laid.rms) else None,
                        "residuals": figures.laid.residuals, "scale": motion.scale,
                        "rotation": motion.rotation.tolist(), "translation": motion.translation.tolist()}
    return made
