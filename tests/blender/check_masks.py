# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A box in the scene becomes masks of the photos. Arguments: the workspace, a Python with the worker's libraries."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

import curecon_blender
from curecon_blender import preferences
from curecon_blender.core.cloud.ply import read_cloud
from curecon_blender.scene import frame

WORKSPACE, WORKER = map(Path, sys.argv[1:3])
preferences.Settings.__init__.__kwdefaults__["worker_python"] = WORKER
curecon_blender.register()
try:
    bpy.ops.wm.read_homefile(use_empty=True)
    assert not bpy.ops.curecon.mask_photos.poll()
    assert bpy.ops.curecon.import_workspace(directory=str(WORKSPACE)) == {"FINISHED"}
    # The site is moved in the scene: the box stands in the scene, the masks are of the site.
    moved = Matrix.Translation((100.0, 0.0, 0.0)) @ Matrix.Rotation(1.0, 4, "Z")
    for item in frame.parts_of(bpy.context.scene)[0].collection.all_objects:
        if item.parent is None:
            item.matrix_basis = moved @ item.matrix_basis
    bpy.context.view_layer.update()
    bpy.ops.object.select_all(action="DESELECT")
    assert not bpy.ops.curecon.mask_photos.poll() and not bpy.ops.curecon.clear_masks.poll()
    points = read_cloud(WORKSPACE / "cloud.ply").points
    middle = moved @ Matrix.Translation(np.median(points, axis=0).tolist())
    bpy.ops.mesh.primitive_cube_add(size=6)
    bpy.context.object.matrix_world = middle
    bpy.context.view_layer.update()
    assert bpy.ops.curecon.mask_photos() == {"FINISHED"}
    assert list((WORKSPACE / "masks").glob("*.png"))
    assert bpy.ops.curecon.clear_masks() == {"FINISHED"}
    assert not list((WORKSPACE / "masks").glob("*.png"))
    assert bpy.ops.curecon.mask_photos() == {"FINISHED"}
finally:
    curecon_blender.unregister()
print("CHECKED")
