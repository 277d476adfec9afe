# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The frame tools move a whole site by one similarity, which survives undo, re-import, export and saving; distances
carry their uncertainty. Argument: an empty folder."""

from __future__ import annotations

import json
import struct
import sys
from pathlib import Path

import bpy
import numpy as np
import surface_scene
import workspace_scene
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

import curecon_blender
from curecon_blender.core.cloud.ply import Cloud, CloudWriter
from curecon_blender.scene import measurements, site
from curecon_blender.scene.frame import world_matrix
from curecon_blender.scene.points import positions
from curecon_blender.scene.surface import surfaces_of
from curecon_blender.scene.workspace import clouds_of

FOLDER = Path(sys.argv[1])
SITE, KEPT = FOLDER / "one", FOLDER / "one" / "sparse" / "0" / "adjustment.json"
SLAB = np.array([(0.0, 0, 0), (10, 0, 0), (0, 10, 0), (10, 10, 1)])


def scene() -> bpy.types.Scene:
    return bpy.context.scene


def tells_where(blend: Path) -> bool:
    """Save the scene and look for its longitude, 117.25 degrees, in words or as a number."""
    bpy.ops.wm.save_as_mainfile(filepath=str(blend), compress=False)
    content = blend.read_bytes()
    return any(form in content for form in (b"117.25", struct.pack("<d", 117.25), struct.pack("<f", 117.25)))


def where(places: np.ndarray) -> np.ndarray:
    """Places (N,3) of the site as reconstructed in the world now; all that is the site's must agree on it."""
    bpy.context.view_layer.update()
    found = [np.array([world_matrix(item) @ Vector(place) for place in places])
             for item in (clouds_of(scene())[0], surfaces_of(scene())[0])]
    np.testing.assert_allclose(*found, atol=1e-4)
    return found[0]


def check_photos() -> None:
    """The world falls on each photo as it did before anything was moved."""
    width, height = workspace_scene.SIZE
    for index, name in enumerate(workspace_scene.PHOTOS):
        camera = bpy.data.objects[name]
        with bpy.context.temp_override(active_object=camera):
            bpy.ops.curecon.look_through(which="SELECTED")
        K, cam_from_world = workspace_scene.camera(index)
        for place, given in zip(where(SLAB), SLAB, strict=True):
            seen = world_to_camera_view(scene(), camera, Vector(place))
            projected = K @ (cam_from_world[:, :3] @ given + cam_from_world[:, 3])
            pixel = np.array([seen.x * width, (1 - seen.y) * height])
            assert np.abs(pixel - projected[:2] / projected[2]).max() < 0.02, (name, pixel, projected)
        assert np.allclose(camera.scale, 1)


def error_of(operator, **options: object) -> str:  # type: ignore[no-untyped-def]
    try:
        result = operator(**options)
    except RuntimeError as error:
        return str(error)
    raise AssertionError(f"no error, but {result}")


def check_tools() -> None:
    properties = scene().curecon
    assert bpy.ops.curecon.add_region() == {"FINISHED"}
    region = np.array(properties.region.matrix_world)
    assert "places first, second" in error_of(bpy.ops.curecon.measure)
    assert bpy.ops.curecon.measure(first=SLAB[0], second=SLAB[1]) == {"FINISHED"}
    assert "units" in measurements.in_words(scene(), properties.measurements[0])

    # Scale: 10 units are 25 m.
    assert bpy.ops.curecon.frame_scale(first=SLAB[0], second=SLAB[1], length=25.0, known_to=0.05) == {"FINISHED"}
    np.testing.assert_allclose(where(SLAB), 2.5 * SLAB, atol=1e-4)
    np.testing.assert_allclose(np.array(properties.region.matrix_world)[:3], 2.5 * region[:3], atol=1e-4)
    check_photos()
    known = site.known(scene())
    assert known.metres and known.scale_source == "a measured distance of 25.00 m", known
    assert scene().unit_settings.system == "METRIC"
    words = measurements.in_words(scene(), properties.measurements[0])
    assert words == "25 m ± 2 m", words  # the slab is a thick haze, and its scale rests on two picks in it

    # Bearing, then level: a floor that rises to the east by a tenth.
    assert bpy.ops.curecon.frame_north(first=where(SLAB)[0], second=where(SLAB)[2], bearing=90.0) == {"FINISHED"}
    np.testing.assert_allclose(where(SLAB)[2], (25, 0, 0), atol=1e-4)
    floor = where(np.array([(0.0, 0, 0), (10, 0, 1), (0, 10, 0)]))
    assert bpy.ops.curecon.frame_level(plane="FLOOR", first=floor[0], second=floor[1], third=floor[2]) == {"FINISHED"}
    flat = where(np.array([(0.0, 0, 0), (10, 0, 1), (0, 10, 0)]))
    assert np.ptp(flat[:, 2]) < 1e-4
    assert np.linalg.norm(flat[2]) - 25 < 1e-4
    check_photos()
    collection = bpy.data.collections["CU-Recon: one"]
    surface = surfaces_of(scene())[0]
    for holder in (collection, surface):
        assert (holder["scale"], holder["up"], holder["north"]) == ("metres", "measured", True)
    assert "one line" in error_of(bpy.ops.curecon.frame_level, plane="FLOOR", first=(0, 0, 0), second=(1, 0, 0),
                                  third=(2, 0, 0))


def write_terrain(folder: Path) -> None:
    """A workspace of a field at z = -8 with a house on it, whose flat roof is at -2, and some strays deep below."""
    workspace_scene.write(folder)
    rng = np.random.default_rng(2)
    field, roof = rng.uniform(-20, 20, (6000, 2)), rng.uniform(-6, 6, (2500, 2))
    points = np.concatenate([
        np.column_stack([field, rng.normal(-8, 0.05, 6000)]), np.column_stack([roof, rng.normal(-2, 0.05, 2500)]),
        np.column_stack([roof[:40], rng.uniform(-30, -12, 40)]),
    ]).astype(np.float32)
    with CloudWriter(folder / "cloud.ply") as writer:
        writer.write(Cloud(
            points=points, colours=np.full(points.shape, 128, np.uint8), confidence=np.ones(len(points), np.float32),
            normals=np.tile(np.float32([0, 0, 1]), (len(points), 1)), views=np.full(len(points), 5, np.uint8),
        ))


def check_ground() -> None:
    """The ground comes to Z = 0, the origin's altitude with it, and stays there over a new scale and an import."""
    write_terrain(FOLDER / "terrain")
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.curecon.import_workspace(directory=str(FOLDER / "terrain"))

    def of_ground() -> Vector:
        bpy.context.view_layer.update()
        return clouds_of(scene())[0].matrix_world @ Vector((10, 10, -8))

    assert bpy.ops.curecon.frame_ground() == {"FINISHED"}
    np.testing.assert_allclose(of_ground(), (10, 10, 0), atol=0.05)
    collection = bpy.data.collections["CU-Recon: terrain"]
    assert abs(collection["origin_altitude"] - 302) < 0.05
    bpy.ops.curecon.frame_scale(first=(0, 0, 0), second=(10, 0, 0), length=20.0)
    np.testing.assert_allclose(of_ground(), (20, 20, 0), atol=0.1)
    bpy.ops.curecon.import_workspace(directory=str(FOLDER / "terrain"))
    np.testing.assert_allclose(of_ground(), (20, 20, 0), atol=0.1)
    assert bpy.ops.curecon.frame_reset() == {"FINISHED"}
    np.testing.assert_allclose(of_ground(), (10, 10, -8), atol=1e-4)
    assert bpy.data.collections["CU-Recon: terrain"]["origin_altitude"] == 310


def check_files() -> np.ndarray:
    """What the workspace keeps comes back with an import, an export, a saved file; undo takes it back there too."""
    stands = where(SLAB)
    kept = json.loads(KEPT.read_text())
    assert [step["kind"] for step in kept["measured"]] == ["scale", "north", "level"]
    assert np.allclose(kept["measured"][0]["points"], SLAB[:2], atol=1e-5)
    for _ in range(2):
        assert bpy.ops.curecon.import_workspace(directory=str(SITE)) == {"FINISHED"}
        np.testing.assert_allclose(where(SLAB), stands, atol=1e-4)
    check_photos()
    assert site.known(scene()).scale_source == "a measured distance of 25.00 m"
    assert " m ± " in measurements.in_words(scene(), scene().curecon.measurements[0])

    assert bpy.ops.curecon.export_surface(filepath=str(FOLDER / "out.ply"), form="PLY") == {"FINISHED"}
    written = (FOLDER / "out.ply").read_bytes()
    assert b"x east, y north, metres" in written[:600]
    wanted = where(surface_scene.mesh().vertices)
    start = written.index(b"end_header\n") + len(b"end_header\n")
    header = written[:start].decode()
    assert header.index("property float x") < header.index("property float y") < header.index("property float z")
    sizes = {"float": 4, "uchar": 1, "int": 4}
    kinds = header[header.index("element vertex"):header.index("element face")].split("property ")[1:]
    row = sum(sizes[kind.split()[0]] for kind in kinds)
    count = int(header.split("element vertex ")[1].split()[0])
    body = np.frombuffer(written[start:start + row * count], np.uint8).reshape(count, row)
    places = body[:, :12].copy().view("<f4")
    np.testing.assert_allclose(places.min(axis=0), wanted.min(axis=0), atol=1e-3)
    np.testing.assert_allclose(places.max(axis=0), wanted.max(axis=0), atol=1e-3)
    return stands


def check_undo(stands: np.ndarray) -> None:
    bpy.ops.ed.undo_push(message="before")
    text = KEPT.read_text()
    assert bpy.ops.curecon.frame_turn(turn=30.0) == {"FINISHED"}
    bpy.ops.ed.undo_push(message="turned")
    assert KEPT.read_text() != text and np.abs(where(SLAB) - stands).max() > 1
    bpy.ops.ed.undo()
    np.testing.assert_allclose(where(SLAB), stands, atol=1e-4)
    assert KEPT.read_text() == text
    bpy.ops.ed.redo()
    assert KEPT.read_text() != text
    assert bpy.ops.curecon.frame_reset() == {"FINISHED"}
    assert not KEPT.exists() and not bpy.ops.curecon.frame_reset.poll()
    np.testing.assert_allclose(where(SLAB), SLAB, atol=1e-4)
    check_photos()
    assert not site.known(scene()).metres and scene().unit_settings.system == "NONE"


curecon_blender.register()
try:
    assert not bpy.ops.curecon.measure.poll()
    workspace_scene.write(SITE, scale="unknown")
    surface_scene.write(SITE, textured=True)
    bpy.ops.curecon.import_workspace(directory=str(SITE))
    check_tools()
    check_undo(check_files())

    # A site that the user has moved is put right where it stands.
    for item in bpy.data.collections["CU-Recon: one"].all_objects:
        item.location.x += 100
    bpy.context.view_layer.update()
    bpy.ops.curecon.frame_scale(first=(100, 0, 0), second=(110, 0, 0), length=20.0)
    np.testing.assert_allclose(where(SLAB), 2 * SLAB + (100, 0, 0), atol=1e-4)
    assert positions(clouds_of(scene())[0].data).max() <= 10  # the points themselves are never changed

    # Copy and delete.
    bpy.ops.curecon.measure(first=(100, 0, 0), second=(100, 20, 0))
    lines = measurements.as_text(scene()).splitlines()
    assert len(lines) == 2 and lines[1].startswith("2\t20"), lines
    assert bpy.ops.curecon.delete_measurement() == {"FINISHED"} and len(scene().curecon.measurements) == 1
    bpy.ops.curecon.delete_measurement(all=True)
    assert not bpy.ops.curecon.delete_measurement.poll() and not bpy.ops.curecon.copy_measurements.poll()

    # Two parts: each is put right by itself.
    workspace_scene.write(FOLDER / "parts", parts=2, scale="unknown")
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.curecon.import_workspace(directory=str(FOLDER / "parts"))
    second = bpy.data.objects["parts Cloud 2"]
    second.location.x = 50
    bpy.context.view_layer.update()
    bpy.ops.curecon.frame_scale(first=(50, 0, 0), second=(60, 0, 0), length=30.0)
    bpy.context.view_layer.update()
    assert np.isclose(second.matrix_world.median_scale, 3) and bpy.data.objects["parts Cloud 1"].scale.x == 1
    assert (FOLDER / "parts" / "sparse" / "1" / "adjustment.json").is_file()
    assert site.subject(scene()) == bpy.data.objects["parts Cloud 1"] and not site.known(scene()).metres

    # A .blend to be given away does not tell where the site is; its workspace still does.
    scene().curecon.present.longitude = 117.25
    assert tells_where(FOLDER / "mine.blend")
    assert bpy.ops.curecon.forget_position() == {"FINISHED"} and not bpy.ops.curecon.forget_position.poll()
    assert not tells_where(FOLDER / "given.blend")
    assert second["scale"] if "scale" in second else second.users_collection[0]["scale"] == "metres"
    bpy.ops.curecon.import_workspace(directory=str(FOLDER / "parts"))
    assert bpy.ops.curecon.forget_position.poll()
    check_ground()
finally:
    curecon_blender.unregister()
print("CHECKED")
