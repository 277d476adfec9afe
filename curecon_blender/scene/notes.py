# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Notes on a site: empties with a text, which published pages show at their place."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import bpy
import numpy as np
from mathutils import Vector

from ..core.publish.records import Note
from .frame import Part, world_matrix

TEXT_KEY = "curecon_note"  # marks an empty, and is what it says; its title is the empty's name
EYE_KEY = "curecon_eye"  # from where it was seen when it was made, from the empty, in its axes
_SIZE = 0.02  # of the distance that it was seen from


def is_note(item: bpy.types.Object | None) -> bool:
    return item is not None and item.type == "EMPTY" and TEXT_KEY in item


def add(
    context: bpy.types.Context, part: Part, place: np.ndarray, title: str, text: str, eye: np.ndarray | None
) -> bpy.types.Object:
    """Put a note at a `place` (3,) of the world; `eye` (3,) is where the user looks from, None where nobody looks."""
    item = bpy.data.objects.new(title, None)
    item.empty_display_type = "SPHERE"
    item.empty_display_size = part.metre if eye is None else max(_SIZE * float(np.linalg.norm(eye - place)), 1e-6)
    item.show_name = item.show_in_front = True
    item.location = place
    item[TEXT_KEY] = text
    if eye is not None:
        item[EYE_KEY] = (eye - place).tolist()
    part.collection.objects.link(item)
    for other in context.selected_objects:
        other.select_set(False)
    item.select_set(True)
    context.view_layer.objects.active = item
    return item


def records(scene: bpy.types.Scene, part: Part) -> list[dict[str, Any]]:
    """The scene's notes in the part's frame, by their names, as published pages have them."""
    found = []
    for item in sorted(filter(is_note, scene.objects), key=lambda item: item.name):
        stands = world_matrix(item)
        eye = None
        if EYE_KEY in item:
            eye = _triple(part.local(np.array(stands @ Vector(item[EYE_KEY]))))
        note = Note(title=item.name, text=str(item[TEXT_KEY]), place=_triple(part.local(np.array(stands.translation))),
                    eye=eye)
        found.append(asdict(note))
    return found


def _triple(place: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in place)
    return x, y, z
