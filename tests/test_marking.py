# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Marks in photos, against COLMAP's own cameras and the sample site's exact truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap
import pytest
from conftest import ROOT
from PIL import Image, ImageOps

from curecon_blender.core.adjust.marking import best_first, seen, stored, stored_size, to_pixels, to_rays, triangulate
from curecon_blender.core.base.records import Lens
from curecon_blender.core.sparse.models import lens_of

MINI = Lens(f=2900.0, aspect=1.001, cx=2010.0, cy=1490.0, k1=0.12, k2=-0.35, p1=0.0006, p2=-0.0009, k3=0.21)


def test_a_lens_agrees_with_colmap_and_inverts() -> None:
    camera = pycolmap.Camera(
        model="FULL_OPENCV", width=4000, height=3000,
        params=[MINI.f, MINI.f * MINI.aspect, MINI.cx, MINI.cy, MINI.k1, MINI.k2, MINI.p1, MINI.p2, MINI.k3, 0, 0, 0],
    )
    assert lens_of(camera) == MINI
    rng = np.random.default_rng(0)
    pixels = rng.uniform([0, 0], [4000, 3000], (200, 2))
    rays = to_rays(MINI, pixels)
    np.testing.assert_allclose(to_pixels(MINI, rays), pixels, atol=1e-6)
    theirs = camera.img_from_cam(np.column_stack([rays, np.ones(len(rays))]))
    np.testing.assert_allclose(theirs, pixels, atol=1e-6)


@pytest.mark.parametrize(("model", "params"), [
    ("SIMPLE_PINHOLE", [2900.0, 2000.0, 1500.0]), ("PINHOLE", [2900.0, 2910.0, 2000.0, 1500.0]),
    ("SIMPLE_RADIAL", [2900.0, 2000.0, 1500.0, 0.03]), ("RADIAL", [2900.0, 2000.0, 1500.0, 0.03, -0.02]),
    ("OPENCV", [2900.0, 2910.0, 2000.0, 1500.0, 0.03, -0.02, 0.001, -0.001]),
])
def test_every_common_camera_of_colmap_is_a_lens(model: str, params: list[float]) -> None:
    camera = pycolmap.Camera(model=model, width=4000, height=3000, params=params)
    lens, rays = lens_of(camera), np.array([[0.1, -0.2], [-0.4, 0.3]])
    assert lens is not None
    np.testing.assert_allclose(to_pixels(lens, rays), camera.img_from_cam(np.column_stack([rays, np.ones(2)])))


def test_other_cameras_are_none() -> None:
    assert lens_of(pycolmap.Camera(model="OPENCV_FISHEYE", width=9, height=9, params=[9, 9, 4, 4, 0, 0, 0, 0])) is None


def _sample() -> tuple[list[str], np.ndarray]:
    model = pycolmap.Reconstruction(str(ROOT / "samples" / "tulou" / "truth"))
    images = sorted(model.images.values(), key=lambda image: str(image.name))
    return [image.name for image in images], np.array([image.cam_from_world().matrix() for image in images])


def test_marks_give_a_place_and_the_place_its_other_photos() -> None:
    names, cameras = _sample()
    lens = Lens(f=900, aspect=1, cx=600, cy=450, k1=0, k2=0, p1=0, p2=0, k3=0)
    place = np.array([4.0, -3.0, 0.0])  # in the courtyard
    cloud = np.load(ROOT / "samples" / "tulou" / "truth" / "cloud.npz")
    site = cloud["points"].T[::20] * cloud["unit"]
    order = best_first(cameras, [lens] * len(cameras), np.full((len(cameras), 2), [1200, 900]), place, site)
    # From the low orbit the ring hides the ground of the courtyard; from above and into it all is free.
    assert {names[number] for number in order[:8]} <= {f"DJI_{n:04}.JPG" for n in range(14, 34)}
    assert len(order) == len(names)
    rays, depths = seen(cameras, place)
    assert (depths[order] > 0).all()
    two = order[:2]
    rng = np.random.default_rng(1)
    marked = rays[two] + rng.normal(scale=0.3 / 900, size=(2, 2))
    found = triangulate(cameras[two], marked, np.full(2, 0.3 / 900))
    assert found is not None
    assert np.linalg.norm(found - place) < 0.05  # a pixel is 3 to 7 cm
    many = triangulate(cameras[order], rays[order], np.ones(len(order)))
    np.testing.assert_allclose(many, place, atol=1e-9)


def test_marks_from_one_direction_tell_no_place() -> None:
    _, cameras = _sample()
    rays, _ = seen(cameras, np.array([4.0, -3.0, 0.0]))
    assert triangulate(cameras[[0, 0]], rays[[0, 0]], np.ones(2)) is None
    assert triangulate(cameras[:1], rays[:1], np.ones(1)) is None


@pytest.mark.parametrize("turn", range(1, 9))
def test_a_displayed_pixel_is_found_in_a_file_that_is_turned(tmp_path: Path, turn: int) -> None:
    marked = np.zeros((5, 7), np.uint8)
    marked[1, 4] = 255
    exif = Image.Exif()
    exif[274] = turn
    Image.fromarray(marked).save(tmp_path / "turned.png", exif=exif)
    shown = np.asarray(ImageOps.exif_transpose(Image.open(tmp_path / "turned.png")))
    (row,), (column,) = np.nonzero(shown)
    size = (shown.shape[1], shown.shape[0])
    np.testing.assert_allclose(stored(np.array([[column + 0.5, row + 0.5]]), size, turn), [[4.5, 1.5]])
    np.testing.assert_allclose(stored_size(size, turn), (7, 5))
