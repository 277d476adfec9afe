# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Bad input, in background Blender: each ends as an error in words. Argument: an empty folder."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import bpy

import curecon_blender

FOLDER = Path(sys.argv[1])


def error_of(operator: Callable[[], object]) -> str:
    try:
        result = operator()
    except RuntimeError as error:  # what Blender makes of an operator's error report
        return str(error)
    raise AssertionError(f"no error, but {result}")


curecon_blender.register()
try:
    properties = bpy.context.scene.curecon
    assert "Choose the folder" in error_of(bpy.ops.curecon.reconstruct)
    assert "views.json" in error_of(lambda: bpy.ops.curecon.import_workspace(directory=str(FOLDER)))
    assert "no COLMAP model" in error_of(lambda: bpy.ops.curecon.import_model(directory=str(FOLDER)))
    assert "not a folder" in error_of(lambda: bpy.ops.curecon.choose_photos(directory=str(FOLDER / "none")))

    empty = FOLDER / "空 photos"
    empty.mkdir()
    assert bpy.ops.curecon.choose_photos(directory=str(empty)) == {"FINISHED"}
    said = error_of(bpy.ops.curecon.reconstruct)
    print(said)
    assert len(said.split()) > 6 and "Traceback" not in said
    from curecon_blender.operators import running

    failure = running.status.failure
    assert failure is not None and failure.message in said and failure.remedy in said
    assert not running.status.running
    assert not bpy.data.pointclouds
finally:
    curecon_blender.unregister()
print("CHECKED")
