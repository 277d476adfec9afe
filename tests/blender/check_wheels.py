# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A zip with wheels comes out of an extension repository, and the worker finds them. Argument: the repository's folder.

Run with BLENDER_USER_RESOURCES in a temporary folder."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import bpy

REPOSITORY = Path(sys.argv[1])

bpy.context.preferences.system.use_online_access = True  # Blender asks for it even where the repository is a folder
repository = bpy.context.preferences.extensions.repos.new(
    name="Releases", module="releases", remote_url=(REPOSITORY / "index.json").as_uri(),
)
repository.enabled = True
repositories = bpy.context.preferences.extensions.repos
assert bpy.ops.extensions.repo_sync(repo_index=repositories.find(repository.name)) == {"FINISHED"}
assert bpy.ops.extensions.package_install(
    repo_index=repositories.find(repository.name), pkg_id="curecon_blender", enable_on_install=True,
) == {"FINISHED"}
name = "bl_ext.releases.curecon_blender"
assert name in bpy.context.preferences.addons

# The worker's Python, started as the add-on starts it, sees the wheel and Blender's own NumPy.
settings = sys.modules[f"{name}.curecon_blender.preferences"].settings(bpy.context)
told = subprocess.run(
    [settings.worker_python, "-c", "import curecon_probe, numpy; print(curecon_probe.VALUE, numpy.__file__)"],
    env={"PYTHONPATH": ":".join(map(str, settings.import_paths))}, capture_output=True, text=True, check=True,
).stdout.split()
assert told[0] == "7" and ".local" not in told[1], told
bpy.ops.preferences.addon_disable(module=name)
print("CHECKED")
