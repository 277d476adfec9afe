# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Gaps of a workspace found and drawn. Arguments: the workspace, a Python with the worker's libraries."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

import curecon_blender
from curecon_blender import preferences
from curecon_blender.core.plan.patches import read_patches
from curecon_blender.scene import frame, gaps

WORKSPACE, WORKER = map(Path, sys.argv[1:3])
preferences.Settings.__init__.__kwdefaults__["worker_python"] = WORKER
curecon_blender.register()
try:
    bpy.ops.wm.read_homefile(use_empty=True)
    assert not bpy.ops.curecon.find_gaps.poll()
    assert bpy.ops.curecon.import_workspace(directory=str(WORKSPACE)) == {"FINISHED"}
    # The site is moved in the scene: what is drawn goes with it.
    moved = Matrix.Translation((100.0, 0.0, 0.0))
    for item in frame.parts_of(bpy.context.scene)[0].collection.all_objects:
        if item.parent is None:
            item.matrix_basis = moved @ item.matrix_basis
    bpy.context.view_layer.update()
    for _ in range(2):  # the second takes the first one's place
        assert bpy.ops.curecon.find_gaps() == {"FINISHED"}
    (top,) = (item for item in bpy.context.scene.collection.children if gaps.GAPS_KEY in item)
    bpy.context.view_layer.update()
    kept = read_patches(WORKSPACE / "gaps" / "gaps.ply")
    squares = top.objects["Gaps"]
    assert len(squares.data.polygons) == len(kept.areas)
    corners = np.array([squares.matrix_world @ vertex.co for vertex in squares.data.vertices])
    off = np.linalg.norm(corners.reshape(-1, 4, 3).mean(axis=1) - kept.parts.places - [100, 0, 0], axis=1)
    assert (off < 0.11 * np.sqrt(kept.areas) + 0.001).all()  # before the surface by a tenth of their side
    colours = np.empty(16 * len(kept.areas), np.float32)
    squares.data.color_attributes[0].data.foreach_get("color_srgb", colours)
    enough = colours.reshape(-1, 4, 4)[:, 0, 1] > colours.reshape(-1, 4, 4)[:, 0, 0]
    assert (enough == (kept.short == 0)).all() and 0 < enough.sum() < len(enough)
    photos = [item for item in top.objects if item.type == "CAMERA"]
    assert photos and all(gaps.says(item).endswith(".") for item in photos) and gaps.says(squares) == ""
    # A photo shows what it is asked for: patches that lack photos lie within its picture and face it, and its middle
    # looks at the site.
    lacking = kept.short > 0
    for item in photos:
        forward, eye = np.array(item.matrix_world.to_3x3()) @ [0, 0, -1], np.array(item.matrix_world.translation)
        rays = kept.parts.places + [100, 0, 0] - eye
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        cosine = rays @ forward
        facing = (kept.parts.normals * rays).sum(axis=1) < 0
        assert (lacking & facing & (cosine > np.cos(item.data.angle_y / 2))).sum() > 1
        assert cosine.max() > 0.98 and eye[2] > kept.parts.places[:, 2].min()
finally:
    curecon_blender.unregister()
print("CHECKED")
