# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Every class is registered under its name, twice over, and nothing is left behind; every operator and property says
what it is for, and every disabled button why it is."""

from __future__ import annotations

import importlib
import inspect
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


def check_words(cls: Any) -> None:
    """Tooltips of a registered class and of the properties that it declares itself."""
    if issubclass(cls, bpy.types.Operator):
        assert cls.__doc__, f"{cls.__name__} has no tooltip"
        assert cls.bl_label[0].isupper(), f"{cls.__name__}: {cls.bl_label}"
    for name in inspect.get_annotations(cls):
        found = cls.bl_rna.properties.get(name)
        if found is not None:
            assert found.description, f"{cls.__name__}.{name} has no description"


def check_disabled(cls: Any) -> bool:
    """Whether the operator cannot be run in an empty scene; it then says why."""
    operator = getattr(bpy.ops.curecon, cls.bl_idname.removeprefix("curecon."))
    if operator.poll():
        return False
    try:
        operator()
    except RuntimeError as error:
        assert "context is incorrect" not in str(error), f"{cls.__name__} does not say why it is disabled"
    return True


classes = our_classes()
assert len(classes) > 12, classes
for _ in range(2):
    curecon_blender.register()
    for cls in classes:
        assert cls.is_registered, f"{cls.__name__} is in no CLASSES"
        assert cls.__name__.startswith("CURECON_"), cls
        check_words(cls)
        if issubclass(cls, bpy.types.Operator):
            assert cls.__name__ == f"CURECON_OT_{cls.bl_idname.removeprefix('curecon.')}", cls
    disabled = [cls for cls in classes if issubclass(cls, bpy.types.Operator) and check_disabled(cls)]
    assert len(disabled) > 5, disabled
    assert bpy.context.scene.curecon.quality == "preview"
    curecon_blender.unregister()
    assert not any(cls.is_registered for cls in classes)
    assert not hasattr(bpy.types.Scene, "curecon")
print("CHECKED")
