# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""An import that is stopped midway leaves the scene as it was; an undo, a lost scene or another file in its midst ends
well. Argument: an empty folder."""

from __future__ import annotations

import sys
import time
from collections.abc import Generator
from pathlib import Path

import bpy
import surface_scene
import workspace_scene

import curecon_blender
from curecon_blender.core.base.errors import CuReconError
from curecon_blender.operators.import_workspace import bring_in
from curecon_blender.scene.surface import surfaces_of
from curecon_blender.scene.workspace import clouds_of

FOLDER = Path(sys.argv[1]) / "site"
KINDS = ("collections", "objects", "pointclouds", "meshes", "cameras", "images")


def stock() -> dict[str, list[str]]:
    """The names of all that an import makes."""
    return {kind: sorted(item.name for item in getattr(bpy.data, kind)) for kind in KINDS}


def begin(until: str) -> Generator[str | None, None, str]:
    """An import that has come to its first step called `until`, and done one step more."""
    steps = bring_in(bpy.context, bpy.context.scene, FOLDER)
    while (doing := next(steps)) != until:
        if doing is None:
            time.sleep(0.01)
    next(steps)
    return steps


def finish(steps: Generator[str | None, None, str]) -> str:
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value


def check_stopping(before: dict[str, list[str]]) -> None:
    """Whatever it was doing, what was there before is all that is there after."""
    for doing in ("Making the cameras", "Making the point cloud", "Making the surface"):
        steps = begin(doing)
        assert stock() != before
        assert not any("curecon_unplaced" in item for item in bpy.context.scene.collection.children_recursive)
        steps.close()
        assert stock() == before, (doing, stock())


curecon_blender.register()
try:
    bpy.ops.wm.read_homefile(use_empty=True)
    workspace_scene.write(FOLDER)
    surface_scene.write(FOLDER, textured=True)
    bpy.ops.ed.undo_push(message="empty")
    check_stopping(stock())
    assert "4 cameras" in finish(begin("Making the surface"))
    imported = stock()
    assert len(clouds_of(bpy.context.scene)) == len(surfaces_of(bpy.context.scene)) == 1
    check_stopping(imported)  # the earlier import stays
    finish(begin("Making the point cloud"))
    assert stock() == imported  # and is replaced, names and all

    # An undo takes away what was built; the import begins to build anew, and one undo takes all of it back.
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.ed.undo_push(message="empty")
    bpy.context.scene.frame_end = 77
    bpy.ops.ed.undo_push(message="frames")
    empty = stock()
    for undo in (bpy.ops.ed.undo, bpy.ops.ed.redo):
        steps = begin("Making the surface")
        undo()
        assert stock() == empty, stock()
        steps.close()
    steps = begin("Making the point cloud")
    bpy.ops.ed.undo()
    finish(steps)
    assert stock() == imported, stock()
    bpy.ops.ed.undo_push(message="imported")
    bpy.ops.ed.undo()
    assert stock() == empty, stock()
    # What was pushed in the midst of one does not come back with an undo.
    steps = begin("Making the surface")
    bpy.ops.ed.undo_push(message="in the midst")
    finish(steps)
    bpy.ops.ed.undo_push(message="imported")
    bpy.ops.ed.undo()
    assert stock() == empty, stock()

    # Another file, or the scene deleted.
    steps = begin("Making the surface")
    bpy.ops.wm.read_homefile(use_empty=True)
    steps.close()
    assert stock() == empty, stock()
    steps = begin("Making the surface")
    bpy.data.scenes.new("Other")
    bpy.data.scenes.remove(bpy.context.scene)
    try:
        finish(steps)
    except CuReconError as error:
        print(error, error.remedy)
        assert "is gone" in error.message
    else:
        raise AssertionError("no error")
    assert stock() == empty, stock()
finally:
    curecon_blender.unregister()
print("CHECKED")
