# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The cube, camera and light that Blender puts into every new file, and the collection that they are in."""

from __future__ import annotations

import bpy
import numpy as np

# Where Blender puts each, and of what kind it is.
PLACES = {
    "Cube": ("MESH", (0.0, 0.0, 0.0)),
    "Camera": ("CAMERA", (7.358891, -6.925791, 4.958309)),
    "Light": ("LIGHT", (4.076245, 1.005454, 5.903862)),
}


def is_untouched(scene: bpy.types.Scene) -> bool:
    """Whether a scene holds nothing but what Blender put there."""
    return all(_is_untouched(item) for item in scene.objects)


def clear(scene: bpy.types.Scene) -> bool:
    """Take them out of a scene that holds nothing else, and only as Blender made them, with the collection that
    is empty then; returns whether it did."""
    items = list(scene.objects)
    if not items or not is_untouched(scene):
        return False
    for holder in list(scene.collection.children):
        if holder.objects and not holder.children:  # all of them ours, as is told above
            scene.collection.children.unlink(holder)  # removed, an undo in Blender 5.2 would not always bring it back
    bpy.data.batch_remove([*items, *(item.data for item in items)])
    return True


def _is_untouched(item: bpy.types.Object) -> bool:
    kind, place = PLACES.get(item.name, ("", ()))
    if item.type != kind or item.data.users > 1 or item.modifiers or item.constraints or item.animation_data:
        return False
    if not np.allclose(item.location, place, atol=1e-3) or not np.allclose(item.scale, 1):
        return False
    if kind != "MESH":
        return True
    corners = np.array([list(vertex.co) for vertex in item.data.vertices[:9]])
    return len(corners) == 8 and np.allclose(np.abs(corners), 1)
