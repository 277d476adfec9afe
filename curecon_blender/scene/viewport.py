# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws the clouds in colour in Solid and Wireframe shading, where Blender would draw them grey or not at all.

Each cloud is uploaded once, when it is first drawn; since points.py stores it in random order, drawing a prefix shows a
fair sample of it: as much as the user set and, while the view moves, no more than keeps it fluent. The buffers are made
from the PointCloud's own attributes, so they come back by themselves after a file is loaded, an undo or a reload of the
add-on.
"""

from __future__ import annotations

from collections.abc import Callable

import bpy
import gpu
import numpy as np
from bpy.app.handlers import persistent

from .points import CLOUD_KEY, COLOUR, about_the_subject

MAX_POINT_PIXELS = 40.0
MIN_POINT_PIXELS = 2.0
MOVING_POINTS = 3_000_000  # drawn of all clouds together while the view moves; the rest follows when it rests
REST_SECONDS = 0.25

VERTEX_SOURCE = """
void main()
{
  gl_Position = clip_from_object * vec4(position, 1.0);
  // The point's size in pixels at its depth, so that a near cloud closes to a surface.
  gl_PointSize = clamp(radius * size.x / gl_Position.w, size.y, size.z);
  // sRGB to the viewport's linear colours.
  vec3 low = colour.rgb / 12.92;
  vec3 high = pow((colour.rgb + 0.055) / 1.055, vec3(2.4));
  shown = vec4(mix(low, high, step(vec3(0.04045), colour.rgb)), 1.0);
}
"""
FRAGMENT_SOURCE = "void main() { fragment = shown; }"

_shader: gpu.types.GPUShader | None = None
_batches: dict[tuple[int, int], gpu.types.GPUBatch] = {}  # by the point cloud's session_uid and number of points
_last_views: dict[int, tuple[float, ...]] = {}  # by region: where it looked from when it was last drawn
_remove_handler: Callable[[], None] | None = None


def start() -> None:
    """Begin to draw in every 3D viewport."""
    global _remove_handler
    handler = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_VIEW")
    _remove_handler = lambda: bpy.types.SpaceView3D.draw_handler_remove(handler, "WINDOW")  # noqa: E731
    bpy.app.handlers.load_pre.append(_forget)


def stop() -> None:
    """Stop drawing and free the graphics memory."""
    global _remove_handler, _shader
    if _remove_handler is not None:
        _remove_handler()
        _remove_handler = None
    bpy.app.handlers.load_pre.remove(_forget)
    _forget()
    if bpy.app.timers.is_registered(_draw_the_rest):
        bpy.app.timers.unregister(_draw_the_rest)
    _shader = None
    redraw()


def redraw() -> None:
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()


def frame(context: bpy.types.Context, item: bpy.types.Object) -> None:
    """Turn every 3D viewport of the window to a cloud or a surface, without what lies far from most of it, from
    obliquely above, with fitting clip planes. Viewports in camera view leave it."""
    from mathutils import Euler, Vector

    if (bounds := subject_bounds(item)) is None:
        return
    low, high = bounds
    centre, size = (low + high) / 2, float(np.linalg.norm(high - low)) * item.matrix_world.median_scale
    for area in context.window.screen.areas if context.window is not None else ():
        if area.type != "VIEW_3D":
            continue
        space = area.spaces.active
        view = space.region_3d
        view.view_perspective = "PERSP"
        view.view_location = item.matrix_world @ Vector(centre.tolist())
        view.view_rotation = Euler((np.radians(58), 0, np.radians(35))).to_quaternion()
        view.view_distance = size * 0.95
        space.clip_start, space.clip_end = size / 2000, size * 50


def subject_bounds(item: bpy.types.Object) -> tuple[np.ndarray, np.ndarray] | None:
    """Lowest and highest x, y, z (3,) of what most of a cloud or a surface is about, in its own frame; None for one
    without points."""
    attribute = item.data.attributes["position"]
    positions = np.empty((len(attribute.data), 3), np.float32)
    if not len(positions):
        return None
    attribute.data.foreach_get("vector", positions.ravel())
    sample = positions[:: max(1, len(positions) // 100_000)]
    low, high = np.percentile(about_the_subject(sample), [2, 98], axis=0)
    return low, high


def show_texture(context: bpy.types.Context, *, textured: bool) -> None:
    """Let Solid shading show the surface's texture or its vertex colours, where it shows plain materials so far."""
    for area in context.window.screen.areas if context.window is not None else ():
        if area.type == "VIEW_3D":
            shading = area.spaces.active.shading
            if shading.color_type in {"MATERIAL", "TEXTURE", "VERTEX"}:
                shading.color_type = "TEXTURE" if textured else "VERTEX"


@persistent
def _forget(*_: object) -> None:
    _batches.clear()
    _last_views.clear()


def _draw_the_rest() -> None:
    redraw()


def _shown_share(context: bpy.types.Context, points: int) -> float:
    """How much of `points` to draw now: less while the view moves, with the rest to follow."""
    wanted = context.scene.curecon.display_fraction / 100
    looking = tuple(value for row in context.region_data.perspective_matrix for value in row)
    region = context.region.as_pointer()
    moving = _last_views.get(region) != looking
    _last_views[region] = looking
    if not moving or points * wanted <= MOVING_POINTS:
        return wanted
    if bpy.app.timers.is_registered(_draw_the_rest):
        bpy.app.timers.unregister(_draw_the_rest)
    bpy.app.timers.register(_draw_the_rest, first_interval=REST_SECONDS)
    return MOVING_POINTS / points


def _draw() -> None:
    context = bpy.context
    space = context.space_data
    if space.shading.type not in {"SOLID", "WIREFRAME"}:
        return
    clouds = [
        item for item in context.view_layer.objects
        if item.type == "POINTCLOUD" and CLOUD_KEY in item.data and item.visible_get(viewport=space)
    ]
    alive = {(data.session_uid, len(data.points)) for data in bpy.data.pointclouds}
    for key in _batches.keys() - alive:
        del _batches[key]
    if not clouds:
        return
    shader, settings, region = _get_shader(), context.scene.curecon, context.region
    view, share = context.region_data, _shown_share(context, sum(len(item.data.points) for item in clouds))
    gpu.state.depth_test_set("LESS_EQUAL")
    gpu.state.depth_mask_set(True)
    gpu.state.program_point_size_set(True)
    shader.bind()
    for item in clouds:
        # Pixels that a radius of 1 takes at clip w = 1; a square of 0.85 of a disc's width has about its area.
        scale = item.matrix_world.median_scale * settings.point_size
        pixels = view.window_matrix[1][1] * region.height * 0.85 * scale
        smallest = MIN_POINT_PIXELS * settings.point_size
        shader.uniform_float("clip_from_object", view.perspective_matrix @ item.matrix_world)
        shader.uniform_float("size", (pixels, max(1.0, smallest), MAX_POINT_PIXELS))
        count = round(len(item.data.points) * share)
        if count:
            _get_batch(item.data).draw_range(shader, elem_start=0, elem_count=count)
    gpu.state.program_point_size_set(False)
    gpu.state.depth_mask_set(False)
    gpu.state.depth_test_set("NONE")


def _get_shader() -> gpu.types.GPUShader:
    global _shader
    if _shader is None:
        info = gpu.types.GPUShaderCreateInfo()
        info.push_constant("MAT4", "clip_from_object")
        info.push_constant("VEC3", "size")  # pixels of radius 1 at w = 1; smallest, largest
        info.vertex_in(0, "VEC3", "position")
        info.vertex_in(1, "VEC4", "colour")
        info.vertex_in(2, "FLOAT", "radius")
        between = gpu.types.GPUStageInterfaceInfo("curecon_points")
        between.flat("VEC4", "shown")
        info.vertex_out(between)
        info.fragment_out(0, "VEC4", "fragment")
        info.vertex_source(VERTEX_SOURCE)
        info.fragment_source(FRAGMENT_SOURCE)
        _shader = gpu.shader.create_from_info(info)
    return _shader


def _get_batch(data: bpy.types.PointCloud) -> gpu.types.GPUBatch:
    count = len(data.points)
    key = (data.session_uid, count)
    if key not in _batches:
        positions = np.empty((count, 3), np.float32)
        colours = np.empty((count, 4), np.float32)
        data.attributes["position"].data.foreach_get("vector", positions.ravel())
        data.attributes[COLOUR].data.foreach_get("color_srgb", colours.ravel())
        radii = np.empty((count, 1), np.float32)
        data.attributes["radius"].data.foreach_get("value", radii.ravel())
        np.multiply(colours, 255, out=colours)
        layout = gpu.types.GPUVertFormat()
        layout.attr_add(id="position", comp_type="F32", len=3, fetch_mode="FLOAT")
        layout.attr_add(id="colour", comp_type="U8", len=4, fetch_mode="INT_TO_FLOAT_UNIT")
        layout.attr_add(id="radius", comp_type="F32", len=1, fetch_mode="FLOAT")
        vertices = gpu.types.GPUVertBuf(layout, count)
        vertices.attr_fill("position", positions)
        vertices.attr_fill("colour", np.rint(colours, out=colours).astype(np.uint8))
        vertices.attr_fill("radius", radii)
        _batches[key] = gpu.types.GPUBatch(type="POINTS", buf=vertices)
    return _batches[key]
