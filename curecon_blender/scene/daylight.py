# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A sun lamp and Blender's sky."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Vector

from ..core import sun
from . import presentation
from .site import Box

SUN_ROLE, SKY_ROLE = "sun", "sky"
SUN_NAME, SKY_NAME = "CU-Recon Sun", "CU-Recon Sky"
SUN_STRENGTH = 2.8  # W/m2: with the sky's share, white that faces the sun comes to just under 1
SUN_ANGLE = 0.00918  # radians across
# The measured sky's name, and what brings it to a fifth of the sun's light: 5.0 renamed and brightened it.
SKIES = {"NISHITA": 0.06, "MULTIPLE_SCATTERING": 0.035}
BEFORE_KEY = "curecon_before"  # on our world: the one that it took the place of
HORIZON = 0.02  # z of the lowest direction looked up in the sky: below it is black ground, not haze


def shine(scene: bpy.types.Scene, about: Box, azimuth: float, altitude: float, north: float = 0.0) -> None:
    """Let the sun stand at `azimuth` and `altitude` (degrees) above the box; north lies `north` degrees clockwise from
    +Y. A second call moves the lamp and the sky that the first one made and keeps what the user changed on them."""
    towards = sun.direction(azimuth, altitude, north)
    lamp = presentation.find(scene, SUN_ROLE)
    if lamp is None:
        data = bpy.data.lights.new(SUN_NAME, "SUN")
        data.energy, data.angle = SUN_STRENGTH, SUN_ANGLE
        lamp = presentation.put(scene, SUN_ROLE, data)
    lamp.location = about.centre + 2 * about.radius * towards  # only its direction counts; there it can be seen
    lamp.rotation_mode = "XYZ"
    lamp.rotation_euler = Vector(towards.tolist()).to_track_quat("Z", "Y").to_euler()
    if scene.world is None or scene.world.get(presentation.ROLE_KEY) != SKY_ROLE:
        world = _new_sky()
        if scene.world is not None:
            world[BEFORE_KEY] = scene.world
        scene.world = world
    sky = scene.world.node_tree.nodes[SKY_NAME]
    # Blender's sky turns clockwise from +Y, as a compass does.
    sky.sun_rotation, sky.sun_elevation = np.radians(azimuth + north) % (2 * np.pi), np.radians(altitude)


def remove(scene: bpy.types.Scene) -> None:
    """Take the lamp and the sky away, and put the world back that was there before."""
    if (lamp := presentation.find(scene, SUN_ROLE)) is not None:
        bpy.data.lights.remove(lamp.data)  # and the object with it
    world = scene.world
    if world is not None and world.get(presentation.ROLE_KEY) == SKY_ROLE:
        scene.world = world.get(BEFORE_KEY)
        bpy.data.worlds.remove(world)


def is_shining(scene: bpy.types.Scene) -> bool:
    return presentation.find(scene, SUN_ROLE) is not None


def _new_sky() -> bpy.types.World:
    world = bpy.data.worlds.new(SKY_NAME)
    world[presentation.ROLE_KEY] = SKY_ROLE
    if world.node_tree is None:  # before Blender 5.0 a new world has no nodes yet
        world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    nodes.clear()
    place, above, unit = (nodes.new(f"ShaderNode{kind}") for kind in ("TexCoord", "VectorMath", "VectorMath"))
    sky, background, output = (nodes.new(f"ShaderNode{kind}") for kind in ("TexSky", "Background", "OutputWorld"))
    above.operation, unit.operation = "MAXIMUM", "NORMALIZE"
    above.inputs[1].default_value = (-1, -1, HORIZON)
    kinds = sky.bl_rna.properties["sky_type"].enum_items
    sky.name = sky.label = SKY_NAME
    sky.sky_type = next(kind for kind in SKIES if kind in kinds)
    sky.sun_disc = False  # the lamp is the sun
    background.inputs["Strength"].default_value = SKIES[sky.sky_type]
    links.new(place.outputs["Generated"], above.inputs[0])
    links.new(above.outputs[0], unit.inputs[0])
    links.new(unit.outputs[0], sky.inputs["Vector"])
    links.new(sky.outputs[0], background.inputs["Color"])
    links.new(background.outputs[0], output.inputs["Surface"])
    for index, node in enumerate((place, above, unit, sky, background, output)):
        node.location = (200 * index, 0)
    return world
