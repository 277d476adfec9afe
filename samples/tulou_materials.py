# SPDX-License-Identifier: GPL-3.0-or-later
"""Procedural materials of the sample site: noise at several scales, in object coordinates (metres).

Every material reads the vertex attribute `paint`. What its four numbers mean is said at each function.
No material moves the surface: depth is that of the mesh.
"""

from __future__ import annotations

from collections.abc import Callable

import bpy

Colour = tuple[float, float, float]
Socket = bpy.types.NodeSocket


class Graph:
    """A thin wrapper over a material's node tree; its methods add nodes and return their output sockets."""

    def __init__(self, name: str) -> None:
        self.material = bpy.data.materials.new(name)
        self.material.use_nodes = True
        self.tree = self.material.node_tree
        self.tree.nodes.clear()
        self.position = self.node("ShaderNodeTexCoord").outputs["Object"]
        paint = self.node("ShaderNodeAttribute")
        paint.attribute_name = "paint"
        self.paint = paint.outputs["Color"]
        split = self.node("ShaderNodeSeparateColor")
        self.link(self.paint, split.inputs[0])
        self.r, self.g, self.b = split.outputs

    def node(self, kind: str) -> bpy.types.Node:
        return self.tree.nodes.new(kind)

    def link(self, value: Socket | float | tuple, target: Socket) -> None:
        """Connect a socket, or set a constant."""
        if isinstance(value, bpy.types.NodeSocket):
            self.tree.links.new(value, target)
        elif isinstance(value, tuple) and len(value) == 3 and target.type == "RGBA":
            target.default_value = (*value, 1.0)
        else:
            target.default_value = value

    def math(self, operation: str, a: Socket | float, b: Socket | float = 0.0) -> Socket:
        node = self.node("ShaderNodeMath")
        node.operation = operation
        self.link(a, node.inputs[0])
        self.link(b, node.inputs[1])
        return node.outputs[0]

    def ramp(self, value: Socket, low: float, high: float, to_low: float = 0.0, to_high: float = 1.0) -> Socket:
        """Map [low, high] to [to_low, to_high], clamped."""
        node = self.node("ShaderNodeMapRange")
        for index, number in enumerate((value, low, high, to_low, to_high)):
            self.link(number, node.inputs[index])
        return node.outputs[0]

    def noise(self, wavelength: float, detail: float = 3.0, stretch: Colour = (1, 1, 1), rough: float = 0.6) -> Socket:
        """Fractal noise in about [0.2, 0.8]; `wavelength` in metres, `stretch` scales it along x, y and z."""
        position = self.position
        if stretch != (1, 1, 1):
            mapping = self.node("ShaderNodeVectorMath")
            mapping.operation = "DIVIDE"
            self.link(position, mapping.inputs[0])
            mapping.inputs[1].default_value = stretch
            position = mapping.outputs[0]
        node = self.node("ShaderNodeTexNoise")
        self.link(position, node.inputs["Vector"])
        node.inputs["Scale"].default_value = 1.0 / wavelength
        node.inputs["Detail"].default_value = detail
        node.inputs["Roughness"].default_value = rough
        return node.outputs[0]

    def mix(self, share: Socket | float, a: Socket | Colour, b: Socket | Colour, blend: str = "MIX") -> Socket:
        node = self.node("ShaderNodeMix")
        node.data_type = "RGBA"
        node.blend_type = blend
        self.link(share, node.inputs[0])
        self.link(a, node.inputs[6])
        self.link(b, node.inputs[7])
        return node.outputs[2]

    def brighten(self, colour: Socket, factor: Socket) -> Socket:
        """Multiply a colour by a number."""
        node = self.node("ShaderNodeVectorMath")
        node.operation = "SCALE"
        self.link(colour, node.inputs[0])
        self.link(factor, node.inputs["Scale"])
        return node.outputs[0]

    def height(self) -> Socket:
        split = self.node("ShaderNodeSeparateXYZ")
        self.link(self.position, split.inputs[0])
        return split.outputs[2]

    def finish(self, colour: Socket, average: Colour, roughness: float | None = None) -> bpy.types.Material:
        """The material: `colour` where the camera sees it, the plain `average` where bounced light does (faster).

        Matt, or, with a `roughness`, a little glossy.
        """
        shader = self.node("ShaderNodeBsdfDiffuse" if roughness is None else "ShaderNodeBsdfPrincipled")
        self.link(colour, shader.inputs[0])
        if roughness is not None:
            shader.inputs["Roughness"].default_value = roughness
            shader.inputs["Specular IOR Level"].default_value = 0.25
        plain = self.node("ShaderNodeBsdfDiffuse")
        self.link(average, plain.inputs[0])
        choice = self.node("ShaderNodeMixShader")
        self.link(self.node("ShaderNodeLightPath").outputs["Is Camera Ray"], choice.inputs[0])
        self.link(plain.outputs[0], choice.inputs[1])
        self.link(shader.outputs[0], choice.inputs[2])
        output = self.node("ShaderNodeOutputMaterial")
        self.link(choice.outputs[0], output.inputs[0])
        return self.material


def earth() -> bpy.types.Material:
    """Rammed earth in lifts, rain streaks, pebbles. Paint: r tone, g lime or cement repair, b damp and dirt."""
    g = Graph("earth")
    broad, grain = g.noise(2.6, 3), g.noise(0.13, 2, rough=0.8)
    streak = g.noise(0.5, 2, (1, 1, 7))
    colour = g.mix(g.ramp(broad, 0.3, 0.7), (0.27, 0.165, 0.075), (0.47, 0.325, 0.18))
    colour = g.mix(g.ramp(streak, 0.48, 0.68, 0, 0.7), colour, (0.165, 0.12, 0.08))
    lift = g.math("ADD", g.math("MULTIPLY", g.height(), 2.4), g.math("MULTIPLY", broad, 0.9))
    seam = g.ramp(g.math("ABSOLUTE", g.math("SUBTRACT", g.math("FRACT", lift), 0.5)), 0.40, 0.5, 1.0, 0.66)
    patch = g.mix(g.ramp(grain, 0.3, 0.7), (0.40, 0.37, 0.32), (0.62, 0.58, 0.5))
    repair = g.ramp(g.math("ADD", g.g, g.math("MULTIPLY", g.math("SUBTRACT", broad, 0.5), 0.9)), 0.45, 0.6)
    colour = g.mix(repair, g.brighten(colour, seam), patch)
    dirt = g.ramp(g.math("ADD", g.b, g.math("SUBTRACT", streak, 0.5)), 0.25, 1.0, 0, 0.85)
    colour = g.mix(dirt, colour, (0.105, 0.09, 0.065))
    shade = g.math("MULTIPLY", g.ramp(grain, 0.25, 0.75, 0.55, 1.4), g.ramp(g.r, 0, 1, 0.8, 1.2))
    return g.finish(g.brighten(colour, shade), (0.40, 0.28, 0.155))


def stone() -> bpy.types.Material:
    """Field stones. Paint: r tone of the stone, g joint (1 = in the joint), b moss."""
    g = Graph("stone")
    grain, blotch = g.noise(0.11, 2, rough=0.8), g.noise(0.9, 2)
    colour = g.mix(g.r, (0.13, 0.125, 0.12), (0.40, 0.37, 0.32))
    colour = g.mix(g.ramp(blotch, 0.4, 0.65, 0, 0.5), colour, (0.26, 0.20, 0.13))
    colour = g.mix(g.ramp(g.math("MULTIPLY", g.b, blotch), 0.15, 0.5, 0, 0.7), colour, (0.09, 0.11, 0.045))
    colour = g.mix(g.ramp(g.g, 0.3, 1.0, 0, 0.8), colour, (0.085, 0.075, 0.055))
    return g.finish(g.brighten(colour, g.ramp(grain, 0.25, 0.75, 0.5, 1.5)), (0.22, 0.20, 0.165))


def tile() -> bpy.types.Material:
    """Fired clay tiles, weathered. Paint: r tone of the tile, g newness, b moss and soot."""
    g = Graph("tile")
    grain, blotch = g.noise(0.13, 2, rough=0.8), g.noise(1.7, 3)
    old = g.mix(g.r, (0.085, 0.075, 0.068), (0.235, 0.20, 0.17))
    old = g.mix(g.ramp(blotch, 0.42, 0.65, 0, 0.6), old, (0.22, 0.15, 0.105))
    new = g.mix(g.r, (0.27, 0.125, 0.075), (0.40, 0.22, 0.14))
    colour = g.mix(g.g, old, new)
    moss = g.mix(g.ramp(grain, 0.35, 0.65), (0.05, 0.05, 0.04), (0.20, 0.20, 0.13))
    colour = g.mix(g.ramp(g.math("MULTIPLY", g.b, g.ramp(grain, 0.3, 0.6)), 0.2, 0.9, 0, 0.7), colour, moss)
    return g.finish(g.brighten(colour, g.ramp(grain, 0.25, 0.75, 0.55, 1.5)), (0.16, 0.13, 0.11))


def wood() -> bpy.types.Material:
    """Old fir. Paint: r tone, g darkness (doors and shutters in the shade of an opening)."""
    g = Graph("wood")
    grain, board = g.noise(0.08, 2, (1, 1, 9), 0.75), g.noise(0.35, 2, (1, 1, 4))
    colour = g.mix(g.ramp(board, 0.35, 0.65), (0.115, 0.072, 0.042), (0.30, 0.20, 0.12))
    colour = g.mix(g.ramp(g.r, 0.5, 1.0, 0, 0.7), colour, (0.36, 0.30, 0.235))
    colour = g.mix(g.math("MULTIPLY", g.g, 0.8), colour, (0.035, 0.026, 0.02))
    return g.finish(g.brighten(colour, g.ramp(grain, 0.25, 0.75, 0.5, 1.5)), (0.19, 0.13, 0.085))


def plaster() -> bpy.types.Material:
    """Stained whitewash, flaked to the brick. Paint: r tone, g bare brick, b dirt."""
    g = Graph("plaster")
    broad, grain, streak = g.noise(1.3, 3), g.noise(0.12, 2, rough=0.8), g.noise(0.4, 2, (1, 1, 6))
    colour = g.mix(g.ramp(broad, 0.35, 0.65), (0.62, 0.59, 0.53), (0.42, 0.39, 0.34))
    colour = g.mix(g.ramp(streak, 0.5, 0.7, 0, 0.6), colour, (0.2, 0.185, 0.16))
    bare = g.ramp(g.math("ADD", g.g, g.math("SUBTRACT", broad, 0.5)), 0.15, 0.25)
    colour = g.mix(bare, colour, (0.33, 0.175, 0.105))
    colour = g.mix(
        g.ramp(g.math("ADD", g.b, g.math("SUBTRACT", streak, 0.5)), 0.25, 1, 0, 0.8), colour, (0.1, 0.09, 0.07)
    )
    return g.finish(g.brighten(colour, g.ramp(grain, 0.25, 0.75, 0.65, 1.3)), (0.44, 0.40, 0.34))


def ground() -> bpy.types.Material:
    """Grass, earth and tilled soil. Paint: r trodden earth, g tilled soil, b wet or lush."""
    g = Graph("ground")
    broad, middle, grain = g.noise(9.0, 2), g.noise(0.8, 3), g.noise(0.15, 2, rough=0.8)
    grass = g.mix(g.ramp(middle, 0.35, 0.65), (0.065, 0.082, 0.03), (0.17, 0.16, 0.07))
    grass = g.mix(g.ramp(broad, 0.4, 0.65, 0, 0.75), grass, (0.23, 0.19, 0.095))
    grass = g.mix(g.math("MULTIPLY", g.b, 0.6), grass, (0.055, 0.08, 0.026))
    trodden = g.mix(g.ramp(middle, 0.3, 0.7), (0.25, 0.17, 0.10), (0.44, 0.345, 0.23))
    tilled = g.mix(g.ramp(middle, 0.3, 0.7), (0.115, 0.068, 0.038), (0.235, 0.15, 0.085))
    edge = g.math("MULTIPLY", g.math("SUBTRACT", middle, 0.5), 1.6)
    colour = g.mix(g.ramp(g.math("ADD", g.r, edge), 0.35, 0.6), grass, trodden)
    colour = g.mix(g.ramp(g.math("ADD", g.g, edge), 0.4, 0.6), colour, tilled)
    return g.finish(g.brighten(colour, g.ramp(grain, 0.25, 0.75, 0.4, 1.7)), (0.17, 0.15, 0.08))


def leaf() -> bpy.types.Material:
    """Leaves and grass blades. Paint: r yellow, g dark."""
    g = Graph("leaf")
    info = g.node("ShaderNodeObjectInfo")
    grain = g.noise(0.3, 1)
    colour = g.mix(g.r, (0.055, 0.10, 0.024), (0.24, 0.25, 0.07))
    colour = g.mix(g.math("MULTIPLY", g.g, 0.75), colour, (0.03, 0.058, 0.018))
    colour = g.mix(g.ramp(info.outputs["Random"], 0, 1, 0, 0.45), colour, (0.10, 0.095, 0.03))
    return g.finish(g.brighten(colour, g.ramp(grain, 0.25, 0.75, 0.6, 1.5)), (0.08, 0.11, 0.03), 0.6)


def bark() -> bpy.types.Material:
    """Bark and split logs. Paint: r lightness (cut wood)."""
    g = Graph("bark")
    grain = g.noise(0.12, 4, (1, 1, 3), 0.75)
    colour = g.mix(g.r, (0.075, 0.058, 0.042), (0.42, 0.31, 0.19))
    return g.finish(g.brighten(colour, g.ramp(grain, 0.25, 0.75, 0.45, 1.6)), (0.16, 0.12, 0.08))


def water() -> bpy.types.Material:
    """A green pond with scum, so that it is not a mirror."""
    g = Graph("water")
    scum = g.noise(1.6, 4)
    colour = g.mix(g.ramp(scum, 0.45, 0.62), (0.03, 0.042, 0.024), (0.10, 0.125, 0.05))
    return g.finish(colour, (0.05, 0.06, 0.035), 0.3)


def goods() -> bpy.types.Material:
    """Everything of its own colour: cloth, baskets, lanterns, metal sheet. Paint: the colour, linear."""
    g = Graph("goods")
    grain, broad = g.noise(0.1, 2, rough=0.8), g.noise(0.9, 2)
    shade = g.math("MULTIPLY", g.ramp(grain, 0.25, 0.75, 0.5, 1.45), g.ramp(broad, 0.3, 0.7, 0.75, 1.2))
    return g.finish(g.brighten(g.paint, shade), (0.25, 0.2, 0.15), 0.75)


MATERIALS: dict[str, Callable[[], bpy.types.Material]] = {
    make.__name__: make for make in (earth, stone, tile, wood, plaster, ground, leaf, bark, water, goods)
}
