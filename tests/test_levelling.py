# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Levelling of photos whose falloff is known: pictures of the box that a lens darkens towards the corners."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from curecon_blender.core.base import images
from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.base.records import Component, View
from curecon_blender.core.report.likeness import compare
from curecon_blender.core.texture.falloff import FILE_NAME, factor, off_axis_picture, read_cameras
from curecon_blender.core.texture.texture import colour_vertices
from evaluation.texture import evaluate
from tests import box_scene
from tests.test_texturing import OPTIONS, box_mesh, errors, textured

Lens = Callable[[np.ndarray], np.ndarray]


def usual(square: np.ndarray) -> np.ndarray:
    """What a lens leaves of the light at squared radii, 1 at the corner: a quarter less there."""
    return 1 - 0.16 * square - 0.09 * square**2


def scene(workspace: Path, lens: Lens, photos: int = 8, exposure: float = 1.0) -> Component:
    """Pictures around the box from two heights, taken through a lens and exposed anew."""
    rings = [[box_scene.make_view(i, photos, elevation=rise, radius=far) for i in range(photos)]
             for rise, far in ((35.0, 5.0), (65.0, 4.0))]
    views = [view if i % 2 else replace(other, name=view.name, image=view.image)
             for i, (view, other) in enumerate(zip(*rings, strict=True))]
    component = box_scene.write_scene(workspace, views)
    for view in views:
        path = workspace / view.image
        taken = images.read_rgb(path) * exposure * lens(squares(view))[..., None]
        cv2.imwrite(str(path), np.clip(np.rint(taken), 0, 255).astype(np.uint8)[..., ::-1])
    return component


def squares(view: View) -> np.ndarray:
    """Squared radii of the pixels, 1 at the corner."""
    x, y = np.arange(view.width) + 0.5 - view.width / 2, np.arange(view.height) + 0.5 - view.height / 2
    result: np.ndarray = 4 * (x**2 + y[:, None] ** 2) / (view.width**2 + view.height**2)
    return result


def found(workspace: Path, component: Component) -> np.ndarray:
    """What is found that the first photo's lens leaves of the light at each pixel."""
    textured((workspace, component))
    (camera,) = read_cameras(workspace / "textured")
    assert camera.took(component.views[0])
    result: np.ndarray = 1 / factor(camera.lens, off_axis_picture(component.views[0]))
    return result


def test_a_known_falloff_is_found(tmp_path: Path) -> None:
    component = scene(tmp_path, usual)
    left = found(tmp_path, component)
    np.testing.assert_allclose(left, usual(squares(component.views[0])), atol=0.025)


@pytest.mark.parametrize("lens", [np.ones_like, lambda square: 0.8 + 0.2 * square])
def test_photos_that_do_not_darken_have_no_falloff(tmp_path: Path, lens: Lens) -> None:
    """Even ones, and ones that are brighter towards the corners: no lens does that."""
    assert found(tmp_path, scene(tmp_path, lens)).min() > 0.98


def test_two_photos_do_not_tell_a_falloff(tmp_path: Path) -> None:
    assert found(tmp_path, scene(tmp_path, usual, photos=2)).min() > 0.9


def test_a_falloff_never_rises_nor_takes_more_than_a_lens_can(tmp_path: Path) -> None:
    left = found(tmp_path, scene(tmp_path, lambda square: np.where(square > 0.3, 0.15, 1.0)))
    by_radius = left.ravel()[np.argsort(squares(box_scene.make_view(0, 8)), axis=None)]
    assert (np.diff(by_radius) <= 1e-4).all() and left.min() >= 0.4 - 1e-4


def test_overexposed_colours_do_not_hide_the_falloff(tmp_path: Path) -> None:
    component = scene(tmp_path, usual, exposure=1.8)
    np.testing.assert_allclose(found(tmp_path, component), usual(squares(component.views[0])), atol=0.04)


def test_a_texture_of_darkened_photos_is_even(tmp_path: Path) -> None:
    component = scene(tmp_path, usual)
    spread = {}
    for level in (True, False):
        spread[level] = errors(*textured((tmp_path, component), level=level), 2.5).std()
    even = errors(*textured((tmp_path / "even", scene(tmp_path / "even", np.ones_like))), 2.5).std()
    assert spread[True] ** 2 - even**2 < 0.25 * (spread[False] ** 2 - even**2), (spread, even)


def test_what_photos_are_held_against_is_seen_through_their_lens(tmp_path: Path) -> None:
    """Photos that took part, as the report compares them, and one that was held out of the texture."""
    component = scene(tmp_path, usual)
    mesh, _ = textured((tmp_path, component))
    through = compare(mesh, component, tmp_path, Reporter()).psnr
    held_out = evaluate(box_mesh(), component, tmp_path, replace(OPTIONS, exclude=("photo_03.png",)))
    (tmp_path / "textured" / FILE_NAME).unlink()
    plain = compare(mesh, component, tmp_path, Reporter()).psnr
    assert np.mean(through) > np.mean(plain) + 1.5
    assert held_out.psnr_matched > held_out.psnr + 1.5


def test_colours_of_vertices_are_even(tmp_path: Path) -> None:
    off = {}
    for name, lens in (("even", np.ones_like), ("darkened", usual)):
        component = scene(tmp_path / name, lens)
        mesh = replace(box_mesh(), colours=np.full((len(box_mesh().vertices), 3), 128, np.uint8))
        coloured = colour_vertices(mesh, component, tmp_path / name, Reporter())
        seen = np.unique(coloured.faces[~coloured.unseen])
        ratio = coloured.colours[seen].sum(axis=1) / box_scene.texture(mesh.vertices[seen]).sum(axis=1, dtype=float)
        off[name] = np.subtract(*np.percentile(ratio, (90, 10)))
    assert off["darkened"] < off["even"] + 0.01, off
