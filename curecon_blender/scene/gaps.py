# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The gaps of a site in the scene: a coloured square on each patch, and a camera for each photo that would close them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from ..core.base.options import GAPS_FILE
from ..core.plan.coverage import ENOUGH, Parts
from ..core.plan.patches import ABSENT, Kept, read_patches
from . import cameras, flight_plan, frame

NAME = "CU-Recon Gaps"
GAPS_KEY = "curecon_gaps"  # marks the collection
SAYS_KEY = "curecon_says"  # on a camera: where to fly for its photo, in a sentence
COLOURS = np.array([(0.15, 0.65, 0.3, 1), (0.95, 0.85, 0.1, 1), (0.95, 0.45, 0.05, 1), (0.85, 0.05, 0.05, 1)])
_NOTHING = (0.55, 0.1, 0.75, 1)  # where nothing was found at all
_LENS = 24.0  # millimetres on a sensor of SENSOR_WIDTH, as most drones have


def draw(scene: bpy.types.Scene, folder: Path, photos: list[dict[str, Any]]) -> None:
    """Draw what `gaps` found for the scene's first part, in place of what was drawn before: green where photos are
    enough, yellow, orange and red where one, two or three are lacking. Raises WorkspaceError."""
    kept = read_patches(folder / GAPS_FILE)
    flight_plan.remove(scene, GAPS_KEY)
    parts = frame.parts_of(scene)
    stands = frame.world_matrix(parts[0].clouds[0]) if parts and parts[0].clouds else Matrix.Identity(4)
    top = bpy.data.collections.new(NAME)
    top[GAPS_KEY] = True
    scene.collection.children.link(top)
    for item in (_squares(kept), *_cameras(photos, kept)):
        item.matrix_world = stands @ item.matrix_basis
        top.objects.link(item)


def drawn(scene: bpy.types.Scene) -> bool:
    return any(GAPS_KEY in collection for collection in scene.collection.children)


def says(item: bpy.types.Object | None) -> str:
    """Where to fly for the photo that an object stands for; empty for any other."""
    return "" if item is None else item.get(SAYS_KEY, "")


def _squares(kept: Kept) -> bpy.types.Object:
    colours = COLOURS[np.minimum(kept.short, ENOUGH)]
    colours[kept.kinds == ABSENT] = _NOTHING
    sides = np.sqrt(np.maximum(kept.areas, 0))
    lifted = Parts(kept.parts.places + 0.1 * sides[:, None] * kept.parts.normals, kept.parts.normals)
    return flight_plan.squares("Gaps", lifted, sides, colours)


def _cameras(photos: list[dict[str, Any]], kept: Kept) -> list[bpy.types.Object]:
    data = bpy.data.cameras.new("Gap")
    data.lens, data.sensor_width = _LENS, cameras.SENSOR_WIDTH
    data.display_size = 0.03 * float(np.ptp(kept.parts.places, axis=0).max()) if len(kept.areas) else 1.0
    found = []
    for n, photo in enumerate(photos, start=1):
        pose = np.eye(4)
        pose[:3] = photo["cam_to_world"]
        pose[:3, :3] = pose[:3, :3] @ cameras.BLENDER_FROM_OPENCV
        item = bpy.data.objects.new(f"Gap {n}", data)
        item.matrix_basis = Matrix(pose.tolist())
        item[SAYS_KEY] = photo["says"]
        item.hide_render = True
        found.append(item)
    return found
