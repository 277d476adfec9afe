# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Photos at full size, in an Image Editor."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..core.base.errors import PhotoError
from ..core.base.language import Text


def show(context: bpy.types.Context, path: Path) -> None:
    """Show a photo in an Image Editor that is open, else in a window of its own. Raises PhotoError when it is gone."""
    if not path.is_file():
        raise PhotoError(Text("{} is gone.", path), remedy="Check the photos again.", path=path)
    try:
        picture = bpy.data.images.load(str(path), check_existing=True)
    except RuntimeError as error:
        raise PhotoError(Text("Blender cannot read {}.", path), remedy="Check the photos again.", path=path) from error
    _image_editor(context).image = picture


def show_finished(context: bpy.types.Context, path: Path) -> None:
    """Show what was rendered where an earlier render is seen, else in an Image Editor or a window of its own."""
    seen = [area.spaces.active for window in context.window_manager.windows for area in window.screen.areas
            if area.type == "IMAGE_EDITOR" and area.spaces.active.image is not None
            and area.spaces.active.image.type == "RENDER_RESULT"]
    picture = bpy.data.images.load(str(path), check_existing=True)
    picture.reload()  # an earlier one may have been of the same name
    for editor in seen or [_image_editor(context)]:
        editor.image = picture


def _image_editor(context: bpy.types.Context) -> bpy.types.SpaceImageEditor:
    windows = context.window_manager.windows
    for window in windows:
        for area in window.screen.areas:
            if area.type == "IMAGE_EDITOR":
                return area.spaces.active
    bpy.ops.wm.window_new()
    area = windows[-1].screen.areas[0]  # a new window is one area
    area.type = "IMAGE_EDITOR"
    return area.spaces.active
