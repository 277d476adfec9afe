# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a photo's EXIF and the drone's XMP say of its camera, place and attitude. A bad tag loses only that tag."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import ExifTags, Image

from ..base.images import exif_tags, open_image, oriented_size
from ..base.records import GeoPosition, Gimbal, Lens
from .kinds import Hints, read_hints
from .position import gimbal, position, relative_altitude
from .times import time
from .values import number, positive, text
from .xmp import read as read_xmp

_RTK_FIXED = 50  # DJI's RtkFlag of a fixed solution
_FILM_DIAGONAL = math.hypot(36, 24)  # mm
# Sigmas of focal lengths as shares: measured by the maker for this camera; the design's; a 35 mm equivalent, which is
# rounded to whole millimetres and counts by the sensor's diagonal or by its width.
_MEASURED_SIGMA, _NOMINAL_SIGMA, _EQUIVALENT_SIGMA = 0.005, 0.02, 0.04
_NO_FOCAL = 0.2  # share by which a second calibrated focal length differs that is none, or not in pixels
_FOCAL_PLANE_UNITS = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}  # EXIF FocalPlaneResolutionUnit, in mm
# Sensor widths in mm of the drone cameras whose files carry no 35 mm equivalent (makers' specifications).
_SENSOR_WIDTHS = {
    "FC220": 6.17, "FC300C": 6.17, "FC300S": 6.17, "FC300X": 6.17, "FC330": 6.17, "FC350": 6.17, "FC550": 17.3,
    "FC6310": 13.2, "FC6310R": 13.2, "FC6310S": 13.2, "FC6510": 13.2, "FC6520": 17.3, "FC7203": 6.17, "FC7303": 6.17,
    "L1D-20c": 13.2,
}


@dataclass(frozen=True, kw_only=True)
class Metadata:
    """See Photo in base/records.py for units; every field is None (or empty) where the photo does not tell."""

    camera: str  # `body` with the 35 mm equivalent and the zoom: photos with the same share intrinsics
    body: str  # make, model, lens, focal length and serial number
    focal_px: float | None
    focal_sigma: float | None
    centre_px: tuple[float, float] | None
    zoom: float  # digital, of this picture; it may or may not be in focal_px
    lens: Lens | None
    gps_sigmas: tuple[float, float] | None
    gps: GeoPosition | None
    gimbal: Gimbal | None
    relative_altitude: float | None
    speed: float | None
    time: str | None
    xmp_fault: str  # what is wrong with the XMP, in words
    hints: Hints  # of what kind the picture is


def read_metadata(path: Path) -> Metadata:
    """The metadata of a photo. Raises PhotoError when the file is missing or not a picture."""
    with open_image(path) as image:
        return from_image(image)


def from_image(image: Image.Image) -> Metadata:
    """The metadata of an image that is open and not yet decoded."""
    main = exif_tags(image)
    exif = exif_tags(image, ExifTags.IFD.Exif)
    gps = exif_tags(image, ExifTags.IFD.GPSInfo)
    xmp = read_xmp(image.info.get("xmp"))
    model = text(main.get(ExifTags.Base.Model))
    body = _body(main, exif, model)
    focal_px, focal_sigma = _focal_px(exif, xmp.drone, model, *oriented_size(image))
    upright = main.get(ExifTags.Base.Orientation, 1) == 1
    return Metadata(
        camera=(body + _as_set(exif)).strip(),
        body=body,
        focal_px=focal_px,
        focal_sigma=focal_sigma,
        centre_px=_optical_centre(exif, xmp.drone, image.size) if upright else None,
        zoom=_zoom(exif),
        lens=_lens(xmp.drone, focal_px, image.size) if upright else None,
        gps_sigmas=_gps_sigmas(xmp.drone),
        gps=position(gps, exif, xmp),
        gimbal=gimbal(xmp),
        relative_altitude=relative_altitude(xmp),
        speed=_speed(xmp.drone),
        time=time(main, exif, gps, xmp),
        xmp_fault=xmp.fault,
        hints=read_hints(image, main, exif, xmp),
    )


def _body(main: Mapping[int, Any], exif: Mapping[int, Any], model: str) -> str:
    make, lens = text(main.get(ExifTags.Base.Make)), text(exif.get(ExifTags.Base.LensModel))
    focal, serial = positive(exif.get(ExifTags.Base.FocalLength)), text(exif.get(ExifTags.Base.BodySerialNumber))
    parts = [make if make and not model.startswith(make) else "", model, lens if lens not in model else ""]
    parts += [f"{focal:g} mm" if focal else "", f"no. {serial}" if serial else ""]
    return " ".join(part for part in parts if part)


def _as_set(exif: Mapping[int, Any]) -> str:
    """What one camera may set differently from photo to photo."""
    film, zoom = positive(exif.get(ExifTags.Base.FocalLengthIn35mmFilm)), _zoom(exif)
    return (f" as {film:g} mm" if film else "") + (f" zoomed {zoom:g}x" if zoom != 1 else "")


def _zoom(exif: Mapping[int, Any]) -> float:
    """The digital zoom; 1 for none, which EXIF writes as 0 too."""
    zoom = positive(exif.get(ExifTags.Base.DigitalZoomRatio)) or 1.0
    return zoom if 1 < zoom <= 100 else 1.0


def _focal_px(
    exif: Mapping[int, Any], dji: Mapping[str, str], model: str, width: int, height: int
) -> tuple[float, float] | tuple[None, None]:
    """Focal length in pixels of this picture and its sigma as a share: the drone's own calibration, else EXIF's 35 mm
    equivalent, else the focal length over the sensor's width."""
    longest, shortest = max(width, height), min(width, height)
    taken = max(_taken(exif))
    equivalent = None
    if film := positive(exif.get(ExifTags.Base.FocalLengthIn35mmFilm)):
        # Makers give the equivalent by the diagonal of the whole sensor. Pictures at 16:9 are cropped from sensors
        # of 4:3 at full width, and their tag stays that of the whole sensor.
        sensor_height = 0.75 * longest if longest > 1.6 * shortest else shortest
        equivalent = film * math.hypot(longest, sensor_height) / _FILM_DIAGONAL

    calibrated, sigma = _calibrated_focal(dji, longest, taken)
    if calibrated and equivalent and not 0.8 < calibrated / equivalent < 1.25:
        calibrated = None  # another lens's or zoom's, or the picture was cropped
    candidates = [(calibrated, sigma), (equivalent, _EQUIVALENT_SIGMA)]
    if focal := positive(exif.get(ExifTags.Base.FocalLength)):
        resolution = positive(exif.get(ExifTags.Base.FocalPlaneXResolution))
        unit = _FOCAL_PLANE_UNITS.get(exif.get(ExifTags.Base.FocalPlaneResolutionUnit, 2))
        if resolution and unit:
            candidates.append((focal * _zoom(exif) * resolution / unit * longest / (taken or longest), _NOMINAL_SIGMA))
        if model in _SENSOR_WIDTHS:
            candidates.append((focal * _zoom(exif) * longest / _SENSOR_WIDTHS[model], _NOMINAL_SIGMA))
    # Beyond these (127 degrees of view, a 360 mm equivalent) it is a tag gone wrong.
    plausible = ((f, share) for f, share in candidates if f is not None and 0.25 < f / longest < 10)
    return next(plausible, (None, None))


def _taken(exif: Mapping[int, Any]) -> tuple[float, float]:
    """Width and height of the picture as the camera took it, for tags that count its pixels: it may have been scaled
    down since. 0 where it is not told."""
    width, height = (number(exif.get(tag)) or 0.0 for tag in
                     (ExifTags.Base.ExifImageWidth, ExifTags.Base.ExifImageHeight))
    return width, height


def _calibrated_focal(dji: Mapping[str, str], longest: int, taken: float) -> tuple[float | None, float]:
    """The drone's calibration, in pixels of the picture as taken, brought to this picture's size; its sigma as a share:
    where it tells two focal lengths, neither is better than their difference."""
    if centre := positive(dji.get("CalibratedOpticalCenterX", dji.get("CalibratedOpticalCenter/X"))):
        taken = 2 * centre
    scale = longest / taken if taken else 1.0
    dewarp = dji.get("DewarpData", "").partition(";")[2].split(",")  # date; fx, fy, cx, cy, k1...
    calibrated = positive(dji.get("CalibratedFocalLength", dji.get("CalibratedFocalLength/X")))
    if len(dewarp) >= 9 and (fx := positive(dewarp[0])) and (fy := positive(dewarp[1])):
        measured = math.sqrt(fx * fy)
        apart = abs(calibrated / measured - 1) if calibrated else 0.0
        return scale * measured, max(_MEASURED_SIGMA, apart if apart < _NO_FOCAL else 0.0)
    return (scale * calibrated if calibrated else None), _NOMINAL_SIGMA


def _optical_centre(
    exif: Mapping[int, Any], dji: Mapping[str, str], size: tuple[int, int]
) -> tuple[float, float] | None:
    """The lens's centre that older DJI cameras tell beside their focal length, in pixels of this picture."""
    centre, taken = [positive(dji.get(f"CalibratedOpticalCenter{axis}")) for axis in "XY"], _taken(exif)
    shares = [place / length if place and length else 0.0 for place, length in zip(centre, taken, strict=True)]
    if "DewarpData" in dji or not all(0.45 < share < 0.55 for share in shares):
        return None
    return shares[0] * size[0], shares[1] * size[1]


def _lens(dji: Mapping[str, str], focal_px: float | None, size: tuple[int, int]) -> Lens | None:
    """The calibration that DJI writes into every photo of a camera (DewarpData), brought to this picture's size; None
    for a picture that was straightened already or cropped, or whose focal length says otherwise."""
    told = [number(text) for text in dji.get("DewarpData", "").partition(";")[2].split(",")]
    numbers = [number for number in told if number is not None]
    half_width, half_height = (positive(dji.get(f"CalibratedOpticalCenter{axis}")) for axis in "XY")
    if len(told) != 9 or len(numbers) != 9 or not half_width or not half_height or number(dji.get("DewarpFlag")) == 1:
        return None
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = numbers
    width, height = size
    scale = 0.5 * width / half_width
    if not abs(0.5 * height / half_height / scale - 1) < 0.01:
        return None
    if not (fx > 0 and 0.9 < fy / fx < 1.1 and focal_px and abs(scale * math.sqrt(fx * fy) / focal_px - 1) < 0.01):
        return None
    if not (abs(cx) < half_width / 4 and abs(cy) < half_height / 4
            and max(abs(k1), abs(k2), abs(k3)) < 5 and max(abs(p1), abs(p2)) < 0.5):
        return None
    return Lens(f=scale * fx, aspect=fy / fx, cx=0.5 * width + scale * cx, cy=0.5 * height + scale * cy,
                k1=k1, k2=k2, p1=p1, p2=p2, k3=k3)


def _speed(dji: Mapping[str, str]) -> float | None:
    """Metres a second, of the drone when it took the photo."""
    along = [number(dji.get(f"Flight{axis}Speed")) for axis in "XYZ"]
    known = [one for one in along if one is not None]
    speed = math.hypot(*known)
    return speed if len(known) == 3 and speed < 100 else None


def _gps_sigmas(dji: Mapping[str, str]) -> tuple[float, float] | None:
    """Sigmas in plan and height (metres) of a position that RTK has fixed; None where the receiver states none."""
    longitude, latitude, height = (positive(dji.get(f"RtkStd{name}")) for name in ("Lon", "Lat", "Hgt"))
    if number(dji.get("RtkFlag")) != _RTK_FIXED or longitude is None or latitude is None or height is None:
        return None
    plan = max(longitude, latitude)
    return (plan, height) if 1e-3 <= plan < 100 and 1e-3 <= height < 100 else None
