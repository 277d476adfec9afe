# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The region of interest: an ordinary box object that the user moves and scales."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix, Vector

from . import viewport

NAME = "CU-Recon Region"
MARGIN = 0.1  # of the subject's size, on each side


def add(scene: bpy.types.Scene, around: bpy.types.Object) -> bpy.types.Object:
    """A box about the subject of a cloud or a surface, drawn as wires and never rendered."""
    bounds = viewport.subject_bounds(around)
    low, high = bounds if bounds is not None else (-np.ones(3), np.ones(3))
    middle, half = (low + high) / 2, np.maximum((high - low) * (0.5 + MARGIN), 1e-3)
    data = bpy.data.meshes.new(NAME)
    corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    data.from_pydata(corners, [], faces)
    box = bpy.data.objects.new(NAME, data)
    box.matrix_world = around.matrix_world @ Matrix.LocRotScale(Vector(middle.tolist()), None, Vector(half.tolist()))
    box.display_type, box.hide_render = "WIRE", True
    scene.collection.objects.link(box)
    return box


def bounds(box: bpy.types.Object, reference: bpy.types.Object | None) -> tuple[float, ...]:
    """x0, y0, z0, x1, y1, z1 of the box in the site frame: in that of `reference`, a cloud or a surface that the user
    may have moved, or in the world's."""
    to_site = reference.matrix_world.inverted() if reference is not None else Matrix.Identity(4)
    corners = np.array([to_site @ box.matrix_world @ Vector(corner) for corner in box.bound_box])
    return (*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist())
