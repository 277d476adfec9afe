# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A plain ground under the site, for pictures: no part of the record, of which sheets and exports know nothing."""

from __future__ import annotations

import bpy
import numpy as np

from ..core.present import terrain
from . import backdrop, presentation, surface
from .points import COLOUR, positions
from .site import Box

ROLE, NAME = "ground", "CU-Recon Ground"


def add(scene: bpy.types.Scene, about: Box, item: bpy.types.Object) -> None:
    """Lay the ground of the surface `item` under it, in place of what an earlier call made."""
    remove(scene)
    matrix = np.array(item.matrix_world)
    places = positions(item.data) @ matrix[:3, :3].T + matrix[:3, 3]
    normals = np.empty((len(places), 3), np.float32)
    item.data.vertex_normals.foreach_get("vector", normals.ravel())
    normals = normals @ (matrix[:3, :3] / item.matrix_world.median_scale).T
    colours = np.empty((len(places), 4), np.float32)
    item.data.attributes[COLOUR].data.foreach_get("color", colours.ravel())
    made = terrain.spread(places, normals, colours[:, :3], about.centre, about.radius, about.height,
                          backdrop.ground_of(scene))
    data = bpy.data.meshes.new(NAME)
    data.from_pydata(made.points.reshape(-1, 3).tolist(), [], made.faces.tolist())
    data.attributes.new(COLOUR, "FLOAT_COLOR", "POINT").data.foreach_set(
        "color", made.colours.astype(np.float32).ravel())
    data.materials.append(surface.ground_material(NAME))
    data.shade_smooth()
    data[surface.GROUND_KEY] = True
    presentation.put(scene, ROLE, data)
    surface.light(scene, by_scene=scene.curecon.surface_light == "SCENE")


def remove(scene: bpy.types.Scene) -> None:
    """Take the ground away, if there is one."""
    if (item := presentation.find(scene, ROLE)) is not None:
        data, materials = item.data, [*item.data.materials]
        bpy.data.objects.remove(item)
        bpy.data.meshes.remove(data)
        bpy.data.batch_remove([material for material in materials if not material.users])


def is_there(scene: bpy.types.Scene) -> bool:
    return presentation.find(scene, ROLE) is not None


def leave_out(stage: bpy.types.Scene) -> None:
    """Take the ground off the stage of drawings, which show the record alone."""
    for item in [item for item in stage.objects if surface.is_ground(item)]:
        bpy.data.objects.remove(item)
