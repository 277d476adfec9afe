# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What holds for every scene on this computer: the device, its memory, the worker's Python, where workspaces go."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import bpy
from bpy.props import EnumProperty, FloatProperty, StringProperty

from . import ADDON

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
        description="Gibibytes that the depth stage may use; 0 takes 60 % of what is free when it starts",
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

    def draw(self, context: bpy.types.Context) -> None:
        from .panels import self_check  # the panels need the preferences

        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(self, "device")
        layout.prop(self, "memory_gib", text="Memory Budget (GiB, 0 = Automatic)")
        layout.prop(self, "worker_python", placeholder="Blender's own Python")
        layout.prop(self, "scheduler", placeholder="This computer alone")
        layout.prop(self, "cache", placeholder="Beside the photos")
        self_check.draw(layout, context)


@dataclass(frozen=True, kw_only=True)
class Settings:
    """The preferences as plain values; the defaults hold where the package runs without being an enabled add-on."""

    device: str = "auto"
    memory_gib: float | None = None
    worker_python: Path = Path(sys.executable)
    scheduler: str = ""
    cache: Path | None = None

    @property
    def import_paths(self) -> list[Path]:
        """What goes on the worker's PYTHONPATH: the extension's folder and, for Blender's own Python, its wheels."""
        root = Path(__file__).resolve().parent.parent
        if self.worker_python != Path(sys.executable):
            return [root]
        wheels = [Path(entry) for entry in sys.path if Path(entry).parts[-1:] == ("site-packages",)]
        return [root, *wheels]


def settings(context: bpy.types.Context) -> Settings:
    addon = context.preferences.addons.get(ADDON)
    if addon is None:
        return Settings()
    preferences = addon.preferences
    return Settings(
        device=preferences.device,
        memory_gib=preferences.memory_gib or None,
        worker_python=Path(bpy.path.abspath(preferences.worker_python or sys.executable)),
        scheduler=preferences.scheduler.strip(),
        cache=Path(bpy.path.abspath(preferences.cache)) if preferences.cache else None,
    )


CLASSES = (CURECON_AP_preferences,)
