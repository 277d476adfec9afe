# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The add-on's page in Blender's preferences, and whether the installation works."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, StringProperty

from ..operators import running
from ..operators.self_check import in_words
from ..preferences import ADDON, settings
from .layout import draw_progress, paragraph

DEVICES = (
    ("auto", "Automatic", "CUDA or MPS where there is one, otherwise the processor"),
    ("cpu", "Processor", "Works everywhere, slowly"),
    ("cuda", "NVIDIA (CUDA)", "An NVIDIA card, with libraries for it: those of Get Libraries, or of a Worker Python"),
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
        description="The Python that does the work: one with torch and pycolmap, such as one with NVIDIA's CUDA. "
                    "Empty: Blender's own Python",
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
    indexes: StringProperty(
        name="Package Index",
        description="Addresses from which Get Libraries fetches, such as a mirror near you, with spaces between them. "
                    "Empty: pypi.org and pytorch.org",
    )
    licence: StringProperty(
        name="Licence", description="Of what you export, such as CC BY 4.0, where a file does not say another",
    )
    credit: StringProperty(
        name="Credit", description="Who is to be named with what you export, where a file does not say another",
    )
    atlas: StringProperty(
        name="Atlas", description="Address of the atlas that Upload to Atlas sends sites to, beginning with https://",
    )
    atlas_token: StringProperty(
        name="Atlas Token",
        description="Made on your page of the atlas. It can upload in your name and nothing else. Blender keeps it "
                    "with the preferences, as it is",
        subtype="PASSWORD",
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
        layout.prop(self, "credit")
        layout.prop(self, "licence")
        layout.prop(self, "sound")
        layout.prop(self, "atlas")
        layout.prop(self, "atlas_token")
        layout.prop(self, "indexes", placeholder="pypi.org and pytorch.org")
        _draw_check(layout, context)


def draw_libraries(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """The offer to fetch what this zip does not bring."""
    paragraph(layout, context, "What CU-Recon computes with is fetched once.", icon="INFO")
    if not bpy.app.online_access:
        paragraph(layout, context, "For that, Blender must be allowed to go online:")
        layout.prop(context.preferences.system, "use_online_access")
    row = layout.row()
    row.scale_y = 1.6
    row.operator("curecon.get_libraries", icon="IMPORT")


def _draw_check(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    row = layout.row()
    row.operator("curecon.self_check", icon="CHECKMARK")
    row.operator("curecon.copy_diagnostics", icon="COPYDOWN")
    status, chosen = running.status, settings(context)
    ours = running.panel == running.PREFERENCES
    if ours and status.running:
        draw_progress(layout, status)
        return
    box = layout.box()
    if ours and status.failure is not None:
        paragraph(box, context, status.failure.message, icon="CANCEL", alert=True)
        paragraph(box, context, status.failure.remedy)
    elif ours and status.result is not None and "synthetic_points" in status.result.summary:
        for line, icon in in_words(status.result.summary):
            paragraph(box, context, line, icon=icon)
    elif ours and status.said:
        paragraph(box, context, status.said, icon="CHECKMARK")
    if chosen.lacks_libraries or (ours and status.failure is not None and status.failure.kind == "setup"):
        draw_libraries(box, context)
    elif chosen.has_libraries:
        row = box.row()
        row.label(text="The libraries that Get Libraries fetched are in place.")
        row.operator("curecon.remove_libraries", text="", icon="TRASH")


CLASSES = (CURECON_AP_preferences,)
