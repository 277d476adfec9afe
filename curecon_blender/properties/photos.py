# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the photo check said."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

import bpy
from bpy.props import CollectionProperty, FloatProperty, IntProperty, StringProperty


class CURECON_PG_skipped(bpy.types.PropertyGroup):
    """A file that the photo check left out. `name` is the file's."""

    reason: StringProperty()


class CURECON_PG_cost(bpy.types.PropertyGroup):
    """What a quality would cost on this computer, roughly. `name` is the quality."""

    seconds: FloatProperty()
    memory_gib: FloatProperty()
    disk_gib: FloatProperty()


class CURECON_PG_check(bpy.types.PropertyGroup):
    """What the photo check said about the folder `folder`."""

    folder: StringProperty()
    photos: IntProperty()
    cameras: IntProperty()
    gps: IntProperty()
    blurred: StringProperty(description="Names of the blurred photos")
    blurred_count: IntProperty()
    gsd_mm: FloatProperty(description="Ground sampling distance in millimetres, 0 when unknown")
    skipped: CollectionProperty(type=CURECON_PG_skipped)
    costs: CollectionProperty(type=CURECON_PG_cost)


CLASSES = (CURECON_PG_skipped, CURECON_PG_cost, CURECON_PG_check)
