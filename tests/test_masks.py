# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks: what is black in them comes into nothing that is made of the photos; what cannot be used is named."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from conftest import SMALL, Run, curecon
from little_photos import HEIGHT, WIDTH, check, exif, save, scene, sound_folder
from PIL import Image
from test_extension import blender, run_script  # noqa: F401

from curecon_blender.core.base.errors import PhotoError
from curecon_blender.core.base.records import Photo
from curecon_blender.core.cloud.ply import read_cloud
from curecon_blender.core.depth.maps import read_depth
from curecon_blender.core.photos import masks
from curecon_blender.core.photos.check import describe
from curecon_blender.core.photos.record import read_photos
from curecon_blender.core.surface.mesh import read_mesh
from curecon_blender.core.views import record
from curecon_blender.core.views.masks import left_out

LEFT = np.s_[:, : WIDTH // 2]  # what the masks here leave out


def half(size: tuple[int, int] = (WIDTH, HEIGHT)) -> Image.Image:
    """A mask that leaves out the left half."""
    picture = np.full((size[1], size[0]), 255, np.uint8)
    picture[:, : size[0] // 2] = 0
    return Image.fromarray(picture)


def _photo_set(workspace: Path) -> tuple[Photo, ...]:
    return read_photos(workspace).photos


@pytest.mark.parametrize("name", [
    "DJI_1.JPG.png", "dji_1.jpg.PNG", "DJI_1_mask.png", "DJI_1_mask.JPG", "masks/DJI_1.JPG.png", "masks/DJI_1.png",
    "mask/DJI_1_mask.png",
])
def test_masks_beside_the_photos_are_found_and_are_no_photos(tmp_path: Path, name: str) -> None:
    folder = sound_folder(tmp_path)
    (folder / name).parent.mkdir(exist_ok=True)
    half().save(folder / name)
    photo_set, warnings = check(folder)
    assert [photo.name for photo in photo_set.photos] == ["DJI_0.JPG", "DJI_1.JPG", "DJI_2.JPG"] and not warnings
    kept = [masks.kept(photo) for photo in photo_set.photos]
    assert kept[0] is None and kept[2] is None and kept[1] is not None
    assert (kept[1][LEFT] == 0).all() and kept[1][:, WIDTH // 2 :].all()
    assert photo_set.photos[1].masked == 0.5 and describe(photo_set)["masked"] == 1


def test_a_photos_own_alpha_is_a_mask_and_faint_glass_is_none(tmp_path: Path) -> None:
    folder = sound_folder(tmp_path)
    for number, alpha in ((3, half()), (4, Image.new("L", (WIDTH, HEIGHT), 100))):
        picture = Image.fromarray(scene(number))
        picture.putalpha(alpha)
        picture.save(folder / f"DJI_{number}.png")
    photos = check(folder)[0].photos
    assert [photo.masked for photo in photos] == [0, 0, 0, 0.5, 0]


def test_masks_add_up(tmp_path: Path) -> None:
    folder = sound_folder(tmp_path)
    half().save(folder / "DJI_1.JPG.png")
    half().transpose(Image.Transpose.ROTATE_90).resize((WIDTH, HEIGHT)).save(folder / "DJI_1_mask.png")
    assert check(folder)[0].photos[1].masked == 0.75


@pytest.mark.parametrize("turn", [6, 8])
def test_a_mask_of_a_turned_photo_may_be_drawn_as_it_lies_or_upright(tmp_path: Path, turn: int) -> None:
    folder = sound_folder(tmp_path)
    save(folder / "DJI_3.JPG", 3, exif=exif(main={0x0112: turn}))
    upright = half((HEIGHT, WIDTH))
    lying = upright.transpose(Image.Transpose.ROTATE_90 if turn == 6 else Image.Transpose.ROTATE_270)
    for mask in (upright, lying):
        mask.save(folder / "DJI_3.JPG.png")
        kept = masks.kept(check(folder)[0].photos[3])
        assert kept is not None and kept.shape == (WIDTH, HEIGHT)
        assert (kept[:, : HEIGHT // 2] == 0).all() and kept[:, HEIGHT // 2 :].all()


def test_a_mask_of_another_size_is_scaled_and_one_of_another_shape_refused(tmp_path: Path) -> None:
    folder = sound_folder(tmp_path)
    half((WIDTH // 4, HEIGHT // 4)).save(folder / "DJI_0.JPG.png")
    half((WIDTH, WIDTH)).save(folder / "DJI_1.JPG.png")
    photo_set, warnings = check(folder)
    assert [photo.masked for photo in photo_set.photos] == [0.5, 0, 0]
    assert warnings == [
        "The mask DJI_1.JPG.png has 320x320 pixels, its photo 320x240. It is not used: DJI_1.JPG is taken whole."]


def test_masks_that_say_nothing_leave_all_or_are_of_nobody_are_named(tmp_path: Path) -> None:
    folder = sound_folder(tmp_path)
    for number in (3, 4):
        save(folder / f"DJI_{number}.JPG", number, exif=exif())
    Image.new("L", (WIDTH, HEIGHT), 0).save(folder / "DJI_0.JPG.png")
    Image.new("L", (WIDTH, HEIGHT), 255).save(folder / "DJI_1.JPG.png")
    (folder / "DJI_2.JPG.png").write_bytes(b"\x89PNG\r\n")
    half().save(folder / "DJI_9.JPG.png")
    half().save(folder / "DJI_8_mask.png")
    photo_set, warnings = check(folder)
    assert [photo.name for photo in photo_set.photos] == ["DJI_1.JPG", "DJI_2.JPG", "DJI_3.JPG", "DJI_4.JPG"]
    assert not any(photo.mask for photo in photo_set.photos)
    said = "\n".join(warnings)
    assert "The photos of 2 masks are not there: DJI_8_mask.png, DJI_9.JPG.png. These masks say nothing." in said
    assert "DJI_0.JPG is left out as a whole by DJI_0.JPG.png" in said
    assert "It is not used: DJI_2.JPG is taken whole." in said and len(warnings) == 3


def test_masks_the_wrong_way_round_leave_no_job(tmp_path: Path) -> None:
    folder = sound_folder(tmp_path)
    for number in range(3):
        Image.new("L", (WIDTH, HEIGHT), 0).save(folder / f"DJI_{number}.JPG.png")
    with pytest.raises(PhotoError, match=r"no usable photo.*left out as a whole by DJI_0\.JPG\.png"):
        check(folder)


def test_photos_that_are_only_called_like_masks_are_photos(tmp_path: Path) -> None:
    folder = tmp_path / "photos"
    folder.mkdir()
    for number in range(3):
        save(folder / f"DJI_{number}.JPG.png", number)
        save(folder / f"site_{number}_mask.jpg", number + 3, exif=exif())
    assert len(check(folder)[0].photos) == 6


# ---- through all stages


@pytest.fixture(scope="module")
def masked(site_photos: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Run]:
    """A job up to the texture whose photos' left thirds are masked in one of the conventions each, and a drawn one."""
    folder, workspace = tmp_path_factory.mktemp("masked"), tmp_path_factory.mktemp("workspace")
    (workspace / "masks").mkdir()
    for number, photo in enumerate(sorted(site_photos.glob("*.JPG"))):
        shutil.copy(photo, folder)
        with Image.open(photo) as picture:
            mask = Image.new("L", picture.size, 255)
            mask.paste(0, (0, 0, picture.width // 3, picture.height))
        places = (folder / f"{photo.name}.png", folder / f"{photo.stem}_mask.png",
                  workspace / "masks" / f"{photo.name}.png")
        mask.save(places[number % 3])
    return workspace, curecon("reconstruct", folder, "--workspace", workspace, *SMALL, "--until", "texture")


def test_features_depth_and_cloud_hold_nothing_of_what_is_masked(masked: tuple[Path, Run]) -> None:
    workspace, run = masked
    assert run.code == 0, run.said
    model = pycolmap.Reconstruction(workspace / "sparse" / "0")
    for image in model.images.values():
        camera = model.cameras[image.camera_id]
        assert min(point.xy[0] for point in image.points2D) > camera.width / 3 - 1
    views = record.read(workspace)[0].views
    points = read_cloud(workspace / "cloud.ply").points
    for view in views:
        hidden = left_out(workspace, view)
        assert hidden is not None and 0.3 < hidden.mean() < 0.36 and hidden[:, : view.width // 4].all()
        depth, confidence = read_depth(workspace, view)
        assert not depth[hidden].any() and not confidence[hidden].any() and (depth[~hidden] > 0).mean() > 0.9
    seen = np.zeros(len(points), int)
    for view in views:
        camera = points @ view.cam_from_world[:, :3].T + view.cam_from_world[:, 3]
        pixel = (camera / camera[:, 2:]) @ view.K.T
        seen += ((pixel[:, 0] > view.width / 3 - 2) & (pixel[:, 0] < view.width) & (pixel[:, 1] > 0)
                 & (pixel[:, 1] < view.height))
    assert len(points) > 1000 and (seen >= 2).mean() > 0.99


def test_a_face_that_only_masked_parts_show_is_unseen(masked: tuple[Path, Run]) -> None:
    workspace, _ = masked
    mesh, views = read_mesh(workspace / "textured" / "mesh.ply"), record.read(workspace)[0].views
    centroid = mesh.vertices[mesh.faces].mean(axis=1)
    shown = np.zeros(len(centroid), bool)
    for view in views:
        camera = centroid @ view.cam_from_world[:, :3].T + view.cam_from_world[:, 3]
        pixel = (camera / camera[:, 2:]) @ view.K.T
        shown |= (pixel[:, 0] > view.width / 3) & (pixel[:, 0] < view.width) & (pixel[:, 1] > 0) & (
            pixel[:, 1] < view.height)
    assert mesh.unseen is not None and mesh.unseen[~shown].all() and not mesh.unseen[shown].all()


def test_what_a_mask_says_counts_for_what_is_made_anew(masked: tuple[Path, Run], tmp_path: Path) -> None:
    workspace, photos = tmp_path / "w", tmp_path / "photos"
    shutil.copytree(masked[0], workspace)
    photos.mkdir()
    for path in {photo.path for photo in _photo_set(workspace)}:
        for file in path.parent.glob(f"{path.stem}*"):
            shutil.copy(file, photos)
    again = curecon("reconstruct", photos, "--workspace", workspace, *SMALL, "--until", "photos")
    assert again.code == 0 and _photo_set(workspace)[0].mask
    changed = _photo_set(workspace)[2].name
    Image.open(workspace / "masks" / f"{changed}.png").transpose(Image.Transpose.FLIP_LEFT_RIGHT).save(
        workspace / "masks" / f"{changed}.png")
    before = _photo_set(workspace)[2].mask
    curecon("reconstruct", photos, "--workspace", workspace, *SMALL, "--until", "photos")
    assert _photo_set(workspace)[2].mask != before


def test_what_stands_in_a_solid_is_masked_in_the_photos_that_show_it(
    textured: tuple[Path, Run], tmp_path: Path
) -> None:
    workspace = tmp_path / "w"
    shutil.copytree(textured[0], workspace)
    points = read_cloud(workspace / "cloud.ply").points
    middle = np.median(points, axis=0)
    box = tmp_path / "box.obj"
    corners = middle + 3 * np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    faces = ((1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4))
    box.write_text("".join(f"v {x} {y} {z}\n" for x, y, z in corners)
                   + "".join(f"f {a} {b} {c} {d}\n" for a, b, c, d in faces))
    run = curecon("mask", workspace, "--solid", box)
    assert run.code == 0 and run.summary["mask"]["photos"] >= 3, run.said
    inside = points[(np.abs(points - middle) < 2.8).all(axis=1)]
    outside = points[(np.abs(points - middle) > 3.6).any(axis=1)]
    model = pycolmap.Reconstruction(workspace / "sparse" / "0")
    hits, misses = [], []
    for image in model.images.values():
        camera, file = model.cameras[image.camera_id], workspace / "masks" / f"{image.name}.png"
        if not file.is_file():
            continue
        left = np.asarray(Image.open(file))
        for cloud, found in ((inside, hits), (outside, misses)):
            seen = cloud @ image.cam_from_world().matrix()[:, :3].T + image.cam_from_world().matrix()[:, 3]
            scale = np.divide(left.shape[::-1], (camera.width, camera.height))
            pixel = camera.img_from_cam(seen[seen[:, 2] > 0]) * scale
            column, row = pixel.astype(int).T
            there = (column >= 0) & (row >= 0) & (column < left.shape[1]) & (row < left.shape[0])
            found.append((left[row[there], column[there]] == 0).mean() if there.any() else np.nan)
    assert np.nanmedian(hits) > 0.8 and np.nanmax(misses) < 0.2
    assert curecon("mask", workspace, "--clear").summary["mask"]["cleared"] == run.summary["mask"]["photos"]
    assert not list((workspace / "masks").glob("*.png"))
    box.write_text("".join(f"v {x} {y} {z + 500}\nf 1 2 3\n" for x, y, z in corners))
    assert "No photo shows" in curecon("mask", workspace, "--solid", box).said
    box.write_text("".join(f"v {x} {y} {z}\n" for x, y, z in corners))
    refused = curecon("mask", workspace, "--solid", box)
    assert refused.code == 5 and "encloses nothing" in refused.summary["error"]


def test_a_box_in_blender_becomes_masks(
    blender: Path, textured: tuple[Path, Run], tmp_path: Path  # noqa: F811
) -> None:
    shutil.copytree(textured[0], tmp_path / "w")
    run_script(blender, "check_masks.py", tmp_path / "w", Path(sys.executable), resources=tmp_path / "user")
