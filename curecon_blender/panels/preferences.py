# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The add-on's page in Blender's preferences, and whether the installation works."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, StringProperty

from ..operators import running
from ..operators.self_check import PANEL, described
from ..preferences import ADDON
from .layout import draw_progress, paragraph

DEVICES = (
    ("auto", "Automatic", "CUDA or MPS where there is one, otherwise the processor"),
    ("cpu", "Processor", "Works everywhere, slowly"),
    ("cuda", "NVIDIA (CUDA)", "An NVIDIA card, through a Worker Python whose torch has CUDA"),
    ("mps", "Apple (MPS)", "The graphics part of an Apple processor"),
)


class CURECON_AP_preferences(bpy.types.AddonPreferences):
    bl_idname = ADDON

    device: EnumProperty(
        name="Device", description="What the neural network runs on", items=DEVICES, default="auto",
    )
    memory_gib: FloatProperty(
        name="Memory Budget",
        description="Gibibytes for the depth maps and the point cloud; 0 takes 60 % of what is free when they start",
        default=0.0, min=0.0, soft_max=64.0, step=100, precision=1,
    )
    worker_python: StringProperty(
        name="Worker Python",
        description="The Python that does the work: one with torch and pycolmap. Empty: Blender's own Python",
        subtype="FILE_PATH",
    )
    scheduler: StringProperty(
        name="Dask Scheduler",
        description="Address of a Dask cluster whose workers make the depth maps, such as tcp://192.168.1.5:8786. They "
        "run what they are sent: in a trusted network only. Empty: this computer makes them",
    )
    cache: StringProperty(
        name="Cache Folder",
        description="Where workspaces are made. Empty: beside each photo folder",
        subtype="DIR_PATH",
    )

    sound: BoolProperty(
        name="Sound at the End", description="A tone when a job of more than a minute is done", default=False,
    )


    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(self, "device")
        layout.prop(self, "memory_gib", text="Memory Budget (GiB, 0 = Automatic)")
        layout.prop(self, "worker_python", placeholder="Blender's own Python")
        layout.prop(self, "scheduler", placeholder="This computer alone")
        layout.prop(self, "cache", placeholder="Beside the photos")
        layout.prop(self, "sound")
        _draw_self_check(layout, context)


def _draw_self_check(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    row = layout.row()
    row.operator("curecon.self_check", icon="CHECKMARK")
    row.operator("curecon.copy_diagnostics", icon="COPYDOWN")
    status = running.status
    if running.panel != PANEL:
        return
    if status.running:
        draw_progress(layout, status)
        return
    box = layout.box()
    if status.failure is not None:
        paragraph(box, context, status.failure.message, icon="CANCEL", alert=True)
        paragraph(box, context, status.failure.remedy)
    elif status.result is not None:
        box.label(text="The installation works", icon="CHECKMARK")
        for line in described(status.result.summary):
            paragraph(box, context, line)


CLASSES = (CURECON_AP_preferences,)
