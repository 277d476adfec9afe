# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Textures of a box on a plane, from pictures that are exact but for what each test does to them."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from curecon_blender.core.base import files, images
from curecon_blender.core.base.errors import WorkspaceError
from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.base.records import Component
from curecon_blender.core.base.sampling import sample
from curecon_blender.core.surface.mesh import Mesh, read_mesh, write_mesh
from curecon_blender.core.surface.triangles import triangle_areas
from curecon_blender.core.texture.diffusion import diffuse
from curecon_blender.core.texture.rendering import render
from curecon_blender.core.texture.texture import TextureError, TextureOptions, colour_vertices, texture_mesh
from tests import box_scene

OPTIONS = TextureOptions(page_size=512)


def quad(corner: tuple[float, ...], u: tuple[float, ...], v: tuple[float, ...], steps: int) -> tuple[np.ndarray, ...]:
    """A grid of steps x steps squares from `corner` along u and v, its front on the side of u x v."""
    at = np.linspace(0, 1, steps + 1)
    vertices = np.array(corner) + (at[:, None, None] * np.array(u)) + (at[None, :, None] * np.array(v))
    i = np.arange(steps)[:, None] * (steps + 1) + np.arange(steps)
    a, b, c, d = i, i + steps + 1, i + steps + 2, i + 1
    faces = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
    return vertices.reshape(-1, 3), faces


def box_mesh(finer: int = 1) -> Mesh:
    """The scene's box and 6 x 6 m of its ground, in triangles of 10 to 20 cm, or so many times finer; the ground under
    the box too."""
    quads = [
        quad((-3, -3, 0), (6, 0, 0), (0, 6, 0), 40 * finer), quad((-1, -1, 1.5), (2, 0, 0), (0, 2, 0), 20 * finer),
        quad((-1, -1, 0), (2, 0, 0), (0, 0, 1.5), 20 * finer), quad((1, 1, 0), (-2, 0, 0), (0, 0, 1.5), 20 * finer),
        quad((1, -1, 0), (0, 2, 0), (0, 0, 1.5), 20 * finer), quad((-1, 1, 0), (0, -2, 0), (0, 0, 1.5), 20 * finer),
    ]
    offsets = np.cumsum([0, *(len(vertices) for vertices, _ in quads)])
    vertices = np.concatenate([vertices for vertices, _ in quads]).astype(np.float32)
    faces = np.concatenate([faces + offset for (_, faces), offset in zip(quads, offsets, strict=False)])
    return Mesh(
        vertices=vertices, faces=faces.astype(np.int32), colours=box_scene.texture(vertices),
        distance=np.zeros(len(vertices), np.float32), views=np.full(len(vertices), 3, np.uint8),
        filled=np.zeros(len(faces), bool),
    )


@pytest.fixture
def scene(tmp_path: Path) -> tuple[Path, Component]:
    """Eight pictures around the box. Only the undistorted pictures exist, as after the photos were moved away."""
    return tmp_path, box_scene.write_scene(tmp_path, [box_scene.make_view(i, 8) for i in range(8)])


def repaint(workspace: Path, component: Component, index: int, change) -> None:  # type: ignore[no-untyped-def]
    path = workspace / component.views[index].image
    cv2.imwrite(str(path), change(images.read_rgb(path))[..., ::-1])


def textured(scene: tuple[Path, Component], mesh: Mesh | None = None, **changes: Any) -> tuple[Mesh, list[np.ndarray]]:
    workspace, component = scene
    folder = workspace / "textured"
    mesh = texture_mesh(mesh or box_mesh(), component, workspace, replace(OPTIONS, **changes), folder, Reporter())
    return mesh, [images.read_rgb(folder / page) for page in mesh.pages]


def errors(mesh: Mesh, pages: list[np.ndarray], index: float) -> np.ndarray:
    """Differences (n,3), 0 to 255, of a render from the scene's truth, from a ring's place between its cameras."""
    view = box_scene.make_view(1, 8) if index == 1 else box_scene.make_view(int(2 * index), 16, elevation=50)
    truth = box_scene.cast(view)[1].astype(np.float32)
    picture, _, shown = render(mesh, pages, view)
    counted = (shown >= 0) & ~mesh.unseen[np.maximum(shown, 0)]
    difference: np.ndarray = gain(picture[counted], truth[counted]) * picture[counted] - truth[counted]
    return difference


def gain(picture: np.ndarray, truth: np.ndarray) -> float:
    """What brings two pictures to one exposure, if they differ by more than noise: photos have no true one."""
    factor = float(truth.mean() / picture.mean())
    return factor if abs(factor - 1) > 0.02 else 1.0


def test_a_render_of_the_texture_looks_like_the_scene(scene: tuple[Path, Component]) -> None:
    mesh, pages = textured(scene)
    for index in (1, 2.5):
        assert np.sqrt((errors(mesh, pages, index) ** 2).mean()) < 6  # 32 dB
    assert mesh.uv is not None and mesh.uv.min() >= 0 and mesh.uv.max() <= 1
    truth = box_scene.texture(mesh.vertices).astype(int)
    seen = np.unique(mesh.faces[~mesh.unseen])
    assert np.median(np.abs(mesh.colours[seen] - truth[seen])) < 10


def test_a_textured_mesh_survives_its_file(scene: tuple[Path, Component]) -> None:
    mesh, _ = textured(scene)
    write_mesh(scene[0] / "textured" / "mesh.ply", mesh)
    again = read_mesh(scene[0] / "textured" / "mesh.ply")
    assert again.pages == mesh.pages == ("texture_0.png",)
    assert again.uv is not None and mesh.uv is not None
    np.testing.assert_array_equal(again.uv, mesh.uv)


def test_ground_under_the_box_is_unseen_and_not_coloured_like_the_roof(scene: tuple[Path, Component]) -> None:
    workspace, component = scene
    for index in range(8):  # the box all red
        depth, _ = box_scene.cast(component.views[index])
        view = component.views[index]
        u, v = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
        rays = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(view.K).T @ view.cam_from_world[:, :3]
        on_box = (view.centre + rays * depth[..., None])[..., 2] > 0.01
        repaint(workspace, component, index, lambda rgb, box=on_box: np.where(
            box[..., None], [255, 0, 0], [90, 120, 90]).astype(np.uint8))
    mesh = box_mesh()
    grey = np.full_like(mesh.colours, (90, 120, 90))
    grey[mesh.vertices[:, 2] > 0] = (255, 0, 0)
    mesh, _ = textured(scene, replace(mesh, colours=grey))
    centre = mesh.vertices[mesh.faces].mean(axis=1)
    ground = centre[:, 2] == 0
    under = ground & (np.abs(centre[:, :2]) < 0.9).all(axis=1)
    around = ground & (np.abs(centre[:, :2]) > 1.2).any(axis=1) & (np.abs(centre[:, :2]) < 2).all(axis=1)
    assert mesh.unseen[under].all()
    assert mesh.unseen[around].mean() < 0.02
    assert (mesh.colours[mesh.faces[ground]][..., 0] < 130).all()


def test_faces_smaller_than_a_texel_show_their_own_colour(scene: tuple[Path, Component]) -> None:
    """Crumbs of a mesh, each a chart of its own: none may show what lies beside it on the page."""
    whole = box_mesh()
    kept = np.random.default_rng(1).random(len(whole.faces)) < 0.15
    mesh, pages = textured(scene, replace(whole, faces=whole.faces[kept], filled=whole.filled[kept]), image_size=80)
    assert mesh.uv is not None
    seen = np.flatnonzero(~mesh.unseen)
    assert (triangle_areas(mesh.uv[seen] * len(pages[0])) < 1).mean() > 0.1
    u, v = mesh.uv[seen].mean(axis=1).T * len(pages[0])
    shown = sample(pages[0], u, len(pages[0]) - v).astype(int)
    truth = box_scene.texture(mesh.vertices[mesh.faces[seen]].mean(axis=1)).astype(int)
    assert np.percentile(np.abs(shown - truth).max(axis=1), 95) < 45  # 104 when they do


def test_exposure_differences_are_levelled(scene: tuple[Path, Component]) -> None:
    workspace, component = scene
    for index in range(8):
        exposure = 0.75 if index % 2 else 1.0
        repaint(workspace, component, index, lambda rgb, by=exposure: np.rint(rgb * by).astype(np.uint8))
    spread = {}
    for level in (True, False):
        mesh, pages = textured(scene, level=level)
        spread[level] = errors(mesh, pages, 2.5).std()
    assert spread[True] < 0.6 * spread[False], spread


def test_a_moving_thing_in_one_photo_does_not_show(scene: tuple[Path, Component]) -> None:
    workspace, component = scene

    def passer_by(rgb: np.ndarray) -> np.ndarray:
        rgb[70:95, 60:75] = (255, 0, 255)
        return rgb

    repaint(workspace, component, 1, passer_by)
    mesh, pages = textured(scene)
    assert (np.abs(errors(mesh, pages, 1)).max(axis=1) > 90).mean() < 0.002


def test_vertex_colours_are_the_light_alternative(scene: tuple[Path, Component]) -> None:
    workspace, component = scene
    mesh = replace(box_mesh(), colours=np.full((len(box_mesh().vertices), 3), 128, np.uint8))
    coloured = colour_vertices(mesh, component, workspace, Reporter())
    seen = np.unique(coloured.faces[~coloured.unseen])
    truth = box_scene.texture(mesh.vertices).astype(int)
    assert coloured.uv is None
    assert np.median(np.abs(coloured.colours[seen] - truth[seen])) < 8


def test_a_photo_larger_than_its_picture_gives_more_texels(scene: tuple[Path, Component]) -> None:
    """The original is used where it is there; after it was deleted, the smaller picture, with a warning."""
    workspace, component = scene
    views = []
    for view in component.views:
        K = view.K * np.array([[0.5], [0.5], [1]])
        small = cv2.resize(images.read_rgb(workspace / view.image), (80, 60), interpolation=cv2.INTER_AREA)
        original = workspace / view.name
        shutil.move(workspace / view.image, original)
        cv2.imwrite(str(workspace / view.image), small[..., ::-1])
        views.append(replace(view, width=80, height=60, K=K, original=str(original)))
    component = replace(component, views=tuple(views))
    mesh, pages = textured((workspace, component))
    sharp = np.sqrt((errors(mesh, pages, 1) ** 2).mean())
    for view in views:
        Path(view.original).unlink()
    reporter = Reporter()
    texture_mesh(box_mesh(), component, workspace, OPTIONS, workspace / "textured", reporter)
    assert len(reporter.warnings) == 8 and "photo_00.png is gone" in reporter.warnings[0]
    blurred = texture_mesh(box_mesh(), component, workspace, OPTIONS, workspace / "textured", Reporter())
    pages = [images.read_rgb(workspace / "textured" / page) for page in blurred.pages]
    assert sharp < 0.8 * np.sqrt((errors(blurred, pages, 1) ** 2).mean())


def test_a_missing_picture_is_left_out_and_none_at_all_is_an_error(scene: tuple[Path, Component]) -> None:
    workspace, component = scene
    textured(scene)
    before = (workspace / "textured" / "texture_0.png").read_bytes()
    (workspace / component.views[0].image).unlink()
    reporter = Reporter()
    texture_mesh(box_mesh(), component, workspace, OPTIONS, workspace / "other", reporter)
    assert [w for w in reporter.warnings if "photo_00.png is missing" in w]
    for view in component.views[1:]:
        (workspace / view.image).unlink()
    with pytest.raises(TextureError, match="No photo is left") as error:
        textured(scene)
    assert error.value.exit_code == 10 and "Put the photos back" in error.value.remedy
    assert (workspace / "textured" / "texture_0.png").read_bytes() == before


@pytest.mark.parametrize(("options", "said"), [
    ({"page_size": 128}, "128 pixels"), ({"page_size": 16384}, "16384 pixels"), ({"max_pages": 0}, "one page"),
    ({"image_size": 0}, "at 0 pixels"), ({"memory_gib": 0.0001}, "memory"),
])
def test_wrong_options_are_told(scene: tuple[Path, Component], options: dict[str, Any], said: str) -> None:
    with pytest.raises(TextureError, match=said) as error:
        textured(scene, **options)
    assert error.value.remedy


def test_meshes_that_cannot_be_textured_are_told(scene: tuple[Path, Component]) -> None:
    mesh = box_mesh()
    with pytest.raises(TextureError, match="no faces"):
        textured(scene, replace(mesh, faces=mesh.faces[:0], filled=mesh.filled[:0], unseen=None))
    with pytest.raises(TextureError, match="not at any place"):
        textured(scene, replace(mesh, vertices=np.full_like(mesh.vertices, np.nan)))
    with pytest.raises(TextureError, match="No photo shows any face"):
        textured(scene, replace(mesh, vertices=mesh.vertices + np.float32(1000)))


def test_a_full_disk_leaves_the_earlier_texture(scene: tuple[Path, Component], monkeypatch: pytest.MonkeyPatch) -> None:
    workspace, _ = scene
    textured(scene)
    before = {path.name: path.read_bytes() for path in (workspace / "textured").iterdir()}

    def full(_: int) -> None:
        raise OSError(files.errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(files.os, "fsync", full)
    with pytest.raises(WorkspaceError, match="disk is full"):
        textured(scene, level=False)
    assert {path.name: path.read_bytes() for path in (workspace / "textured").iterdir()} == before


def test_jpeg_pages_take_the_place_of_png_pages(scene: tuple[Path, Component]) -> None:
    textured(scene)
    mesh, _ = textured(scene, jpeg=True)
    assert [path.name for path in (scene[0] / "textured").glob("texture*")] == ["texture_0.jpg"] == list(mesh.pages)


def test_a_thing_that_only_a_depth_map_knows_gives_no_texture(scene: tuple[Path, Component]) -> None:
    """A branch before a wall, in half of the photos: no majority speaks against it, but the depth maps do."""
    workspace, component = scene
    for index in range(0, 8, 2):
        depth, picture = box_scene.cast(component.views[index])
        depth[40:90, 70:90], picture[40:90, 70:90] = 1.5, (255, 0, 255)
        cv2.imwrite(str(workspace / component.views[index].image), picture[..., ::-1])
        box_scene.write_depth(workspace, component.views[index], depth, np.full(depth.shape, 0.9, np.float32))
    mesh, pages = textured(scene)
    assert (np.abs(errors(mesh, pages, 1)).max(axis=1) > 90).mean() < 0.005


def test_filled_ground_takes_no_colour_of_what_photos_show_before_it(scene: tuple[Path, Component]) -> None:
    """Nobody measured the box: the mesh has the ground alone, which was closed where the box stands."""
    workspace, component = scene
    for view in component.views:
        depth, _ = box_scene.cast(view)
        box_scene.write_depth(workspace, view, depth, np.full(depth.shape, 0.2, np.float32))
    vertices, faces = quad((-3, -3, 0), (6, 0, 0), (0, 6, 0), 40)
    under = (np.abs(vertices[faces].mean(axis=1)[:, :2]) < 0.8).all(axis=1)
    mesh, _ = textured(scene, replace(
        box_mesh(), vertices=vertices.astype(np.float32), faces=faces.astype(np.int32), filled=under,
        colours=box_scene.texture(vertices), distance=np.zeros(len(vertices), np.float32),
        views=np.full(len(vertices), 3, np.uint8)))
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    assert mesh.unseen[(np.abs(centres[:, :2]) < 0.7).all(axis=1)].all()
    assert not mesh.unseen[(np.abs(centres[:, :2]) > 2).any(axis=1)].any()


def test_an_unseen_wall_hardly_takes_the_colour_of_the_roof_that_it_is_joined_to() -> None:
    roof, roof_faces = quad((0, 0, 2), (2, 0, 0), (0, 2, 0), 20)
    wall, wall_faces = quad((0, 0, 2), (0, 0, -2), (2, 0, 0), 20)
    joint = np.flatnonzero(np.isclose(wall[:, 2], 2))
    number = np.arange(len(wall)) + len(roof)
    number[joint] = np.linalg.norm(roof[:, None] - wall[joint], axis=2).argmin(axis=0)
    vertices, faces = np.concatenate([roof, wall]), np.concatenate([roof_faces, number[wall_faces]])
    known = np.arange(len(vertices)) < len(roof)
    guess = np.full((len(vertices), 3), 40.0)
    found = diffuse(vertices, faces, np.full_like(guess, 200.0), known, guess)
    assert (found[known] == 200).all()
    below = np.unique(number[wall_faces])
    below = below[vertices[below, 2] < 1.7]
    assert found[below].max() < 70
