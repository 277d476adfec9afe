# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Upload to Atlas. Arguments: a folder, a Python with the worker's libraries, an atlas's address, a token for it."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import workspace_scene

import curecon_blender
from curecon_blender import preferences

FOLDER, WORKER = map(Path, sys.argv[1:3])
ADDRESS, TOKEN = sys.argv[3:5]
defaults = preferences.Settings.__init__.__kwdefaults__
defaults["worker_python"] = WORKER
curecon_blender.register()
try:
    bpy.ops.wm.read_homefile(use_empty=True)
    system = bpy.context.preferences.system
    workspace_scene.imported(FOLDER / "gate")
    system.use_online_access = True
    assert not bpy.ops.curecon.upload.poll(), "nothing is published yet"
    assert bpy.ops.curecon.publish(directory=str(FOLDER / "pages"), title="From Blender", location="hidden") == {
        "FINISHED"
    }
    system.use_online_access = False
    assert not bpy.ops.curecon.upload.poll(), "Blender may not go online"
    system.use_online_access = True
    assert bpy.ops.curecon.upload.poll()
    for atlas, token, said in (
        ("", TOKEN, "no atlas"),
        (ADDRESS, "", "no token"),
        ("http://atlas.example", TOKEN, "no safe address"),
        (ADDRESS, "atlas_" + "x" * 40, "not valid"),
    ):
        defaults["atlas"], defaults["atlas_token"] = atlas, token
        try:
            bpy.ops.curecon.upload()
            raise AssertionError(said)
        except RuntimeError as error:
            assert said in str(error), error
    defaults["atlas"], defaults["atlas_token"] = ADDRESS, TOKEN
    assert bpy.ops.curecon.upload(tags="earth, 圆楼、round", register="CN-1113", dated=True, period_from=-20,
                                  period_to=220) == {"FINISHED"}
finally:
    curecon_blender.unregister()
print("CHECKED")
