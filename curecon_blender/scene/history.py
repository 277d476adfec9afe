# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Undo and redo reach into the workspace: what the scene keeps there follows them."""

from __future__ import annotations

import bpy
from bpy.app.handlers import persistent

from . import cloud_edits, frame
from .workspace import clouds_of

_EVENTS = ("undo_post", "redo_post")


def start() -> None:
    for event in _EVENTS:
        getattr(bpy.app.handlers, event).append(_follow)


def stop() -> None:
    for event in _EVENTS:
        getattr(bpy.app.handlers, event).remove(_follow)


@persistent
def _follow(*_: object) -> None:
    for scene in bpy.data.scenes:
        frame.keep_up(scene)
        cloud_edits.keep_up(clouds_of(scene))
