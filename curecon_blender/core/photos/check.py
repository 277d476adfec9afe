# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The photo check: a folder of anything in, verified photos with their camera priors out. It writes nothing."""

from __future__ import annotations

import hashlib
import os
import unicodedata
from collections import Counter
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ..base import images, raw
from ..base.errors import OutOfMemory, PhotoError
from ..base.geodesy import altitudes_tell
from ..base.language import Text
from ..base.messages import Reporter
from ..base.records import ELLIPSOID, SEA_LEVEL, UNKNOWN, Photo, PhotoSet, SkippedPhoto
from . import advice, masks, metadata, overlap, stations
from .find import Files, find_files, listed, remedy_for
from .kinds import SURPLUS, Examined, find_surplus, preview_of

RAW = "raw"  # kind of a file left out
MIN_PHOTOS = 3
MIN_SIDE = 200  # pixels: below it there is no detail to match
SHARPNESS_SIZE = 1000  # pixels: photos are compared at this longest side, whatever the camera's resolution
BLURRED = 0.65  # real sharp sets stay above 0.75; motion of 1/300 of the photo's width brings one below 0.6
# Shares of a photo where no channel tells anything. Sound sets reach 0.29 white (a façade before a bright sky) and 0.04
# black; the same photos taken 3 stops too bright have 0.3 to 0.6 white, 5 stops too dark 0.1 to 0.4 black.
WHITE, OVEREXPOSED = 250, 0.35
BLACK, UNDEREXPOSED = 10, 0.15
THUMBNAIL_SIZE = 256  # pixels, longest side
MOST_THUMBNAILS = 48
SAME_FOCAL = 0.05  # relative difference of focal lengths that are the same
_OVERRULE = "Surplus pictures are used if you ask for them."
_MAX_STEM = 50  # characters of a name, so that NAME.jpg and NAME.npz stay within every file system's limit


def check_photos(
    source: Path, reporter: Reporter, paths: list[Path] | None = None, *, surplus: bool = False,
    drawn: Path | None = None,
) -> PhotoSet:
    """Find the photos in `source` (see `find_files`), decode each, and read what its metadata says.

    `paths` are what `find_photos` found in `source`, for a caller who has looked already: files that came since are not
    taken up, those that went are left out.
    Files that cannot be used are left out with a reason and a warning, and so are pictures that are no photos of the
    job, unless `surplus` asks for them; blurred and badly exposed photos are used, with a warning. Masks beside the
    photos and in the folder `drawn` say what of them is left out.
    Raises PhotoError when `source` is missing or no folder, or holds fewer than MIN_PHOTOS usable photos.
    """
    files = find_files(source)
    results: list[Examined | SkippedPhoto] = []
    paths = files.pictures if paths is None else paths
    threads = images.readers(max(map(_pixels, paths)), os.cpu_count() or 1)
    workers = ThreadPoolExecutor(threads, thread_name_prefix="photos")
    try:
        for result in workers.map(_examine, paths):
            results.append(result)
            reporter.progress(len(results), len(paths))
    finally:
        workers.shutdown(cancel_futures=True)
    examined, skipped = _without_duplicates(results)
    raws = [skip for skip in skipped if skip.kind == RAW]
    for skip in skipped:
        if skip.kind != RAW or len(raws) == 1:
            reporter.warning(Text("Left out: {}", Text(skip.reason)))
    if len(raws) > 1:
        reporter.warning(Text("Left out: {} raw files that cannot be developed here: {}. Export them as JPEG with "
                              "their maker's program.", len(raws), listed([images.shown(skip.path) for skip in raws])))
    if not surplus:
        examined, left_out = _without_surplus(examined, reporter)
        skipped += left_out
    skipped += _unreadable(files, reporter)
    _tell_of_lone_masks(files.lone_masks, reporter)
    if len(examined) < MIN_PHOTOS:
        if any(skip.reason.startswith(images.NO_MEMORY_FOR) for skip in skipped):
            raise OutOfMemory
        raise _too_few(source, len(examined), skipped)
    _tell_of_xmp(examined, reporter)
    photos = with_one_datum(_with_altitudes(_with_zoom(examined), reporter), reporter)
    photos = _with_names(source, _with_sharpness(photos))
    photos, hidden = masks.applied(photos, files.masks, drawn, reporter)
    skipped += hidden
    if len(photos) < MIN_PHOTOS:
        raise _too_few(source, len(photos), skipped)
    for problem in ("blurred", "overexposed", "underexposed"):
        if names := [photo.name for photo in photos if problem in _problems(photo)]:
            text = "1 photo looks" if len(names) == 1 else f"{len(names)} photos look"
            reporter.warning(Text("{} {} and will still be used: {}.", Text(text), Text(problem), listed(names)))
    return PhotoSet(photos=tuple(photos), skipped=tuple(skipped))


def ground_sampling_distance(photo_set: PhotoSet) -> float | None:
    """Metres on the ground per pixel below the drone: the median of height above take-off over focal length.

    None when no photo tells both.
    """
    distances = [
        photo.relative_altitude / photo.focal_px for photo in photo_set.photos
        if photo.focal_px and photo.relative_altitude is not None and photo.relative_altitude > 0
    ]
    return float(np.median(distances)) if distances else None


def time_span(photo_set: PhotoSet) -> tuple[str, str] | None:
    """When the first and the last photo were taken, as ISO 8601 in the camera's time; None when no photo tells."""
    times = sorted(photo.time for photo in photo_set.photos if photo.time)
    return (times[0], times[-1]) if times else None


def write_thumbnails(photo_set: PhotoSet, folder: Path) -> dict[str, Path]:
    """Small pictures of the first MOST_THUMBNAILS doubtful photos, in `folder`: their files by the photos' names."""
    doubtful = [photo for photo in photo_set.photos if _problems(photo)][:MOST_THUMBNAILS]
    files = {photo.name: folder / f"{photo.name}.jpg" for photo in doubtful}
    for photo in doubtful:
        images.write_jpeg(files[photo.name], images.read_rgb(photo.path, THUMBNAIL_SIZE), quality=85)
    return files


def describe(photo_set: PhotoSet) -> dict[str, Any]:
    """A summary for people and for `--json`: plain numbers, strings and lists."""
    photos = photo_set.photos
    distance = ground_sampling_distance(photo_set)
    span = time_span(photo_set)
    sizes = Counter((photo.width, photo.height) for photo in photos)
    found = overlap.estimate(photos)
    forward, side = (None if share is None else round(share, 2) for share in (found.forward, found.side))
    return {
        "photos": len(photos),
        "cameras": len({photo.camera for photo in photos}),
        "size": list(sizes.most_common(1)[0][0]) if sizes else None,  # of most photos: [width, height]
        "with_focal": sum(photo.focal_px is not None for photo in photos),
        "with_gps": sum(photo.gps is not None for photo in photos),
        "with_gimbal": sum(photo.gimbal is not None for photo in photos),
        "masked": sum(bool(photo.mask) for photo in photos),
        "ground_sampling_distance_mm": None if distance is None else round(1000 * distance, 2),
        "taken": list(span) if span else None,
        "overlap": {"forward": forward, "side": side, "weak": list(found.weak), "unknown": found.unknown},
        "advice": [{"says": str(one.says), "remedy": str(one.remedy)} for one in advice.advise(photos, found)],
        "stations": stations.describe(photos),
        "doubtful": [
            {"name": photo.name, "path": str(photo.path), "problems": _problems(photo)}
            for photo in photos if _problems(photo)
        ],
        "skipped": [
            {"path": str(skip.path), "reason": skip.reason, "kind": skip.kind, "surplus": skip.kind in SURPLUS}
            for skip in photo_set.skipped
        ],
    }


def _pixels(path: Path) -> int:
    """What a photo's header promises; 0 for one that will be left out."""
    try:
        with images.open_image(path) as image:
            return image.width * image.height
    except PhotoError:
        return 0


def _examine(path: Path) -> Examined | SkippedPhoto:
    if not images.is_text(path):
        return SkippedPhoto(path=path, reason=f"{images.shown(path)} has a name or a folder whose letters are no text.")
    try:
        with images.open_image(path) as image:
            told = metadata.from_image(image)
            width, height = images.oriented_size(image)
            if min(width, height) < MIN_SIDE:
                reason = f"{images.shown(path)} is only {width}x{height} pixels."
                return SkippedPhoto(path=path, reason=reason)
            rgb = images.decode(image, path, SHARPNESS_SIZE)
    except PhotoError as error:
        return SkippedPhoto(path=path, reason=error.message, kind=RAW if path.suffix.lower() in raw.SUFFIXES else "")
    photo = Photo(
        name=path.name, path=path, width=width, height=height,
        camera=f"{told.camera or 'unknown camera'} {width}x{height}", focal_px=told.focal_px,
        focal_sigma=told.focal_sigma, speed=told.speed, centre_px=told.centre_px, lens=told.lens,
        gps=told.gps, gps_sigmas=told.gps_sigmas, gimbal=told.gimbal, relative_altitude=told.relative_altitude,
        time=told.time, sharpness=_sharpness(rgb),
        overexposed=bool((rgb.min(axis=2) >= WHITE).mean() >= OVEREXPOSED),
        underexposed=bool((rgb.max(axis=2) <= BLACK).mean() >= UNDEREXPOSED),
        sky=round(advice.sky_share(rgb), 3), digest=hashlib.sha256(rgb.tobytes()).hexdigest(),
    )
    return Examined(
        photo=photo, hints=told.hints, xmp_fault=told.xmp_fault, zoom=told.zoom, body=(told.body, width, height),
        preview=preview_of(rgb),
    )


def _problems(photo: Photo) -> list[str]:
    """What makes a usable photo doubtful."""
    return [problem for problem in ("blurred", "overexposed", "underexposed") if getattr(photo, problem)]


def _sharpness(rgb: np.ndarray) -> float:
    """Variance of the Laplacian over what is left of it after a blur of 2 pixels.

    The ratio tells blur from scenes with little detail: the plain variance falls as much over a lawn as in motion.
    """
    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY).astype(np.float32)
    fine = float(cv2.Laplacian(grey, cv2.CV_32F).var())
    coarse = float(cv2.Laplacian(cv2.GaussianBlur(grey, (0, 0), 2), cv2.CV_32F).var())
    return fine / coarse if coarse > 0 else 0.0


def _with_sharpness(photos: list[Photo]) -> list[Photo]:
    """Sharpness relative to the median of the photos from the same camera."""
    medians = {}
    for camera in {photo.camera for photo in photos}:
        same = [photo.sharpness for photo in photos if photo.camera == camera]
        medians[camera] = float(np.median(same if len(same) >= MIN_PHOTOS else [p.sharpness for p in photos]))
    relative = [photo.sharpness / (medians[photo.camera] or 1.0) for photo in photos]
    return [replace(p, sharpness=round(s, 3), blurred=s < BLURRED) for p, s in zip(photos, relative, strict=True)]


def _without_duplicates(
    results: Iterable[Examined | SkippedPhoto],
) -> tuple[list[Examined], list[SkippedPhoto]]:
    first: dict[str, Path] = {}
    examined: list[Examined] = []
    skipped: list[SkippedPhoto] = []
    for result in results:
        if isinstance(result, SkippedPhoto):
            skipped.append(result)
        elif result.photo.digest in first:
            path, same = result.photo.path, first[result.photo.digest]
            skipped.append(SkippedPhoto(path=path, reason=f"{images.shown(path)} is the same picture as "
                                                          f"{images.shown(same)}."))
        else:
            first[result.photo.digest] = result.photo.path
            examined.append(result)
    return examined, skipped


def _without_surplus(examined: list[Examined], reporter: Reporter) -> tuple[list[Examined], list[SkippedPhoto]]:
    """Without the pictures that are no photos of the job; each kind is told of once."""
    found = find_surplus(examined)
    kinds: dict[str, list[Path]] = {}
    for path, surplus in found.items():
        kinds.setdefault(surplus.kind, []).append(path)
    for kind, paths in kinds.items():
        if len(paths) == 1:
            reporter.warning(Text("Left out: {} {}", Text(found[paths[0]].reason), Text(_OVERRULE)))
        else:
            names = listed([images.shown(path) for path in paths])
            reporter.warning(Text("Left out: {} pictures, each a {}: {}. {}", len(paths), Text(kind), names,
                                  Text(_OVERRULE)))
    left = [picture for picture in examined if picture.photo.path not in found]
    return left, [SkippedPhoto(path=path, reason=it.reason, kind=it.kind) for path, it in found.items()]


def _unreadable(files: Files, reporter: Reporter) -> list[SkippedPhoto]:
    """What lies beside the photos and cannot be read, each kind told of once."""
    found = files.unreadable()
    for kind, skips in found.items():
        count = f"1 {kind} file is" if len(skips) == 1 else f"{len(skips)} {kind} files are"
        names = listed([images.shown(skip.path) for skip in skips])
        reporter.warning(Text("{} not used, since this kind is not read here: {}. {}", Text(count), names,
                              Text(remedy_for(kind))))
    return [skip for skips in found.values() for skip in skips]


def _tell_of_lone_masks(lone: list[Path], reporter: Reporter) -> None:
    if lone:
        reporter.warning(Text("The photos of {} masks are not there: {}. These masks say nothing.", len(lone),
                              listed([images.shown(path) for path in lone])))


def _tell_of_xmp(examined: list[Examined], reporter: Reporter) -> None:
    if faulty := [picture for picture in examined if picture.xmp_fault]:
        of = "1 photo" if len(faulty) == 1 else f"{len(faulty)} photos"
        names = listed([images.shown(picture.photo.path) for picture in faulty])
        reporter.warning(
            Text("The XMP of {} is faulty; what is sound in it is used: {}. That of {} {}.", Text(of), names,
                 images.shown(faulty[0].photo.path), Text(faulty[0].xmp_fault))
        )


def _with_zoom(examined: list[Examined]) -> list[Photo]:
    """The photos, with a digital zoom in their focal length where their 35 mm equivalent leaves it out: where that is
    the same as in photos that the camera took without zoom."""
    unzoomed = {}
    for picture in examined:
        if picture.zoom == 1 and picture.photo.focal_px:
            unzoomed[picture.body] = picture.photo.focal_px
    photos = []
    for picture in examined:
        photo, focal = picture.photo, picture.photo.focal_px
        if picture.zoom != 1 and focal and abs(unzoomed.get(picture.body, 0.0) / focal - 1) < SAME_FOCAL:
            photo = replace(photo, focal_px=focal * picture.zoom, lens=None)
        photos.append(photo)
    return photos


def _with_altitudes(photos: list[Photo], reporter: Reporter) -> list[Photo]:
    """Without altitudes that tell nothing."""
    located = [photo for photo in photos if photo.gps is not None and photo.gps.altitude is not None]
    if not located or altitudes_tell(located).all():
        return photos
    assert located[0].gps is not None
    reporter.warning(
        Text("All photos have the same GPS altitude ({:.1f} m), which is not used: no receiver measured it.",
             located[0].gps.altitude)
    )
    return [replace(photo, gps=photo.gps and replace(photo.gps, altitude=None, altitude_datum=UNKNOWN))
            for photo in photos]


def with_one_datum(photos: list[Photo], reporter: Reporter) -> list[Photo]:
    """Without the altitudes that count from another level than most do: the two lie tens of metres apart."""
    levels = Counter(photo.gps.altitude_datum for photo in photos if photo.gps is not None)
    if not (levels[ELLIPSOID] and levels[SEA_LEVEL]):
        return photos
    fewer, more = sorted((ELLIPSOID, SEA_LEVEL), key=lambda level: levels[level])
    reporter.warning(
        Text("{} photos count their altitude from the {}, {} from the {}: the altitudes of the {} are not used. Use "
             "photos of one flight, or of one kind of receiver.", levels[fewer], Text(fewer), levels[more], Text(more),
             levels[fewer])
    )
    return [replace(photo, gps=replace(photo.gps, altitude=None, altitude_datum=UNKNOWN), gps_sigmas=None)
            if photo.gps is not None and photo.gps.altitude_datum == fewer else photo for photo in photos]


def _with_names(source: Path, photos: list[Photo]) -> list[Photo]:
    """Names that are unique whatever the file system's idea of case, and safe in COLMAP's text format."""
    clashes = Counter(_safe(photo.path.name).casefold() for photo in photos)
    taken: set[str] = set()
    named = []
    for photo in photos:
        name = _safe(photo.path.name)
        if clashes[name.casefold()] > 1 and photo.path.parent != source:
            name = _safe(f"{photo.path.parent.name}_{photo.path.name}")
        stem, suffix = os.path.splitext(name)
        number = 2
        while name.casefold() in taken:
            name, number = f"{stem}_{number}{suffix}", number + 1
        taken.add(name.casefold())
        named.append(replace(photo, name=name))
    return named


def _safe(name: str) -> str:
    """Letters and digits of any script, and . _ - ( ) stay; all else becomes _: spaces end a name in COLMAP's text
    format, and quotes and the like are not allowed in a Windows file name."""
    stem, suffix = os.path.splitext(unicodedata.normalize("NFC", name))
    stem = "".join(c if unicodedata.category(c)[0] in "LMN" or c in "._-()" else "_" for c in stem)
    return (stem.strip(".")[:_MAX_STEM] or "photo") + suffix


def _too_few(source: Path, usable: int, skipped: list[SkippedPhoto]) -> PhotoError:
    found = f"only {usable} usable photo{'' if usable == 1 else 's'}" if usable else "no usable photo"
    left_out = f" Left out: {listed([skip.reason.rstrip('.') for skip in skipped], ';')}." if skipped else ""
    return PhotoError(
        Text("There is {} in {}: a reconstruction needs at least {}.{}", Text(found), source, MIN_PHOTOS,
             Text(left_out)),
        remedy="Add photos of the same site that overlap by two thirds or more.", path=source,
    )
