# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What holds for every scene on this computer, as plain values: the device, its memory, the worker's Python, where
workspaces go. panels/preferences.py shows it."""

from __future__ import annotations

import hashlib
import importlib.util
import sys
from dataclasses import dataclass
from pathlib import Path

import bpy

from .core.run.libraries import RECORD

# The add-on's name in Blender is that of the extension (bl_ext.<repository>.curecon_blender), one package up from this
# one; in a source checkout this package stands alone.
ADDON = __package__.rpartition(".")[0] or __package__
LOCKS = Path(__file__).resolve().parent.parent / "wheels"  # with lock files where the zip brings no libraries itself


def user_folder() -> Path:
    """The extension's own folder of the user."""
    if ADDON.startswith("bl_ext."):
        return Path(bpy.utils.extension_path_user(ADDON, create=True))
    return Path(bpy.utils.user_resource("CONFIG", path="curecon", create=True))  # a source checkout


@dataclass(frozen=True, kw_only=True)
class Settings:
    """The preferences as plain values; the defaults hold where the package runs without being an enabled add-on."""

    device: str = "auto"
    memory_gib: float | None = None
    worker_python: Path = Path(sys.executable)
    scheduler: str = ""
    cache: Path | None = None
    sound: bool = False
    indexes: tuple[str, ...] = ()
    atlas: str = ""
    atlas_token: str = ""

    @property
    def is_blenders(self) -> bool:
        """Whether Blender's own Python does the work."""
        return self.worker_python == Path(sys.executable)

    @property
    def import_paths(self) -> list[Path]:
        """What goes on the worker's PYTHONPATH: the extension's folder, the libraries that were fetched for this
        Python and, for Blender's own, its wheels."""
        root = Path(__file__).resolve().parent.parent
        fetched = [self.libraries] if self.has_libraries else []
        if not self.is_blenders:
            return [root, *fetched]
        wheels = [Path(entry) for entry in sys.path if Path(entry).parts[-1:] == ("site-packages",)]
        return [root, *fetched, *wheels]

    @property
    def libraries(self) -> Path:
        """Where Get Libraries puts what this Python needs."""
        name = f"py{sys.version_info.major}{sys.version_info.minor}" if self.is_blenders else hashlib.sha256(
            str(self.worker_python).encode()).hexdigest()[:8]
        return user_folder() / "libraries" / name

    @property
    def has_libraries(self) -> bool:
        return (self.libraries / RECORD).is_file()

    @property
    def lacks_libraries(self) -> bool:
        """Whether Blender's own Python is to do the work and has nothing to do it with, or fetching was cut off."""
        begun = self.libraries.is_dir() or (self.is_blenders and importlib.util.find_spec("torch") is None)
        return LOCKS.is_dir() and begun and not self.has_libraries


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
        indexes=tuple(preferences.indexes.split()), atlas=preferences.atlas.strip(),
        atlas_token=preferences.atlas_token.strip(),
    )
