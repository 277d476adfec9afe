# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Whose the record is: licence and credit are asked for once, and later files have them from the preferences."""

from __future__ import annotations

import bpy

from ..preferences import ADDON

FIELDS = {"licence": "licence", "credit": "credit"}  # of the scene, and of the preferences


def recall(context: bpy.types.Context) -> None:
    """Fill in what the scene does not say."""
    addon = context.preferences.addons.get(ADDON)
    for name, kept in FIELDS.items() if addon is not None else ():
        if not getattr(context.scene.curecon, name):
            setattr(context.scene.curecon, name, getattr(addon.preferences, kept))


def remember(context: bpy.types.Context) -> None:
    """Keep what the scene says for the files that come after."""
    addon = context.preferences.addons.get(ADDON)
    for name, kept in FIELDS.items() if addon is not None else ():
        said = getattr(context.scene.curecon, name)
        if said and said != getattr(addon.preferences, kept):
            setattr(addon.preferences, kept, said)
            context.preferences.is_dirty = True  # Blender writes them when it quits
