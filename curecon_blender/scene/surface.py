# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The surface as a mesh object: its texture or vertex colours, what supports it, and the two ways to look at it.

Every page of texture has two materials, one for faces that photos measured and one for faces that were filled in, so
that filled surface can be tinted by a switch in the latter: nothing is rebuilt. Both show the photos' colours as they
are (the photos' own light) or lit by the scene.
"""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from ..core.errors import WorkspaceError
from ..core.mesh import Mesh
from .points import COLOUR, linear

SURFACE_KEY = "curecon_surface"  # marks the mesh data that came from a workspace
FILLED_KEY = "curecon_filled"  # marks the materials of filled faces
UV = "UVMap"
TINTED = "Color with filled"  # the vertex colours with the filled faces tinted, for Solid shading
TINT = (1.0, 0.12, 0.45)  # sRGB: a pink that no building has
TINT_STRENGTH = 0.85  # the rest is the surface's own colour, which keeps its shape readable
SHARP_ANGLE = 45.0  # degrees: corners of buildings stay sharp, the noise of measured walls is smoothed
# Names of nodes, by which the switches find them.
COLOUR_NODE, TINT_IMAGE_NODE, LIGHT_NODE, FILLED_NODE = "Colour", "Tint for Solid", "Light", "Filled"


def pictures(mesh: Mesh, file: Path) -> list[Path]:
    """The pages' files of a mesh that was read from `file`. Raises WorkspaceError where one is missing, or where a
    face names one that is not there; -1 is a face too thin to be on any."""
    paths = [file.parent / page for page in mesh.pages]
    for path in paths:
        if not path.is_file():
            raise WorkspaceError(
                f"The texture {path} is missing.", remedy="Run Texture again in this workspace.", path=path
            )
    if mesh.page is not None and len(mesh.page) and not -1 <= mesh.page.min() <= mesh.page.max() < len(paths):
        raise WorkspaceError(
            f"{file} is damaged: a face names a texture that is not there.", remedy="Run Texture again.", path=file
        )
    return paths


def add(
    mesh: Mesh, pages: list[Path], name: str, collection: bpy.types.Collection, *, pack: bool = False
) -> bpy.types.Object:
    """Link a mesh object with the surface into `collection`.

    Attributes: Color (sRGB bytes), distance (world units to the nearest measured point) and views a vertex, filled a
    face; UVs and the `pages`' images where it is textured. Images stay in their files unless `pack`.
    """
    data = bpy.data.meshes.new(name)
    data[SURFACE_KEY] = True
    _geometry(data, mesh)
    _attribute(data, "distance", "FLOAT", "POINT", "value", mesh.distance)
    _attribute(data, "views", "INT", "POINT", "value", mesh.views.astype(np.int32))
    _attribute(data, "filled", "BOOLEAN", "FACE", "value", mesh.filled)
    colours = np.ones((len(mesh.vertices), 4), np.float32)
    np.divide(mesh.colours, 255, out=colours[:, :3], dtype=np.float32)
    _attribute(data, COLOUR, "BYTE_COLOR", "POINT", "color_srgb", colours)
    page = np.zeros(len(mesh.faces), np.int32)
    images: list[bpy.types.Image | None] = [None]
    if mesh.uv is not None and mesh.page is not None:
        data.uv_layers.new(name=UV).uv.foreach_set("vector", np.ascontiguousarray(mesh.uv).ravel())
        page, images = np.maximum(mesh.page, 0), [_image(path, pack) for path in pages]
    else:
        # Solid shading knows no materials' nodes, only colour attributes: the tint needs one of its own.
        corners = colours[mesh.faces]
        corners[mesh.filled, :, :3] += TINT_STRENGTH * (np.array(TINT, np.float32) - corners[mesh.filled, :, :3])
        _attribute(data, TINTED, "BYTE_COLOR", "CORNER", "color_srgb", corners)
    mean = linear(mesh.colours.mean(axis=0) / 255) if len(mesh.colours) else np.full(3, 0.5)
    for number, image in enumerate(images):
        label = name if len(images) == 1 else f"{name} {number + 1}"
        data.materials.append(_material(label, image, mean, filled=False))
        data.materials.append(_material(f"{label} Filled", image, mean, filled=True))
    _attribute(data, "material_index", "INT", "FACE", "value", page * 2 + mesh.filled)
    data.validate()  # a face that names a vertex twice would crash Blender later
    data.shade_smooth()
    data.set_sharp_from_angle(angle=float(np.radians(SHARP_ANGLE)))
    data.color_attributes.active_color_name = COLOUR
    data.color_attributes.render_color_index = data.color_attributes.find(COLOUR)
    item = bpy.data.objects.new(name, data)
    collection.objects.link(item)
    return item


def remove(item: bpy.types.Object) -> None:
    """Remove an imported surface with those of its materials and images that nothing else uses."""
    data = item.data
    bpy.data.objects.remove(item)
    if data.users:
        return
    materials = [material for material in data.materials if material is not None]
    bpy.data.meshes.remove(data)
    for material in materials:
        nodes = material.node_tree.nodes if material.node_tree is not None else ()
        images = {node.image for node in nodes if node.type == "TEX_IMAGE" and node.image is not None}
        if not material.users:
            bpy.data.materials.remove(material)
        for image in images:
            if not image.users:
                bpy.data.images.remove(image)


def is_surface(item: bpy.types.Object) -> bool:
    return item.type == "MESH" and SURFACE_KEY in item.data


def surfaces_of(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The scene's imported surfaces, largest first."""
    found = [item for item in scene.objects if is_surface(item)]
    return sorted(found, key=lambda item: -len(item.data.polygons))


def show_filled(scene: bpy.types.Scene, tinted: bool) -> None:
    """Tint the filled faces of the scene's surfaces, in every kind of shading and in renders, or show them plainly."""
    for item in surfaces_of(scene):
        for material in item.data.materials:
            if material is None or FILLED_KEY not in material or material.node_tree is None:
                continue
            nodes = material.node_tree.nodes
            if FILLED_NODE in nodes:
                nodes[FILLED_NODE].inputs[0].default_value = TINT_STRENGTH if tinted else 0.0
            # Solid shading shows the active image node, or else the viewport colour.
            if (shown := nodes.get(TINT_IMAGE_NODE if tinted else COLOUR_NODE)) is not None:
                nodes.active = shown
            material.diffuse_color = (*(linear(np.array(TINT)) if tinted else material[FILLED_KEY]), 1.0)
        attributes = item.data.color_attributes
        if (wanted := TINTED if tinted else COLOUR) in attributes:
            attributes.active_color_name = wanted
        item.data.update_tag()


def light(scene: bpy.types.Scene, by_scene: bool) -> None:
    """Let the scene's lights shade the surfaces, or show the photos' colours as they are, with the photos' light."""
    for item in surfaces_of(scene):
        for material in item.data.materials:
            if material is not None and material.node_tree is not None and LIGHT_NODE in material.node_tree.nodes:
                material.node_tree.nodes[LIGHT_NODE].inputs[0].default_value = 0.0 if by_scene else 1.0


def simplify(items: list[bpy.types.Object], simple: bool) -> None:
    """Let the materials be a plain matte surface, which exporters understand, or what they are in Blender."""
    for item in items:
        for material in item.data.materials:
            nodes = material.node_tree.nodes if material is not None and material.node_tree is not None else {}
            if LIGHT_NODE not in nodes:
                continue
            last = nodes[LIGHT_NODE].inputs[1].links[0].from_node if simple else nodes.get(
                FILLED_NODE, nodes[LIGHT_NODE])
            output = next(node for node in nodes if node.type == "OUTPUT_MATERIAL")
            material.node_tree.links.new(last.outputs[0], output.inputs["Surface"])


def page_images(item: bpy.types.Object) -> dict[str, bpy.types.Image]:
    """The image of each of the surface's materials that has one, by the material's name."""
    found = {}
    for material in item.data.materials:
        node = material.node_tree.nodes.get(COLOUR_NODE) if material is not None and material.node_tree else None
        if node is not None and node.type == "TEX_IMAGE" and node.image is not None:
            found[material.name] = node.image
    return found


def _geometry(data: bpy.types.Mesh, mesh: Mesh) -> None:
    data.vertices.add(len(mesh.vertices))
    data.vertices.foreach_set("co", np.ascontiguousarray(mesh.vertices, np.float32).ravel())
    data.loops.add(3 * len(mesh.faces))
    data.loops.foreach_set("vertex_index", np.ascontiguousarray(mesh.faces, np.int32).ravel())
    data.polygons.add(len(mesh.faces))
    data.polygons.foreach_set("loop_start", np.arange(0, 3 * len(mesh.faces), 3, dtype=np.int32))
    data.update(calc_edges=True)


def _attribute(
    data: bpy.types.Mesh, name: str, kind: str, domain: str, field: str, values: np.ndarray
) -> None:
    attribute = data.attributes.get(name) or data.attributes.new(name, kind, domain)
    attribute.data.foreach_set(field, np.ascontiguousarray(values).ravel())


def _image(path: Path, pack: bool) -> bpy.types.Image:
    image = bpy.data.images.load(str(path))
    if pack:
        image.pack()
    return image


def _material(name: str, image: bpy.types.Image | None, mean: np.ndarray, *, filled: bool) -> bpy.types.Material:
    """The photos' colour, as the photos' own light showed it or on a matte surface in the scene's light."""
    material = bpy.data.materials.new(name)
    if material.node_tree is None:  # before Blender 5.0 a new material has no nodes yet
        material.use_nodes = True
    material.diffuse_color, material.roughness, material.specular_intensity = (*mean, 1.0), 1.0, 0.0
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    colour = nodes.new("ShaderNodeTexImage" if image is not None else "ShaderNodeAttribute")
    matte, photo = nodes.new("ShaderNodeBsdfPrincipled"), nodes.new("ShaderNodeEmission")
    mix, output = nodes.new("ShaderNodeMixShader"), nodes.new("ShaderNodeOutputMaterial")
    colour.name = colour.label = COLOUR_NODE
    mix.name = mix.label = LIGHT_NODE
    if image is not None:
        colour.image, colour.extension = image, "EXTEND"
    else:
        colour.attribute_type, colour.attribute_name = "GEOMETRY", COLOUR
    matte.inputs["Roughness"].default_value = 1.0
    matte.inputs["Specular IOR Level"].default_value = 0.0
    mix.inputs[0].default_value = 1.0
    for node, place in ((colour, (-600, 100)), (matte, (-280, 300)), (photo, (-280, -120)), (mix, (20, 100)),
                        (output, (460, 100))):
        node.location = place
    links.new(colour.outputs["Color"], matte.inputs["Base Color"])
    links.new(colour.outputs["Color"], photo.inputs["Color"])
    links.new(matte.outputs[0], mix.inputs[1])
    links.new(photo.outputs[0], mix.inputs[2])
    links.new(mix.outputs[0], output.inputs["Surface"])
    if filled:
        material[FILLED_KEY] = mean.tolist()
        _add_tint(material, mix, output, solid=image is not None)
    nodes.active = colour
    if hasattr(material, "cycles"):  # the Cycles add-on can be switched off
        # Each face would otherwise count as a lamp, and Cycles would sample millions of them.
        material.cycles.emission_sampling = "NONE"
    return material


def _add_tint(
    material: bpy.types.Material, shader: bpy.types.Node, output: bpy.types.Node, *, solid: bool
) -> None:
    nodes, links = material.node_tree.nodes, material.node_tree.links
    tint, mix = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeMixShader")
    mix.name = mix.label = FILLED_NODE
    mix.inputs[0].default_value = 0.0
    tint.inputs["Color"].default_value = (*linear(np.array(TINT)), 1.0)
    tint.location, mix.location = (20, -120), (240, 100)
    links.new(shader.outputs[0], mix.inputs[1])
    links.new(tint.outputs[0], mix.inputs[2])
    links.new(mix.outputs[0], output.inputs["Surface"])
    if solid:
        node = nodes.new("ShaderNodeTexImage")  # linked to nothing: Solid shading shows it while it is active
        node.name = node.label = TINT_IMAGE_NODE
        node.image, node.location = _tint_image(), (-600, -300)


def _tint_image() -> bpy.types.Image:
    """A picture of the tint, shared by all surfaces and kept in the .blend (Blender writes none that is generated by
    colour alone, but its settings, from which it comes back)."""
    image = bpy.data.images.get(FILLED_KEY)
    if image is None:
        image = bpy.data.images.new(FILLED_KEY, 1, 1)
        image.generated_color = (*TINT, 1.0)
    return image
