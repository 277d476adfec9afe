# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a job will take on this computer: time, memory and disk, told before it starts.

Seconds are those of the reference (two cores of a Xeon with AVX512-bf16, benchmarks/RESULTS.md) times how much slower
this computer is. That comes from the user's own finished jobs, a stage at a time, or, before the first, from a probe
and from what other programs take of the processor meanwhile.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import psutil
import torch

from ..base import images, memory
from ..base.files import write_json
from ..base.options import PRESETS, STAGES, SURFACE_STAGES, Options
from ..base.reading import Within, build, read_json
from ..base.records import Photo
from ..cloud import fuse
from ..depth import tiles
from ..depth.estimate import choose_device, choose_precision, features_kept
from ..sparse.matches import PHOTOS_KEPT
from ..sparse.pairs import expected_pairs, metadata_pairs
from ..sparse.parallel import threads
from ..surface.build import most_points
from .workspace import folder_bytes

GOALS = ("fusion", *SURFACE_STAGES)  # what a job may end with
JOBS_KEPT = 5  # last finished jobs whose speed counts: their median
SHORTEST_LEARNED = 5.0  # seconds: below it a stage is mostly its start
FEATURE_BYTES_PER_PHOTO = 3 << 20  # features and matches in COLMAP's database
BYTES_PER_DEPTH_PIXEL = 11.0  # a depth map's file, its undistorted picture, its points and fusion's scratch, per pixel
SURFACE_BYTES = 300 << 20  # a mesh of a million faces and its pages
CROWDING_SECONDS = 0.5  # for which other programs are watched
SATURATED = 0.9  # of the processors in use: from here on programs queue for them
LIBRARIES_BYTES = 350 << 20  # the worker itself, before it has done anything
FEATURE_BYTES_PER_PIXEL = 60  # of a photo's features, which the depth stage keeps
# Measured peaks of other stages: matching, per thread and feature asked for, and per photo kept and feature; features,
# per thread and pixel; the mesh, per pixel of all depth maps together.
MATCHING_BYTES, PHOTO_FEATURE_BYTES, EXTRACTION_BYTES_PER_PIXEL, MESH_BYTES_PER_PIXEL = 5000, 260, 250, 140
LEARNED_BYTES = 1000 << 20  # of the networks that match photos, and their pictures
ADJUSTING_BYTES = 1 << 20  # of a photo's observations and their derivatives
PIXELS_A_POINT = 11  # of all depth maps, for each point of the cloud
_PROBE_CONVOLUTION, _PROBE_BLUR = 0.037, 0.013  # seconds of the probes on the reference


def predict(photos: tuple[Photo, ...], pairs: int, options: Options, slowness: dict[str, float]) -> dict[str, Any]:
    """Rough seconds, memory and disk (GiB) of a job with these options to its end `until`, in which so many `pairs` of
    photos are matched; see `count_pairs` and `slowness_here`."""
    stages = STAGES[: STAGES.index(options.until) + 1]
    seconds = reference_seconds(photos, pairs, options)
    surface = SURFACE_BYTES if set(stages) & set(SURFACE_STAGES) else 0
    return {
        "seconds": round(sum(seconds[stage] * slowness[stage] for stage in stages)),
        "memory_gib": round(max(_peak_bytes(photos, options)[stage] for stage in stages) / 2**30, 1),
        "disk_gib": round((disk_bytes(photos, options) + surface) / 2**30, 2),
    }


def predict_all(photos: tuple[Photo, ...], options: Options, slowness: dict[str, float]) -> dict[str, dict[str, Any]]:
    """`predict` for every quality and goal: {quality: {goal: ...}}."""
    pairs = count_pairs(photos)
    return {
        quality: {goal: predict(photos, pairs, replace(options, quality=quality, until=goal), slowness)
                  for goal in GOALS}
        for quality in PRESETS
    }


def count_pairs(photos: tuple[Photo, ...]) -> int:
    """How many pairs of photos a job will match, whatever its options."""
    return expected_pairs(photos, metadata_pairs(photos))


def free(workspace: Path) -> dict[str, float]:
    """GiB of memory that are free now, and of the disk of `workspace`, with what a job there holds already."""
    workspace = workspace.absolute()
    place = next(folder for folder in (workspace, *workspace.parents) if folder.exists())
    disk = psutil.disk_usage(str(place)).free
    if (workspace / "workspace.json").exists():
        disk += folder_bytes(workspace)
    return {
        "free_memory_gib": round(psutil.virtual_memory().available / 2**30, 1),
        "free_disk_gib": round(disk / 2**30, 2),
    }


def disk_bytes(photos: tuple[Photo, ...], options: Options) -> int:
    """What a job's features, depth maps and cloud take on disk."""
    return len(photos) * FEATURE_BYTES_PER_PHOTO + depth_bytes(photos, options)


def depth_bytes(photos: tuple[Photo, ...], options: Options) -> int:
    """What the depth maps and all that is made of them take on disk."""
    return int(sum(_pixels(photo, options.image_size) for photo in photos) * BYTES_PER_DEPTH_PIXEL)


def reference_seconds(photos: tuple[Photo, ...], pairs: int, options: Options) -> dict[str, float]:
    """Seconds a stage takes the reference, fitted to the runs in benchmarks/RESULTS.md."""
    size, sources = options.image_size, options.source_views
    sparse_size = options.preset.sfm_image_size
    megapixels = sum(_pixels(photo, size) for photo in photos) / 1e6
    sparse_megapixels = sum(_pixels(photo, sparse_size) for photo in photos) / 1e6
    features = (options.preset.max_features / 8192) ** 2
    hypotheses = _hypotheses(photos, size)
    learned = 0.5 * pairs + 0.9 * len(photos) if options.matches == "both" else 0.0
    return {
        "photos": 0.02 * len(photos),
        "sparse": 0.75 * sparse_megapixels + 0.3 * features * pairs + 0.5 * len(photos) + learned,
        "adjust": 0.4 * features * len(photos),
        "views": 0.1 * len(photos),
        "depth": megapixels * (1.0 + 0.059 * hypotheses) * (1 + 0.3 * sources) / 2.2,
        "fusion": 0.6 * megapixels,
        "mesh": 20 + 8.0 * megapixels,
        "texture": 3.8 * len(photos),
    }


def slowness_here(device: str, speeds: Path | None) -> dict[str, float]:
    """Seconds here for one of the reference, by stage: the median of finished jobs, else what a probe says of a
    processor that is shared as it is now.

    Raises DeviceError when this computer has no such device.
    """
    chosen = choose_device(device)
    known = _read(speeds)
    own = {stage: statistics.median(ratios) for stage in STAGES if (ratios := known.get(_key(stage, chosen)))}
    probed = _probe(chosen)
    on_processor = [stage for stage in STAGES if stage not in own and (stage != "depth" or chosen.type == "cpu")]
    if on_processor:
        shared = crowding()
        probed |= {stage: shared * probed[stage] for stage in on_processor}
    return {**probed, **own}


def crowding() -> float:
    """By how much work takes longer for what other programs do at this moment: 1 where they do nothing, 2 where they
    would use all processors. Programs that give way (nice) do not count."""
    now = psutil.cpu_times_percent(interval=CROWDING_SECONDS)
    used = (now.user + now.system) / 100
    if used < SATURATED:
        return 1 + used
    return 1 + max(used, psutil.getloadavg()[0] / (psutil.cpu_count() or 1))  # the queue before the processors


def learn(stage: str, seconds: float, photos: tuple[Photo, ...], options: Options) -> None:
    """Keep in `options.speeds` what a stage of a finished job took; one too short to tell is passed over."""
    if options.speeds is None or seconds < SHORTEST_LEARNED:
        return
    known, key = _read(options.speeds), _key(stage, choose_device(options.device))
    ratio = seconds / reference_seconds(photos, count_pairs(photos), options)[stage]
    known[key] = [*known.get(key, []), round(ratio, 3)][-JOBS_KEPT:]
    write_json(options.speeds, known)


def _probe(chosen: torch.device) -> dict[str, float]:
    """Seconds here for one of the reference, by stage, from a third of a second's work of the two kinds there are."""
    dtype = choose_precision("auto", chosen)
    volume = torch.randn(1, 8, 32, 120, 160, dtype=dtype, device=chosen)
    kernel = torch.randn(8, 8, 3, 3, 3, dtype=dtype, device=chosen)
    picture = np.random.default_rng(0).random((1200, 1600), dtype=np.float32)

    def convolve() -> None:
        with torch.inference_mode():
            torch.nn.functional.conv3d(volume, kernel, padding=1).sum().item()

    network = _fastest(convolve) / _PROBE_CONVOLUTION
    other = _fastest(lambda: cv2.GaussianBlur(picture, (0, 0), 4)) / _PROBE_BLUR
    return {stage: network if stage == "depth" else other for stage in STAGES}


def _fastest(work: Callable[[], object]) -> float:
    """Seconds of the fastest of some runs: other programs slow the rest down."""
    work()
    runs = []
    for _ in range(4):
        started = time.perf_counter()
        work()
        runs.append(time.perf_counter() - started)
    return min(runs)


def _peak_bytes(photos: tuple[Photo, ...], options: Options) -> dict[str, float]:
    """The worker's peak memory by stage. The depth stage keeps to its budget, down to what one tile needs."""
    size = options.image_size
    pixels = [_pixels(photo, size) for photo in photos]
    workers = threads()
    picture = EXTRACTION_BYTES_PER_PIXEL * max(_pixels(photo, options.preset.sfm_image_size) for photo in photos)
    matching = workers * MATCHING_BYTES + min(len(photos), PHOTOS_KEPT) * PHOTO_FEATURE_BYTES
    full = max(photo.width * photo.height for photo in photos)
    readers = images.readers(full, workers)
    full *= images.DECODING_BYTES
    budget = memory.budget(options)
    per_pixel = tiles.bytes_per_pixel(_hypotheses(photos, size))
    per_pixel += options.source_views * tiles.BYTES_PER_SOURCE_PIXEL
    tile = max(min(tiles.BASE_BYTES + max(pixels) * per_pixel, budget), tiles.LEAST_BUDGET)
    features = min(budget / 4, sum(sorted(pixels)[-features_kept(options) :]) * FEATURE_BYTES_PER_PIXEL)
    meshed = min(sum(pixels), PIXELS_A_POINT * most_points(options.mesh_faces))
    peaks = {
        "photos": readers * full,
        "sparse": max(readers * (full + picture), matching * options.preset.max_features,
                      LEARNED_BYTES if options.matches == "both" else 0),
        "adjust": len(photos) * ADJUSTING_BYTES,
        "views": 1.2 * full, "depth": tile + features, "fusion": fuse.peak_bytes(pixels, budget),
        "mesh": meshed * MESH_BYTES_PER_PIXEL, "texture": meshed * MESH_BYTES_PER_PIXEL / 2,
    }
    return {stage: LIBRARIES_BYTES + peak for stage, peak in peaks.items()}


def _hypotheses(photos: tuple[Photo, ...], size: int) -> int:
    longest = max(max(photo.width, photo.height) for photo in photos)
    return tiles.typical_hypotheses(min(size, longest))


def _pixels(photo: Photo, size: int) -> float:
    return photo.width * photo.height * min(1.0, size / max(photo.width, photo.height)) ** 2


def _key(stage: str, device: torch.device) -> str:
    return f"depth {device.type}" if stage == "depth" else stage


def _read(speeds: Path | None) -> dict[str, list[float]]:
    """What finished jobs have told; nothing where there is no file, or it cannot be read: it can be learned again."""
    try:
        known = build(dict, read_json(speeds, 1 << 20)) if speeds is not None else {}
        kind = tuple[Annotated[float, Within(1e-6, 1e6)], ...]
        return {stage: list(build(kind, ratios, stage)) for stage, ratios in known.items()}
    except (OSError, ValueError):
        return {}
