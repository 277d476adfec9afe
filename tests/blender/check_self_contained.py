# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A self-contained zip in a Blender that has nothing else: install it, reconstruct photos, see the cloud. Arguments:
the zip, a folder of photos, an empty folder, and how many photos to take, from the last one back (all).

Not part of the tests, since the zip's wheels are downloads. Run it in a Python with bpy and what bpy needs alone:

    env -u PYTHONPATH BLENDER_USER_RESOURCES=EMPTY python check_self_contained.py ZIP samples/tulou/photos EMPTY 12
"""

from __future__ import annotations

import importlib.util
import shutil
import sys
import time
from pathlib import Path

import bpy

ARCHIVE, PHOTOS, FOLDER = map(Path, sys.argv[1:4])
COUNT = int(sys.argv[4]) if len(sys.argv) > 4 else 0
NAME = "bl_ext.user_default.curecon_blender"
OWN = {"cv2", "numba", "PIL", "pycolmap", "scipy", "torch", "xatlas", "fast_simplification"}

found = {name for name in OWN | {"curecon_blender"} if importlib.util.find_spec(name)}
assert not found, f"this Python has {', '.join(sorted(found))} already, so it would prove nothing"

started = time.monotonic()
assert bpy.ops.extensions.package_install_files(
    filepath=str(ARCHIVE), repo="user_default", enable_on_install=True
) == {"FINISHED"}
print(f"installed in {time.monotonic() - started:.0f} s", flush=True)

site = FOLDER / "site"
site.mkdir()
for photo in sorted(PHOTOS.glob("*.JPG"))[-COUNT:]:
    shutil.copy(photo, site)
properties = bpy.context.scene.curecon
preferences = bpy.context.preferences.addons[NAME].preferences
assert preferences.worker_python == ""  # Blender's own Python does the work
assert bpy.ops.curecon.choose_photos(directory=str(site)) == {"FINISHED"}
properties.quality = "preview"
started = time.monotonic()
assert bpy.ops.curecon.reconstruct() == {"FINISHED"}
clouds = [len(cloud.points) for cloud in bpy.data.pointclouds]
print(f"reconstructed in {time.monotonic() - started:.0f} s: {clouds} points", flush=True)
assert max(clouds) > 10_000
assert not OWN & set(sys.modules), "the worker's libraries were loaded in Blender itself"
print("CHECKED")
