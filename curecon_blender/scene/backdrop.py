# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a site is seen against and in which colours, where the user has chosen nothing: a hazy sky, a ground of the
site's own colour, and the photos' colours as they are."""

from __future__ import annotations

from collections.abc import Callable

import bpy
import numpy as np

from ..core.base.ground import LEVEL, STRAYS, lowest_wide_level
from . import presentation
from .points import CloudArrays

BACKDROP_ROLE = "backdrop"
NAME, GROUND_NAME = "CU-Recon Backdrop", "Ground"
GROUND_KEY = "curecon_ground"  # on a workspace's collection: the linear colour of its ground
HAZE, ZENITH = (0.62, 0.72, 0.80), (0.22, 0.38, 0.66)  # linear, of the sky at the horizon and overhead
HIGH = 0.6  # z of a unit vector where the sky is as overhead
HAZY = -0.3  # and where the ground begins to fade into the haze
NEAR = 0.05  # of all heights: what is level and no farther from the ground's tells its colour
LIT = 55  # percentile of its colours: some of it lies in shade
DULL = 0.5  # how much of its saturation the ground loses, not to outshine the site
DARKEST = 0.16  # linear luminance of the ground, at least
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
GREY = (0.2, 0.2, 0.2)  # ground whose colour nobody knows
TONED = {"AgX", "Filmic"}  # what Blender starts with, in turn
BLENDERS_GREY = 0.0509  # of the world in a new file, linear

AddSky = Callable[[bpy.types.NodeTree, bpy.types.NodeSocket], bpy.types.NodeSocket]


def ground_colour(cloud: CloudArrays) -> tuple[float, float, float]:
    """The typical linear colour of what lies level in the light at the height of a cloud's ground. No bpy: it may run
    on any thread."""
    level, heights = cloud.normals[:, 2] > LEVEL, cloud.points[:, 2]
    if not level.any():
        return GREY
    reach = NEAR * np.ptp(np.percentile(heights, STRAYS))
    at_ground = level & (np.abs(heights - lowest_wide_level(heights, heights[level])) <= reach)
    colour = np.percentile(cloud.colours[at_ground, :3], LIT, axis=0)
    luminance = max(float(colour @ LUMINANCE), 1e-3)
    # No open ground is blue: this one was seen in shade, where only the sky lights it.
    dull = DULL if colour[0] >= colour[2] else 1.0
    red, green, blue = ((colour + dull * (luminance - colour)) * max(1.0, DARKEST / luminance)).tolist()
    return red, green, blue


def set_up(scene: bpy.types.Scene, ground: tuple[float, float, float]) -> None:
    """Give a scene our backdrop in place of Blender's grey, and colours as the photos have them in place of Blender's
    toned ones; a world or a view that the user has chosen stays."""
    view = scene.view_settings
    if view.view_transform in TONED and (view.look, view.exposure, view.gamma) == ("None", 0, 1):
        view.view_transform = "Standard"
    if scene.world is None or _is_untouched(scene.world):
        scene.world = new_world(NAME, BACKDROP_ROLE, ground, _gradient)


def ground_of(scene: bpy.types.Scene) -> tuple[float, float, float]:
    """The colour of the ground of what stands in a scene."""
    found = next((child[GROUND_KEY] for child in scene.collection.children_recursive if GROUND_KEY in child), GREY)
    red, green, blue = found
    return red, green, blue


def new_world(name: str, role: str, ground: tuple[float, float, float], add_sky: AddSky) -> bpy.types.World:
    """A world with a level ground of a linear colour that fades into the sky at the horizon. `add_sky` makes the nodes
    of the sky from a node tree and a socket of the direction, and returns their shader."""
    world = bpy.data.worlds.new(name)
    world[presentation.ROLE_KEY] = role
    if world.node_tree is None:  # before Blender 5.0 a new world has no nodes yet
        world.use_nodes = True
    tree = world.node_tree
    tree.nodes.clear()
    place = tree.nodes.new("ShaderNodeTexCoord")
    shader = add_sky(tree, place.outputs["Generated"])
    kinds = ("SeparateXYZ", "MapRange", "Background", "MixShader", "OutputWorld")
    split, fade, earth, both, output = (tree.nodes.new(f"ShaderNode{kind}") for kind in kinds)
    fade.interpolation_type = "SMOOTHSTEP"
    fade.inputs["From Min"].default_value, fade.inputs["From Max"].default_value = HAZY, 0.0
    earth.name = earth.label = GROUND_NAME
    earth.inputs["Color"].default_value = (*ground, 1.0)
    for source, target in (
        (place.outputs["Generated"], split.inputs[0]), (split.outputs["Z"], fade.inputs["Value"]),
        (fade.outputs["Result"], both.inputs[0]), (earth.outputs[0], both.inputs[1]), (shader, both.inputs[2]),
        (both.outputs[0], output.inputs["Surface"]),
    ):
        tree.links.new(source, target)
    for index, node in enumerate(tree.nodes):  # a readable row for who opens it
        node.location = (200 * index, 0)
    return world


def _gradient(tree: bpy.types.NodeTree, direction: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    split, ramp, sky = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("SeparateXYZ", "ValToRGB", "Background"))
    elements = ramp.color_ramp.elements
    elements[0].color, elements[1].color, elements[1].position = (*HAZE, 1), (*ZENITH, 1), HIGH
    tree.links.new(direction, split.inputs[0])
    tree.links.new(split.outputs["Z"], ramp.inputs[0])
    tree.links.new(ramp.outputs["Color"], sky.inputs["Color"])
    return sky.outputs[0]


def _is_untouched(world: bpy.types.World) -> bool:
    """Whether it is the plain grey one of a new file."""
    if world.node_tree is None or len(world.node_tree.nodes) != 2 or "Background" not in world.node_tree.nodes:
        return False
    colour, strength = (world.node_tree.nodes["Background"].inputs[name] for name in ("Color", "Strength"))
    if colour.is_linked or strength.is_linked or strength.default_value != 1:
        return False
    return bool(np.allclose(colour.default_value[:3], BLENDERS_GREY, atol=1e-3))
