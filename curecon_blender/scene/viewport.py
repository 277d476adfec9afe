# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws the clouds in colour in Solid and Wireframe shading, where Blender would draw them grey or not at all.

Each cloud is uploaded once, a piece with each drawing from the first on, so that none takes long. Since points.py
stores it in random order, drawing a prefix shows a fair sample of it: what has come so far, as much as the user set
and, while the view moves, no more than keeps it fluent. The buffers are made from the PointCloud's own attributes, so
they come back by themselves after a file is loaded, an undo or a reload of the add-on.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import bpy
import gpu
import numpy as np
from bpy.app.handlers import persistent
from gpu_extras.batch import batch_for_shader
from mathutils import Matrix, Vector

from . import cameras, display
from .drawing import Drawing
from .points import CLOUD_KEY, COLOUR, COMPARED_KEY, PRECISION
from .workspace import clouds_of

MAX_POINT_PIXELS = 40.0
MIN_POINT_PIXELS = 2.0
MOVING_POINTS = 3_000_000  # drawn of all clouds together while the view moves; the rest follows when it rests
REST_SECONDS = 0.25
BOX_EDGES = (0, 1, 1, 2, 2, 3, 3, 0, 4, 5, 5, 6, 6, 7, 7, 4, 0, 4, 1, 5, 2, 6, 3, 7)  # corners of Blender's bound_box
EDGE_PARTS = 32  # in each of which a background's gradient is even enough
PAINT_PIXELS = 5.0  # a smooth wire of Blender's and a little more
NEARER = 1e-5  # of the depth: to be before what lies at the same place
MOST_EDGES = 48  # of boxes, beside which points are drawn that they would hide
PIECE = 1 << 18  # points that are uploaded at once
PIECE_SECONDS = 0.02  # a drawing begins to upload pieces for so long

# What is drawn of a cloud: the field, width and type of its attributes, as Blender copies them fastest.
_ATTRIBUTES: dict[str, tuple[str, int, type]] = {
    "position": ("vector", 3, np.float32), COLOUR: ("color", 4, np.float32), "radius": ("value", 1, np.float32),
    "confidence": ("value", 1, np.float32), "views": ("value", 1, np.int32), "normal": ("vector", 3, np.float32),
    PRECISION: ("value", 1, np.float32),
    display.REMOVED: ("value", 1, np.bool_),
}

RAMP_STEPS = 32
# One block of 16-byte rows: Vulkan and Metal promise no more than 128 bytes of push constants.
BLOCK = f"""
struct CloudDisplay {{
  mat4 clip_from_object;
  mat4 region_from_object;
  vec4 size;    // pixels of radius 1 at w = 1; smallest, largest; what takes lengths to the world
  vec4 least;   // confidence, views; 1 to show the region only; what to colour by, as in COLOURS
  vec4 value;   // height above the world's floor of (x, y, z, 1) in the object's frame
  vec4 range;   // the ramp's low and high end
  vec4 ramp[{RAMP_STEPS}];
  vec4 view;    // pixels of the region; how many edges
  vec4 edge[{2 * MOST_EDGES}];  // of boxes painted over, from and to: pixels, depth
}};
"""
COLOURS = (display.PHOTO, display.HEIGHT, display.CONFIDENCE, display.VIEWS, display.NORMAL, display.SIGMA)
VERTEX_SOURCE = f"""
void main()
{{
  vec3 cube = abs((show.region_from_object * vec4(position, 1.0)).xyz);
  bool outside = max(cube.x, max(cube.y, cube.z)) > 1.0;
  if (quality.x < show.least.x || quality.y < show.least.y || (show.least.z > 0.5 && outside)) {{
    gl_Position = vec4(2.0, 2.0, 2.0, 1.0);  // outside of every view
    gl_PointSize = 1.0;
    shown = vec4(0.0);
    return;
  }}
  gl_Position = show.clip_from_object * vec4(position, 1.0);
  // The point's size in pixels at its depth, so that a near cloud closes to a surface.
  gl_PointSize = clamp(radius * show.size.x / gl_Position.w, show.size.y, show.size.z);
  // A box has left its depth along its edges, though it was painted over: a point behind comes just before them, the
  // nearer ones before the farther.
  vec2 at = (0.5 + 0.5 * gl_Position.xy / gl_Position.w) * show.view.xy;
  float depth = gl_Position.z / gl_Position.w, before = depth;
  for (int i = 0; i < int(show.view.z + 0.5); i++) {{
    vec3 start = show.edge[2 * i].xyz, along = show.edge[2 * i + 1].xyz - start;
    vec3 near = start + along * clamp(dot(at - start.xy, along.xy) / max(dot(along.xy, along.xy), 1e-6), 0.0, 1.0);
    if (near.z < depth && distance(at, near.xy) < 0.71 * gl_PointSize + 1.0) {{
      before = min(before, near.z - {NEARER} * (2.0 + (1.0 - depth) / (1.0 - near.z)));
    }}
  }}
  gl_Position.z = before * gl_Position.w;
  int by = int(show.least.w + 0.5);
  if (by == 0) {{
    shown = vec4(colour.rgb, 1.0);
  }}
  else if (by == 4) {{
    shown = vec4(normal.xyz * 0.5 + 0.5, 1.0);
  }}
  else {{
    float value = by == 1 ? dot(show.value, vec4(position, 1.0)) : by == 2 ? quality.x
      : by == 3 ? quality.y : quality.z * show.size.w;
    float place = clamp((value - show.range.x) / (show.range.y - show.range.x), 0.0, 1.0) * {RAMP_STEPS - 1}.0;
    int step_below = min(int(place), {RAMP_STEPS - 2});
    shown = mix(show.ramp[step_below], show.ramp[step_below + 1], place - float(step_below));
  }}
}}
"""
FRAGMENT_SOURCE = "void main() { fragment = shown; }"

_shader: gpu.types.GPUShader | None = None
_uploads: dict[tuple[object, ...], _Upload] = {}  # by _upload_key
_last_views: dict[int, tuple[float, ...]] = {}  # by region: where it looked from when it was last drawn


def start() -> None:
    """Begin to draw in every 3D viewport."""
    _drawing.start()
    bpy.app.handlers.load_pre.append(_forget)


def stop() -> None:
    """Stop drawing and free the graphics memory."""
    global _shader
    _drawing.stop()
    bpy.app.handlers.load_pre.remove(_forget)
    _forget()
    for timer in (_draw_the_rest, _let_nodes_show):
        if bpy.app.timers.is_registered(timer):
            bpy.app.timers.unregister(timer)
    _shader = None
    redraw()


def redraw() -> None:
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()


@persistent
def _forget(*_: object) -> None:
    _uploads.clear()
    _last_views.clear()


def _draw_the_rest() -> None:
    redraw()


def _let_nodes_show() -> None:
    """Switch on what display.py leaves off for as long as no viewport needs it."""
    for scene in {window.scene for window in bpy.context.window_manager.windows}:
        clouds = clouds_of(scene)
        if any(not modifier.show_viewport for item in clouds
               if (modifier := item.modifiers.get(display.MODIFIER)) is not None):
            display.apply(scene, clouds)


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


def _is_ours(data: bpy.types.PointCloud) -> bool:
    return CLOUD_KEY in data or COMPARED_KEY in data


def _draw() -> None:
    context = bpy.context
    space = context.space_data
    clouds = [
        item for item in context.view_layer.objects
        if item.type == "POINTCLOUD" and _is_ours(item.data) and item.visible_get(viewport=space)
    ]
    edges = np.empty((0, 2, 3))
    if space.overlay.show_overlays and (unselected := [item for item in clouds if not item.select_get()]):
        edges = _paint_over_bounds(context, unselected)
    if space.shading.type not in {"SOLID", "WIREFRAME"}:
        if not bpy.app.timers.is_registered(_let_nodes_show):
            bpy.app.timers.register(_let_nodes_show, first_interval=0.0)  # nothing may be written while drawing
        return
    alive = {_upload_key(data) for data in bpy.data.pointclouds if _is_ours(data)}
    for key in _uploads.keys() - alive:
        del _uploads[key]
    photo_alone = context.region_data.view_perspective == "CAMERA" and cameras.hides_scene(space.camera)
    if not clouds or photo_alone:
        return
    shader, settings, region = _get_shader(), display.of(context.scene), context.region
    view, share = context.region_data, _shown_share(context, sum(len(item.data.points) for item in clouds))
    gpu.state.depth_test_set("LESS_EQUAL")
    gpu.state.depth_mask_set(True)
    gpu.state.program_point_size_set(True)
    shader.bind()
    for item in clouds:
        # Pixels that a radius of 1 takes at clip w = 1; a square of 0.85 of a disc's width has about its area.
        scale = item.matrix_world.median_scale * settings.size
        pixels = view.window_matrix[1][1] * region.height * 0.85 * scale
        smallest = max(1.0, MIN_POINT_PIXELS * settings.size)
        size = pixels, smallest, MAX_POINT_PIXELS, item.matrix_world.median_scale
        by = settings if CLOUD_KEY in item.data else replace(
            settings, colour_by=display.PHOTO, min_confidence=0.0, min_views=0, region_from_world=None)
        block = _block(by, item, view.perspective_matrix, size, (region.width, region.height), edges)
        shader.uniform_block("show", block)
        upload = _uploads.setdefault(_upload_key(item.data), _Upload())
        upload.go_on(item.data)
        upload.draw(shader, round(len(item.data.points) * share))
        if not upload.whole and not bpy.app.timers.is_registered(_draw_the_rest):
            bpy.app.timers.register(_draw_the_rest, first_interval=0.0)
    gpu.state.program_point_size_set(False)
    gpu.state.depth_mask_set(False)
    gpu.state.depth_test_set("NONE")


def _paint_over_bounds(context: bpy.types.Context, items: list[bpy.types.Object]) -> np.ndarray:
    """Paint the boxes about objects shown as bounds in the background's colours, where it has its own and nothing
    stands before them: black wires about the farthest points say nothing of a site. Returns the edges (E,2,3) that were
    painted over, as far as they lie before the viewer, in pixels and depth."""
    corners = np.array([item.matrix_world @ Vector(corner) for item in items for corner in item.bound_box])
    starts, ends = corners.reshape(-1, 8, 3)[:, BOX_EDGES].reshape(-1, 2, 3).swapaxes(0, 1)
    along = np.linspace(0, 1, EDGE_PARTS + 1)[:, None, None]
    nodes = starts + along * (ends - starts)
    places = np.stack([nodes[:-1], nodes[1:]], axis=2).reshape(-1, 3).astype(np.float32)
    if (colours := _background(context, places)) is None:
        return np.empty((0, 2, 3))
    shader = gpu.shader.from_builtin("POLYLINE_SMOOTH_COLOR")
    shader.uniform_float("viewportSize", (context.region.width, context.region.height))
    shader.uniform_float("lineWidth", PAINT_PIXELS * context.preferences.system.pixel_size)
    nearer = context.region_data.window_matrix.copy()
    nearer[2] -= nearer[3] * NEARER
    with gpu.matrix.push_pop_projection():
        gpu.matrix.load_projection_matrix(nearer)
        gpu.state.blend_set("NONE")
        gpu.state.depth_test_set("LESS_EQUAL")
        gpu.state.depth_mask_set(False)  # or the points behind an edge, drawn next, would be left out
        batch_for_shader(shader, "LINES", {"pos": places, "color": colours}).draw(shader)
        gpu.state.depth_test_set("NONE")
    return _on_screen(np.stack([starts, ends], axis=1), context)[:MOST_EDGES]


def _on_screen(edges: np.ndarray, context: bpy.types.Context) -> np.ndarray:
    """Edges (E,2,3) in the world as pixels and depth, without what lies behind the viewer."""
    clip = np.concatenate([edges, np.ones((*edges.shape[:2], 1))], axis=2) @ np.array(
        context.region_data.perspective_matrix).T
    ahead = clip[..., 2] + clip[..., 3]  # above 0 beyond the near plane
    clip, ahead = clip[(ahead > 0).any(axis=1)], ahead[(ahead > 0).any(axis=1)]
    for one, other in ((0, 1), (1, 0)):
        share = np.clip(-ahead[:, one] / np.maximum(ahead[:, other] - ahead[:, one], 1e-12), 0, 1)[:, None]
        clip[:, one] += share * (clip[:, other] - clip[:, one])
    screen = clip[..., :3] / np.maximum(clip[..., 3:], 1e-9)
    screen[..., :2] = (0.5 + 0.5 * screen[..., :2]) * (context.region.width, context.region.height)
    return screen


def _background(context: bpy.types.Context, places: np.ndarray) -> np.ndarray | None:
    """What stands behind places (N,3) of a viewport: the theme's colours (N,4), nothing (0) over a rendered world; None
    for anything else."""
    shading = context.space_data.shading
    colours = np.zeros((len(places), 4), np.float32)
    if shading.type == "RENDERED" or (
            shading.type == "MATERIAL" and (shading.use_scene_world or shading.studiolight_background_alpha > 0)):
        return colours
    if shading.type != "MATERIAL" and shading.background_type != "THEME":
        return None
    theme = context.preferences.themes[0].view_3d.space.gradients
    high, low = np.array(theme.high_gradient), np.array(theme.gradient)
    clip = np.column_stack([places, np.ones(len(places))]) @ np.array(context.region_data.perspective_matrix).T
    seen = np.clip(clip[:, :2] / np.maximum(clip[:, 3:], 1e-6), -1, 1)  # from the view's middle to its edges
    share = {"SINGLE_COLOR": np.ones(len(places)), "LINEAR": (seen[:, 1] + 1) / 2,
             "RADIAL": 1 - np.linalg.norm(seen, axis=1) / np.sqrt(2)}[theme.background_type]
    colours[:, :3], colours[:, 3] = low + share[:, None] * (high - low), 1.0
    return colours


def _block(
    settings: display.Display, item: bpy.types.Object, perspective: Matrix, size: tuple[float, ...],
    region: tuple[int, int], edges: np.ndarray,
) -> gpu.types.GPUUniformBuf:
    """The shader's CloudDisplay for one cloud in one view; `edges` as _on_screen has them."""
    matrix, box = item.matrix_world, settings.region_from_world
    rows = np.zeros((13 + RAMP_STEPS + 2 * MOST_EDGES, 4), np.float32)
    rows[0:4] = np.array(perspective @ matrix).T  # by columns
    rows[4:8] = np.array(box @ matrix if box is not None else Matrix.Identity(4)).T
    rows[8] = size
    rows[9] = (settings.min_confidence, settings.min_views, float(box is not None), COLOURS.index(settings.colour_by))
    rows[10], rows[11, :2] = matrix[2], (settings.low, max(settings.high, settings.low + 1e-6))
    if (node := display.ramp_node()) is not None:
        rows[12 : 12 + RAMP_STEPS] = [node.color_ramp.evaluate(step / (RAMP_STEPS - 1)) for step in range(RAMP_STEPS)]
    rows[12 + RAMP_STEPS, :3] = (*region, len(edges))
    rows[13 + RAMP_STEPS : 13 + RAMP_STEPS + 2 * len(edges), :3] = edges.reshape(-1, 3)
    return gpu.types.GPUUniformBuf(gpu.types.Buffer("FLOAT", rows.size, rows.ravel().tolist()))


def _get_shader() -> gpu.types.GPUShader:
    global _shader
    if _shader is None:
        info = gpu.types.GPUShaderCreateInfo()
        info.typedef_source(BLOCK)
        info.uniform_buf(0, "CloudDisplay", "show")
        info.vertex_in(0, "VEC3", "position")
        info.vertex_in(1, "VEC4", "colour")
        info.vertex_in(2, "FLOAT", "radius")
        info.vertex_in(3, "VEC3", "quality")
        info.vertex_in(4, "VEC4", "normal")
        between = gpu.types.GPUStageInterfaceInfo("curecon_points")
        between.flat("VEC4", "shown")
        info.vertex_out(between)
        info.fragment_out(0, "VEC4", "fragment")
        info.vertex_source(VERTEX_SOURCE)
        info.fragment_source(FRAGMENT_SOURCE)
        _shader = gpu.shader.create_from_info(info)
    return _shader


def _upload_key(data: bpy.types.PointCloud) -> tuple[object, ...]:
    return data.session_uid, len(data.points), data.get(display.REMOVED_KEY)


class _Upload:
    """A cloud on its way into graphics memory: first its attributes are fetched, then a batch is made of each PIECE."""

    def __init__(self) -> None:
        self.whole = False
        self._batches: list[gpu.types.GPUBatch] = []
        self._slices = self._work()
        self._data: bpy.types.PointCloud

    def go_on(self, data: bpy.types.PointCloud) -> None:
        """Do what can be begun within PIECE_SECONDS."""
        self._data = data  # Python's hold on it may be void by the next drawing
        deadline = time.monotonic() + PIECE_SECONDS
        for _ in self._slices:
            if time.monotonic() > deadline:
                return
        self.whole = True

    def _work(self) -> Iterator[None]:
        """A few milliseconds a slice."""
        count = len(self._data.points)
        fetched: dict[str, np.ndarray] = {}
        for name, (field, width, kind) in _ATTRIBUTES.items():
            if name not in self._data.attributes:
                continue
            values = fetched[name] = np.empty((count, width), kind)
            for start in range(0, count, PIECE):  # the system may take a tenth of a second to find all of it at once
                values[start : start + PIECE] = 0
                yield
            self._data.attributes[name].data.foreach_get(field, values.ravel())
            yield
        for start in range(0, count, PIECE):
            self._batches.append(_batch({name: values[start : start + PIECE] for name, values in fetched.items()}))
            yield

    def draw(self, shader: gpu.types.GPUShader, count: int) -> None:
        """Draw the first `count` points, or those of them that have come so far."""
        for number, batch in enumerate(self._batches):
            if (left := count - number * PIECE) > 0:
                batch.draw_range(shader, elem_start=0, elem_count=min(left, PIECE))


def _batch(piece: dict[str, np.ndarray]) -> gpu.types.GPUBatch:
    """The points whose attributes `piece` holds, by name, each (n, width)."""
    count = len(piece["position"])
    sigma = piece.get(PRECISION, np.zeros((count, 1)))  # not every cloud knows its own
    quality = np.concatenate([piece["confidence"], piece["views"], sigma], axis=1).astype(np.float32)
    if display.REMOVED in piece:
        quality[piece[display.REMOVED][:, 0]] = -1  # below every threshold
    normals = np.zeros((count, 4), np.int8)
    normals[:, :3] = np.rint(127 * piece["normal"])
    layout = gpu.types.GPUVertFormat()
    layout.attr_add(id="position", comp_type="F32", len=3, fetch_mode="FLOAT")
    layout.attr_add(id="colour", comp_type="U16", len=4, fetch_mode="INT_TO_FLOAT_UNIT")
    layout.attr_add(id="radius", comp_type="F32", len=1, fetch_mode="FLOAT")
    layout.attr_add(id="quality", comp_type="F32", len=3, fetch_mode="FLOAT")
    layout.attr_add(id="normal", comp_type="I8", len=4, fetch_mode="INT_TO_FLOAT_UNIT")
    vertices = gpu.types.GPUVertBuf(layout, count)
    vertices.attr_fill("position", piece["position"])
    vertices.attr_fill("colour", np.rint(np.clip(piece[COLOUR], 0, 1) * 65535).astype(np.uint16))
    vertices.attr_fill("radius", piece["radius"])
    vertices.attr_fill("quality", quality)
    vertices.attr_fill("normal", normals)
    return gpu.types.GPUBatch(type="POINTS", buf=vertices)


_drawing = Drawing(_draw, "POST_VIEW")
