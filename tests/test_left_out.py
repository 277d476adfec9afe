# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Photos too far apart for SIFT: placed by learned matches, unless GPS or gimbal contradict."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from curecon_blender.core.base.errors import WeightsError
from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.base.options import Options
from curecon_blender.core.base.records import Photo, PhotoSet
from curecon_blender.core.base.weights import FOLDER
from curecon_blender.core.photos.check import check_photos
from curecon_blender.core.sparse import find_cameras
from curecon_blender.core.sparse.learned import load_weights
from curecon_blender.core.sparse.lightglue import LightGlue
from evaluation.alignment import align

SITE = Path(__file__).parent.parent / "samples/tulou"
FAR = "DJI_0011.JPG"  # SIFT finds too little in it that the others show


@pytest.fixture(scope="module")
def photos() -> tuple[Photo, ...]:
    """Each fifth photo of part of the sample site's flight."""
    paths = [SITE / f"photos/DJI_00{number}.JPG" for number in (11, 16, 21, 26, 31)]
    return check_photos(SITE / "photos", Reporter(), paths).photos


def placed(photos: tuple[Photo, ...], workspace: Path, matches: str) -> tuple[dict[str, np.ndarray], list[str]]:
    """Where the largest model has the cameras, and the warnings."""
    reporter = Reporter()
    reporter.stage("sparse")
    options = Options(photos=SITE / "photos", workspace=workspace, quality="preview", matches=matches)
    find_cameras.reconstruct(PhotoSet(photos=photos), options, workspace, reporter)
    model = pycolmap.Reconstruction(workspace / "sparse/mapped/0")
    images = [model.image(i) for i in model.reg_image_ids()]
    return {image.name: image.projection_center() for image in images}, reporter.warnings


@pytest.fixture(scope="module")
def by_sift(photos: tuple[Photo, ...], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A workspace in which SIFT's matches are kept; it leaves the far photo out, and says so."""
    workspace = tmp_path_factory.mktemp("sift")
    cameras, warnings = placed(photos, workspace, "sift")
    assert cameras.keys() == {photo.name for photo in photos} - {FAR}
    assert any("could not be placed" in warning and FAR in warning for warning in warnings)
    return workspace


def test_a_photo_too_far_for_sift_is_placed(photos: tuple[Photo, ...], by_sift: Path, tmp_path: Path) -> None:
    shutil.copytree(by_sift, tmp_path, dirs_exist_ok=True)
    cameras, warnings = placed(photos, tmp_path, "auto")
    assert cameras.keys() == {photo.name for photo in photos} and not warnings
    truth = pycolmap.Reconstruction(SITE / "truth")
    places = {image.name: image.projection_center() for image in truth.images.values()}
    found, true = (np.array([where[name] for name in cameras]) for where in (cameras, places))
    assert np.linalg.norm(align(found, true).apply(found) - true, axis=1).max() < 0.3  # metres


def test_what_the_gimbal_contradicts_is_not_taken(photos: tuple[Photo, ...], by_sift: Path, tmp_path: Path) -> None:
    """A photo of another side that looks alike is as well matched; the gimbal alone tells."""
    shutil.copytree(by_sift, tmp_path, dirs_exist_ok=True)
    gimbal = photos[0].gimbal
    assert photos[0].name == FAR and gimbal is not None
    turned = replace(photos[0], gps=None, gimbal=replace(gimbal, yaw=gimbal.yaw - 40))
    cameras, warnings = placed((turned, *photos[1:]), tmp_path, "auto")
    assert cameras.keys() == {photo.name for photo in photos} - {FAR}
    assert any("could not be placed" in warning for warning in warnings)


def test_without_gps_and_gimbal_nothing_is_taken(photos: tuple[Photo, ...], by_sift: Path, tmp_path: Path) -> None:
    """A photo's matches alone do not tell whether it stands where a look-alike is."""
    shutil.copytree(by_sift, tmp_path, dirs_exist_ok=True)
    bare = tuple(replace(photo, gps=None, gimbal=None) for photo in photos)
    cameras, warnings = placed(bare, tmp_path, "auto")
    assert cameras.keys() == {photo.name for photo in photos} - {FAR}
    assert any("could not be placed" in warning for warning in warnings)


def test_damaged_weights_are_told(tmp_path: Path) -> None:
    for suffix in (".json", ".safetensors"):
        shutil.copy(FOLDER / f"lightglue{suffix}", tmp_path)
    path = tmp_path / "lightglue.safetensors"
    with open(path, "r+b") as file:
        file.seek(-1, 2)
        file.write(b"\x55")
    with pytest.raises(WeightsError, match="checksum"):
        load_weights(LightGlue(), path)
    path.unlink()
    with pytest.raises(WeightsError):
        load_weights(LightGlue(), path)
