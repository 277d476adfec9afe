# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which folders a scene's job works with, and whether what a button works on is there."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import bpy

from ..core.base.errors import PhotoError
from ..preferences import settings, user_folder
from ..scene import site


def photos_chosen(operator: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """For an operator's poll: whether a photo folder has been chosen; where none has, the button says so."""
    if not context.scene.curecon.photos:
        operator.poll_message_set("Choose the folder with the drone's photos first")
        return False
    return True


def cloud_finished(operator: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """For an operator's poll: whether the scene's workspace has a cloud; where it has none, the button says so."""
    result = context.scene.curecon.result
    if not (result.workspace and result.points):
        operator.poll_message_set("Reconstruct photos or import a workspace with a cloud first")
        return False
    return True


def site_stands(operator: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """For an operator's poll: whether a cloud or a surface is in the scene; where none is, the button says so."""
    if site.subject(context.scene) is None:
        operator.poll_message_set("There is no cloud and no surface in the scene")
        return False
    return True


def speeds_file() -> Path:
    """Where this computer's speed is kept between jobs."""
    return user_folder() / "speeds.json"


def photos_folder(scene: bpy.types.Scene) -> Path:
    """The chosen photo folder, absolute. Raises PhotoError when none has been chosen."""
    if not scene.curecon.photos:
        raise PhotoError("No photos have been chosen.", remedy="Choose the folder with the drone's photos first.")
    return absolute(scene.curecon.photos)


def workspace_folder(context: bpy.types.Context, scene: bpy.types.Scene) -> Path:
    """Where the scene's job is kept.

    In this order: the scene's own workspace; a folder in the preferences' cache folder; NAME_curecon beside the
    photos; and where that place cannot be written (a memory card, a server), a folder in CU-Recon in the user's home.
    Raises PhotoError when no photos have been chosen.
    """
    if scene.curecon.workspace:
        return absolute(scene.curecon.workspace)
    photos = photos_folder(scene)
    # Two folders of the same name must not share a workspace where workspaces of many places meet.
    distinct = f"{photos.name}_{hashlib.sha256(str(photos).encode()).hexdigest()[:8]}"
    if (cache := settings(context).cache) is not None:
        return cache / distinct
    beside = photos.with_name(f"{photos.name}_curecon")
    if os.access(beside if beside.exists() else photos.parent, os.W_OK):
        return beside
    return Path.home() / "CU-Recon" / distinct


def site_name(scene: bpy.types.Scene) -> str:
    """What the site is called: its workspace's name."""
    return absolute(site.workspace(scene)).name.removesuffix("_curecon")


def export_file(scene: bpy.types.Scene, ending: str) -> Path:
    """Where an export goes unless the user says otherwise: named after the site, beside the .blend or the workspace."""
    folder = Path(bpy.data.filepath).parent if bpy.data.filepath else absolute(site.workspace(scene)).parent
    return folder / f"{site_name(scene)}{ending}"


def absolute(blender_path: str) -> Path:
    """A path as Blender's fields hold it (perhaps relative to the .blend, with a slash at its end), made absolute."""
    return Path(os.path.normpath(bpy.path.abspath(blender_path)))
