# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The photo check as a user asks for it, its panels in every state, and presets. Arguments: the sample photos, an empty
folder, and a Python for the worker."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import bpy
import numpy as np

import curecon_blender
from curecon_blender import preferences, thumbnails
from curecon_blender.operators import running
from curecon_blender.scene import stations_overlay

PHOTOS, FOLDER, PYTHON = map(Path, sys.argv[1:4])
preferences.Settings.__init__.__kwdefaults__["worker_python"] = PYTHON
curecon_blender.register()
try:
    site = FOLDER / "site"
    site.mkdir()
    for file in sorted(PHOTOS.glob("*.JPG"))[:12]:
        shutil.copy(file, site)

    # A photo that moved while it was taken: half of it is smeared along its rows.
    picture = bpy.data.images.load(str(site / "DJI_0005.JPG"))
    pixels = np.empty(len(picture.pixels), np.float32)
    picture.pixels.foreach_get(pixels)
    rows = pixels.reshape(picture.size[1], picture.size[0], 4)
    picture.pixels.foreach_set(np.mean([np.roll(rows, shift, axis=1) for shift in range(9)], axis=0).ravel())
    picture.filepath_raw, picture.file_format = str(site / "DJI_0005.JPG"), "JPEG"
    picture.save()

    properties = bpy.context.scene.curecon
    assert bpy.ops.curecon.choose_photos(directory=str(site)) == {"FINISHED"}
    assert bpy.ops.curecon.check_photos() == {"FINISHED"}
    check = properties.check
    assert (check.photos, check.cameras) == (12, 2), (check.photos, check.cameras)  # Blender's JPEG tells no camera
    assert check.gps == 11 and check.taken_first.startswith("2024-09-28T10:48:05"), check.taken_first
    assert check.forward > 50 and not check.overlap_unknown
    (doubtful,) = check.doubtful
    assert (doubtful.name, doubtful.problems) == ("DJI_0005.JPG", "blurred")
    assert Path(doubtful.thumbnail).is_file() and Path(doubtful.thumbnail).parent == thumbnails.folder()
    assert thumbnails.icon(str(FOLDER / "gone.jpg")) == 0

    # Where they were taken, for the viewport: also in a scene whose units are centimetres.
    places, corners = stations_overlay.stations(bpy.context.scene)
    assert len(places) == 11 and len(corners) == 11 and len(check.stations) == 11
    low, high = stations_overlay.bounds(bpy.context.scene)
    assert 10 < np.linalg.norm(high - low) < 1000 and low[2] == 0 and 20 < places[:, 2].max() < 120
    bpy.context.scene.unit_settings.scale_length = 0.01
    np.testing.assert_allclose(stations_overlay.stations(bpy.context.scene)[0], places * 100, rtol=1e-5)
    bpy.context.scene.unit_settings.scale_length = 1.0

    for goal in ("fusion", "mesh", "texture"):
        seconds = [check.costs[f"{quality}:{goal}"].seconds for quality in ("preview", "standard", "high", "ultra")]
        assert seconds == sorted(seconds) and seconds[0] > 0
    assert check.free_memory_gib > 0 and check.free_disk_gib > 0

    # Presets: kept, changed, brought back.
    properties.quality, properties.max_faces = "high", 250_000
    bpy.ops.curecon.add_preset(name="Façade")
    properties.quality, properties.max_faces = "preview", 1_000_000
    (kept,) = [Path(p) for folder in bpy.utils.preset_paths("curecon") for p in Path(folder).glob("*.py")]
    bpy.ops.script.execute_preset(filepath=str(kept), menu_idname="CURECON_PT_presets")
    assert (properties.quality, properties.max_faces) == ("high", 250_000)

    # A folder that has gone: the check says so, and what to do.
    shutil.rmtree(site)
    try:
        bpy.ops.curecon.check_photos()
        raise AssertionError("the folder is gone")
    except RuntimeError as error:
        assert "does not exist" in str(error), error
    assert running.status.failure.kind == "photos" and running.panel == "photos"
    assert not thumbnails.folder().exists()
finally:
    curecon_blender.unregister()
print("CHECKED")
