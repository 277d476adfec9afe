# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Control points in the bundle adjustment: as known points with their marks, and left out one by one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pycolmap

from ..base.geodesy import gps_enu
from ..base.records import GeoPosition, Photo
from .bundle import Bundle, adjust
from .control import frame_positions
from .control_frame import MarkedPoint
from .conversion import registered, to_bundle
from .priors import LensPrior
from .record import PointResidual

LEAST_LEFT_OUT, MOST_LEFT_OUT = 6, 20  # control points of which each is left out once where none is a check point


def with_control(
    bundle: Bundle, names: Sequence[str], points: Sequence[MarkedPoint], origin: GeoPosition | None
) -> Bundle:
    """A bundle in the site frame, whose photos have these names, with the points and their marks at its end."""
    if not points:
        return bundle
    number, count = {name: n for n, name in enumerate(names)}, len(bundle.points)
    marks = [(p, mark) for p, point in enumerate(points) for mark in point.marks]
    told = np.full(len(bundle.photo), np.nan) if bundle.observation_sigmas is None else bundle.observation_sigmas
    given = [point.point for point in points]
    return replace(
        bundle, points=np.concatenate([bundle.points, [point.place for point in points]]),
        photo=np.concatenate([bundle.photo, [number[mark.photo] for _, mark in marks]]),
        point=np.concatenate([bundle.point, [count + p for p, _ in marks]]),
        pixels=np.concatenate([bundle.pixels, [[mark.x, mark.y] for _, mark in marks]]),
        observation_sigmas=np.concatenate([told, [mark.sigma for _, mark in marks]]),
        control=np.arange(count, count + len(points)), control_positions=frame_positions(given, origin),
        control_sigmas=np.array([point.sigmas for point in given]),
    )


def known_with_control(
    model: pycolmap.Reconstruction, photos: Mapping[str, Photo], lenses: Mapping[int, LensPrior],
    origin: GeoPosition | None, points: Sequence[MarkedPoint], *, by_control: bool,
) -> Bundle:
    """A model in its site frame as a bundle with all that is known of it, the points too. `by_control` is a frame that
    they gave: GPS counts from its own middle where that is not on Earth."""
    names = [image.name for image in registered(model)]
    located = [photos[name] for name in names if photos[name].gps is not None]
    counted_from = gps_enu(located)[1] if by_control and origin is None and located else origin
    bundle = to_bundle(model, photos, lenses, counted_from)
    if by_control:
        bundle = gps_in_frame(bundle, local=origin is None)
    return with_control(bundle, names, points, origin)


def gps_in_frame(bundle: Bundle, *, local: bool) -> Bundle:
    """The bundle whose photos' GPS tells how they lie to each other and not where: in a frame of control points a
    receiver's common error and another datum of heights say nothing. For a `local` frame it is turned about Z."""
    known = np.isfinite(bundle.position_sigmas)
    plan, turn = known[:, :2].all(axis=1), np.eye(3)
    if local and plan.sum() >= 2:
        turn[:2, :2] = _turn_in_plan(bundle.positions[plan, :2], bundle.centres[plan, :2])
    positions = bundle.positions @ turn.T
    off = np.where(known, bundle.centres - positions, np.nan)
    shift = np.array([np.nanmedian(axis) if np.isfinite(axis).any() else 0.0 for axis in off.T])
    return replace(bundle, positions=positions + shift, apart=True)


def _turn_in_plan(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """The rotation (2,2) that brings places (N,2) to others; those that lie far off do not count."""
    turn, counted = np.eye(2), np.ones(len(source), bool)
    for _ in range(5):
        first, second = (places - places[counted].mean(axis=0) for places in (source, target))
        cross = (first[counted, 0] * second[counted, 1] - first[counted, 1] * second[counted, 0]).sum()
        angle = np.arctan2(cross, (first[counted] * second[counted]).sum())
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        off = np.linalg.norm(first @ turn.T - second, axis=1)
        counted = off <= max(3 * float(np.median(off)), 1e-9)
    return turn


def left_out(
    adjusted: Bundle, points: Sequence[MarkedPoint], progress: Callable[[], None] = lambda: None
) -> tuple[PointResidual, ...]:
    """How far each control point of an adjusted bundle is off where it is left to its marks alone and all is adjusted
    once more; nothing where they are too few or many. Raises Cancelled."""
    found: list[PointResidual] = []
    if not LEAST_LEFT_OUT <= len(points) <= MOST_LEFT_OUT:
        return ()
    for which, (number, given) in enumerate(zip(adjusted.control, adjusted.control_positions, strict=True)):
        kept = np.arange(len(adjusted.control)) != which
        without = adjust(replace(
            adjusted, control=adjusted.control[kept], control_positions=adjusted.control_positions[kept],
            control_sigmas=adjusted.control_sigmas[kept],
        ), progress)
        off = without.points[number] - given
        if points[which].point.place[2] is None:
            off[2] = 0.0
        pixels = np.linalg.norm(without.residuals()[without.point == number], axis=1)
        east, north, up = off.tolist()
        found.append(PointResidual(
            name=points[which].point.name, off=(east, north, up), marks=len(pixels),
            pixels=float(np.sqrt(np.mean(pixels**2))),
        ))
    return tuple(found)
