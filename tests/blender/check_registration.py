# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Every class is registered under its name, twice over, and nothing is left behind."""

from __future__ import annotations

import importlib
import pkgutil
from typing import Any

import bpy

import curecon_blender


def our_classes() -> list[Any]:
    """Every Blender class that the package defines, found by looking rather than in its CLASSES."""
    found = []
    for module in pkgutil.walk_packages(curecon_blender.__path__, "curecon_blender."):
        if module.name.startswith("curecon_blender.core"):
            continue
        for value in vars(importlib.import_module(module.name)).values():
            if isinstance(value, type) and value.__module__ == module.name and hasattr(value, "bl_rna"):
                found.append(value)
    return found


classes = our_classes()
assert len(classes) > 12, classes
for _ in range(2):
    curecon_blender.register()
    for cls in classes:
        assert cls.is_registered, f"{cls.__name__} is in no CLASSES"
        assert cls.__name__.startswith("CURECON_"), cls
        if issubclass(cls, bpy.types.Operator):
            assert cls.__name__ == f"CURECON_OT_{cls.bl_idname.removeprefix('curecon.')}", cls
            assert cls.__doc__, f"{cls.__name__} has no tooltip"
    assert bpy.context.scene.curecon.quality == "standard"
    curecon_blender.unregister()
    assert not any(cls.is_registered for cls in classes)
    assert not hasattr(bpy.types.Scene, "curecon")
print("CHECKED")
