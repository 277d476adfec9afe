# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Measured distances of a scene."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

import bpy
from bpy.props import FloatProperty, FloatVectorProperty, StringProperty


class CURECON_PG_measurement(bpy.types.PropertyGroup):
    """A distance between two places of the world."""

    first: FloatVectorProperty(name="From", description="Where it begins, in scene units", subtype="TRANSLATION")
    second: FloatVectorProperty(name="To", description="Where it ends, in scene units", subtype="TRANSLATION")
    spread: FloatProperty(description="Standard deviation that the two picks give to it, in scene units")
    part: StringProperty(description="Folder of the frame of the part of the site that it was measured on")


CLASSES = (CURECON_PG_measurement,)
