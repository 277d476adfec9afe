# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a flight is planned from."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

import bpy
from bpy.props import EnumProperty, FloatProperty, FloatVectorProperty, IntProperty, PointerProperty, StringProperty

from ..core.plan.drones import DRONES
from ..core.plan.wishes import Wishes

KINDS = (
    ("building", "Building", "A house or a church: orbits at the height of its walls, one from above, and a grid"),
    ("tulou", "Tulou", "A ring with a court: orbits, a grid, and the inner galleries across the court"),
    ("tower", "Tower", "Orbits one above the other, one of the top, and a grid"),
    ("facade", "Façade", "Lines along every wall, straight and turned to both sides, and a grid"),
    ("courtyard", "Courtyard House", "A grid straight down, and leaning grids from four sides"),
    ("ruin", "Ruin", "Leaning grids from four sides, and lines along the walls"),
    ("grid", "Grid", "Lines straight down only: a plan without walls"),
    ("crossed", "Crossed Grids", "Two grids straight down"),
    ("orbit", "Orbit", "One orbit only"),
    ("helix", "Helix", "One way that climbs around the building, and an orbit of its top"),
)
DRONE_ITEMS = tuple((key, drone.name, "") for key, drone in DRONES.items())


class CURECON_PG_plan(bpy.types.PropertyGroup):
    kind: EnumProperty(name="Kind", description="Of building, or the form to fly", items=KINDS, default="building")
    drone: EnumProperty(name="Drone", description="Which drone flies", items=DRONE_ITEMS, default="mini4pro")
    pixel: FloatProperty(
        name="Pixel (mm)", description="Wanted size of a pixel on the building, 0.5 to 200 millimetres",
        default=Wishes.pixel, min=0.5, max=200.0, precision=1,
    )
    forward: FloatProperty(
        name="Overlap", description="Of a photo with the one before it, 0 to 95 per cent",
        default=100 * Wishes.forward, min=0.0, max=95.0, subtype="PERCENTAGE", precision=0,
    )
    side: FloatProperty(
        name="Side Overlap", description="With the neighbouring line, 0 to 95 per cent",
        default=100 * Wishes.side, min=0.0, max=95.0, subtype="PERCENTAGE", precision=0,
    )
    clearance: FloatProperty(
        name="Clearance", description="Least distance to anything, 1 to 100 metres", default=Wishes.clearance, min=1.0,
        max=100.0, precision=1, unit="LENGTH",
    )
    ceiling: FloatProperty(
        name="Ceiling", description="Greatest height above take-off that is allowed, 5 to 1000 metres",
        default=Wishes.ceiling, min=5.0, max=1000.0, precision=0, unit="LENGTH",
    )
    building: PointerProperty(
        type=bpy.types.Object, name="Building",
        description="What is to be recorded: a cloud, a surface, or a mesh or curve drawn around it and as high as it",
    )
    court: PointerProperty(
        type=bpy.types.Object, name="Court", description="A mesh or curve drawn along the court, if there is one",
    )
    takeoff: FloatVectorProperty(
        name="Take-Off", description="Where the drone starts, in the scene", size=3, subtype="TRANSLATION",
        default=(0.0, -40.0, 0.0),
    )
    position: StringProperty(
        name="Position",
        description="Latitude and longitude of the scene's origin, as maps give them: 24.6581, 117.0523. Empty: the "
                    "site's own, where it is known",
    )
    photos: IntProperty(name="Photos", description="That the last plan takes")
    minutes: FloatProperty(name="Minutes", description="In the air, of the last plan")
    batteries: IntProperty(name="Batteries", description="That the last plan takes")
    covered: FloatProperty(name="Covered", description="Share of walls and roofs that three photos or more will show")
    said: StringProperty(name="Notes", description="What to know about the last plan")


CLASSES = (CURECON_PG_plan,)
