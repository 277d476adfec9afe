# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The adjust stage: the mapper's components in, the same in the site frame out, adjusted with all that is known."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from ..base.language import Text
from ..base.messages import Reporter
from ..base.records import Frame, GeoPosition, Photo, PhotoSet
from ..photos import shutter
from ..sparse.models import ADJUSTED, MAPPED, find_models, listed, read_model, write_components
from ..sparse.placement import BENT, Placement, middle_on_the_ground, place, with_residual
from ..sparse.record import FRAME_FILE, read_frame
from . import bending
from .bundle import LENS_PARAMETERS, Bundle, adjust, fit_points, posterior_sigmas
from .control import CHECK, CONTROL, ControlSet, frame_positions
from .control_bundle import known_with_control, left_out
from .control_frame import (
    MarkedPoint,
    control_of,
    doubtful,
    holds,
    marked_points,
    placed,
    residuals,
    told_by,
    with_positions,
)
from .conversion import registered, started, write_back
from .precision import precision
from .precision_record import Precision, write_precision
from .priors import FOCAL, MAKER, NOTHING, gps_positions, lens_priors
from .record import ACCURACY_FILE, Accuracy, Dome, LensFound, PhotoResidual, PointResidual

CONTRADICTS = 15.0, 10.0  # metres, times the median: a photo farther than both from its GPS is named
# Photos whose camera is wrong and not their GPS: that share of the distance lies along their line of sight, in so many.
ALONG, FEWEST_ALONG = 0.9, 2
MOST_PHOTOS = 1500  # the reduced system is a full matrix: 0.7 GB, and some copies of it
# Beyond these a calibration is not this camera's: times the mapper's reprojection error, sigmas of the focal length.
WORSE, CONTRADICTED = 2.0, 5.0
# Of its prior sigma: a lens parameter that the flight leaves more open than so stays at its prior. The focal length has
# to be determined better: what a flight at one height tells of it, all that is systematic tells as well.
UNDETERMINED, UNDETERMINED_FOCAL = 0.7, 0.3
SIGNIFICANT = 3.0  # sigmas; a third radial term that nobody measured has to differ from none by so many
SEEN_BY_MANY, _KEPT_BACK = 4, 5  # photos of a point; every so many of these points have an observation kept back
_HELD = 1e-9  # of what is held fast
_ROUGHLY = 1e-3  # of the cost: enough where one only has to come near
_FREE_AT_FIRST = [LENS_PARAMETERS.index(name) for name in ("k1", "k2", "p1", "p2")]
_K3 = LENS_PARAMETERS.index("k3")
_NO_CONTROL = ControlSet()


@dataclass(frozen=True, kw_only=True)
class Adjusted:
    """A model as adjusted: the bundle with what was known of it, what that was of each lens, how precisely it is known
    now, and what control points are off each of which was left out once."""

    bundle: Bundle
    sources: tuple[str, ...]
    precision: Precision
    left_out: tuple[PointResidual, ...] = ()

    def moved(self, transform: pycolmap.Sim3d) -> Adjusted:
        """The same where the model was moved; its bundle stays."""
        moved = self.precision.moved(float(transform.scale), transform.rotation.matrix(), transform.translation)
        return replace(self, precision=moved)


def adjust_cameras(photo_set: PhotoSet, workspace: Path, reporter: Reporter) -> list[Frame]:
    """Place and adjust the components in `workspace/sparse/mapped/N`; write each to `workspace/sparse/N` with the
    records of its frame and accuracy. A given model, which has its frame already, stays as it is.

    The workspace's control points hold the cameras where they are marked. Returns the components' frames. GPS and
    control that contradict the cameras are warned of. Raises SparseError for a component that cannot be read,
    ControlError for control that cannot belong to the photos, Cancelled, WorkspaceError.
    """
    control = control_of(workspace, photo_set, reporter)
    photos = with_positions({photo.name: photo for photo in photo_set.photos}, control)
    located = sum(photo.gps is not None for photo in photos.values())
    if unfixed := _unfixed(photos):
        reporter.warning(
            Text("Only {} of {} photos have an RTK fix; the positions of the others count as those of an ordinary "
                 "receiver.", located - len(unfixed), located)
        )
    folders = find_models(workspace / MAPPED)
    components: list[tuple[pycolmap.Reconstruction, dict[str, Any]]] = []
    frames, precisions = [], []
    for index, folder in enumerate(folders):
        reporter.progress(index, len(folders))
        model = read_model(folder)
        if (folder / FRAME_FILE).is_file():
            frame = read_frame(folder)
            accuracy, told = _judged(model, photos, frame, None, control), None
        else:
            frame, accuracy, told = _placed(model, photos, control, index, reporter)
        for sentence in doubtful(accuracy.control, control):
            reporter.warning(sentence)
        components.append((model, {FRAME_FILE: frame, ACCURACY_FILE: accuracy}))
        frames.append(frame)
        precisions.append(told)
    write_components(workspace, ADJUSTED, components)
    for index, told in enumerate(precisions):
        if told is not None:
            write_precision(workspace / ADJUSTED / str(index), told)
    reporter.progress(len(folders), len(folders))
    return frames


def _placed(
    model: pycolmap.Reconstruction, photos: Mapping[str, Photo], control: ControlSet, index: int, reporter: Reporter
) -> tuple[Frame, Accuracy, Precision | None]:
    """Bring a mapped model into the site frame, in place, adjusted where that can be; tell what the user must know."""
    placement, adjusted = place_and_adjust(model, photos, reporter, control)
    _warn_of_gps(placement, model.num_reg_images(), _unfixed(photos), index, reporter)
    accuracy = _judged(model, photos, placement.frame, adjusted, control)
    scale_sigma = float(adjusted.precision.datum_sigmas[6]) if adjusted else 0.0
    doubt = bending.doubt(accuracy.domes, accuracy.focal_sigma, scale_sigma)
    if doubt:
        reporter.warning(Text("{} {}", Text(doubt), Text(bending.REMEDY)))
    if accuracy.shutter_shift is not None and accuracy.shutter_shift > shutter.MOST_SHIFT:
        reporter.warning(
            Text("The drone flew while its photos were read out row by row: by about {:.1f} pixels. That bends the "
                 "model a little. Fly slower, or stop for each photo.", accuracy.shutter_shift)
        )
    return replace(placement.frame, doubt=doubt), accuracy, adjusted.precision if adjusted else None


def place_and_adjust(
    model: pycolmap.Reconstruction, photos: Mapping[str, Photo], reporter: Reporter,
    control: ControlSet = _NO_CONTROL,
) -> tuple[Placement, Adjusted | None]:
    """Bring a mapped model into the site frame, in place, and adjust it. Returns its placement and its adjustment, None
    where it stays as the mapper has it."""
    placement = placed(model, photos, control, reporter)
    model.transform(placement.site_from_model)
    frame = placement.frame
    held = marked_points(model, control, CONTROL) if holds(frame, control) else []
    adjusted = adjust_model(model, photos, frame.origin, reporter, held, by_control=frame.up == "control",
                            one_by_one=not control.of_role(CHECK))
    if adjusted is None:
        return placement, None
    if held:  # which have put it in its place, but for the ground
        frame = told_by(frame, control, residuals(model, control, frame.origin, CONTROL))
        if frame.origin is not None:
            frame, to_ground = _grounded(model, frame, frame.origin)
            adjusted = adjusted.moved(to_ground)
        return replace(placement, frame=frame), adjusted
    again = place(model, photos)
    if frame.up != "gps" or again.frame.up != "gps" or frame.origin is None or frame.origin.altitude is None:
        model.transform(again.site_from_model)
        return again, adjusted.moved(again.site_from_model)
    # GPS with its sigmas and all else have put it in its place; but for the ground, whose height has changed.
    frame, to_ground = _grounded(model, again.frame, frame.origin)
    off = [np.linalg.norm(residual.off) for residual in _gps_residuals(model, photos, frame)]
    return replace(again, frame=with_residual(frame, float(np.median(off)))), adjusted.moved(to_ground)


def _grounded(
    model: pycolmap.Reconstruction, frame: Frame, origin: GeoPosition
) -> tuple[Frame, pycolmap.Sim3d]:
    """Bring a model whose frame has its origin at `origin` onto height 0; its frame then, and how it was moved."""
    level = float(middle_on_the_ground(np.array([point.xyz for point in model.points3D.values()]))[2])
    to_ground = pycolmap.Sim3d(1.0, pycolmap.Rotation3d(), np.array([0.0, 0.0, -level]))
    model.transform(to_ground)
    return replace(frame, origin=replace(origin, altitude=(origin.altitude or 0.0) + level)), to_ground


def _judged(
    model: pycolmap.Reconstruction, photos: Mapping[str, Photo], frame: Frame, adjusted: Adjusted | None,
    control: ControlSet,
) -> Accuracy:
    """What the cameras of a model in its frame rest on, and how well they agree with it."""
    images = registered(model)
    taken = [photos[image.name] for image in images]
    centres = np.array([image.projection_center() for image in images])
    known, sigmas = gps_positions(taken, frame.origin)
    focal = np.array([model.camera(image.camera_id).mean_focal_length() for image in images])
    above = np.array([_typical_depth(model, image) for image in images])
    gps_heights = np.where(np.isfinite(sigmas[:, 2]), known[:, 2], np.nan)
    found, focal_sigma = lenses_found(adjusted.bundle, adjusted.sources) if adjusted else ((), None)
    metres = frame.scale == "metres"
    told = residuals(model, control, frame.origin, CONTROL) if holds(frame, control) else ()
    return Accuracy(
        adjusted=adjusted is not None, reprojection_error=model.compute_mean_reprojection_error(),
        gps=_gps_residuals(model, photos, frame), lenses=found, focal_sigma=focal_sigma,
        domes=(*bending.domes(taken, centres, gps_heights, float(np.median(above))),
               *_control_dome(told, control, frame, float(np.median(above / focal)))) if metres else (),
        shutter_shift=shutter.shutter_shift(taken, centres, focal, above) if metres else None,
        control=told,
        left_out=adjusted.left_out if adjusted else (),
    )


def _control_dome(
    told: Sequence[PointResidual], control: ControlSet, frame: Frame, pixel: float
) -> tuple[Dome, ...]:
    """What the residuals of control points tell of a dome, by those whose heights are known."""
    known = {point.name: point for point in control.points if point.place[2] is not None}
    heights = np.array([one.off[2] for one in told if one.name in known])
    points = [known[one.name] for one in told if one.name in known]
    sigmas = np.array([point.sigma_height for point in points])
    dome = bending.control_dome(frame_positions(points, frame.origin)[:, :2], heights, sigmas, pixel)
    return () if dome is None else (dome,)


def _typical_depth(model: pycolmap.Reconstruction, image: pycolmap.Image) -> float:
    """Median distance along the view of the points that an image sees; 0 for none."""
    seen = np.array([model.point3D(point.point3D_id).xyz for point in image.get_observation_points2D()]).reshape(-1, 3)
    depths = (seen - image.projection_center()) @ image.cam_from_world().rotation.matrix()[2]
    return float(np.median(depths)) if len(depths) else 0.0


def _gps_residuals(
    model: pycolmap.Reconstruction, photos: Mapping[str, Photo], frame: Frame
) -> tuple[PhotoResidual, ...]:
    images = registered(model)
    known, sigmas = gps_positions([photos[image.name] for image in images], frame.origin)
    residuals = []
    for image, position, sigma in zip(images, known, sigmas, strict=True):
        if np.isfinite(sigma[0]):
            east, north, up = np.where(np.isfinite(sigma), image.projection_center() - position, 0.0).tolist()
            residuals.append(PhotoResidual(name=image.name, off=(east, north, up)))
    return tuple(residuals)


def adjust_model(
    model: pycolmap.Reconstruction, photos: Mapping[str, Photo], origin: GeoPosition | None, reporter: Reporter,
    held: Sequence[MarkedPoint] = (), *, by_control: bool = False, one_by_one: bool = False,
) -> Adjusted | None:
    """Adjust a model in the site frame, in place, with the control points that hold it. Its cameras are FULL_OPENCV
    afterwards. `by_control` is a frame that control points gave; with `one_by_one` each is left out once.

    None where the model stays as it is: where nothing but the photos themselves is known, and the adjustment predicts
    observations that were kept from it no better than the mapper does. The user is told where a calibration does not
    fit the photos, or the photos are too many. Raises Cancelled.
    """
    if model.num_reg_images() > MOST_PHOTOS:
        reporter.warning(
            Text("The cameras are those of the mapper, not adjusted to GPS and calibration: that is for up to {:,} "
                 "photos. Heights may be wrong if all photos look straight down from one height.", MOST_PHOTOS)
        )
        return None
    for best in (MAKER, FOCAL, NOTHING):
        lenses = lens_priors(model, photos, best)
        sources = [lens.source for lens in lenses.values()]
        if best not in sources:
            continue
        mapped = known_with_control(model, photos, lenses, origin, held, by_control=by_control)
        kept_back = _kept_back(mapped)
        adjusted = _adjusted(mapped.without(kept_back), sources, reporter.check_cancelled)
        error = _error(adjusted, mapped, kept_back)
        mappers = _error(fit_points(mapped.without(kept_back)), mapped, kept_back)
        off = np.abs(adjusted.lenses - mapped.known_lenses) / mapped.lens_sigmas
        if error < WORSE * mappers and (best == NOTHING or off.max() < CONTRADICTED):
            break
        if best == MAKER:
            reporter.warning(
                "The maker's calibration of the camera does not fit the photos and is not used: it is another lens's, "
                "or the pictures were edited. Heights may be wrong if all photos look straight down from one height."
            )
    if error > (mappers if origin is None and not held else WORSE * mappers):
        return None
    adjusted = adjust(adjusted.observing(mapped), reporter.check_cancelled, _ROUGHLY)
    write_back(adjusted, model)
    out = left_out(adjusted, held, reporter.check_cancelled) if one_by_one else ()
    return Adjusted(bundle=_restated(adjusted, mapped, mapped.lens_sigmas), sources=tuple(sources),
                    precision=precision(adjusted, mapped.lens_sigmas), left_out=out)


def lenses_found(bundle: Bundle, sources: Sequence[str]) -> tuple[tuple[LensFound, ...], float]:
    """The lenses of an adjusted bundle, and the share by which the least sure focal length is left open."""
    sigmas = posterior_sigmas(bundle)
    found = (LensFound(source=source, known=tuple(known), values=tuple(values), sigmas=tuple(open_))
             for source, known, values, open_ in zip(sources, bundle.known_lenses.tolist(), bundle.lenses.tolist(),
                                                     sigmas.tolist(), strict=True))
    return tuple(found), float((sigmas[:, 0] / bundle.lenses[:, 0]).max())


def _kept_back(bundle: Bundle) -> np.ndarray:
    """(M,) one observation each of some points that many photos see, kept from the adjustment to judge it by."""
    chosen = np.flatnonzero(np.diff(bundle.starts) >= SEEN_BY_MANY)[::_KEPT_BACK]
    chosen = np.setdiff1d(chosen, bundle.control)
    kept = np.zeros(len(bundle.photo), bool)
    kept[bundle.starts[chosen] + np.arange(len(chosen)) % SEEN_BY_MANY] = True
    return kept


def _error(bundle: Bundle, observed: Bundle, kept_back: np.ndarray) -> float:
    """Median distance in pixels of the observations kept back from where the bundle has their points."""
    return float(np.median(np.linalg.norm(bundle.observing(observed).residuals(), axis=1)[kept_back]))


def _adjusted(mapped: Bundle, sources: list[str], progress: Callable[[], None]) -> Bundle:
    """A mapped bundle adjusted; what it does not determine of its lenses stays as it is known beforehand."""
    known = np.array([source == MAKER for source in sources])
    sigmas = mapped.lens_sigmas
    first = np.full_like(sigmas, _HELD)
    first[:, _FREE_AT_FIRST] = np.where(known[:, None], _HELD, sigmas[:, _FREE_AT_FIRST])
    bundle = adjust(replace(started(mapped, sources), lens_sigmas=first), progress, _ROUGHLY)
    bundle = adjust(_restated(bundle, mapped, sigmas), progress, _ROUGHLY)
    left_open = posterior_sigmas(bundle)
    held = left_open > np.where(np.arange(len(LENS_PARAMETERS)) == 0, UNDETERMINED_FOCAL, UNDETERMINED) * sigmas
    held[:, _K3] |= ~known & (np.abs(bundle.lenses[:, _K3]) < SIGNIFICANT * left_open[:, _K3])
    bundle = _restated(bundle, mapped, np.where(held, _HELD, sigmas))
    return adjust(replace(bundle, lenses=np.where(held, mapped.known_lenses, bundle.lenses)), progress)


def _restated(bundle: Bundle, mapped: Bundle, lens_sigmas: np.ndarray) -> Bundle:
    """The bundle with the sigmas of before it was adjusted, and these of its lenses."""
    return replace(bundle, position_sigmas=mapped.position_sigmas, control_sigmas=mapped.control_sigmas,
                   lens_sigmas=lens_sigmas)


def _unfixed(photos: Mapping[str, Photo]) -> set[str]:
    """Photos without an RTK fix, in a flight where others have one."""
    without = {name for name, photo in photos.items() if photo.gps is not None and photo.gps_sigmas is None}
    return without if any(photo.gps_sigmas is not None for photo in photos.values()) else set()


def _warn_of_gps(placement: Placement, photos: int, unfixed: set[str], index: int, reporter: Reporter) -> None:
    """Tell of photos far from their GPS; of those that lost their RTK fix the user knows already."""
    part = "" if index == 0 else Text(" of part {}", index + 1)
    if placement.frame.scale == "unknown":
        reporter.warning(Text("Placement{}: {}", Text(part), Text(placement.frame.note)))
        return
    residual = placement.frame.gps_residual or 0.0
    if residual > BENT:
        reporter.warning(
            Text("The camera positions{} lie {:.1f} m (median) and up to {:.1f} m from the GPS of their {} photos: "
                 "the model may be bent, or the GPS poor. Do not trust measurements; photos from more heights and "
                 "directions help.", Text(part), residual, max(placement.gps_residuals.values()), photos)
        )
    distances = {
        name: distance for name, distance in sorted(placement.gps_residuals.items(), key=lambda x: -x[1])
        if distance > CONTRADICTS[0] and distance > CONTRADICTS[1] * residual and name not in unfixed
    }
    for way, sign in (("near to", 1), ("far from", -1)):
        along = [name for name, distance in distances.items() if sign * placement.along[name] > ALONG * distance]
        if len(along) >= FEWEST_ALONG:
            by = np.median([distances.pop(name) for name in along])
            reporter.warning(
                Text("{} of {} photos{} stand too {} the site by {:.0f} m, along their line of sight: {}. Their "
                     "focal length is not what their metadata say (zoom, another lens, a crop); their GPS may be "
                     "right. Leave them out, or use them without the other photos.", len(along), photos, Text(part),
                     Text(way), by, listed(along))
            )
    far = [f"{name} ({distance:.0f} m)" for name, distance in distances.items()]
    if far:
        reporter.warning(
            Text("{} of {} photos lie far from their GPS, against a median of {:.1f} m: {}. Their GPS is wrong, or "
                 "they were joined to the wrong place: check them.", len(far), photos, residual, listed(far))
        )
