# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The built zip installs, is enabled, and its worker's package can be found. Arguments: the zip, an empty folder.

Run with BLENDER_USER_RESOURCES in a temporary folder."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import workspace_scene

ARCHIVE, FOLDER = Path(sys.argv[1]), Path(sys.argv[2])
NAME = "bl_ext.user_default.curecon_blender"

workspace_scene.write(FOLDER / "one")
# From here on the package must be the installed one.
sys.path = [entry for entry in sys.path if not (Path(entry) / "curecon_blender").is_dir()]
for module in [name for name in sys.modules if name.partition(".")[0] == "curecon_blender"]:
    del sys.modules[module]

assert bpy.ops.extensions.package_install_files(
    filepath=str(ARCHIVE), repo="user_default", enable_on_install=True
) == {"FINISHED"}
assert NAME in bpy.context.preferences.addons
try:
    assert bpy.ops.curecon.import_workspace(directory=str(FOLDER / "one")) == {"FINISHED"}
    assert len(bpy.data.pointclouds[0].points) == workspace_scene.POINTS
    preferences = bpy.context.preferences.addons[NAME].preferences
    preferences.worker_python, preferences.memory_gib = "//python", 2.0
    preferences.scheduler = " tcp://192.168.1.5:8786"
    package = sys.modules[f"{NAME}.curecon_blender.preferences"]
    settings = package.settings(bpy.context)
    assert settings.memory_gib == 2.0 and settings.scheduler == "tcp://192.168.1.5:8786"
    root = settings.import_paths[0]
    assert "user_default" in root.parts and (root / "curecon_blender" / "core").is_dir(), root
finally:
    bpy.ops.preferences.addon_disable(module=NAME)
assert not hasattr(bpy.types.Scene, "curecon")
print("CHECKED")
