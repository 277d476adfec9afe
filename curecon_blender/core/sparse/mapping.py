# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Mapping: from the verified matches in the database to models of cameras and points."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path

import pycolmap

from ..base.files import scratch_folder
from ..base.messages import Reporter
from .parallel import threads

INCREMENTAL = 300  # photos; up to here "auto" takes the incremental mapper, which is the more robust
SMALLEST = 3  # photos in a component
# Points of three photos or more that hold a photo. The mapper places one by 30 such points; where the adjustment then
# throws out more than half of them, they were false.
FEWEST_TIES = 15
# All is adjusted anew after the model has grown so much, until a step gains less than so much of the cost: the adjust
# stage has the last word. COLMAP's own 1.1 and 0 take twice as long and give the same model.
_GROWTH, _TOLERANCE = 1.4, 1e-5


def map_photos(
    database: Path, names: list[str], mapper: str, reporter: Reporter, placed: Callable[[int], None]
) -> list[pycolmap.Reconstruction]:
    """The components that a mapper ("auto", "incremental" or "global") makes of the photos named, the largest first.

    Each photo is in one component, and none has fewer than SMALLEST. A photo with fewer than FEWEST_TIES is not in: it
    may stand anywhere. `placed` is told how many photos more were placed, where the mapper tells. Raises Cancelled.
    """
    if mapper == "auto":
        mapper = "incremental" if len(names) <= INCREMENTAL else "global"
    registered = [0]  # photos placed so far, told by the mapper's thread

    def count() -> None:
        registered[0] += 1

    with scratch_folder(database.parent / "mapper") as output:

        def incremental(token: pycolmap.CancellationToken) -> list[pycolmap.Reconstruction]:
            return list(pycolmap.incremental_mapping(
                database, output, output, _incremental(names), next_image_callback=count, cancellation_token=token,
            ).values())

        def at_once(_: pycolmap.CancellationToken) -> list[pycolmap.Reconstruction]:
            settings = pycolmap.GlobalPipelineOptions()
            settings.image_names, settings.min_model_size = names, SMALLEST
            settings.num_threads, settings.random_seed = threads(), 0
            return list(pycolmap.global_mapping(database, output, output, settings).values())

        call = incremental if mapper == "incremental" else at_once
        return _components(_cancellable(call, registered, reporter, placed))


def _incremental(names: list[str]) -> pycolmap.IncrementalPipelineOptions:
    settings = pycolmap.IncrementalPipelineOptions()
    settings.image_names, settings.extract_colors = names, False
    settings.min_model_size = SMALLEST
    settings.num_threads, settings.random_seed = threads(), 0
    settings.ba_global_frames_ratio = settings.ba_global_points_ratio = _GROWTH
    settings.ba_global_function_tolerance = settings.ba_local_function_tolerance = _TOLERANCE
    settings.ba_global_max_refinements, settings.ba_local_max_refinements = 2, 1
    return settings


def _cancellable(
    call: Callable[[pycolmap.CancellationToken], list[pycolmap.Reconstruction]], registered: list[int],
    reporter: Reporter, placed: Callable[[int], None],
) -> list[pycolmap.Reconstruction]:
    """Run a long native call on a thread of its own, so that this one can report progress and pass on a cancel."""
    token = pycolmap.CancellationToken()
    told = 0
    with ThreadPoolExecutor(1, "mapper") as pool:
        future = pool.submit(call, token)
        try:
            while not future.done():
                wait([future], timeout=0.2)
                reporter.check_cancelled()
                if registered[0] > told:
                    placed(registered[0] - told)
                    told = registered[0]
        finally:
            token.cancel()
        return future.result()


def _components(models: list[pycolmap.Reconstruction]) -> list[pycolmap.Reconstruction]:
    """The models by falling size, each photo only in the largest that has it, none below three photos."""
    taken: set[str] = set()
    components = []
    for model in sorted(models, key=lambda model: (-model.num_reg_images(), -model.num_points3D())):
        for image_id in model.reg_image_ids():
            if model.image(image_id).name in taken:
                model.deregister_frame(model.image(image_id).frame_id)
        drop_loose(model)
        if model.num_reg_images() >= SMALLEST and model.num_points3D() > 0:
            model.tear_down()
            taken |= {model.image(i).name for i in model.reg_image_ids()}
            components.append(model)
    return sorted(components, key=lambda model: -model.num_reg_images())


def drop_loose(model: pycolmap.Reconstruction) -> None:
    """Take out the photos that too few points of three photos or more hold in their place."""
    while loose := [model.image(i) for i in model.reg_image_ids() if _ties(model, model.image(i)) < FEWEST_TIES]:
        for image in loose:  # what they leave may be loose in its turn
            model.deregister_frame(image.frame_id)


def _ties(model: pycolmap.Reconstruction, image: pycolmap.Image) -> int:
    points = (model.point3D(point.point3D_id) for point in image.get_observation_points2D())
    return sum(point.track.length() >= 3 for point in points)
