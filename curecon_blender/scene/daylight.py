# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A sun lamp and Blender's sky."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Vector

from ..core.present import sun
from . import backdrop, presentation
from .site import Box

SUN_ROLE, SKY_ROLE = "sun", "sky"
SUN_NAME, SKY_NAME = "CU-Recon Sun", "CU-Recon Sky"
SUN_STRENGTH = 2.8  # W/m2: with the sky's share, white that faces the sun comes to just under 1
SUN_ANGLE = 0.00918  # radians across
# The measured sky's name, and what brings it to a fifth of the sun's light: 5.0 renamed and brightened it.
SKIES = {"NISHITA": 0.06, "MULTIPLE_SCATTERING": 0.035}
OVERCAST_NAME = "Overcast"
OVERCAST = 0.9  # of the even light: white under it comes to just under 1
BEFORE_KEY = "curecon_before"  # on our world: the one that it took the place of
SEEN = 2.0  # times as bright as it lights, the sky is seen: as a photo exposed for the building shows it
HORIZON = 0.08  # z of the lowest direction looked up in the sky: below it is black ground, not haze


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
        world = backdrop.new_world(SKY_NAME, SKY_ROLE, backdrop.ground_of(scene), _sky)
        if scene.world is not None:
            world[BEFORE_KEY] = scene.world
        scene.world = world
    soften(scene, scene.curecon.present.sky_only)
    sky = scene.world.node_tree.nodes[SKY_NAME]
    # Blender's sky turns clockwise from +Y, as a compass does.
    sky.sun_rotation, sky.sun_elevation = np.radians(azimuth + north) % (2 * np.pi), np.radians(altitude)


def soften(scene: bpy.types.Scene, sky_only: bool) -> None:
    """Let an even, white light take the place of our sun's, or the sun shine again; the sky is seen as it is."""
    lamp, world = presentation.find(scene, SUN_ROLE), scene.world
    if lamp is not None:
        lamp.hide_render = lamp.hide_viewport = sky_only
    if world is not None and world.get(presentation.ROLE_KEY) == SKY_ROLE:
        world.node_tree.nodes[OVERCAST_NAME].inputs[1].default_value = float(sky_only)


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


def _sky(tree: bpy.types.NodeTree, direction: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    above, unit = (tree.nodes.new("ShaderNodeVectorMath") for _ in range(2))
    sky, background = tree.nodes.new("ShaderNodeTexSky"), tree.nodes.new("ShaderNodeBackground")
    above.operation, unit.operation = "MAXIMUM", "NORMALIZE"
    above.inputs[1].default_value = (-1, -1, HORIZON)
    kinds = sky.bl_rna.properties["sky_type"].enum_items
    sky.name = sky.label = SKY_NAME
    sky.sky_type = next(kind for kind in SKIES if kind in kinds)
    sky.sun_disc = False  # the lamp is the sun
    background.inputs["Strength"].default_value = SKIES[sky.sky_type]
    tree.links.new(direction, above.inputs[0])
    tree.links.new(above.outputs[0], unit.inputs[0])
    tree.links.new(unit.outputs[0], sky.inputs["Vector"])
    # Surfaces may be lit evenly, while who looks up sees the sky.
    seen, unseen, switch = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("LightPath", "Math", "Math"))
    even, both = tree.nodes.new("ShaderNodeBackground"), tree.nodes.new("ShaderNodeMixShader")
    unseen.operation, switch.operation = "SUBTRACT", "MULTIPLY"
    unseen.inputs[0].default_value, switch.inputs[1].default_value = 1.0, 0.0
    switch.name = switch.label = OVERCAST_NAME
    even.name = even.label = f"{OVERCAST_NAME} Light"
    even.inputs["Color"].default_value, even.inputs["Strength"].default_value = (1, 1, 1, 1), OVERCAST
    brightness, scaled = tree.nodes.new("ShaderNodeMath"), tree.nodes.new("ShaderNodeVectorMath")
    brightness.operation, scaled.operation = "MULTIPLY_ADD", "SCALE"
    brightness.inputs[1].default_value, brightness.inputs[2].default_value = SEEN - 1, 1.0
    for source, target in (
        (seen.outputs["Is Camera Ray"], brightness.inputs[0]), (brightness.outputs[0], scaled.inputs["Scale"]),
        (sky.outputs[0], scaled.inputs[0]), (scaled.outputs[0], background.inputs["Color"]),
        (seen.outputs["Is Camera Ray"], unseen.inputs[1]), (unseen.outputs[0], switch.inputs[0]),
        (switch.outputs[0], both.inputs[0]), (background.outputs[0], both.inputs[1]), (even.outputs[0], both.inputs[2]),
    ):
        tree.links.new(source, target)
    return both.outputs[0]
