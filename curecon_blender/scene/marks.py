# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What is known of a surface's faces, shown and exported: filled and weak ones tinted, and attributes in files.

The faces of each mark have materials of their own, in which a switch mixes the tint in: nothing is rebuilt.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager

import bpy
import numpy as np

from .points import COLOUR, linear

MARKS = "filled", "weak"  # what a switch tints; a face that is neither was measured
TINTED = "Color with filled"  # the vertex colours with marked faces tinted, for Solid shading
TINTS = {"filled": (1.0, 0.12, 0.45), "weak": (0.1, 0.55, 1.0)}  # sRGB: a pink and a blue that no building has
TINT_STRENGTH = 0.85  # the rest is the surface's own colour, which keeps its shape readable
# Names of nodes, by which the switches find them.
COLOUR_NODE, TINT_IMAGE_NODE, FILLED_NODE = "Colour", "Tint for Solid", "Filled"
# Attributes that exported files have: a face's kind, 0 measured, 1 weak, 2 filled; and whether no photo shows it.
KIND, UNSEEN = "_KIND", "_UNSEEN"


def mark_key(mark: str) -> str:
    """What marks the materials of the faces that have one of MARKS."""
    return f"curecon_{mark}"


def show(surfaces: Iterable[bpy.types.Object], marks: Collection[str]) -> None:
    """Tint the faces of surfaces that have one of `marks`, of MARKS, in every kind of shading and in
    renders, and show all others plainly."""
    for item in surfaces:
        for material in item.data.materials:
            mark = _mark_of(material)
            if mark is None or material.node_tree is None:
                continue
            nodes, tinted = material.node_tree.nodes, mark in marks
            if FILLED_NODE in nodes:
                nodes[FILLED_NODE].inputs[0].default_value = TINT_STRENGTH if tinted else 0.0
            # Solid shading shows the active image node, or else the viewport colour.
            if (shown := nodes.get(TINT_IMAGE_NODE if tinted else COLOUR_NODE)) is not None:
                nodes.active = shown
            own = material[mark_key(mark)]
            material.diffuse_color = (*(linear(np.array(TINTS[mark])) if tinted else own), 1.0)
        _tint_corners(item.data, marks)
        item.data.update_tag()


def _mark_of(material: bpy.types.Material | None) -> str | None:
    return next((mark for mark in MARKS if material is not None and mark_key(mark) in material), None)


def has_mark(material: bpy.types.Material | None, mark: str) -> bool:
    """Whether a material is that of the faces which have one of MARKS."""
    return _mark_of(material) == mark


def _tint_corners(data: bpy.types.Mesh, marks: Collection[str]) -> None:
    """Without a texture, Solid shading knows no materials' nodes, only colour attributes: the tint needs one of its
    own."""
    attributes = data.color_attributes
    if data.uv_layers or COLOUR not in attributes:
        return
    attributes.active_color_name = COLOUR
    if not marks:
        return
    point = np.empty((len(data.vertices), 4), np.float32)
    attributes[COLOUR].data.foreach_get("color", point.ravel())
    corner = np.empty(len(data.loops), np.int32)
    data.loops.foreach_get("vertex_index", corner)
    colours = point[corner]
    for mark in marks:
        which = _corner_mark(data, mark)
        colours[which, :3] = (1 - TINT_STRENGTH) * colours[which, :3] + TINT_STRENGTH * linear(np.array(TINTS[mark]))
    if TINTED not in attributes:
        attributes.new(TINTED, "FLOAT_COLOR", "CORNER")
    attributes[TINTED].data.foreach_set("color", colours.ravel())
    attributes.active_color_name = TINTED


def _corner_mark(data: bpy.types.Mesh, mark: str) -> np.ndarray:
    """A face's mark at each of its corners, (C,) bool; False where it is not known."""
    total, which = np.empty(len(data.polygons), np.int32), np.zeros(len(data.polygons), bool)
    data.polygons.foreach_get("loop_total", total)
    if mark in data.attributes:
        data.attributes[mark].data.foreach_get("value", which)
    return np.repeat(which, total)


@contextmanager
def for_export(items: list[bpy.types.Object], domain: str) -> Iterator[None]:
    """Surfaces with the attributes KIND and UNSEEN, of their CORNERs or, where a file knows only these, their POINTs:
    there, what the least sure face about a vertex is."""
    for data in {item.data for item in items}:
        filled, weak, unseen = (_corner_mark(data, mark) for mark in (*MARKS, "unseen"))
        for name, values in ((KIND, np.where(filled, 2, weak)), (UNSEEN, unseen)):
            if domain == "POINT":
                corner, whole = np.empty(len(data.loops), np.int32), np.zeros(len(data.vertices), np.float32)
                data.loops.foreach_get("vertex_index", corner)
                np.maximum.at(whole, corner, values.astype(np.float32))
                values = whole
            data.attributes.new(name, "FLOAT", domain).data.foreach_set("value", values.astype(np.float32))
    try:
        yield
    finally:
        for data in {item.data for item in items}:
            for name in (KIND, UNSEEN):
                data.attributes.remove(data.attributes[name])


def add_tint(
    material: bpy.types.Material, mark: str, shader: bpy.types.Node, output: bpy.types.Node, *, solid: bool
) -> None:
    """Mix a mark's tint into what `shader` gives to `output`, by nothing yet; with `solid` also for Solid shading."""
    nodes, links = material.node_tree.nodes, material.node_tree.links
    tint, mix = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeMixShader")
    mix.name = mix.label = FILLED_NODE
    mix.inputs[0].default_value = 0.0
    tint.inputs["Color"].default_value = (*linear(np.array(TINTS[mark])), 1.0)
    tint.location, mix.location = (20, -120), (240, 100)
    links.new(shader.outputs[0], mix.inputs[1])
    links.new(tint.outputs[0], mix.inputs[2])
    links.new(mix.outputs[0], output.inputs["Surface"])
    if solid:
        node = nodes.new("ShaderNodeTexImage")  # linked to nothing: Solid shading shows it while it is active
        node.name = node.label = TINT_IMAGE_NODE
        node.image, node.location = _tint_image(mark), (-600, -300)


def _tint_image(mark: str) -> bpy.types.Image:
    """A picture of a mark's tint, shared by all surfaces and kept in the .blend (Blender writes none that is generated
    by colour alone, but its settings, from which it comes back)."""
    image = bpy.data.images.get(mark_key(mark))
    if image is None:
        image = bpy.data.images.new(mark_key(mark), 1, 1)
        image.generated_color = (*TINTS[mark], 1.0)
    return image
