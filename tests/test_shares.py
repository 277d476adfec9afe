# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A workspace from a stranger cannot make the user's computer log in elsewhere: no path of it on a share is looked at.

On Linux a path with two slashes in front is the same file as with one, so that it can be seen whether it was opened.
"""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import box_scene
import pytest
from little_photos import sound_folder

from curecon_blender.core.base.errors import WorkspaceError
from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.base.options import Options
from curecon_blender.core.base.records import PhotoSet
from curecon_blender.core.base.shares import is_safe
from curecon_blender.core.photos.record import read_photos, write_photos
from curecon_blender.core.run import pipeline
from curecon_blender.core.run.workspace import StageRecord, Workspace
from curecon_blender.core.texture.photo_sources import find_sources
from curecon_blender.core.views import record

FOREIGN = (
    "\\\\host\\share\\1.jpg", "//host/share/1.jpg", "\\/host/share/1.jpg", "/\\host\\share\\1.jpg",
    "\\\\?\\UNC\\host\\share\\1.jpg", "//?/unc/host/share/1.jpg", "\\\\.\\UNC\\host\\share\\1.jpg",
    "\\??\\UNC\\host\\share\\1.jpg", "\\\\?\\GLOBALROOT\\Device\\Mup\\host\\share\\1.jpg",
    "\\\\host@SSL@443\\DavWWWRoot\\1.jpg", "\\\\.\\pipe\\x", "\\\\.\\C:\\..\\UNC\\host\\share\\1.jpg",
    "file://host/share/1.jpg", "FILE:////host/share/1.jpg", "https://host/1.jpg", "\\\\nas\\other\\1.jpg",
    "\\\\nas\\photos\\..\\..\\host\\share\\1.jpg", "\\\\nas", "//",
)


@pytest.mark.parametrize("place", FOREIGN)
def test_a_share_that_the_user_has_not_chosen_is_foreign(place: str) -> None:
    assert not is_safe(place, [])
    assert not is_safe(place, [Path("//nas/photos/site"), Path("C:/photos")])


@pytest.mark.parametrize("place", [
    "C:\\photos\\1.jpg", "C:/photos/1.jpg", "Z:\\site\\1.jpg", "/home/a/photos/1.jpg", "photos/1.jpg", "",
])
def test_a_path_on_a_drive_is_not(place: str) -> None:
    assert is_safe(place, [])


@pytest.mark.parametrize("place", [
    "\\\\nas\\photos\\site\\1.jpg", "//NAS/Photos/1.jpg", "\\\\?\\UNC\\nas\\photos\\1.jpg",
])
def test_nor_is_one_on_the_share_that_the_user_has_chosen(place: str) -> None:
    assert is_safe(place, [Path("//nas/photos/site")])


def test_texture_does_not_look_at_photos_on_a_foreign_share(tmp_path: Path) -> None:
    box_scene.write_scene(tmp_path, [box_scene.make_view(i, 8) for i in range(3)])
    views = tmp_path / "views.json"
    photo = shutil.copy(tmp_path / "undistorted" / "photo_00.png", tmp_path / "photo.png")

    def taken(original: str) -> str:
        """What texture takes of the first view when its photo is said to lie at `original`."""
        content = json.loads(views.read_text())
        content["components"][0]["views"][0]["original"] = original
        views.write_text(json.dumps(content))
        (component,) = record.read(tmp_path)
        source = find_sources(component, tmp_path, None, (), Reporter())[0]
        return str(source.original) if source.camera else source.picture.name

    assert taken(str(photo)) == str(photo)
    assert taken(f"/{photo}") == taken("\\\\host\\share\\1.jpg") == "photo_00.png"


def test_a_job_for_a_surface_says_that_such_photos_are_left_alone(tmp_path: Path) -> None:
    component = box_scene.write_scene(tmp_path, [box_scene.make_view(i, 8) for i in range(3)])
    write_photos(tmp_path, PhotoSet(photos=()))
    with Workspace(tmp_path) as workspace:
        workspace.mark_done("fusion", StageRecord(key="k", seconds=0, peak_gib=0))
    record.write(tmp_path, [replace(component, views=tuple(
        replace(view, original="//host/share/1.jpg") for view in component.views
    ))])
    reporter = Reporter()
    pipeline.reconstruct(Options(photos=None, workspace=tmp_path, until="mesh"), reporter)
    assert any("network drive, which are left alone" in warning for warning in reporter.warnings)


def test_a_job_looks_at_no_photo_but_those_in_the_users_folder(tmp_path: Path) -> None:
    """A stranger's record may name others, under a done-marker that fits."""
    folder = sound_folder(tmp_path)
    options = Options(photos=folder, workspace=tmp_path / "w", device="cpu", until="photos")
    pipeline.reconstruct(options, Reporter())
    photo_set = read_photos(tmp_path / "w")
    write_photos(tmp_path / "w", replace(photo_set, photos=(
        replace(photo_set.photos[0], path=Path("//host/share/1.jpg")), *photo_set.photos[1:]
    )))
    with pytest.raises(WorkspaceError, match=f"names photos that are not in {folder}"):
        pipeline.reconstruct(replace(options, until="sparse"), Reporter())
