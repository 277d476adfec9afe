# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How clouds are shown: which points, how large, in which colours. The scene's settings are the one truth; they act
through a Geometry Nodes modifier and the material in Material Preview and renders, and in the shader of viewport.py in
Solid shading."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix

from . import region
from .points import COLOUR, MATERIAL, PRECISION, colour_material, linear, positions

MODIFIER = "CU-Recon Display"
REMOVED = "removed"  # the attribute of points that the user took out
REMOVED_KEY = "curecon_removed"  # on cloud data: tells one set of removed points from another
PHOTO, HEIGHT, CONFIDENCE, VIEWS, NORMAL, SIGMA = "PHOTO", "HEIGHT", "CONFIDENCE", "VIEWS", "NORMAL", "PRECISION"
RAMP = ((0.0, (68, 20, 110)), (0.3, (40, 95, 150)), (0.55, (30, 155, 135)), (0.8, (150, 205, 70)),
        (1.0, (253, 231, 60)))  # sRGB, dark to light, so that it reads in grey as well
RAMP_NODE, RANGE_NODE = "Ramp", "Range"
SAMPLE = 100_000  # points that tell the range of a quantity
PIECE = 1 << 14  # points whose places stay in the processor's cache


@dataclass(frozen=True)
class Display:
    """The scene's settings. `share` in [0, 1] acts in viewports only; `region_from_world` takes the region box to the
    cube from -1 to 1, None when the whole cloud is shown; `low` and `high` are the ramp's ends."""

    share: float
    size: float
    min_confidence: float
    min_views: int
    region_from_world: Matrix | None
    colour_by: str
    low: float
    high: float


def of(scene: bpy.types.Scene) -> Display:
    properties, cloud = scene.curecon, scene.curecon.cloud
    box = properties.region if cloud.only_region else None
    return Display(
        properties.display_fraction / 100, properties.point_size, cloud.min_confidence, cloud.min_views,
        region.from_world(box) if box is not None else None, cloud.colour_by, cloud.low, cloud.high,
    )


def apply(scene: bpy.types.Scene, clouds: list[bpy.types.Object]) -> None:
    """Hand the scene's settings to the clouds' modifiers and their material."""
    properties, display = scene.curecon, of(scene)
    box = properties.region if properties.cloud.only_region else None
    values: dict[str, object] = {
        "Share": display.share, "Point Size": display.size, "Min Confidence": display.min_confidence,
        "Min Views": display.min_views, "Only Region": box is not None, "Region": box,
    }
    nodes_show = nodes_needed()
    for item in clouds:
        modifier = item.modifiers.get(MODIFIER) or _equip(item)
        if modifier.show_viewport != nodes_show:
            modifier.show_viewport = nodes_show
        for name, value in values.items():
            _set_input(modifier, name, value)
        _set_input(modifier, "Material", item.active_material)
        if nodes_show:
            item.update_tag()
    if clouds:
        _colour(display, clouds[0].matrix_world.median_scale)


def nodes_needed() -> bool:
    """Whether Geometry Nodes must act in viewports: they take a tenth of a second for millions of points, which
    Solid shading, where viewport.py draws, need not wait for. Renders always have them."""
    return bpy.app.background or any(
        area.spaces.active.shading.type in {"MATERIAL", "RENDERED"}
        for window in bpy.context.window_manager.windows for area in window.screen.areas if area.type == "VIEW_3D"
    )


def measure_range(scene: bpy.types.Scene, clouds: list[bpy.types.Object]) -> tuple[float, float]:
    """Ends for the ramp that suit what the scene colours by: those of the middle 96 % of the points."""
    kind = scene.curecon.cloud.colour_by
    if kind == CONFIDENCE:
        return 0.0, 1.0
    values: list[np.ndarray] = []
    for item in clouds:
        step = max(1, len(item.data.points) // SAMPLE)  # their order is random: any part is fair
        if kind == HEIGHT:
            places = positions(item.data)[::step]
            row = np.array(item.matrix_world[2])
            values.append(places @ row[:3] + row[3])
        elif kind == SIGMA:
            values.append(_values(item.data, PRECISION, np.float32)[::step] * item.matrix_world.median_scale)
        else:
            values.append(_values(item.data, "views", np.int32)[::step])
    if not values or not sum(map(len, values)):
        return 0.0, 1.0
    # What is far off is known so much worse that a site would be all of one colour.
    low, high = np.percentile(np.concatenate(values), [2, 80 if kind == SIGMA else 98])
    return float(low), float(max(high, low + 1e-3))


def shown(scene: bpy.types.Scene, item: bpy.types.Object, places: np.ndarray) -> np.ndarray:
    """Which of a cloud's points (N,) bool the viewport shows; `places` (N,3) are theirs in its own frame."""
    display, data = of(scene), item.data
    kept = np.ones(len(places), bool)
    kept[round(len(places) * display.share) :] = False
    if display.min_confidence > 0:
        kept &= _values(data, "confidence", np.float32) >= display.min_confidence
    if display.min_views > 0:
        kept &= _values(data, "views", np.int32) >= display.min_views
    if REMOVED in data.attributes:
        kept &= ~_values(data, REMOVED, bool)
    if display.region_from_world is not None:
        kept &= inside(places, display.region_from_world @ item.matrix_world)
    return kept


def key(scene: bpy.types.Scene, item: bpy.types.Object) -> tuple[object, ...]:
    """What `shown` depends on."""
    display = of(scene)
    box = display.region_from_world
    return (item.data.session_uid, len(item.data.points), item.data.get(REMOVED_KEY), display.share,
            display.min_confidence, display.min_views, None if box is None else tuple(map(tuple, box)))


def inside(places: np.ndarray, region_from_object: Matrix) -> np.ndarray:
    """Which of `places` (N,3) lie in the region box: (N,) bool."""
    matrix = np.array(region_from_object, np.float32)
    within = np.empty(len(places), bool)
    for start in range(0, len(places), PIECE):
        x, y, z = np.abs(matrix[:3, :3] @ places[start : start + PIECE].T + matrix[:3, 3:]) <= 1
        within[start : start + PIECE] = x & y & z
    return within


def ramp_node() -> bpy.types.Node | None:
    """The node whose ramp colours by a quantity, which users may change; None before any cloud was shown."""
    material = bpy.data.materials.get(MATERIAL)
    return None if material is None else material.node_tree.nodes.get(RAMP_NODE)


def knows_precision(clouds: list[bpy.types.Object]) -> bool:
    """Whether the points' standard deviations are known of any of the clouds."""
    return any(PRECISION in item.data.attributes for item in clouds)


def _values(data: bpy.types.PointCloud, name: str, kind: type) -> np.ndarray:
    values: np.ndarray = np.zeros(len(data.points), kind)
    if name in data.attributes:  # not every cloud knows its precision
        data.attributes[name].data.foreach_get("value", values)
    return values


def _set_input(modifier: bpy.types.Modifier, name: str, value: object) -> None:
    identifier = next(socket.identifier for socket in modifier.node_group.interface.items_tree
                      if socket.name == name and socket.in_out == "INPUT")
    if hasattr(modifier, "properties"):  # Blender 5.2
        getattr(modifier.properties.inputs, identifier).value = value
    else:
        modifier[identifier] = value


def _equip(item: bpy.types.Object) -> bpy.types.Modifier:
    modifier = item.modifiers.new(MODIFIER, "NODES")
    modifier.node_group = bpy.data.node_groups.get(MODIFIER) or _build_nodes()
    return modifier


class _Tree:
    """A tree of Geometry Nodes that is being built, and what it is built of."""

    def __init__(self, name: str) -> None:
        self.tree = bpy.data.node_groups.new(name, "GeometryNodeTree")

    def node(self, kind: str, inputs: dict[int | str, object], **settings: object) -> bpy.types.Node:
        """A node whose inputs are values, or links from other nodes' outputs."""
        made = self.tree.nodes.new(kind)
        for name, value in settings.items():
            setattr(made, name, value)
        for socket, value in inputs.items():
            if isinstance(value, bpy.types.NodeSocket):
                self.tree.links.new(value, made.inputs[socket])
            else:
                made.inputs[socket].default_value = value
        return made

    def attribute(self, name: str, kind: str) -> bpy.types.NodeSocket:
        return self.node("GeometryNodeInputNamedAttribute", {"Name": name}, data_type=kind).outputs["Attribute"]

    def either(self, *conditions: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
        result, *others = conditions
        for other in others:
            result = self.node("FunctionNodeBooleanMath", {0: result, 1: other}, operation="OR").outputs[0]
        return result

    def compare(
        self, first: bpy.types.NodeSocket, second: bpy.types.NodeSocket, how: str = "LESS_THAN"
    ) -> bpy.types.NodeSocket:
        return self.node("FunctionNodeCompare", {0: first, 1: second}, data_type="FLOAT", operation=how).outputs[0]


def _build_nodes() -> bpy.types.NodeTree:
    """Points that pass all thresholds keep on; their radius is multiplied by the point size."""
    made = _Tree(MODIFIER)
    sockets, node = made.tree.interface, made.node
    sockets.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    sockets.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    for name, kind, default in (("Share", "Float", 1.0), ("Point Size", "Float", 1.0), ("Min Confidence", "Float", 0.0),
                                ("Min Views", "Int", 0), ("Only Region", "Bool", False)):
        sockets.new_socket(name, in_out="INPUT", socket_type=f"NodeSocket{kind}").default_value = default
    sockets.new_socket("Region", in_out="INPUT", socket_type="NodeSocketObject")
    sockets.new_socket("Material", in_out="INPUT", socket_type="NodeSocketMaterial")
    given = made.tree.nodes.new("NodeGroupInput").outputs
    dropped = made.either(
        made.compare(made.attribute("confidence", "FLOAT"), given["Min Confidence"]),
        made.compare(made.attribute("views", "INT"), given["Min Views"]),
        made.attribute(REMOVED, "BOOLEAN"), _beyond_share(made, given), _outside_region(made, given),
    )
    kept = node("GeometryNodeDeleteGeometry", {"Geometry": given["Geometry"], "Selection": dropped})
    radius = node("ShaderNodeMath", {0: made.attribute("radius", "FLOAT"), 1: given["Point Size"]},
                  operation="MULTIPLY").outputs[0]
    sized = node("GeometryNodeSetPointRadius", {"Points": kept.outputs[0], "Radius": radius})
    # Deleting points loses a point cloud's materials.
    painted = node("GeometryNodeSetMaterial", {"Geometry": sized.outputs[0], "Material": given["Material"]})
    node("NodeGroupOutput", {0: painted.outputs[0]})
    for index, item in enumerate(made.tree.nodes):  # a readable grid for who opens it
        item.location = (index // 6 * 220, -(index % 6) * 190)
    return made.tree


def _beyond_share(made: _Tree, given: bpy.types.NodeOutputs) -> bpy.types.NodeSocket:
    """Whether a viewport that shows a share of the cloud leaves the point out: a prefix is a fair sample. Renders show
    all."""
    size = made.node("GeometryNodeAttributeDomainSize", {"Geometry": given["Geometry"]}, component="POINTCLOUD")
    share = made.node("GeometryNodeSwitch", {
        "Switch": made.node("GeometryNodeIsViewport", {}).outputs[0], "False": 1.0, "True": given["Share"],
    }, input_type="FLOAT").outputs[0]
    last = made.node("ShaderNodeMath", {0: size.outputs["Point Count"], 1: share}, operation="MULTIPLY").outputs[0]
    return made.compare(made.node("GeometryNodeInputIndex", {}).outputs[0], last, "GREATER_EQUAL")


def _outside_region(made: _Tree, given: bpy.types.NodeOutputs) -> bpy.types.NodeSocket:
    """Whether the point lies outside of the region box and only what is inside is shown. In the box's own axes, so that
    a turned box cuts as it stands."""
    here = made.node("GeometryNodeObjectInfo", {"Object": given["Region"]}, transform_space="RELATIVE")
    own = made.node("GeometryNodeObjectInfo", {"Object": given["Region"]}, transform_space="ORIGINAL")
    bounds = made.node("GeometryNodeBoundBox", {"Geometry": own.outputs["Geometry"]})
    back = made.node("FunctionNodeInvertMatrix", {"Matrix": here.outputs["Transform"]})
    place = made.node("FunctionNodeTransformPoint", {
        "Vector": made.node("GeometryNodeInputPosition", {}).outputs[0], "Transform": back.outputs["Matrix"],
    }).outputs[0]
    place, low, high = (made.node("ShaderNodeSeparateXYZ", {0: vector}).outputs
                        for vector in (place, bounds.outputs["Min"], bounds.outputs["Max"]))
    outside = made.either(*(made.compare(*pair) for axis in range(3)
                            for pair in ((place[axis], low[axis]), (high[axis], place[axis]))))
    # A switch, since what it does not need is not worked out for each point.
    return made.node("GeometryNodeSwitch", {"Switch": given["Only Region"], "False": False, "True": outside},
                     input_type="BOOLEAN").outputs[0]


def _material() -> bpy.types.Material:
    """The clouds' material with the nodes that colour by a quantity."""
    material = colour_material()
    nodes = material.node_tree.nodes
    if RAMP_NODE not in nodes:
        links = material.node_tree.links
        scale, colours = nodes.new("ShaderNodeMapRange"), nodes.new("ShaderNodeValToRGB")
        scale.name, colours.name = RANGE_NODE, RAMP_NODE
        scale.location, colours.location = (-520, -200), (-340, -200)
        links.new(scale.outputs["Result"], colours.inputs[0])
        elements = colours.color_ramp.elements
        while len(elements) < len(RAMP):
            elements.new(0.5)
        for element, (place, srgb) in zip(elements, RAMP, strict=True):
            element.position = place
            element.color = (*(float(value) for value in linear(np.array(srgb) / 255)), 1.0)
    return material


def _colour(display: Display, scale: float) -> None:
    """Set the material to the settings; `scale` takes lengths in the clouds' own frame to the world's."""
    material = _material()
    nodes, links = material.node_tree.nodes, material.node_tree.links
    spread, colours = nodes[RANGE_NODE], nodes[RAMP_NODE]
    own = 1 / scale if display.colour_by == SIGMA else 1.0
    spread.inputs["From Min"].default_value = own * display.low
    spread.inputs["From Max"].default_value = own * display.high
    if material.get("colour_by", PHOTO) == display.colour_by:
        return
    material["colour_by"] = display.colour_by
    emission = next(node for node in nodes if node.type == "EMISSION")
    photo = next(node for node in nodes if node.type == "ATTRIBUTE" and node.attribute_name == COLOUR)
    for node in [node for node in nodes if node.get("source")]:
        nodes.remove(node)

    def source(kind: str) -> bpy.types.Node:
        made = nodes.new(kind)
        made["source"], made.location = True, (-760, -200)
        return made

    result = colours.outputs["Color"]
    if display.colour_by == PHOTO:
        result = photo.outputs["Color"]
    elif display.colour_by == NORMAL:
        normal, half = source("ShaderNodeAttribute"), source("ShaderNodeVectorMath")
        normal.attribute_name, half.operation = "normal", "MULTIPLY_ADD"
        half.inputs[1].default_value = half.inputs[2].default_value = (0.5, 0.5, 0.5)
        links.new(normal.outputs["Vector"], half.inputs[0])
        result = half.outputs[0]
    elif display.colour_by == HEIGHT:
        place, split = source("ShaderNodeNewGeometry"), source("ShaderNodeSeparateXYZ")
        links.new(place.outputs["Position"], split.inputs[0])
        links.new(split.outputs["Z"], spread.inputs["Value"])
    else:
        value = source("ShaderNodeAttribute")
        value.attribute_name = {CONFIDENCE: "confidence", VIEWS: "views", SIGMA: PRECISION}[display.colour_by]
        links.new(value.outputs["Fac"], spread.inputs["Value"])
    links.new(result, emission.inputs["Color"])

