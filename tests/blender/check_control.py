# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Control points in Blender: imported, marked, predicted, kept in the workspace, taken back, exported. Argument: a
folder."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path

import bpy
import numpy as np
import workspace_scene

import curecon_blender
from curecon_blender.core.adjust.control import CHECK, read_control
from curecon_blender.core.adjust.marking import seen, to_pixels
from curecon_blender.core.adjust.record import ACCURACY_FILE, Accuracy, PointResidual
from curecon_blender.core.base.files import write_json
from curecon_blender.core.base.geodesy import enu_to_geodetic
from curecon_blender.core.base.records import GeoPosition
from curecon_blender.core.views.record import read as read_views
from curecon_blender.scene import control, frame
from curecon_blender.scene.frame import parts_of

FOLDER = Path(sys.argv[1])
SITE = FOLDER / "site"
ORIGIN = GeoPosition(latitude=24.5, longitude=117.25, altitude=310.0)
PLACES = {"gcp1": np.array([3.0, 4.0, 0.5]), "gcp2": np.array([7.0, 6.0, 0.25]), "gcp3": np.array([5.0, 2.0, 0.0])}


def scene() -> bpy.types.Scene:
    return bpy.context.scene


def pixel(photo: str, place: np.ndarray) -> np.ndarray:
    """Where a place of the site is in a photo, by the workspace's own cameras."""
    view = next(view for view in read_views(SITE)[0].views if view.name == photo)
    return to_pixels(workspace_scene.LENS, seen(view.cam_from_world[None], place)[0])[0]


def mark(name: str, photo: str) -> None:
    assert bpy.ops.curecon.set_mark(point=name, photo=photo, pixel=pixel(photo, PLACES[name]).tolist()) == {"FINISHED"}


def write_points(path: Path) -> None:
    places = enu_to_geodetic(np.array(list(PLACES.values())), ORIGIN)
    rows = [f"{name},{lat:.9f},{lon:.9f},{z:.4f}" for name, (lat, lon, z) in zip(PLACES, places, strict=True)]
    path.write_text("name,latitude,longitude,height\n" + "\n".join(rows))


def check_import() -> None:
    """Points are on the list with all their digits, and stand in the site where their coordinates say."""
    write_points(FOLDER / "points.csv")
    bpy.ops.curecon.import_control(directory=str(FOLDER), files=[{"name": "points.csv"}])
    properties = scene().curecon.control
    assert [item.name for item in properties.points] == list(PLACES)
    for name, place in PLACES.items():
        np.testing.assert_allclose(control.given_place(scene(), name), place, atol=1e-3)
    assert len(read_control(SITE).points) == 3
    (FOLDER / "bad.csv").write_text("gcp1,0,0,0\ngcp1,1,0,0\n")
    before = properties.text
    try:
        bpy.ops.curecon.import_control(directory=str(FOLDER), files=[{"name": "bad.csv"}], system="local")
    except RuntimeError as error:
        assert "bad.csv, line 2" in str(error), error
    else:
        raise AssertionError("two points of one name were taken")
    assert properties.text == before


def check_marks() -> None:
    """Marks give the place, wherever the site was moved, and tell their errors; the walk leads through all photos."""
    names = workspace_scene.PHOTOS
    mark("gcp1", names[0])
    assert control.place_of(scene(), "gcp1") is None
    np.testing.assert_allclose(control.expected(scene(), "gcp1"), PLACES["gcp1"], atol=1e-3)  # by its coordinates
    mark("gcp1", names[1])
    np.testing.assert_allclose(control.place_of(scene(), "gcp1"), PLACES["gcp1"], atol=1e-4)
    known = control.photo_cameras(scene())
    for photo in names:
        expected = pixel(photo, PLACES["gcp1"])
        np.testing.assert_allclose(control.pixel_of(known[photo], PLACES["gcp1"]), expected, atol=1e-2)
    assert {camera.name for camera in control.walk(scene(), "gcp1")} == set(names)
    assert max(control.errors(scene(), "gcp1").values()) < 0.02
    off = (pixel(names[2], PLACES["gcp1"]) + [6, 0]).tolist()
    bpy.ops.curecon.set_mark(point="gcp1", photo=names[2], pixel=off)
    assert control.errors(scene(), "gcp1")[names[2]] > 1
    bpy.ops.curecon.set_mark(point="gcp1", photo=names[2])
    assert len(control.of(scene()).marks_of("gcp1")) == 2
    part = parts_of(scene())[0]
    bpy.ops.curecon.frame_scale(first=(0, 0, 0), second=(10, 0, 0), length=20.0)
    np.testing.assert_allclose(control.place_of(scene(), "gcp1"), 2 * PLACES["gcp1"], atol=1e-3)
    np.testing.assert_allclose(control.given_place(scene(), "gcp1"), 2 * PLACES["gcp1"], atol=1e-3)
    with bpy.context.temp_override(active_object=part.clouds[0]):
        bpy.ops.curecon.frame_reset()
    seen_photos = []
    for _ in names:
        assert bpy.ops.curecon.show_point(step=1) == {"FINISHED"}
        seen_photos.append(control.photo_camera(scene().camera).name)
    assert set(seen_photos) == set(names)


def check_undo() -> None:
    """A mark, a role and an accuracy can be taken back, in the workspace too."""
    bpy.ops.ed.undo_push(message="before")
    mark("gcp2", workspace_scene.PHOTOS[0])
    item = scene().curecon.control.points[1]
    item.role = CHECK
    item.sigma_plan = 0.005
    kept = read_control(SITE)
    assert kept.marks_of("gcp2") and kept.point("gcp2").role == CHECK and kept.point("gcp2").sigma_plan == 0.005
    bpy.ops.ed.undo_push(message="marked")
    bpy.ops.ed.undo()
    kept = read_control(SITE)
    assert not kept.marks_of("gcp2") and kept.point("gcp2").role == "control"
    assert scene().curecon.control.points[1].role == "control"
    bpy.ops.ed.redo()
    assert read_control(SITE).marks_of("gcp2") and scene().curecon.control.points[1].role == CHECK


def check_residuals() -> None:
    """What points are off comes with the workspace, control apart from check points."""
    off = [PointResidual(name=name, off=(0.01 * n, 0.0, -0.02), marks=3, pixels=0.4) for n, name in enumerate(PLACES)]
    accuracy = Accuracy(adjusted=True, reprojection_error=0.5, control=tuple(off[:2]), check=tuple(off[2:]))
    write_json(SITE / "sparse" / "0" / ACCURACY_FILE, asdict(accuracy))
    bpy.ops.curecon.import_workspace(directory=str(SITE))
    found = control.residuals(scene())
    assert found == {"control": accuracy.control, "check": accuracy.check, "left_out": ()}


def check_files() -> None:
    """What was marked leaves as ODM's file, and comes back with the workspace."""
    bpy.ops.curecon.export_control(filepath=str(FOLDER / "gcp_list.txt"))
    lines = (FOLDER / "gcp_list.txt").read_text().splitlines()
    assert lines[0] == "EPSG:4326" and len(lines) == 4
    text = scene().curecon.control.text
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.curecon.import_workspace(directory=str(SITE))
    assert control.of(scene()) == control._parsed(text)
    scene().curecon.control.index = 2
    bpy.ops.curecon.delete_control_point()
    assert [point.name for point in read_control(SITE).points] == ["gcp1", "gcp2"]
    assert frame.has_position()
    bpy.ops.curecon.forget_position()
    assert not control.of(scene()).points and not frame.has_position()
    assert len(read_control(SITE).points) == 2


curecon_blender.register()
try:
    bpy.ops.wm.read_homefile(use_empty=True)
    assert not bpy.ops.curecon.set_mark.poll() or not bpy.ops.curecon.show_point.poll()
    SITE.mkdir()
    workspace_scene.write(SITE)
    bpy.ops.curecon.import_workspace(directory=str(SITE))
    check_import()
    check_marks()
    check_undo()
    check_residuals()
    check_files()
finally:
    curecon_blender.unregister()
print("CHECKED")
