# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The surface as a mesh object: its texture or vertex colours, what supports it, and the two ways to look at it.

Every page of texture has three materials, one for faces that photos measured, one for those that were filled in and one
for those that one photo alone measured, so that the latter two can be tinted by a switch in theirs: nothing is rebuilt.
All show the photos' colours as they are (the photos' own light) or lit by the scene.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import bpy
import numpy as np

from ..core.base.errors import WorkspaceError
from ..core.base.language import Text
from ..core.surface.mesh import SHARP_ANGLE, Mesh
from ..core.surface.triangles import face_normals, mesh_edges, unit
from .marks import COLOUR_NODE, FILLED_NODE, MARKS, add_tint, mark_key
from .points import COLOUR, SUBJECT_SAMPLE, fill, linear, linear_colours, positions

SURFACE_KEY = "curecon_surface"  # marks the mesh data that came from a workspace
GROUND_KEY = "curecon_plain_ground"  # and that of a ground under it, which is no record
UV = "UVMap"
# Names of nodes, by which the switches find them.
LIGHT_NODE, RELIEF_NODE = "Light", "Relief"


def pictures(mesh: Mesh, file: Path) -> tuple[list[Path], list[Path]]:
    """The pages' files of a mesh that was read from `file`, and those of its normal map. Raises WorkspaceError where
    one is missing, or where a face names one that is not there; -1 is a face too thin to be on any."""
    paths, normals = ([file.parent / page for page in pages] for pages in (mesh.pages, mesh.normal_pages))
    for path in (*paths, *normals):
        if not path.is_file():
            raise WorkspaceError(
                Text("The texture {} is missing.", path), remedy="Run Texture again in this workspace.", path=path
            )
    if mesh.page is not None and len(mesh.page) and not -1 <= mesh.page.min() <= mesh.page.max() < len(paths):
        raise WorkspaceError(
            Text("{} is damaged: a face names a texture that is not there.", file),
            remedy="Run Texture again.", path=file
        )
    return paths, normals


@dataclass(frozen=True)
class SurfaceArrays:
    """A surface as its object stores it.

    `mesh` has no face that names a vertex twice, which would crash Blender later; `edges` (E,2) int32 are its edges'
    vertices and `corner_edges` (M,3) int32 the edge from each corner to the next; `colours` (N,4) float32 linear;
    `mean` (3,) the mean colour; `material` (M,) int32; `pages` the textures' files, `normal_pages` those of the
    normal map, if any.
    """

    mesh: Mesh
    edges: np.ndarray
    corner_edges: np.ndarray
    colours: np.ndarray
    mean: np.ndarray
    material: np.ndarray
    pages: list[Path]
    normal_pages: list[Path]


def arrays(mesh: Mesh, pages: list[Path], normal_pages: Sequence[Path] = ()) -> SurfaceArrays:
    """What `build` needs of a surface. No bpy: it may run on any thread."""
    faces = mesh.faces
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    if not whole.all():
        mesh = replace(mesh, faces=faces[whole], filled=mesh.filled[whole],
                       weak=None if mesh.weak is None else mesh.weak[whole],
                       unseen=None if mesh.unseen is None else mesh.unseen[whole],
                       uv=None if mesh.uv is None else mesh.uv[whole],
                       page=None if mesh.page is None else mesh.page[whole])
    edges, corner_edges = mesh_edges(mesh.faces)  # Blender would take some hundred milliseconds for it
    page = np.zeros(len(mesh.faces), np.int32) if mesh.page is None else np.maximum(mesh.page, 0)
    weak = np.zeros(len(mesh.faces), bool) if mesh.weak is None else mesh.weak
    return SurfaceArrays(
        mesh=mesh, edges=edges, corner_edges=corner_edges, colours=linear_colours(mesh.colours),
        mean=linear(mesh.colours.mean(axis=0) / 255) if len(mesh.colours) else np.full(3, 0.5),
        material=(page * (1 + len(MARKS)) + np.where(mesh.filled, 1, 2 * weak)).astype(np.int32), pages=pages,
        normal_pages=[*normal_pages],
    )


def build(
    content: SurfaceArrays, name: str, collection: bpy.types.Collection, *, pack: bool = False
) -> Generator[str, None, bpy.types.Object]:
    """Link a mesh object with the surface into `collection`, a few milliseconds of work a step; returns it.

    Attributes: Color, distance (world units to the nearest measured point) and views a vertex; filled, weak and
    unseen a face; UVs and the pages' images where it is textured. Images stay in their files unless `pack`.
    """
    mesh = content.mesh
    data = bpy.data.meshes.new(name)
    data[SURFACE_KEY] = True
    item = bpy.data.objects.new(name, data)
    collection.objects.link(item)
    yield from _geometry(data, content)
    values = [
        ("distance", "FLOAT", "POINT", "value", mesh.distance),
        ("views", "INT", "POINT", "value", mesh.views.astype(np.int32)),
        ("filled", "BOOLEAN", "FACE", "value", mesh.filled),
        (COLOUR, "FLOAT_COLOR", "POINT", "color", content.colours),
        ("material_index", "INT", "FACE", "value", content.material),
    ]
    for mark, which in (("weak", mesh.weak), ("unseen", mesh.unseen)):
        if which is not None:
            values.append((mark, "BOOLEAN", "FACE", "value", which))
    if mesh.uv is not None:
        values.append((UV, "FLOAT2", "CORNER", "vector", mesh.uv))
    yield from fill(data, "Making the surface", values)
    textured = mesh.uv is not None
    for number in range(len(content.pages) if textured else 1):
        yield "Making the surface"
        image = _image(content.pages[number], pack) if textured else None
        relief = _image(content.normal_pages[number], pack) if content.normal_pages else None
        label = name if len(content.pages) < 2 else f"{name} {number + 1}"
        data.materials.append(_material(label, image, relief, content.mean))
        for mark in MARKS:
            data.materials.append(_material(f"{label} {mark.capitalize()}", image, relief, content.mean, mark))
    yield "Making the surface"
    data.update()
    yield "Making the surface"
    data.shade_smooth()
    data.set_sharp_from_angle(angle=float(np.radians(SHARP_ANGLE)))
    data.color_attributes.active_color_name = COLOUR
    data.color_attributes.render_color_index = data.color_attributes.find(COLOUR)
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


def is_ground(item: bpy.types.Object) -> bool:
    return item.type == "MESH" and GROUND_KEY in item.data


def surfaces_of(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The scene's imported surfaces, largest first."""
    found = [item for item in scene.objects if is_surface(item)]
    return sorted(found, key=lambda item: -len(item.data.polygons))


def measured_faces(item: bpy.types.Object) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places and unit normals (n,3) in the world, and areas (n,) in the mesh's units, of the faces of a surface that
    were measured and whose colours a photo shows."""
    data = item.data
    count = len(data.polygons)
    kept = np.ones(count, bool)
    for mark in ("filled", "unseen"):
        if mark in data.attributes and len(data.attributes[mark].data) == count:
            told = np.empty(count, bool)
            data.attributes[mark].data.foreach_get("value", told)
            kept &= ~told
    places, normals = np.empty((2, count, 3), np.float32)
    areas = np.empty(count, np.float32)
    for values, name in ((places, "center"), (normals, "normal"), (areas, "area")):
        data.polygons.foreach_get(name, values.ravel())
    to_world = np.array(item.matrix_world)
    normals = unit(normals[kept] @ np.linalg.inv(to_world[:3, :3]))
    return places[kept] @ to_world[:3, :3].T + to_world[:3, 3], normals, areas[kept]


def facing(data: bpy.types.Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals (N,3) and areas (N,) float32 of a fair sample of a surface's triangles. Asked for all of them,
    Blender takes a tenth of a second for a million."""
    if len(data.loops) == 3 * len(data.polygons):
        corners = np.empty(len(data.loops), np.int32)
        data.attributes[".corner_vert"].data.foreach_get("value", corners)
    else:  # the user has made other faces of some
        data.calc_loop_triangles()
        corners = np.empty(3 * len(data.loop_triangles), np.int32)
        data.loop_triangles.foreach_get("vertices", corners)
    triangles = corners.reshape(-1, 3)
    across = face_normals(positions(data), triangles[:: max(1, len(triangles) // SUBJECT_SAMPLE)])
    lengths = np.linalg.norm(across, axis=1)
    return across / np.maximum(lengths, 1e-12)[:, None], lengths / 2


def light(scene: bpy.types.Scene, by_scene: bool) -> None:
    """Let the scene's lights shade the surfaces and the ground, or show the photos' colours as they are, with the
    photos' light."""
    for item in (item for item in scene.objects if is_surface(item) or is_ground(item)):
        for material in (slot.material for slot in item.material_slots):
            if material is not None and material.node_tree is not None and LIGHT_NODE in material.node_tree.nodes:
                material.node_tree.nodes[LIGHT_NODE].inputs[0].default_value = 0.0 if by_scene else 1.0


def simplify(items: list[bpy.types.Object], simple: bool, *, relief: bool = True) -> None:
    """Let the materials be a plain matte surface, which exporters understand, or what they are in Blender, with their
    normal maps or without."""
    for item in items:
        for material in item.data.materials:
            nodes = material.node_tree.nodes if material is not None and material.node_tree is not None else {}
            if LIGHT_NODE not in nodes:
                continue
            matte, links = nodes[LIGHT_NODE].inputs[1].links[0].from_node, material.node_tree.links
            last = matte if simple else nodes.get(FILLED_NODE, nodes[LIGHT_NODE])
            output = next(node for node in nodes if node.type == "OUTPUT_MATERIAL")
            links.new(last.outputs[0], output.inputs["Surface"])
            if RELIEF_NODE in nodes and relief:
                links.new(nodes[RELIEF_NODE].outputs[0], matte.inputs["Normal"])
            elif RELIEF_NODE in nodes:
                links.remove(matte.inputs["Normal"].links[0])


def add_facts(material: bpy.types.Material, name: str, flag: float) -> None:
    """Give a material a node `name` whose factor, at 1, lets it show in place of its colour: the depth before the
    camera, and the normal's parts to the right and up, with `flag` more where the face is filled, and unseen."""
    nodes, links = material.node_tree.nodes, material.node_tree.links
    output = next(node for node in nodes if node.type == "OUTPUT_MATERIAL")
    geometry, camera, turn, parts, facts, told, switch = (nodes.new(f"ShaderNode{kind}") for kind in (
        "NewGeometry", "CameraData", "VectorTransform", "SeparateXYZ", "CombineXYZ", "Emission", "MixShader"))
    turn.vector_type, turn.convert_from, turn.convert_to = "NORMAL", "WORLD", "CAMERA"
    switch.name = switch.label = name
    switch.inputs[0].default_value = 0.0
    links.new(geometry.outputs["Normal"], turn.inputs[0])
    links.new(turn.outputs[0], parts.inputs[0])
    links.new(camera.outputs["View Z Depth"], facts.inputs[0])
    for part, mark in ((0, "filled"), (1, "unseen")):
        attribute, added = nodes.new("ShaderNodeAttribute"), nodes.new("ShaderNodeMath")
        attribute.attribute_type, attribute.attribute_name = "GEOMETRY", mark
        added.operation, added.inputs[1].default_value = "MULTIPLY_ADD", flag
        links.new(attribute.outputs["Fac"], added.inputs[0])
        links.new(parts.outputs[part], added.inputs[2])
        links.new(added.outputs[0], facts.inputs[part + 1])
    links.new(facts.outputs[0], told.inputs["Color"])
    links.new(output.inputs["Surface"].links[0].from_socket, switch.inputs[1])
    links.new(told.outputs[0], switch.inputs[2])
    links.new(switch.outputs[0], output.inputs["Surface"])


def page_images(item: bpy.types.Object) -> dict[str, bpy.types.Image]:
    """The image of each of the surface's materials that has one, by the material's name."""
    found = {}
    for material in item.data.materials:
        node = material.node_tree.nodes.get(COLOUR_NODE) if material is not None and material.node_tree else None
        if node is not None and node.type == "TEX_IMAGE" and node.image is not None:
            found[material.name] = node.image
    return found


def _geometry(data: bpy.types.Mesh, content: SurfaceArrays) -> Generator[str, None, None]:
    """Triangles with their edges, through Blender's own attributes: vertices and loops take values one by one."""
    mesh = content.mesh
    data.vertices.add(len(mesh.vertices))
    data.edges.add(len(content.edges))
    data.loops.add(mesh.faces.size)
    data.polygons.add(len(mesh.faces))
    yield from fill(data, "Making the surface", (
        ("position", "FLOAT_VECTOR", "POINT", "vector", mesh.vertices),
        (".edge_verts", "INT32_2D", "EDGE", "value", content.edges),
        (".corner_vert", "INT", "CORNER", "value", mesh.faces),
        (".corner_edge", "INT", "CORNER", "value", content.corner_edges),
    ))
    yield "Making the surface"
    data.polygons.foreach_set("loop_start", np.arange(0, mesh.faces.size, 3, dtype=np.int32))


def _image(path: Path, pack: bool) -> bpy.types.Image:
    image = bpy.data.images.load(str(path))
    if pack:
        image.pack()
    return image


def _material(
    name: str, image: bpy.types.Image | None, relief: bpy.types.Image | None, mean: np.ndarray, mark: str = ""
) -> bpy.types.Material:
    """The photos' colour, as the photos' own light showed it or on a matte surface in the scene's light, with the
    normal map `relief`."""
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
    if relief is not None:
        _add_relief(material, relief, matte)
    if mark:
        material[mark_key(mark)] = mean.tolist()
        add_tint(material, mark, mix, output, solid=image is not None)
    nodes.active = colour
    if hasattr(material, "cycles"):  # the Cycles add-on can be switched off
        # Each face would otherwise count as a lamp, and Cycles would sample millions of them.
        material.cycles.emission_sampling = "NONE"
    return material


def ground_material(name: str) -> bpy.types.Material:
    """The vertices' colours as a surface has them, melting away as their alpha falls."""
    material = _material(name, None, None, np.full(3, 0.5))
    nodes, links = material.node_tree.nodes, material.node_tree.links
    output = next(node for node in nodes if node.type == "OUTPUT_MATERIAL")
    nothing, mix = nodes.new("ShaderNodeBsdfTransparent"), nodes.new("ShaderNodeMixShader")
    links.new(nodes[COLOUR_NODE].outputs["Alpha"], mix.inputs[0])
    links.new(nothing.outputs[0], mix.inputs[1])
    links.new(nodes[LIGHT_NODE].outputs[0], mix.inputs[2])
    links.new(mix.outputs[0], output.inputs["Surface"])
    return material


def _add_relief(material: bpy.types.Material, relief: bpy.types.Image, matte: bpy.types.Node) -> None:
    nodes, links = material.node_tree.nodes, material.node_tree.links
    picture, directions = nodes.new("ShaderNodeTexImage"), nodes.new("ShaderNodeNormalMap")
    directions.name = directions.label = RELIEF_NODE
    relief.colorspace_settings.is_data = True
    picture.image, picture.extension = relief, "EXTEND"
    directions.uv_map = UV
    picture.location, directions.location = (-900, 400), (-560, 400)
    links.new(picture.outputs["Color"], directions.inputs["Color"])
    links.new(directions.outputs["Normal"], matte.inputs["Normal"])
