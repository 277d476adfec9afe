# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which points of the clouds are shown, and in which colours."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty

from ..scene import display, viewport
from ..scene.workspace import clouds_of

COLOURS = (
    (display.PHOTO, "Photo", "The photos' colours"),
    (display.HEIGHT, "Height", "Height in the scene, in its units"),
    (display.CONFIDENCE, "Confidence", "How sure the depth maps were, from 0 to 1"),
    (display.VIEWS, "Confirming Views", "How many photos measured the point"),
    (display.SIGMA, "Precision", "How far a point may be off within the site, one standard deviation, in scene units"),
    (display.NORMAL, "Normal", "Which way the surface looks: red east, green north, blue up"),
)


def apply(properties: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    """A property's update: hand the scene's settings on to its clouds."""
    scene = properties.id_data
    display.apply(scene, clouds_of(scene))
    viewport.redraw()


def _colour_by(properties: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    if properties.colour_by in {display.PHOTO, display.NORMAL}:
        apply(properties, context)
    else:  # setting the ends applies all
        properties.low, properties.high = display.measure_range(properties.id_data, clouds_of(properties.id_data))


class CURECON_PG_cloud(bpy.types.PropertyGroup):
    """What of the clouds is shown."""

    min_confidence: FloatProperty(
        name="Min Confidence", description="Hide points that the depth maps were less sure of, from 0 to 1, in "
                                           "viewports and renders",
        default=0.0, min=0.0, max=1.0, precision=2, step=1, update=apply,
    )
    min_views: IntProperty(
        name="Min Views", description="Hide points that fewer photos confirm, in viewports and renders",
        default=0, min=0, soft_max=12, max=255, update=apply,
    )
    only_region: BoolProperty(
        name="Only in Region", description="Show only what lies inside of the region box, in viewports and renders",
        default=False, update=apply,
    )
    colour_by: EnumProperty(
        name="Colour", description="What the points' colours show", items=COLOURS, default=display.PHOTO,
        update=_colour_by,
    )
    low: FloatProperty(
        name="Low", description="Value at the dark end of the ramp: scene units, confidence or views", default=0.0,
        precision=2, update=apply,
    )
    high: FloatProperty(
        name="High", description="Value at the light end of the ramp: scene units, confidence or views", default=1.0,
        precision=2, update=apply,
    )


CLASSES = (CURECON_PG_cloud,)
