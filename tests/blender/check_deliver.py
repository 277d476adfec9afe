# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Export Deliverables: what hinders it, and what comes of it. Arguments: a folder, a Python with the worker's
libraries."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import workspace_scene

import curecon_blender
from curecon_blender import preferences

FOLDER, WORKER = map(Path, sys.argv[1:3])
preferences.Settings.__init__.__kwdefaults__["worker_python"] = WORKER
curecon_blender.register()
try:
    bpy.ops.wm.read_homefile(use_empty=True)
    assert not bpy.ops.curecon.export_deliverables.poll()
    workspace = FOLDER / "a \"quoted\" site"
    workspace_scene.imported(workspace)
    bpy.context.scene.curecon.credit = "-- O'Neill \"& Sons\" <a@b>"

    assert bpy.ops.curecon.export_deliverables(formats={"laz", "dsm", "contours"}) == {"FINISHED"}
    folder = workspace / "deliverables" / "local"
    assert sorted(file.name for file in folder.iterdir()) == ["cloud.laz", "deliverables.txt", "surface_model.tif"]
    told = (folder / "deliverables.txt").read_text(encoding="utf-8")
    assert "Credit: -- O'Neill \"& Sons\" <a@b>" in told and "latitude" not in told, told

    other = FOLDER / "elsewhere"
    other.mkdir()
    (other / "mine.txt").write_text("mine")
    try:
        bpy.ops.curecon.export_deliverables(directory=str(other), formats={"laz"}, frame="utm")
        raise AssertionError("a folder with others' files is not to be written into")
    except RuntimeError as error:
        assert "not empty" in str(error), error
finally:
    curecon_blender.unregister()
print("CHECKED")
