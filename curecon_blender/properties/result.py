# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the last import brought."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

import bpy
from bpy.props import BoolProperty, FloatProperty, IntProperty, StringProperty


class CURECON_PG_result(bpy.types.PropertyGroup):
    """What the last import brought into the scene."""

    workspace: StringProperty(description="The folder that was imported; empty: none", subtype="DIR_PATH")
    points: IntProperty(description="Points of all clouds")
    cameras: IntProperty(description="Photos whose cameras were found")
    photos: IntProperty(description="Photos that were given; 0 when unknown")
    parts: IntProperty(description="Parts of the site that do not connect with each other")
    faces: IntProperty(description="Faces of the surface; 0 when there is none")
    textured: BoolProperty(description="The surface is painted with the photos")
    filled: FloatProperty(description="Per cent of the surface's area that no photo measured, 0 to 100")
    weak: FloatProperty(description="Per cent of the surface's area that one photo alone measured, 0 to 100")
    unseen: FloatProperty(description="Per cent of the surface's area whose colour no photo shows, 0 to 100")
    published: StringProperty(description="The folder that it was published into; empty: none", subtype="DIR_PATH")


CLASSES = (CURECON_PG_result,)
