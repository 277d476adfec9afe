# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The adjust stage: the mapper's components in, the same in the site frame out, adjusted with all that is known.

A flight straight down at one height hardly tells the focal length from the height, and bends where the lens's
distortion is not known: what it does not determine stays with what the maker measured.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from ..base.messages import Reporter
from ..base.records import Frame, Photo, PhotoSet
from ..sparse.models import ADJUSTED, MAPPED, find_models, listed, read_model, write_components
from ..sparse.placement import BENT, Placement, place
from ..sparse.record import FRAME_FILE, read_frame
from .bundle import adjust
from .conversion import registered, to_bundle, write_back
from .priors import calibrations, gps_positions
from .record import ACCURACY_FILE, Accuracy, PhotoResidual

CONTRADICTS = 15.0, 10.0  # metres, times the median: a photo farther than both from its GPS is named
# Photos whose camera is wrong and not their GPS: that share of the distance lies along their line of sight, in so many.
ALONG, FEWEST_ALONG = 0.9, 2
MOST_PHOTOS = 1500  # the reduced system is a full matrix: 0.7 GB, and some copies of it
# Beyond these a calibration is not this camera's: times the mapper's reprojection error, sigmas of the focal length.
WORSE, CONTRADICTED = 2.0, 5.0
_HELD = 1e-9  # of a lens that is held fast


def adjust_cameras(photo_set: PhotoSet, workspace: Path, reporter: Reporter) -> list[Frame]:
    """Place and adjust the components in `workspace/sparse/mapped/N`; write each to `workspace/sparse/N` with the
    records of its frame and accuracy. A given model, which has its frame already, stays as it is.

    Returns the components' frames. GPS that contradicts the cameras is warned of. Raises SparseError for a component
    that cannot be read, Cancelled, WorkspaceError.
    """
    photos = {photo.name: photo for photo in photo_set.photos}
    folders = find_models(workspace / MAPPED)
    components: list[tuple[pycolmap.Reconstruction, dict[str, Any]]] = []
    frames = []
    for index, folder in enumerate(folders):
        reporter.progress(index, len(folders))
        model = read_model(folder)
        if (folder / FRAME_FILE).is_file():
            frame = read_frame(folder)
            accuracy = _accuracy(model, photos, frame, adjusted=False)
        else:
            frame, accuracy = _placed(model, photos, index, reporter)
        components.append((model, {FRAME_FILE: frame, ACCURACY_FILE: accuracy}))
        frames.append(frame)
    write_components(workspace, ADJUSTED, components)
    reporter.progress(len(folders), len(folders))
    return frames


def _placed(
    model: pycolmap.Reconstruction, photos: Mapping[str, Photo], index: int, reporter: Reporter
) -> tuple[Frame, Accuracy]:
    """Bring a mapped model into the site frame, in place, adjusted where that can be."""
    placement = place(model, photos)
    model.transform(placement.site_from_model)
    adjusted = adjust_model(model, photos, placement.frame, reporter)
    if adjusted:
        placement = place(model, photos)
        model.transform(placement.site_from_model)
    _warn_of_gps(placement, model.num_reg_images(), index, reporter)
    return placement.frame, _accuracy(model, photos, placement.frame, adjusted=adjusted)


def _accuracy(
    model: pycolmap.Reconstruction, photos: Mapping[str, Photo], frame: Frame, *, adjusted: bool
) -> Accuracy:
    residuals = []
    if frame.origin is not None:
        images = registered(model)
        known, sigmas = gps_positions([photos[image.name] for image in images], frame.origin)
        for image, place, sigma in zip(images, known, sigmas, strict=True):
            if np.isfinite(sigma).all():
                east, north, up = (image.projection_center() - place).tolist()
                residuals.append(PhotoResidual(name=image.name, off=(east, north, up)))
    return Accuracy(
        adjusted=adjusted, reprojection_error=model.compute_mean_reprojection_error(), gps=tuple(residuals)
    )


def adjust_model(
    model: pycolmap.Reconstruction, photos: Mapping[str, Photo], frame: Frame, reporter: Reporter
) -> bool:
    """Adjust a model in the site frame, in place. Its cameras are FULL_OPENCV afterwards.

    False where the model stays: its frame is not by GPS, or not every lens was calibrated by its maker. The user is
    told where a calibration does not fit the photos, or the photos are too many. Raises Cancelled.
    """
    lenses = calibrations(registered(model), photos)
    if frame.origin is None or not frame.north or lenses is None:
        return False
    if model.num_reg_images() > MOST_PHOTOS:
        reporter.warning(
            f"The maker's calibration of the camera is not used: that is for up to {MOST_PHOTOS:,} photos. Heights may "
            "be wrong if all photos look straight down from one height."
        )
        return False
    mapped = model.compute_mean_reprojection_error()
    bundle, progress = to_bundle(model, photos, frame.origin, lenses), reporter.check_cancelled
    # First with the lens as calibrated, from where it puts the cameras: from a wrong focal length the way is long.
    held = adjust(replace(bundle, lens_sigmas=np.full_like(bundle.lens_sigmas, _HELD)), progress)
    freed = replace(held, lens_sigmas=bundle.lens_sigmas, position_sigmas=bundle.position_sigmas)
    adjusted = adjust(freed, progress)
    off = float(np.median(np.linalg.norm(adjusted.residuals(), axis=1)))
    focal = np.abs(adjusted.lenses - bundle.known_lenses)[:, 0] / bundle.lens_sigmas[:, 0]
    if not off < WORSE * mapped or focal.max() > CONTRADICTED:
        reporter.warning(
            "The maker's calibration of the camera does not fit the photos and is not used: it is another lens's, or "
            "the pictures were edited. Heights may be wrong if all photos look straight down from one height."
        )
        return False
    write_back(adjusted, model)
    return True


def _warn_of_gps(placement: Placement, photos: int, index: int, reporter: Reporter) -> None:
    part = "" if index == 0 else f" of part {index + 1}"
    if placement.frame.scale == "unknown":
        reporter.warning(f"Placement{part}: {placement.frame.note}")
        return
    residual = placement.frame.gps_residual or 0.0
    if residual > BENT:
        reporter.warning(
            f"The camera positions{part} lie {residual:.1f} m (median) and up to "
            f"{max(placement.gps_residuals.values()):.1f} m from the GPS of their {photos} photos: the model may be "
            "bent, or the GPS poor. Do not trust measurements; photos from more heights and directions help."
        )
    distances = {
        name: distance for name, distance in sorted(placement.gps_residuals.items(), key=lambda x: -x[1])
        if distance > CONTRADICTS[0] and distance > CONTRADICTS[1] * residual
    }
    for way, sign in (("near to", 1), ("far from", -1)):
        along = [name for name, distance in distances.items() if sign * placement.along[name] > ALONG * distance]
        if len(along) >= FEWEST_ALONG:
            by = np.median([distances.pop(name) for name in along])
            reporter.warning(
                f"{len(along)} of {photos} photos{part} stand too {way} the site by {by:.0f} m, along their line of "
                f"sight: {listed(along)}. Their focal length is not what their metadata say (zoom, another lens, a "
                "crop); their GPS may be right. Leave them out, or use them without the other photos."
            )
    far = [f"{name} ({distance:.0f} m)" for name, distance in distances.items()]
    if far:
        reporter.warning(
            f"{len(far)} of {photos} photos lie far from their GPS, against a median of {residual:.1f} m: "
            f"{listed(far)}. Their GPS is wrong, or they were joined to the wrong place: check them."
        )
