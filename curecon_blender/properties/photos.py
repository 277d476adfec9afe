# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the photo check said."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    StringProperty,
)


class CURECON_PG_skipped(bpy.types.PropertyGroup):
    """A file that the photo check left out. `name` is the file's."""

    reason: StringProperty(name="Reason", description="Why the file is not used")
    surplus: BoolProperty(name="Surplus", description="A picture that is used where surplus ones are asked for")


class CURECON_PG_doubtful(bpy.types.PropertyGroup):
    """A photo that is used although something is wrong with it. `name` is the photo's."""

    path: StringProperty(name="File", description="The photo's file", subtype="FILE_PATH")
    problems: StringProperty(name="Problems", description="What is wrong with the photo, in words")
    thumbnail: StringProperty(
        name="Thumbnail", description="A small picture of it, gone with the session that made it", subtype="FILE_PATH",
    )


class CURECON_PG_advice(bpy.types.PropertyGroup):
    """Why the flight will give a weak model, and what to do."""

    says: StringProperty(name="Weakness", description="What is weak in the flight")
    remedy: StringProperty(name="Remedy", description="What to do")


class CURECON_PG_cost(bpy.types.PropertyGroup):
    """What a quality would cost on this computer, roughly. `name` is the quality and the result, "preview:mesh"."""

    seconds: FloatProperty(name="Time", description="Seconds from start to end", min=0.0)
    memory_gib: FloatProperty(name="Memory", description="Peak of the worker's memory in GiB", min=0.0)
    disk_gib: FloatProperty(name="Disk", description="Size of the finished workspace in GiB", min=0.0)


class CURECON_PG_station(bpy.types.PropertyGroup):
    """Where a photo was taken and what ground it shows, by its metadata. `name` is the photo's."""

    place: FloatVectorProperty(
        name="Place", description="Metres east and north of the photos' middle, and above take-off", size=3,
    )
    ground: FloatVectorProperty(
        name="Ground", description="Its four corners, metres east and north of the photos' middle", size=8,
    )
    sees_ground: BoolProperty(name="Sees the Ground", description="The photo's ground is known")


class CURECON_PG_check(bpy.types.PropertyGroup):
    """What the photo check said about the folder `folder`."""

    folder: StringProperty(name="Folder", description="The folder that was checked; empty: none", subtype="DIR_PATH")
    photos: IntProperty(name="Photos", description="Photos that can be used", min=0)
    cameras: IntProperty(name="Cameras", description="Different cameras that took them", min=0)
    gps: IntProperty(name="GPS", description="Photos that carry GPS", min=0)
    masked: IntProperty(name="Masks", description="Photos with masks", min=0)
    taken_first: StringProperty(
        name="First Photo", description="When the first photo was taken, ISO 8601 in the camera's time; empty: unknown",
    )
    taken_last: StringProperty(
        name="Last Photo", description="When the last photo was taken, ISO 8601 in the camera's time; empty: unknown",
    )
    gsd_mm: FloatProperty(
        name="Ground Sampling Distance", description="Millimetres on the ground per pixel; 0 when unknown", min=0.0,
    )
    forward: FloatProperty(
        name="Forward Overlap", description="Per cent that a photo shares with the next, 0 to 100; -1 when unknown",
        default=-1.0, min=-1.0, max=100.0,
    )
    side: FloatProperty(
        name="Side Overlap",
        description="Per cent that a photo shares with the next line of flight, 0 to 100; -1 when unknown",
        default=-1.0, min=-1.0, max=100.0,
    )
    overlap_unknown: StringProperty(
        name="Not Told", description="What the metadata does not tell, so that the overlap is unknown",
    )
    weak: StringProperty(name="Little Overlap", description="Names of photos that overlap too little with any other")
    weak_count: IntProperty(name="Little Overlap", description="Photos that overlap too little with any other", min=0)
    advice: CollectionProperty(
        type=CURECON_PG_advice, name="Advice", description="Why the flight will give a weak model, the gravest first",
    )
    doubtful: CollectionProperty(
        type=CURECON_PG_doubtful, name="Doubtful Photos", description="Blurred and badly exposed photos",
    )
    doubtful_index: IntProperty(
        name="Doubtful Photo", description="The chosen one of the doubtful photos", default=0, min=0,
    )
    skipped: CollectionProperty(
        type=CURECON_PG_skipped, name="Left Out", description="Files that cannot be used",
    )
    stations: CollectionProperty(
        type=CURECON_PG_station, name="Flight", description="Where the photos were taken, in the order of capture",
    )
    show_stations: BoolProperty(
        name="Show the Flight",
        description="Draw over the 3D viewports where the photos were taken and what ground they show, until there is "
                    "a site", default=True,
    )
    costs: CollectionProperty(
        type=CURECON_PG_cost, name="Costs", description="Predicted time, memory and disk of each quality and result",
    )
    free_memory_gib: FloatProperty(
        name="Free Memory", description="Memory in GiB that was free at the time of the check", min=0.0,
    )
    free_disk_gib: FloatProperty(
        name="Free Disk", description="GiB that were free on the workspace's disk at the time of the check", min=0.0,
    )


CLASSES = (CURECON_PG_skipped, CURECON_PG_doubtful, CURECON_PG_advice, CURECON_PG_cost, CURECON_PG_station,
           CURECON_PG_check)
