# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The region of interest: an ordinary box object that the user moves and scales."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix, Quaternion, Vector

from .points import bounds, subject

NAME = "CU-Recon Region"
MARGIN = 0.1  # of the subject's size, on each side


def add(scene: bpy.types.Scene, around: bpy.types.Object) -> bpy.types.Object:
    """A box about the subject of a cloud or a surface, drawn as wires and never rendered."""
    low, high = bounds(subject(around)) or (-np.ones(3), np.ones(3))
    middle, half = (low + high) / 2, np.maximum((high - low) * (0.5 + MARGIN), 1e-3)
    data = bpy.data.meshes.new(NAME)
    corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    data.from_pydata(corners, [], faces)
    box = bpy.data.objects.new(NAME, data)
    box.matrix_world = Matrix.LocRotScale(Vector(middle.tolist()), None, Vector(half.tolist()))
    box.display_type, box.hide_render = "WIRE", True
    scene.collection.objects.link(box)
    return box


def from_world(box: bpy.types.Object) -> Matrix:
    """The matrix that takes the box's bounds, along its own axes, to the cube from -1 to 1."""
    return _box_matrix(box).inverted_safe()


def placed(box: bpy.types.Object, reference: bpy.types.Object | None) -> tuple[tuple[float, ...], Quaternion]:
    """The box in the frame that the worker knows: x0, y0, z0, x1, y1, z1 along axes to which the quaternion turns the
    frame. That frame is the one of `reference`, a cloud or a surface that the user or the frame tools may have moved,
    or the world's."""
    matrix = _box_matrix(box)
    if reference is not None:
        matrix = reference.matrix_world.inverted() @ matrix
    centre, turn, half = matrix.decompose()
    back = turn.inverted()
    middle = back @ centre
    size = [abs(value) for value in half]
    return (*(middle[axis] - size[axis] for axis in range(3)), *(middle[axis] + size[axis] for axis in range(3))), back


def _box_matrix(box: bpy.types.Object) -> Matrix:
    corners = np.array([list(corner) for corner in box.bound_box])
    low, high = corners.min(axis=0), corners.max(axis=0)
    return box.matrix_world @ Matrix.LocRotScale(
        Vector(((low + high) / 2).tolist()), None, Vector(np.maximum((high - low) / 2, 1e-9).tolist())
    )
