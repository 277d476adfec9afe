# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Placing a sparse model in the site frame: right-handed, Z up with the ground at 0, metres and y north where GPS says
so."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import pycolmap

from ..base import rotations
from ..base.geodesy import altitudes_tell, enu_to_geodetic, geodetic_to_enu, gps_enu
from ..base.ground import lowest_wide_level
from ..base.records import Frame, GeoPosition, Photo

SHORTEST_BASELINE = 5.0  # metres; GPS positions closer together than this say nothing of scale
WORST_AGREEMENT = 0.4  # median residual over the median distance from the GPS positions' centre; 1 is no agreement
BENT = 5.0  # metres; a larger median distance from GPS is more than GPS errs by
CONTRADICTED = 0.1  # median residual over the same distance: above it, and above BENT, lengths are no metres
LINE = 0.05  # spread across a flight as a share of the spread along it; below it the flight counts as a straight line
NEAR = 2.5  # times the points' median distance from the site's middle: land farther off has its own ground
TYPICAL_DISTANCE = 10.0  # units from camera to points where the scale is unknown
_UP = np.array([0.0, 0.0, 1.0])
_LEVEL_SIGMA = 0.01  # degrees; of an up that is taken as it is


@dataclass(frozen=True, kw_only=True)
class Placement:
    """Where a model belongs: `site_from_model`, the frame's record, and each photo's distance from its GPS in metres;
    `along` is what of it lies along the line of sight, positive where the camera stands too near to what it sees."""

    site_from_model: pycolmap.Sim3d
    frame: Frame
    gps_residuals: dict[str, float] = field(default_factory=dict)
    along: dict[str, float] = field(default_factory=dict)


def place(model: pycolmap.Reconstruction, photos: Mapping[str, Photo]) -> Placement:
    """Find the site frame of a model with points, whose images are named as `photos`: its origin lies in the site's
    middle, on the ground.

    By GPS where at least three photos have it, spread over more than a few metres and in agreement with the model;
    else Z up by gravity (gimbal angles, or level cameras) and a scale said to be unknown. Where GPS tells no altitudes,
    up is gravity's too, and the places in plan give scale and north.
    """
    cameras = cameras_of(model, photos)
    gravity = up_from_cameras(cameras)
    located = [i for i, photo in enumerate(cameras.photos) if photo.gps is not None]
    if len(located) < 3:
        why = "No GPS in the photos" if not located else f"Only {len(located)} of these photos have GPS"
        return _place_by_gravity(model, cameras, gravity, why)
    places = [cameras.photos[i] for i in located]
    gps, origin = gps_enu(places)
    heights = altitudes_tell(places)
    level = heights.sum() < max(3, len(places) / 2)
    if level:
        gps[:, 2] = 0
    extent = float(np.linalg.norm(np.ptp(gps, axis=0)))
    if extent < SHORTEST_BASELINE:
        return _place_by_gravity(
            model, cameras, gravity, f"All photos have GPS within {extent:.1f} m, too close together to tell the scale"
        )

    def fit_to(gps: np.ndarray) -> GpsFit:
        return align_to_gps(cameras.centres[located], gps, gravity, np.zeros_like(heights) if level else heights)

    fit = fit_to(gps)
    reach = float(np.median(np.linalg.norm(gps - gps.mean(0), axis=1)))
    if fit.median_residual > WORST_AGREEMENT * reach:
        return _place_by_gravity(
            model, cameras, gravity,
            f"The photos' GPS does not agree with their camera positions ({fit.median_residual:.1f} m off over "
            f"{extent:.0f} m) and was not used",
        )
    # Move the origin from the cameras to the site's middle, then fit once more: ENU axes turn a little with the place.
    middle = middle_on_the_ground(transformed(fit.enu_from_model, points_of(model)))
    latitude, longitude, altitude = enu_to_geodetic(middle[None], origin)[0].tolist()
    site = replace(origin, latitude=latitude, longitude=longitude, altitude=None if level else altitude)
    gps = geodetic_to_enu(enu_to_geodetic(gps, origin), replace(site, altitude=altitude))
    fit = fit_to(gps)
    if level:
        fit = replace(fit, enu_from_model=_lowered(fit.enu_from_model, model))
    frame = _frame(fit, site, gravity, len(located), reach)
    names = [photo.name for photo in places]
    axes = cameras.rotations[located, 2] @ fit.enu_from_model.rotation.matrix().T
    return Placement(
        site_from_model=fit.enu_from_model, frame=frame,
        gps_residuals=dict(zip(names, fit.residuals.tolist(), strict=True)),
        along=dict(zip(names, (fit.off * axes).sum(axis=1).tolist(), strict=True)),
    )


def _frame(fit: GpsFit, site: GeoPosition, gravity: Gravity, count: int, reach: float) -> Frame:
    """What a fit to GPS tells; `reach` is the typical distance (metres) of the photos from their middle."""
    off, by_gravity = fit.median_residual, fit.on_a_line or site.altitude is None
    # Along a line only the places along it count: across it they are noise.
    contradicted = fit.scale_residual > BENT and fit.scale_residual > CONTRADICTED * reach
    note = f"Metres, Z up and north from the GPS of {count} photos, {off:.2f} m off (median)."
    if site.altitude is None:
        note = (f"Metres and north from the GPS of {count} photos, {off:.2f} m off in plan (median); it tells no "
                f"altitudes, so Z up comes from {gravity.source}, and heights above the sea are unknown.")
    elif fit.on_a_line:
        note = note[:-1] + f"; the flight is a straight line, so the tilt about it comes from {gravity.source}."
    if contradicted:
        note = (f"The photos' GPS contradicts their camera positions ({off:.1f} m off, median): the model is bent, or "
                "the GPS poor. Scale, up and north are roughly GPS's, but lengths are not to be taken for metres (set "
                "the scale with a scale bar).")
    return Frame(
        scale="unknown" if contradicted else "metres", up="gravity" if by_gravity else "gps", north=True, origin=site,
        gps_residual=off, note=note,
    )


def with_residual(frame: Frame, off: float) -> Frame:
    """The frame of a fit to GPS, for cameras that now lie so far off it (metres, median)."""
    note = frame.note.replace(f"{frame.gps_residual or 0:.2f} m off", f"{off:.2f} m off")
    return replace(frame, gps_residual=off, note=note)


def _lowered(site_from_model: pycolmap.Sim3d, model: pycolmap.Reconstruction) -> pycolmap.Sim3d:
    """With the ground of the site's middle at 0."""
    ground = np.array([0.0, 0.0, middle_on_the_ground(transformed(site_from_model, points_of(model)))[2]])
    return pycolmap.Sim3d(site_from_model.scale, site_from_model.rotation, site_from_model.translation - ground)


@dataclass(frozen=True, kw_only=True)
class Cameras:
    """A model's cameras in the order of their names."""

    photos: list[Photo]
    centres: np.ndarray  # (N,3) in the model's world
    rotations: np.ndarray  # (N,3,3) cam_from_world


def cameras_of(model: pycolmap.Reconstruction, photos: Mapping[str, Photo]) -> Cameras:
    images = sorted((model.image(i) for i in model.reg_image_ids()), key=lambda image: image.name)
    return Cameras(
        photos=[photos[image.name] for image in images],
        centres=np.array([image.projection_center() for image in images]),
        rotations=np.array([image.cam_from_world().rotation.matrix() for image in images]),
    )


@dataclass(frozen=True, kw_only=True)
class Gravity:
    """`up` (3,) unit, in the model's world; `sigma` how far it may be off, in degrees; `source` in words."""

    up: np.ndarray
    sigma: float
    source: str


def up_from_cameras(cameras: Cameras) -> Gravity:
    """Where up is, from gimbal angles if they agree with the model, else from how cameras are held.

    Photographers and drones hold a camera level, so that up is the direction most nearly orthogonal to all image
    x axes. Where those are all parallel (a row of photos of one façade, a nadir grid) they leave up open: it is then
    against the viewing direction for a nadir grid, against the image y axes for a façade or a walk along a street.
    """
    with_gimbal = [i for i, photo in enumerate(cameras.photos) if photo.gimbal is not None]
    if len(with_gimbal) >= 3:
        ups = np.array([
            cameras.rotations[i].T @ rotations.from_gimbal(gimbal)[2]
            for i in with_gimbal if (gimbal := cameras.photos[i].gimbal) is not None
        ])
        up = _unit(np.median(ups, axis=0))
        spread = float(np.degrees(np.median(np.arccos(np.clip(ups @ up, -1, 1)))))
        if spread < 5.0:  # else the angles were not the camera's own, or the model is wrong
            return Gravity(up=up, sigma=max(1.0, spread), source="the drone's gimbal angles")
    right, down, forward = (cameras.rotations[:, row] for row in range(3))
    values, vectors = np.linalg.eigh(right.T @ right / len(right))
    if values[1] > 0.05:
        up = vectors[:, 0]
        # Drone and hand-held cameras look ahead or down, hardly ever up.
        up = -up if float(np.sum((down + forward) @ up)) > 0 else up
        off_level = float(np.degrees(np.sqrt(max(values[0], 0.0) / values[1])))
        return Gravity(up=up, sigma=max(3.0, off_level), source="level cameras")
    along_x, along_y, along_z = (
        float(np.ptp(cameras.centres @ _unit(axis))) for axis in (vectors[:, 2], down[0], forward.mean(0))
    )
    ahead = along_z > max(along_x, along_y)  # a drone does not dive while it maps
    if np.linalg.norm(forward.mean(0)) > 0.9 and not ahead and (
        np.linalg.norm(down.mean(0)) < 0.5 or along_y > 0.5 * along_x
    ):
        return Gravity(up=_unit(-forward.mean(0)), sigma=10.0, source="cameras taken to look straight down")
    return Gravity(up=_unit(-down.mean(0)), sigma=15.0, source="level cameras, all looking one way")


def _place_by_gravity(
    model: pycolmap.Reconstruction, cameras: Cameras, gravity: Gravity, why: str
) -> Placement:
    scale = TYPICAL_DISTANCE / max(_median_distance(model), 1e-9)
    rotation = rotations.between(gravity.up, _UP)
    middle = middle_on_the_ground(scale * points_of(model) @ rotation.T)
    transform = pycolmap.Sim3d(scale, pycolmap.Rotation3d(rotation), -middle)
    note = f"{why}: scale and north are unknown (set them with a scale bar); Z up comes from {gravity.source}."
    return Placement(site_from_model=transform, frame=Frame(scale="unknown", up="gravity", note=note))


@dataclass(frozen=True, kw_only=True)
class GpsFit:
    """`enu_from_model` and how well it fits: `off` (N,3) the cameras from their GPS and its length `residuals` (N,) in
    metres, in plan for photos without an altitude, their median, that of what tells the scale, and the flight's shape.
    """

    enu_from_model: pycolmap.Sim3d
    off: np.ndarray
    residuals: np.ndarray
    median_residual: float
    scale_residual: float
    on_a_line: bool


def align_to_gps(
    centres: np.ndarray, gps: np.ndarray, gravity: Gravity, heights: np.ndarray | None = None
) -> GpsFit:
    """Robust similarity from camera centres (N,3) to GPS positions (N,3) in metres, N >= 3; half may be outliers.

    `heights` (N,) says whose altitude is known, at least three or none: with none, gravity alone says where up is, and
    height zero is the cameras' middle.
    """
    known = np.ones(len(centres), bool) if heights is None else heights
    if known.any():
        fit = _align(centres[known], gps[known], gravity)
    else:
        upright = rotations.between(gravity.up, _UP)
        flat = np.array([1.0, 1.0, 0.0])
        fit = _align(centres @ upright.T * flat, gps * flat, Gravity(up=_UP, sigma=_LEVEL_SIGMA, source=gravity.source))
        move = fit.enu_from_model
        turn = pycolmap.Rotation3d(move.rotation.matrix() @ upright)
        middle = np.median(move.scale * centres @ upright.T[:, 2])
        fit = replace(fit, enu_from_model=pycolmap.Sim3d(move.scale, turn, move.translation - middle * _UP))
    off = transformed(fit.enu_from_model, centres) - gps
    off[~known, 2] = 0
    residuals = np.asarray(np.linalg.norm(off, axis=1))
    return replace(fit, off=off, residuals=residuals, median_residual=float(np.median(residuals)))


def _align(centres: np.ndarray, gps: np.ndarray, gravity: Gravity) -> GpsFit:
    """`align_to_gps` where all of a position counts.

    Least median of squares over triplets, then a refit to the inliers in which gravity counts as one more
    direction, weighted by how well it is known. Of a flight along a straight line, or no wider than the GPS is off,
    only the places along it count: across it they are noise, and gravity alone fixes the tilt.
    """
    certain = gravity if gravity.sigma <= _LEVEL_SIGMA else None  # flat places could be fitted from below, too
    best, best_median = None, np.inf
    for triplet in triplets(len(centres)):
        candidate = similarity(centres[triplet], gps[triplet], certain)
        median = float(np.median(_distances(candidate, centres, gps)))
        if median < best_median:
            best, best_median = candidate, median
    assert best is not None
    inliers = np.ones(len(centres), bool)
    for _ in range(10):
        residuals = _distances(best, centres, gps)
        sigma = max(1.4826 * float(np.median(residuals)), 0.3)
        chosen = residuals < 3 * sigma
        if chosen.sum() < 3:
            break
        best = similarity(centres[chosen], gps[chosen], gravity, max(sigma, 1.0))
        if (chosen == inliers).all():
            break
        inliers = chosen
    residuals = _distances(best, centres, gps)
    noise = scale_residual = float(np.median(residuals))
    spread = np.linalg.svd(gps[inliers] - gps[inliers].mean(0), compute_uv=False)
    on_a_line = bool(spread[1] < LINE * spread[0] or spread[1] / np.sqrt(inliers.sum()) < max(1.0, 2 * noise))
    if on_a_line:
        along = _along(centres[inliers]), _along(gps[inliers])
        best = similarity(*along, gravity, max(1.4826 * noise, 1.0))
        residuals = _distances(best, centres, gps)
        scale_residual = float(np.median(_distances(best, *along)))
    return GpsFit(
        enu_from_model=best, off=transformed(best, centres) - gps, residuals=residuals,
        median_residual=float(np.median(residuals)), scale_residual=scale_residual, on_a_line=on_a_line,
    )


def _along(positions: np.ndarray) -> np.ndarray:
    """Positions (N,3) moved onto the line that fits them best."""
    mean = positions.mean(0)
    axis = np.linalg.svd(positions - mean, full_matrices=False)[2][0]
    return np.asarray(mean + np.outer((positions - mean) @ axis, axis))


def triplets(count: int, most: int = 400) -> list[np.ndarray]:
    if count <= 10:
        return [np.array([i, j, k]) for i in range(count) for j in range(i) for k in range(j)]
    rng = np.random.default_rng(0)
    return [rng.choice(count, 3, replace=False) for _ in range(most)]


def similarity(
    source: np.ndarray, target: np.ndarray, gravity: Gravity | None = None, sigma: float = 1.0
) -> pycolmap.Sim3d:
    """Least squares target_from_source; `sigma` is the target's noise in metres, set against gravity's."""
    source_mean, target_mean = source.mean(0), target.mean(0)
    m, g = source - source_mean, target - target_mean
    size = max(float((m**2).sum()), 1e-18)
    correlation = g.T @ m * np.sqrt(float((g**2).sum()) / size) / sigma**2
    if gravity is not None:
        correlation += np.outer(_UP, gravity.up) / np.radians(gravity.sigma) ** 2
    u, _, vt = np.linalg.svd(correlation)
    rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    scale = max(float((g * (m @ rotation.T)).sum()) / size, 1e-9)
    return pycolmap.Sim3d(scale, pycolmap.Rotation3d(rotation), target_mean - scale * rotation @ source_mean)


def _distances(transform: pycolmap.Sim3d, source: np.ndarray, target: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.norm(transformed(transform, source) - target, axis=1))


def transformed(transform: pycolmap.Sim3d, points: np.ndarray) -> np.ndarray:
    matrix = transform.matrix()
    return np.asarray(points @ matrix[:, :3].T + matrix[:, 3])


def points_of(model: pycolmap.Reconstruction) -> np.ndarray:
    return np.array([point.xyz for point in model.points3D.values()])


def middle_on_the_ground(points: np.ndarray) -> np.ndarray:
    """The middle (3,) of points (N,3) with Z up, at the height of the ground there."""
    middle = np.median(points, axis=0)
    distances = np.linalg.norm(points - middle, axis=1)
    middle[2] = lowest_wide_level(points[distances <= NEAR * np.median(distances), 2])
    return np.asarray(middle)


def _median_distance(model: pycolmap.Reconstruction) -> float:
    """Median distance of points from a camera that sees them, in model units."""
    centres = {i: model.image(i).projection_center() for i in model.reg_image_ids()}
    return float(np.median([
        np.linalg.norm(point.xyz - centres[point.track.elements[0].image_id]) for point in model.points3D.values()
    ]))


def _unit(vector: np.ndarray) -> np.ndarray:
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-12))
