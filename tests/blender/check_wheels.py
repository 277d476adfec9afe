# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A zip with wheels comes out of an extension repository, the worker finds them, and the next release comes as an
update. Arguments: the repository's folder, and one with the next release.

Run with BLENDER_USER_RESOURCES in a temporary folder."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import bpy

REPOSITORY, NEWER = map(Path, sys.argv[1:3])

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

for file in NEWER.iterdir():
    shutil.copy(file, REPOSITORY)
assert bpy.ops.extensions.repo_sync(repo_index=repositories.find(repository.name)) == {"FINISHED"}
assert bpy.ops.extensions.package_upgrade_all() == {"FINISHED"}
manifest = settings.import_paths[0] / "blender_manifest.toml"
assert tomllib.loads(manifest.read_text(encoding="utf-8"))["version"] == "9.0.0"
assert name in bpy.context.preferences.addons
bpy.ops.preferences.addon_disable(module=name)
print("CHECKED")
