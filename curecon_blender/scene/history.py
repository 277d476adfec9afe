# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Undo and redo: what the scene keeps in the workspace follows them, and nothing half-built comes back with them."""

from __future__ import annotations

import bpy
from bpy.app.handlers import persistent

from . import cloud_edits, control, frame
from .workspace import clouds_of, sweep

_EVENTS = ("undo_post", "redo_post")
turns = 0  # how often this session was undone or redone: what Python held of the scene before one is void


def start() -> None:
    for event in _EVENTS:
        getattr(bpy.app.handlers, event).append(_follow)


def stop() -> None:
    for event in _EVENTS:
        getattr(bpy.app.handlers, event).remove(_follow)


@persistent
def _follow(*_: object) -> None:
    global turns
    turns += 1
    sweep()
    for scene in bpy.data.scenes:
        frame.keep_up(scene)
        control.keep_up(scene)
        cloud_edits.keep_up(clouds_of(scene))
