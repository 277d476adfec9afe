# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Small pictures of photos for the panel. The worker writes them into Blender's temporary folder, which Blender removes
at its end; a new check removes those of the one before."""

from __future__ import annotations

import shutil
from pathlib import Path

import bpy
import bpy.utils.previews

_previews: bpy.utils.previews.ImagePreviewCollection | None = None


def folder() -> Path:
    """Where the worker writes them."""
    return Path(bpy.app.tempdir) / "curecon_thumbnails"


def icon(path: str) -> int:
    """Blender's icon number of a small picture; 0 where there is none, as in a file from an earlier session."""
    global _previews
    if not path or not Path(path).is_file():
        return 0
    if _previews is None:
        _previews = bpy.utils.previews.new()
    if path not in _previews:
        _previews.load(path, path, "IMAGE")
    return _previews[path].icon_id


def clear() -> None:
    """Forget all pictures and remove their files."""
    global _previews
    if _previews is not None:
        bpy.utils.previews.remove(_previews)
        _previews = None
    if folder().is_dir():
        shutil.rmtree(folder())
