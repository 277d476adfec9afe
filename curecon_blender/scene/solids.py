# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects that stand around what is to be left out of the photos, as a file for the worker."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from ..core.base.files import atomic_write, disk_errors
from .surface import is_ground, is_surface
from .workspace import clouds_of

FILE = "left_out.obj"


def chosen(context: bpy.types.Context) -> list[bpy.types.Object]:
    """The selected meshes that are none of CU-Recon's, or else the region box."""
    ours = {item.name for item in clouds_of(context.scene)}
    selected = [item for item in context.selected_objects if item.type == "MESH" and item.name not in ours
                and not is_surface(item) and not is_ground(item)]
    region = context.scene.curecon.region
    return selected or ([region] if region is not None else [])


def write(items: Iterable[bpy.types.Object], reference: bpy.types.Object | None, folder: Path) -> Path:
    """Write the objects as they look, modifiers and all, in the frame of `reference` or the world's; returns the
    file. Raises WorkspaceError."""
    graph = bpy.context.evaluated_depsgraph_get()
    back = Matrix() if reference is None else reference.matrix_world.inverted()
    lines, count = [], 0
    for item in items:
        evaluated = item.evaluated_get(graph)
        mesh = evaluated.to_mesh()
        mesh.transform(back @ item.matrix_world)
        mesh.calc_loop_triangles()
        places = np.empty(3 * len(mesh.vertices), np.float32)
        mesh.vertices.foreach_get("co", places)
        corners = np.empty(3 * len(mesh.loop_triangles), np.int32)
        mesh.loop_triangles.foreach_get("vertices", corners)
        lines += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in places.reshape(-1, 3)]
        lines += [f"f {a} {b} {c}" for a, b, c in corners.reshape(-1, 3) + (count + 1)]
        count += len(mesh.vertices)
        evaluated.to_mesh_clear()
    with disk_errors(folder):
        folder.mkdir(exist_ok=True)
    with atomic_write(folder / FILE) as file:
        file.write(("\n".join(lines) + "\n").encode())
    return folder / FILE
