# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What holds for every scene on this computer, as plain values: the device, its memory, the worker's Python, where
workspaces go. panels/preferences.py shows it."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import bpy

# The add-on's name in Blender is that of the extension (bl_ext.<repository>.curecon_blender), one package up from this
# one; in a source checkout this package stands alone.
ADDON = __package__.rpartition(".")[0] or __package__


@dataclass(frozen=True, kw_only=True)
class Settings:
    """The preferences as plain values; the defaults hold where the package runs without being an enabled add-on."""

    device: str = "auto"
    memory_gib: float | None = None
    worker_python: Path = Path(sys.executable)
    scheduler: str = ""
    cache: Path | None = None
    sound: bool = False

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
        cache=Path(bpy.path.abspath(preferences.cache)) if preferences.cache else None, sound=preferences.sound,
    )
