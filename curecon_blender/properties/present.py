# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How the result is presented."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

from math import pi

import bpy
from bpy.props import FloatProperty


class CURECON_PG_present(bpy.types.PropertyGroup):
    hour_correction: FloatProperty(
        name="Hour Correction",
        description="Hours from -14 to 14, added to the photos' clock: for summer time, for a time zone that is not "
                    "the longitude's, or for a clock that was wrong",
        default=0.0, min=-14.0, max=14.0, step=25, precision=2,
    )
    latitude: FloatProperty(
        name="Latitude", description="Of the site where the photos do not tell it, -90 to 90 degrees, north positive",
        default=0.0, min=-90.0, max=90.0, precision=4,
    )
    longitude: FloatProperty(
        name="Longitude", description="Of the site where the photos do not tell it, -180 to 180 degrees, east positive",
        default=0.0, min=-180.0, max=180.0, precision=4,
    )
    north: FloatProperty(
        name="North", description="Where north lies when the photos do not tell it, -180 to 180 degrees clockwise from "
                                  "the scene's Y axis, seen from above",
        default=0.0, min=-pi, max=pi, subtype="ANGLE",
    )


CLASSES = (CURECON_PG_present,)
