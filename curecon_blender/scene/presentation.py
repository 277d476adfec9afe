# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the step Present puts into the scene: one collection, one object a role, made again in its own place."""

from __future__ import annotations

import bpy

NAME = "CU-Recon Presentation"
ROLE_KEY = "curecon_role"  # on our collection, objects, worlds and scenes: what each is for
COLLECTION_ROLE = "presentation"


def find(scene: bpy.types.Scene, role: str) -> bpy.types.Object | None:
    return next((item for item in scene.objects if item.get(ROLE_KEY) == role), None)


def put(scene: bpy.types.Scene, role: str, data: bpy.types.ID) -> bpy.types.Object:
    """Link a new object of `role` that holds `data`, named as the data is."""
    item = bpy.data.objects.new(data.name, data)
    item[ROLE_KEY] = role
    _collection(scene).objects.link(item)
    return item


def _collection(scene: bpy.types.Scene) -> bpy.types.Collection:
    for child in scene.collection.children:
        if child.get(ROLE_KEY) == COLLECTION_ROLE:
            return child
    child = bpy.data.collections.new(NAME)
    child[ROLE_KEY] = COLLECTION_ROLE
    scene.collection.children.link(child)
    return child
