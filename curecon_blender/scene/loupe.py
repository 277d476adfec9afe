# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A loupe: the photo itself at its full size about the pixel under the mouse, drawn over the viewport.

The picture behind a photo's camera is undistorted and often smaller, so marks would be less exact in it.
"""

from __future__ import annotations

from pathlib import Path

import bpy
import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader

from ..core.adjust.marking import stored, stored_size
from ..core.base.shares import is_safe

SIDE = 240.0  # pixels of the screen at interface scale 1
ZOOMS = (2.0, 4.0, 8.0, 16.0)  # pixels of the screen for one of the photo
GAP = 24.0  # between the mouse and the loupe
KEY = "curecon_loupe"  # on the pictures that it loads
LINE, EDGE = (1.0, 1.0, 1.0, 0.9), (0.0, 0.0, 0.0, 1.0)

zoom = 1  # which of ZOOMS
_name = ""  # of the picture that is loaded
_file: Path | None = None
_texture: gpu.types.GPUTexture | None = None


def take(file: Path, workspace: Path) -> bool:
    """Take up a photo; False where it is not there, or lies on a share that nobody has chosen."""
    global _name, _file
    if file == _file:
        return bool(_name)
    forget()
    _file = file
    if not file.name or not is_safe(file, [workspace]) or not file.is_file():
        return False
    try:
        image = bpy.data.images.load(str(file))
    except RuntimeError:  # no picture that Blender reads
        return False
    if not image.size[0]:
        bpy.data.images.remove(image)
        return False
    image[KEY], _name = True, image.name
    return True


def has(file: Path) -> bool:
    """Whether it was last asked to take up that photo."""
    return file == _file


def shows(file: Path) -> bool:
    """Whether it has taken up that photo. Drawing alone puts it on the graphics card."""
    global _texture
    image = bpy.data.images.get(_name) if _name and file == _file else None
    if image is None:
        return False
    if _texture is None:
        _texture = gpu.texture.from_image(image)
    return True


def forget() -> None:
    """Give the photo's memory back."""
    global _name, _file, _texture
    _texture, _file, _name = None, None, ""
    for image in [image for image in bpy.data.images if KEY in image and image.users == 0]:  # an undo brings them back
        bpy.data.images.remove(image)


def draw(
    context: bpy.types.Context, mouse: tuple[float, float], pixel: np.ndarray, size: tuple[int, int], turn: int,
    others: list[tuple[np.ndarray, tuple[float, float, float, float]]],
) -> None:
    """Draw the loupe beside `mouse` (pixels of the region) with `pixel` (2,) of the photo of `size` in its middle.
    `turn` is EXIF's orientation of the file; `others` are pixels with the colours that they are shown in."""
    if _texture is None:
        return
    scale = context.preferences.system.ui_scale
    side, each = SIDE * scale, ZOOMS[zoom] * scale
    left = mouse[0] + GAP * scale
    if left + side > context.region.width:
        left = mouse[0] - GAP * scale - side
    bottom = min(max(mouse[1] - side / 2, 0), context.region.height - side)
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    reach = (corners * [1, -1] + [-0.5, 0.5]) * side / each  # the photo's rows count downwards
    places = [(left + x * side, bottom + y * side) for x, y in corners]
    _fill(places, EDGE)
    shader = gpu.shader.from_builtin("IMAGE")
    uv = stored(pixel + reach, size, turn) / stored_size(size, turn)
    uv[:, 1] = 1 - uv[:, 1]
    batch = batch_for_shader(shader, "TRI_FAN", {"pos": places, "texCoord": [tuple(place) for place in uv]})
    shader.uniform_sampler("image", _texture)
    batch.draw(shader)
    middle = np.array([left + side / 2, bottom + side / 2])
    for place, colour in others:
        at = middle + (place - pixel) * [1, -1] * each
        if (np.abs(at - middle) < side / 2 - 6 * scale).all():
            _cross(context, at, 6 * scale, colour, gap=0)
    _cross(context, middle, side / 2, LINE, gap=each)
    _outline(context, places)


def _fill(places: list[tuple[float, float]], colour: tuple[float, float, float, float]) -> None:
    shader = gpu.shader.from_builtin("UNIFORM_COLOR")
    shader.uniform_float("color", colour)
    batch_for_shader(shader, "TRI_FAN", {"pos": [(*place, 0.0) for place in places]}).draw(shader)


def _cross(
    context: bpy.types.Context, at: np.ndarray, arm: float, colour: tuple[float, float, float, float], *, gap: float
) -> None:
    """A cross that leaves its middle free."""
    sides = [np.array(side) for side in ((1, 0), (-1, 0), (0, 1), (0, -1))]
    ends: list[tuple[float, ...]] = [(*(at + side * reach), 0.0) for side in sides for reach in (gap, arm)]
    _draw_lines(context, ends, colour)


def _outline(context: bpy.types.Context, places: list[tuple[float, float]]) -> None:
    ends: list[tuple[float, ...]] = [(*places[i % 4], 0.0) for side in range(4) for i in (side, side + 1)]
    _draw_lines(context, ends, EDGE)


def _draw_lines(
    context: bpy.types.Context, ends: list[tuple[float, ...]], colour: tuple[float, float, float, float]
) -> None:
    shader = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
    shader.uniform_float("viewportSize", (context.region.width, context.region.height))
    shader.uniform_float("lineWidth", 1.5 * context.preferences.system.ui_scale)
    shader.uniform_float("color", colour)
    batch_for_shader(shader, "LINES", {"pos": ends}).draw(shader)
