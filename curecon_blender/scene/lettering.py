# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Texts as triangles, in Blender's own font, which knows the letters of nearly every language."""

from __future__ import annotations

from collections.abc import Callable

import bpy
import numpy as np

from ..languages import translated

RESOLUTION = 6  # steps of a letter's curves: smooth on paper


def letters_but(*names: str) -> Callable[[str], np.ndarray]:
    """What turns a text into its triangles, in Blender's language but for names that the user has given."""
    return lambda text: letters(text if text in names else translated(text))


def letters(text: str) -> np.ndarray:
    """The text's triangles (N,3,2), anticlockwise, about 1 high, from (0, 0) on its base line."""
    curve = bpy.data.curves.new("CU-Recon letters", "FONT")
    curve.body, curve.size, curve.resolution_u = text, 1.0, RESOLUTION
    holder = bpy.data.objects.new(curve.name, curve)
    try:
        mesh = holder.to_mesh()
        mesh.calc_loop_triangles()
        places = np.empty((len(mesh.vertices), 3), np.float32)
        mesh.vertices.foreach_get("co", places.ravel())
        corners = np.empty((len(mesh.loop_triangles), 3), np.int32)
        mesh.loop_triangles.foreach_get("vertices", corners.ravel())
    finally:
        bpy.data.curves.remove(curve)  # and the holder with its mesh
    triangles = places[corners][..., :2].astype(float)
    first, second = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    flipped = first[:, 0] * second[:, 1] < first[:, 1] * second[:, 0]
    triangles[flipped] = triangles[flipped][:, ::-1]
    return triangles
