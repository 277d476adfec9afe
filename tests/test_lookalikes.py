# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Sides that look alike: a model folded onto one side is seen, mended and told; a sound one is left alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from drawn_ring import draw_ring
from lookalike_matches import Ring, write_ring

from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.base.options import Options
from curecon_blender.core.base.records import PhotoSet
from curecon_blender.core.sparse import find_cameras
from curecon_blender.core.sparse.lookalikes import without_lookalikes
from curecon_blender.core.sparse.mapping import map_photos
from curecon_blender.core.sparse.pairs import metadata_pairs


def errors(models: list[pycolmap.Reconstruction], ring: Ring) -> np.ndarray:
    """Distances (N,) in metres of the first model's cameras from their true places, after the best similarity."""
    places = {photo.name: place for photo, place in zip(ring.photos, ring.places, strict=True)}
    images = [models[0].image(i) for i in models[0].reg_image_ids()]
    found = np.array([image.projection_center() for image in images])
    true = np.array([places[image.name] for image in images])
    source, target = found - found.mean(0), true - true.mean(0)
    left, sizes, right = np.linalg.svd(target.T @ source)
    signs = np.array([1, 1, np.sign(np.linalg.det(left @ right))])
    scale = (sizes * signs).sum() / (source**2).sum()
    result: np.ndarray = np.linalg.norm(scale * source @ (left * signs @ right).T - target, axis=1)
    return result


def mapped(database: Path, ring: Ring, reporter: Reporter) -> tuple[list[pycolmap.Reconstruction], ...]:
    """The models before and after the look for look-alikes."""

    def remap(path: Path) -> list[pycolmap.Reconstruction]:
        return map_photos(path, [photo.name for photo in ring.photos], "incremental", reporter, lambda placed: None)

    before = remap(database)
    return before, without_lookalikes(database, before, ring.photos, remap, reporter)


@pytest.mark.parametrize(("count", "bays", "gimbal"), [(36, 12, False), (24, 4, True)])
def test_a_building_of_equal_sides_is_unfolded_and_told(tmp_path: Path, count: int, bays: int, gimbal: bool) -> None:
    """A round building of twelve equal bays without GPS or gimbal, and one of four equal sides with a gimbal."""
    ring = write_ring(tmp_path / "features.db", count, bays, gimbal=gimbal)
    reporter = Reporter()
    before, after = mapped(tmp_path / "features.db", ring, reporter)
    assert np.median(errors(before, ring)) > 5  # metres: folded
    assert [model.num_reg_images() for model in after] == [count]
    assert errors(after, ring).max() < 0.2
    assert len(reporter.warnings) == 1 and "wrong side of the building" in reporter.warnings[0]
    assert "photo_0" in reporter.warnings[0]


def test_a_drawn_ring_of_equal_bays_is_unfolded_and_told(tmp_path: Path) -> None:
    """Twelve equal bays, photographed two thirds of the way round, every ten degrees, without GPS or gimbal. All pairs
    of photos match falsely but those of neighbours."""
    ring = draw_ring(tmp_path / "photos", 36, 12, drawn=24)
    reporter = Reporter()
    reporter.stage("sparse")
    options = Options(photos=tmp_path / "photos", workspace=tmp_path, quality="preview")
    find_cameras.reconstruct(PhotoSet(photos=ring.photos), options, tmp_path, reporter)
    models = [pycolmap.Reconstruction(folder) for folder in sorted((tmp_path / "sparse" / "mapped").iterdir())]
    assert [model.num_reg_images() for model in models] == [24]
    assert errors(models, ring).max() < 0.5
    assert len(reporter.warnings) == 1 and "wrong side of the building" in reporter.warnings[0]


@pytest.mark.parametrize("gimbals", ["true", "frozen"])
def test_a_sound_model_is_left_alone(tmp_path: Path, gimbals: str) -> None:
    """Also where the metadata have one and the same gimbal angle for all photos."""
    ring = write_ring(tmp_path / "features.db", 24, 12, gimbal=True, alike=False)
    if gimbals == "frozen":
        ring = replace(ring, photos=tuple(replace(photo, gimbal=ring.photos[0].gimbal) for photo in ring.photos))
    reporter = Reporter()
    before, after = mapped(tmp_path / "features.db", ring, reporter)
    assert after is before and errors(after, ring).max() < 0.2
    assert not reporter.warnings


def test_photos_that_look_apart_are_not_matched_even_without_gps(tmp_path: Path) -> None:
    ring = write_ring(tmp_path / "features.db", 24, 4, gimbal=True, alike=False)
    pairs = metadata_pairs(ring.photos)
    assert {(i, i + 1) for i in range(23)} <= pairs
    assert not any(6 <= j - i <= 18 for i, j in pairs)  # a quarter round and more
