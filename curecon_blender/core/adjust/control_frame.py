# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Control points in a COLMAP model: where their marks put them, the site frame that they give, and how far they and the
check points are off in it."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import pycolmap

from ..base.errors import ControlError
from ..base.files import write_json
from ..base.geodesy import enu_to_geodetic
from ..base.language import Text
from ..base.messages import Reporter
from ..base.records import Frame, GeoPosition, Photo, PhotoSet
from ..sparse.models import ADJUSTED, find_models, read_model
from ..sparse.placement import LINE, Placement, middle_on_the_ground, place, similarity, transformed, triplets
from ..sparse.record import read_frame
from .control import (
    CHECK,
    CONTROL,
    ControlPoint,
    ControlSet,
    Mark,
    check_places,
    frame_positions,
    read_control,
    resolved,
    thin_points,
    to_json,
)
from .marking import seen, triangulate
from .record import ACCURACY_FILE, PointResidual, read_accuracy

ENOUGH = 3  # points with two marks each that place a site
WORST_FIT = 0.2  # median residual over the points' spread, beyond which points and marks cannot belong together
OUTLIER = 5.0  # times the median residual, and times its own sigma, from where on a point is named
FEET = 0.3048
STEEPEST = 60.0  # degrees between up by control and up by GPS or gravity, beyond which one of them is no up


@dataclass(frozen=True, kw_only=True)
class MarkedPoint:
    """A point with its marks in a model's photos: `poses` (M,3,4) and `rays` (M,2) of the M marks, the rays' `sigmas`
    (M,), and its `place` (3,) by them in the model's world."""

    point: ControlPoint
    marks: tuple[Mark, ...]
    poses: np.ndarray
    rays: np.ndarray
    sigmas: np.ndarray
    place: np.ndarray


def marked_points(model: pycolmap.Reconstruction, control: ControlSet, *roles: str) -> list[MarkedPoint]:
    """The points of some roles whose marks in the model's photos tell where they are."""
    images = {image.name: image for image in (model.image(i) for i in model.reg_image_ids())}
    found = []
    for point in control.of_role(*roles):
        marks = tuple(mark for mark in control.marks_of(point.name) if mark.photo in images)
        if len(marks) < 2:
            continue
        cameras = [model.camera(images[mark.photo].camera_id) for mark in marks]
        poses = np.array([images[mark.photo].cam_from_world().matrix() for mark in marks])
        rays = np.array([_ray(camera, mark) for camera, mark in zip(cameras, marks, strict=True)])
        sigmas = np.array([mark.sigma / camera.mean_focal_length()
                           for camera, mark in zip(cameras, marks, strict=True)])
        place = triangulate(poses, rays, sigmas)
        if place is not None:
            found.append(MarkedPoint(point=point, marks=marks, poses=poses, rays=rays, sigmas=sigmas, place=place))
    return found


def _ray(camera: pycolmap.Camera, mark: Mark) -> np.ndarray:
    ray = camera.cam_from_img(np.array([mark.x, mark.y]))
    return np.full(2, np.nan) if ray is None else np.asarray(ray)


def control_placement(model: pycolmap.Reconstruction, control: ControlSet) -> Placement | None:
    """The site frame that the control points give, whatever the model's own: metres, Z up and y north of the points'
    system, its origin on the ground in the site's middle, or for local points where their own is.

    None where fewer than three with a height tell, or all of them lie in a line. Raises ControlError where points and
    marks cannot belong together.
    """
    points = [point for point in marked_points(model, control, CONTROL) if point.point.place[2] is not None]
    if len(points) < ENOUGH:
        return None
    marked, given = np.array([point.place for point in points]), [point.point for point in points]
    if (spread := np.linalg.svd(marked - marked.mean(0), compute_uv=False))[1] < LINE * spread[0]:
        return None
    origin = None if control.is_local else _middle_of(given)
    fit = _fit(marked, frame_positions(given, origin))
    if origin is not None:
        sparse = np.array([point.xyz for point in model.points3D.values()]).reshape(-1, 3)
        middle = middle_on_the_ground(transformed(fit, sparse)) if len(sparse) else np.zeros(3)
        latitude, longitude, altitude = enu_to_geodetic(middle[None], origin)[0].tolist()
        origin = GeoPosition(latitude=latitude, longitude=longitude, altitude=altitude)
        fit = _fit(marked, frame_positions(given, origin))
    frame = Frame(scale="metres", up="control", north=origin is not None, origin=origin)
    found = [residual(point, there, now) for point, now, there in zip(
        points, transformed(fit, marked), frame_positions(given, origin), strict=True)]
    return Placement(site_from_model=fit, frame=told_by(frame, control, found))


def control_of(workspace: Path, photo_set: PhotoSet, reporter: Reporter) -> ControlSet:
    """The workspace's control points as these photos have them; the user is told of what takes no part. Raises
    ControlError for points and marks that cannot be of these photos, WorkspaceError."""
    control, said = resolved(read_control(workspace), photo_set.photos, {})
    for sentence in (*said, *check_places(control, photo_set.photos, {}), *thin_points(control)):
        reporter.warning(sentence)
    return control


def placed(
    model: pycolmap.Reconstruction, photos: Mapping[str, Photo], control: ControlSet, reporter: Reporter
) -> Placement:
    """Where a model belongs by its control points, else by GPS or gravity. Raises ControlError."""
    otherwise, by_control = place(model, photos), control_placement(model, control)
    if by_control is None:
        return otherwise
    if said := compared(by_control, otherwise):
        reporter.warning(said)
    return by_control


def told_by(frame: Frame, control: ControlSet, found: Sequence[PointResidual]) -> Frame:
    """The frame with its note, where control points gave it that are off like those."""
    if frame.up != "control":
        return frame
    off = np.array([np.linalg.norm(one.off) for one in found])
    axes = "Metres, Z up and north" if frame.origin is not None else "Metres and Z up, in the site's own axes,"
    places = frame_positions(control.of_role(CONTROL), frame.origin)
    reach = max(float(np.linalg.norm(places - places.mean(0), axis=1).max()), 1e-3)
    sigmas = [point.sigma_plan for point in control.of_role(CONTROL)]
    error = float(np.hypot(np.median(sigmas), np.median(off)))
    return replace(
        frame, note=f"{axes} from {len(off)} control points, {np.median(off):.3f} m off (median).",
        scale_sigma=error / reach / np.sqrt(max(len(off) - 2, 1)),
    )


def holds(frame: Frame, control: ControlSet) -> bool:
    """Whether a frame is one in which the points' coordinates say where they are."""
    if frame.scale != "metres":
        return False
    return frame.up == "control" and frame.origin is None if control.is_local else frame.north and (
        frame.origin is not None and frame.origin.altitude is not None)


def _middle_of(points: Iterable[ControlPoint]) -> GeoPosition:
    latitude, longitude, altitude = np.median(np.array([point.place for point in points], float), axis=0).tolist()
    return GeoPosition(latitude=latitude, longitude=longitude, altitude=altitude)


def _fit(marked: np.ndarray, given: np.ndarray) -> pycolmap.Sim3d:
    """The similarity from marked (N,3) to given (N,3) places that half of the points agree on, then of those that do.
    Raises ControlError where no half does."""
    best, off = _least_median(marked, given)
    spread = float(np.median(np.linalg.norm(given - given.mean(0), axis=1)))
    if float(np.median(off)) > WORST_FIT * spread:
        _, mirrored = _least_median(marked, given[:, [1, 0, 2]])
        exchanged = float(np.median(mirrored)) < 0.25 * float(np.median(off))
        raise ControlError(
            Text("The control points do not fit their marks: {:.2f} m off over {:.1f} m.", np.median(off), spread),
            remedy="East and north (x and y) look exchanged: exchange the two columns and import again." if exchanged
            else "Check that every mark is on its own point, and that all coordinates are of one system.",
        )
    agree = off <= max(3 * 1.4826 * float(np.median(off)), 0.01 * spread)
    return similarity(marked[agree], given[agree]) if agree.sum() >= ENOUGH else best


def _least_median(source: np.ndarray, target: np.ndarray) -> tuple[pycolmap.Sim3d, np.ndarray]:
    """The similarity of least median distance, and those distances (N,)."""
    best, least = None, np.full(len(source), np.inf)
    for chosen in [*triplets(len(source)), np.arange(len(source))]:
        candidate = similarity(source[chosen], target[chosen])
        off = np.linalg.norm(transformed(candidate, source) - target, axis=1)
        if best is None or np.median(off) < np.median(least):
            best, least = candidate, off
    assert best is not None
    return best, least


def compared(placement: Placement, otherwise: Placement) -> str:
    """A sentence where control contradicts the GPS on the scale; `otherwise` is the placement without control. Raises
    ControlError where it turns the site over: on flat ground, exchanged axes do no more than that."""
    ups = [one.site_from_model.rotation.matrix()[2] for one in (placement, otherwise)]
    if float(ups[0] @ ups[1]) < np.cos(np.radians(STEEPEST)):
        raise ControlError(
            "The control points turn the site over.",
            remedy="East and north (x and y) look exchanged: exchange the two columns and import again. Or some marks "
            "are on other points.",
        )
    if otherwise.frame.gps_residual is None:
        return ""
    ratio = placement.site_from_model.scale / otherwise.site_from_model.scale
    if 0.9 < ratio < 1.1:
        return ""
    feet = " They look like feet: convert them to metres." if abs(ratio * FEET - 1) < 0.05 else ""
    return f"By the control points the site is {ratio:.3g} times as large as by the photos' GPS.{feet}"


def residuals(
    model: pycolmap.Reconstruction, control: ControlSet, origin: GeoPosition | None, *roles: str
) -> tuple[PointResidual, ...]:
    """How far the marks of points put them from their coordinates, in an adjusted model in the site frame."""
    found = marked_points(model, control, *roles)
    given = frame_positions([point.point for point in found], origin)
    return tuple(residual(point, there) for point, there in zip(found, given, strict=True))


def residual(marked: MarkedPoint, given: np.ndarray, place: np.ndarray | None = None) -> PointResidual:
    """Of a marked point, whose marks put it at `place` (3,), from its given place (3,); an unknown height is off by
    nothing."""
    off = (marked.place if place is None else place) - given
    if marked.point.place[2] is None:
        off[2] = 0.0
    rays, _ = seen(marked.poses, marked.place)
    pixels = np.linalg.norm(rays - marked.rays, axis=1) / marked.sigmas * [mark.sigma for mark in marked.marks]
    east, north, up = off.tolist()
    return PointResidual(name=marked.point.name, off=(east, north, up), marks=len(marked.marks),
                         pixels=float(np.sqrt(np.mean(pixels**2))))


def doubtful(found: Iterable[PointResidual], control: ControlSet) -> list[str]:
    """A sentence on each point that is off by much more than the others and than its own sigma."""
    found = list(found)
    if len(found) < ENOUGH:
        return []
    off = np.array([np.linalg.norm(one.off) for one in found])
    said = []
    for one, distance in zip(found, off, strict=True):
        others = float(np.median(off))
        point = control.point(one.name)
        sigma = float(np.linalg.norm(np.minimum(point.sigmas, 10.0))) if point is not None else 0.0
        if distance > OUTLIER * max(others, sigma):
            said.append(f"{one.name} is {distance:.2f} m from where its marks put it, the others {others:.2f} m "
                        "(median): check its coordinates and its marks.")
    return said


def with_positions(photos: Mapping[str, Photo], control: ControlSet) -> dict[str, Photo]:
    """The photos with the positions that the user gave in place of their GPS."""
    changed = dict(photos)
    for position in control.positions:
        if (photo := photos.get(position.photo)) is None:
            continue
        latitude, longitude, altitude = position.place
        if altitude is None and photo.gps is not None:
            altitude = photo.gps.altitude
        sigmas = None
        if position.sigma_plan is not None and position.sigma_height is not None:
            sigmas = position.sigma_plan, position.sigma_height
        place = GeoPosition(latitude=latitude, longitude=longitude, altitude=altitude)
        changed[photo.name] = replace(photo, gps=place, gps_sigmas=sigmas)
    return changed


def tell_checks(workspace: Path, control: ControlSet) -> None:
    """Write what the check points are off into each component's accuracy.json, where it was of other points or marks.
    They take no part in the adjustment, so that nothing else has to be made anew for them. Raises WorkspaceError."""
    checks = control.of_roles(CHECK)
    key = hashlib.sha256(to_json(checks).encode()).hexdigest()[:20] if checks.points else ""
    for folder in find_models(workspace / ADJUSTED):
        accuracy = read_accuracy(folder)
        if accuracy is not None and accuracy.checked != key:
            frame = read_frame(folder)
            told = checks.points and holds(frame, control)
            found = residuals(read_model(folder), checks, frame.origin, CHECK) if told else ()
            write_json(folder / ACCURACY_FILE, asdict(replace(accuracy, check=found, checked=key)))
