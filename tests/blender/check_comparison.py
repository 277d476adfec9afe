# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A compared cloud stands where ours stands, shows its distances, and is no part of the site. Arguments: a folder, and
the Python of the worker."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
import workspace_scene
from mathutils import Matrix

import curecon_blender
from curecon_blender import preferences
from curecon_blender.core.base.ply import row_type, table, write_ply
from curecon_blender.core.cloud.ply import read_cloud
from curecon_blender.scene import comparison
from curecon_blender.scene.points import positions
from curecon_blender.scene.workspace import clouds_of

FOLDER, WORKER = map(Path, sys.argv[1:3])
preferences.Settings.__init__.__kwdefaults__["worker_python"] = WORKER
ROW = row_type([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1"),
                ("distance", "<f4"), ("limit", "<f4")])


def write(name: str, distance: np.ndarray, limit: np.ndarray) -> Path:
    count = len(distance)
    places = np.random.default_rng(1).random((count, 3)) * 9
    write_ply(FOLDER / name, {"vertex": table(ROW, {
        "x y z": places, "red green blue": np.full((count, 3), 77), "distance": distance, "limit": limit})})
    return FOLDER / name


def colours(item: bpy.types.Object) -> np.ndarray:
    values = np.empty(4 * len(item.data.points), np.float32)
    item.data.attributes["Color"].data.foreach_get("color", values)
    return values.reshape(-1, 4)[:, :3]


def check_distances() -> None:
    far = np.where(np.arange(300) < 30, 1.0, 0.01)
    file = write("1_B.compared.ply", far, np.zeros(300))
    assert bpy.ops.curecon.import_comparison(filepath=str(file)) == {"FINISHED"}
    item = bpy.context.active_object
    assert comparison.is_compared(item) and item.name == "1_B" and len(item.data.points) == 300
    ours = clouds_of(bpy.context.scene)
    assert len(ours) == 1 and item not in ours and item.matrix_world == ours[0].matrix_world
    distance = np.empty(300, np.float32)
    item.data.attributes["distance"].data.foreach_get("value", distance)
    near, away = colours(item)[distance < 0.5], colours(item)[distance > 0.5]
    assert len(away) == 30 and (near[:, 2] > near[:, 0]).all() and (away[:, 0] > away[:, 2]).all()
    bpy.ops.curecon.colour_comparison(by="photo")
    assert np.ptp(colours(item)) < 1e-6
    assert positions(item.data).max() <= 9


def check_change() -> None:
    moved = np.array([-1.0, 1.0, 0.05, np.nan] * 50)
    bpy.ops.curecon.import_comparison(filepath=str(write("2_later.compared.ply", moved, np.full(200, 0.1))))
    item = bpy.context.active_object
    distance = np.empty(200, np.float32)
    item.data.attributes["distance"].data.foreach_get("value", distance)
    shown = colours(item)
    lost, came = shown[distance < -0.5].mean(axis=0), shown[distance > 0.5].mean(axis=0)
    assert lost[0] > 2 * lost[2] and came[2] > 2 * came[0]
    assert np.ptp(shown[np.abs(distance) < 0.1], axis=1).max() < 1e-6, "what is not significant has a colour"
    bars = comparison.histogram(item)
    assert bars[0].low == -bars[-1].high and abs(bars[0].share - 1 / 3) < 1e-6, "lost, came and alike are a third each"


def check_results_of_others() -> None:
    """One button: the sheet, the figures, and each result as a coloured cloud whose distances are counted."""
    ours = read_cloud(FOLDER / "site" / "cloud.ply").points
    for name, shift in (("near", 0.01), ("far", 0.3)):
        np.savetxt(FOLDER / f"{name}.xyz", ours + [0, 0, shift], fmt="%.4f")
    assert bpy.ops.curecon.compare(directory=str(FOLDER), files=[{"name": "near.xyz"}, {"name": "far.xyz"}],
                                   threshold=0.1) == {"FINISHED"}
    made = FOLDER / "site" / "compare"
    assert (made / "sheet.pdf").read_bytes().startswith(b"%PDF") and (made / "sheet.png").is_file()
    near, far = (bpy.data.objects[name] for name in ("1_near", "2_far"))
    for item, expected in ((near, 0), (far, -1)):  # the bar that holds most of it
        bpy.context.view_layer.objects.active = item
        bpy.ops.curecon.colour_comparison(most=0.2)
        bars = comparison.histogram(item)
        assert bars[0].low == 0 and abs(bars[-1].high - 0.2) < 1e-6
        assert bars[expected].share > 0.7, [bar.share for bar in bars]


curecon_blender.register()
try:
    bpy.ops.wm.read_homefile(use_empty=True)
    assert not bpy.ops.curecon.colour_comparison.poll()
    workspace_scene.imported(FOLDER / "site")
    clouds_of(bpy.context.scene)[0].matrix_world = Matrix.Translation((3, 4, 5))
    bpy.context.view_layer.update()
    check_distances()
    check_change()
    check_results_of_others()
    plain = FOLDER / "site" / "cloud.ply"
    try:
        bpy.ops.curecon.import_comparison(filepath=str(plain))
    except RuntimeError as error:
        assert "is not a comparison" in str(error), error
    else:
        raise AssertionError("a cloud without distances was taken")
finally:
    curecon_blender.unregister()
print("CHECKED")
