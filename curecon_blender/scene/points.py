# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The fused cloud as point geometry: a PointCloud object with its attributes and a material that shows its colour."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from dataclasses import dataclass
from functools import lru_cache

import bpy
import numpy as np

from ..core.cloud.ply import Cloud

COLOUR = "Color"  # Blender's own spelling, which other tools look for
PRECISION = "precision"  # the attribute of points whose standard deviation is known
MATERIAL = "CU-Recon Colour"
CLOUD_KEY = "curecon_cloud"  # on the point clouds that viewport.py draws: the points of their file
COMPARED_KEY = "curecon_compared"  # on other programs' clouds, which it draws in their own colours: their points
VOXELS_PER_SPACING = 10  # about 20 points of a surface fall into a voxel of the radius estimate
HASH_BITS = 24
LARGEST_RADIUS = 1.5  # times the median: a lone point is no surface, and a big disc would hide what is behind it
CLOSING = 1.2  # discs of radius 1.2 / sqrt(density) leave 1 % of a randomly sampled surface open
SUBJECT = 2.5  # times the median distance from the middle: what a view holds
SUBJECT_CELLS = 48  # along the longest side, for the density there
THIN = 1 / 3  # of the median density: what is measured less is land about the subject, or strays
SPIRE = 1 / 12  # of the median density: as much is enough for what stands on top of the subject
ABOVE = [(x << 42) + (y << 21) + 1 for x in (-1, 0, 1) for y in (-1, 0, 1)]  # from a cell's key to those above it
SUBJECT_SAMPLE = 100_000  # points that suffice to tell what a view should hold
MEDIAN_SAMPLE = 25_000  # points that suffice for a median
SPACING_CELLS = 64  # along the longest side, for the spacing estimate
SPACING_SAMPLES = 48

Bounds = tuple[np.ndarray, np.ndarray]  # lowest and highest x, y, z (3,) in the world


@dataclass(frozen=True)
class CloudArrays:
    """A cloud as its object stores it, in random order, so that any prefix of the points is a fair sample of the whole.

    `points` (N,3) in the object's frame; `radius` (N,) in world units, from the local spacing; `colours` (N,4) linear;
    `confidence` (N,) in [0, 1]; `normals` (N,3); `sigmas` (N,3) as in Cloud; all float32; `views` (N,) int32.
    """

    points: np.ndarray
    radius: np.ndarray
    colours: np.ndarray
    confidence: np.ndarray
    views: np.ndarray
    normals: np.ndarray
    sigmas: np.ndarray

    def __len__(self) -> int:
        return len(self.points)


def arrays(cloud: Cloud) -> CloudArrays:
    """What `build` needs of a cloud. No bpy: it may run on any thread."""
    order = file_order(len(cloud))
    return CloudArrays(
        points=cloud.points[order], radius=radii(cloud.points)[order], colours=linear_colours(cloud.colours[order]),
        confidence=cloud.confidence[order], views=cloud.views[order].astype(np.int32), normals=cloud.normals[order],
        sigmas=cloud.sigmas[order],
    )


def build(content: CloudArrays, name: str, collection: bpy.types.Collection) -> Generator[str, None, bpy.types.Object]:
    """Link a PointCloud object into `collection`, an attribute a slice; returns it.

    The attributes are position, radius, Color, confidence, views, normal and, where it is known, sigma with its length,
    precision.
    """
    yield "Making the point cloud"
    data = _new_pointcloud(name, len(content))
    data[CLOUD_KEY] = len(content)
    data.materials.append(colour_material())
    item = bpy.data.objects.new(name, data)
    # As bounds Blender leaves the points out of Solid shading, where it would draw them grey; viewport.py draws them
    # there in colour. Material Preview and renders show the points themselves.
    item.display_type = "BOUNDS"
    collection.objects.link(item)
    known = content.sigmas.any()
    yield from fill(data, "Making the point cloud", (
        ("position", "FLOAT_VECTOR", "POINT", "vector", content.points),
        ("radius", "FLOAT", "POINT", "value", content.radius),
        (COLOUR, "FLOAT_COLOR", "POINT", "color", content.colours),
        ("confidence", "FLOAT", "POINT", "value", content.confidence),
        ("views", "INT", "POINT", "value", content.views),
        ("normal", "FLOAT_VECTOR", "POINT", "vector", content.normals),
        *((("sigma", "FLOAT_VECTOR", "POINT", "vector", content.sigmas),
           (PRECISION, "FLOAT", "POINT", "value", np.linalg.norm(content.sigmas, axis=1))) if known else ()),
    ))
    return item


def fill(
    data: bpy.types.PointCloud | bpy.types.Mesh, doing: str,
    attributes: Iterable[tuple[str, str, str, str, np.ndarray]],
) -> Generator[str, None, None]:
    """Give attributes their values in slices that say what is done: each of `attributes` is a name, which may be new,
    with its type, its domain, the field that takes values, and an array of all values. Blender copies arrays of its
    own types (float vectors, float colours, int32) in milliseconds and converts all others one by one."""
    for name, kind, domain, field, values in attributes:
        yield doing
        attribute = data.attributes.get(name)
        if attribute is None:
            data.attributes.new(name, kind, domain)
            yield doing
            attribute = data.attributes[name]
        attribute.data.foreach_set(field, np.ascontiguousarray(values).ravel())


def linear_colours(srgb: np.ndarray) -> np.ndarray:
    """sRGB bytes (...,3) as opaque linear colours (...,4) float32."""
    colours = np.ones((*srgb.shape[:-1], 4), np.float32)
    colours[..., :3] = linear(np.arange(256) / 255).astype(np.float32)[srgb]
    return colours


@lru_cache(maxsize=2)
def file_order(count: int) -> np.ndarray:
    """Which point of its file (count,) int32 each point of a cloud object is. Read-only, and remembered: finding it
    takes a tenth of a second for millions of points."""
    order: np.ndarray = np.random.default_rng(0).permutation(count).astype(np.int32)
    order.flags.writeable = False
    return order


def radii(points: np.ndarray) -> np.ndarray:
    """A radius (N,) float32 for each of `points` (N,3), so that discs on a surface of that local density close it.

    The density is the number of points in a voxel over the area of its side. A surface may only clip a voxel's corner,
    so the fuller voxel of two staggered grids counts. None is larger than LARGEST_RADIUS times the median.
    """
    voxel = VOXELS_PER_SPACING * spacing(points)
    low = points.min(axis=0, initial=0)
    fullest = np.ones(len(points), np.int64)
    for offset in (0.0, 0.5):
        cells = ((points - low) / voxel + offset).astype(np.int64)
        # Voxels by hash: far cheaper than sorting, and two of them seldom meet.
        cells *= np.array([73_856_093, 19_349_663, 83_492_791])
        keys = (cells[:, 0] ^ cells[:, 1] ^ cells[:, 2]) & ((1 << HASH_BITS) - 1)
        np.maximum(fullest, np.bincount(keys, minlength=1)[keys], out=fullest)
    found = CLOSING * voxel / np.sqrt(fullest)
    if len(found):
        np.minimum(found, LARGEST_RADIUS * np.median(found), out=found)
    return found.astype(np.float32)


def spacing(points: np.ndarray) -> float:
    """Median distance to the nearest neighbour, in the unit of `points` (N,3), from a few full-density cells."""
    if len(points) < 2:
        return 0.01
    rng = np.random.default_rng(0)
    sample = points[rng.integers(0, len(points), 10_000)]
    low, high = np.percentile(sample, [1, 99], axis=0)
    cells_aside = SPACING_CELLS if len(points) > 50_000 else 1  # so that a cell holds enough neighbours
    cell = max(float((high - low).max()) / cells_aside, 1e-9)
    keys = _cell_keys(points, low, cell)
    chosen = np.unique(keys[rng.integers(0, len(points), SPACING_SAMPLES)])
    inside = np.flatnonzero(np.isin(keys, chosen))
    nearest = []
    for key in chosen:
        members = points[inside[keys[inside] == key]]
        queries = members[rng.permutation(len(members))[:SPACING_SAMPLES]]
        squared = ((queries[:, None] - members[None]) ** 2).sum(axis=2)
        squared[squared == 0] = np.inf  # the point itself, and exact doubles
        nearest.append(squared.min(axis=1))
    distances = np.sqrt(np.concatenate(nearest))
    distances = distances[np.isfinite(distances)]
    return float(np.median(distances)) if len(distances) else cell


def _cell_keys(points: np.ndarray, low: np.ndarray, side: float) -> np.ndarray:
    """A number (N,) int64 for the cubic cell of a grid from `low` (3,) that each of `points` (N,3) lies in."""
    cells = np.floor((points - low) / side).astype(np.int64)
    return (cells[:, 0] << 42) + (cells[:, 1] << 21) + cells[:, 2]


def positions(data: bpy.types.PointCloud | bpy.types.Mesh) -> np.ndarray:
    """Every point's or vertex' place (N,3) float32 in its object's frame."""
    return vectors(data, "position")


def vectors(data: bpy.types.PointCloud | bpy.types.Mesh, name: str) -> np.ndarray:
    """The values (N,3) float32 of an attribute of vectors."""
    values = data.attributes[name].data
    # NumPy asks for memory in large pages, which Linux may take a tenth of a second to clear.
    found = np.frombuffer(bytearray(12 * len(values)), np.float32)
    values.foreach_get("vector", found)
    return found.reshape(-1, 3)


def about_the_subject(points: np.ndarray) -> np.ndarray:
    """Which (N,) bool of points (N,3) of a cloud, Z up, a view should hold: photos show far land, too, and a view of
    all of it would show no building. What the photos are about is in the middle, and densely measured; a spire on top
    of it belongs to it, thin and high as it is."""
    if not len(points):
        return np.zeros(0, bool)
    step = max(1, len(points) // MEDIAN_SAMPLE)
    distance = np.linalg.norm(points - np.median(points[::step], axis=0), axis=1)
    near = distance <= SUBJECT * np.median(distance[::step])
    low, high = np.percentile(points[::step][near[::step]], [5, 95], axis=0)
    cell = max(float((high - low).max()) / SUBJECT_CELLS, 1e-9)
    cells, cell_of, counts = np.unique(_cell_keys(points, low, cell), return_inverse=True, return_counts=True)
    median = np.median(counts[cell_of[near]])
    about = np.bincount(cell_of[near], minlength=len(cells)) >= THIN * median
    _add_spires(about, cells, counts >= SPIRE * median)
    dense: np.ndarray = about[cell_of]
    return dense


def _add_spires(about: np.ndarray, cells: np.ndarray, enough: np.ndarray) -> None:
    """Add to the cells of the subject (C,) bool those with `enough` points (C,) bool that stand on it, one upon
    another; `cells` (C,) are their keys in order."""
    kept, candidates = set(cells[about].tolist()), set(cells[enough & ~about].tolist())
    front = kept
    while front:
        front = {above for key in front for step in ABOVE if (above := key + step) in candidates}
        candidates -= front
        kept = kept | front
    about |= np.isin(cells, np.fromiter(kept, np.int64, len(kept)))


def subject(item: bpy.types.Object) -> np.ndarray:
    """A fair sample (N,3) of places in the world that tell what a cloud or a surface is about.

    A surface has its vertices where it is crooked, not where many photos measured it: so its own cloud tells, as far as
    the surface reaches.
    """
    matrix = np.array(item.matrix_world)
    if item.type == "MESH":
        for other in (other for holder in item.users_collection for other in holder.objects):
            if other.type == "POINTCLOUD" and CLOUD_KEY in other.data:
                return subject_of(positions(other.data), matrix, within=np.array(item.bound_box))
    return subject_of(positions(item.data), matrix)


def subject_of(points: np.ndarray, matrix: np.ndarray, within: np.ndarray | None = None) -> np.ndarray:
    """The same of points (N,3) in random order that stand in the world by `matrix` (4,4); of those among places (M,3),
    where any are. No bpy: it may run on any thread."""
    sample = points[:: max(1, len(points) // SUBJECT_SAMPLE)]
    if within is not None and len(within):
        low, high = within.min(axis=0), within.max(axis=0)
        inside = sample[np.logical_and.reduce([(sample[:, axis] >= low[axis]) & (sample[:, axis] <= high[axis])
                                               for axis in range(3)])]
        sample = inside if len(inside) else sample
    found: np.ndarray = sample[about_the_subject(sample)].astype(float) @ matrix[:3, :3].T + matrix[:3, 3]
    return found


def is_cloud(item: bpy.types.Object) -> bool:
    return item.type == "POINTCLOUD" and CLOUD_KEY in item.data


def bounds(places: np.ndarray) -> Bounds | None:
    """Lowest and highest x, y, z of `places` (N,3), strays left out; None where there are none."""
    if not len(places):
        return None
    low, high = np.percentile(places[:: max(1, len(places) // MEDIAN_SAMPLE)], [1, 99], axis=0)
    return low, high


def colour_material(name: str = MATERIAL) -> bpy.types.Material:
    """A shared material: the photos' colours as they are, whatever the scene's light."""
    material = bpy.data.materials.get(name)
    if material is not None:
        return material
    material = bpy.data.materials.new(name)
    if material.node_tree is None:  # before Blender 5.0 a new material has no nodes yet
        material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    colour = nodes.new("ShaderNodeAttribute")
    colour.attribute_type, colour.attribute_name = "GEOMETRY", COLOUR
    emission = nodes.new("ShaderNodeEmission")
    output = nodes.new("ShaderNodeOutputMaterial")
    colour.location, emission.location, output.location = (-200, 0), (0, 0), (200, 0)
    links.new(colour.outputs["Color"], emission.inputs["Color"])
    links.new(emission.outputs["Emission"], output.inputs["Surface"])
    if hasattr(material, "cycles"):  # the Cycles add-on can be switched off
        # Each point would otherwise count as a lamp, and Cycles would sample millions of them.
        material.cycles.emission_sampling = "NONE"
    return material


def linear(srgb: np.ndarray) -> np.ndarray:
    """sRGB in [0, 1] to linear."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def _new_pointcloud(name: str, count: int) -> bpy.types.PointCloud:
    data = bpy.data.pointclouds.new(name)
    if hasattr(data, "resize"):  # Blender 5
        data.resize(count)
        return data
    # Blender 4.5 gives Python no way to size a point cloud: take one that geometry nodes made.
    bpy.data.pointclouds.remove(data)
    tree = bpy.data.node_groups.new(name, "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    source, output = tree.nodes.new("GeometryNodePoints"), tree.nodes.new("NodeGroupOutput")
    source.inputs["Count"].default_value = count
    tree.links.new(source.outputs[0], output.inputs[0])
    mesh = bpy.data.meshes.new(name)
    holder = bpy.data.objects.new(name, mesh)
    scene = bpy.data.scenes.new(name)  # of its own: the user's scene is neither evaluated nor touched
    try:
        scene.collection.objects.link(holder)
        holder.modifiers.new(name, "NODES").node_group = tree
        scene.view_layers[0].update()
        depsgraph = scene.view_layers[0].depsgraph
        geometry = holder.evaluated_get(depsgraph).evaluated_geometry()  # owns the point cloud copied from it
        data = geometry.pointcloud.copy()
    finally:
        bpy.data.scenes.remove(scene)
        bpy.data.objects.remove(holder)
        bpy.data.meshes.remove(mesh)
        bpy.data.node_groups.remove(tree)
    data.name = name
    return data
