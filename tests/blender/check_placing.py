# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts stand where GPS has them, in the unit of the user's scene, which stays; lengths, sheets and exports are metres
all the same. Argument: an empty folder."""

from __future__ import annotations

import json
import math
import struct
import sys
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import surface_scene
import workspace_scene

import curecon_blender
from curecon_blender.core.base.records import GeoPosition
from curecon_blender.core.views import record
from curecon_blender.scene import measurements, site
from curecon_blender.scene.frame import parts_of
from curecon_blender.scene.surface import surfaces_of

FOLDER = Path(sys.argv[1])


def write(name: str, *, parts: int = 1, scale: str = "metres", east: float = 0.0, up: float = 0.0,
          datum: str = "sea level") -> Path:
    """A workspace whose last part's origin lies `east` and `up` of the first's, in metres."""
    folder = FOLDER / name
    workspace_scene.write(folder, parts=parts, scale=scale)
    surface_scene.write(folder, textured=False)
    made = list(record.read(folder))
    origin = made[-1].frame.origin
    assert origin is not None
    turned = math.cos(math.radians(origin.latitude)) * 111_383.6  # metres a degree on WGS84 there
    moved = GeoPosition(latitude=origin.latitude, longitude=origin.longitude + east / turned,
                        altitude=origin.altitude + up, altitude_datum=datum)
    made[-1] = replace(made[-1], frame=replace(made[-1].frame, origin=moved if scale == "metres" else None))
    record.write(folder, made)
    return folder


def bring(*folders: Path, unit: float = 1.0, system: str = "METRIC") -> bpy.types.Scene:
    bpy.ops.wm.read_homefile(use_empty=True)
    scene = bpy.context.scene
    scene.unit_settings.system, scene.unit_settings.scale_length = system, unit
    for folder in folders:
        assert bpy.ops.curecon.import_workspace(directory=str(folder)) == {"FINISHED"}
    bpy.context.view_layer.update()
    return scene


def places(scene: bpy.types.Scene) -> np.ndarray:
    """Where the origin of each part's frame stands, in Blender's units."""
    return np.array([list(part.moved.translation) for part in parts_of(scene)])


def check_parts_by_gps() -> None:
    apart = write("apart", parts=2, east=60, up=-5)
    found = places(bring(apart))
    np.testing.assert_allclose(found, [(0, 0, 0), (60, 0, -5)], atol=0.05)
    cameras = [item for item in bpy.context.scene.objects if item.type == "CAMERA"]
    assert sum(item.location.x > 50 for item in cameras) == len(cameras) // 2  # a part's cameras go with it

    # Altitudes above different surfaces do not compare; what is far away stays, and is told.
    np.testing.assert_allclose(places(bring(write("datums", parts=2, east=60, up=-30, datum="ellipsoid")))[1],
                               (60, 0, 0), atol=0.05)
    np.testing.assert_allclose(places(bring(write("far", parts=2, east=60_000)))[1], 0, atol=1e-6)
    np.testing.assert_allclose(places(bring(write("nowhere", parts=2, scale="unknown")))[1], 0, atol=1e-6)

    # A second workspace stands by the first one's GPS, wherever the user has moved that; so does it when it comes anew.
    first, second = write("first"), write("second", east=-200, up=3)
    scene = bring(first, second)
    np.testing.assert_allclose(places(scene)[1], (-200, 0, 3), atol=0.1)
    for item in bpy.data.collections["CU-Recon: first"].all_objects:
        item.location.y += 30
    bpy.context.view_layer.update()
    bpy.ops.curecon.import_workspace(directory=str(second))
    np.testing.assert_allclose(places(scene)[1], (-200, 30, 3), atol=0.1)

    # Exported, the second says where on Earth its axes begin: at the first's origin.
    scene = bring(first, second)
    bpy.data.objects["first Surface"].hide_render = True
    path = FOLDER / "second.glb"
    for item in surfaces_of(scene):
        item.select_set(item.name != "first Surface")
    assert bpy.ops.curecon.export_surface(filepath=str(path), form="GLB", position=True) == {"FINISHED"}
    told = node_of(path, -1)["extras"]["origin"]
    assert abs(told["longitude"] - 117.25) < 1e-6 and abs(told["altitude"] - 310) < 0.01, told


def node_of(path: Path, index: int) -> dict[str, object]:
    content = path.read_bytes()
    length = struct.unpack("<I", content[12:16])[0]
    return json.loads(content[20 : 20 + length])["nodes"][index]


def check_units(unit: float, system: str) -> None:
    """The slab is 10 m wide in a scene of centimetres, inches or kilometres, beside the user's own things."""
    folder = FOLDER / "first"
    bpy.ops.wm.read_homefile(use_empty=True)
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_cube_add(size=2, location=(3, 0, 0))
    scene.unit_settings.system, scene.unit_settings.scale_length = system, unit
    before = scene.unit_settings.length_unit
    assert bpy.ops.curecon.import_workspace(directory=str(folder)) == {"FINISHED"}
    bpy.context.view_layer.update()
    settings = scene.unit_settings
    assert (settings.system, settings.length_unit) == (system, before) and abs(settings.scale_length - unit) < 1e-7
    item = surfaces_of(scene)[0]
    assert abs(item.dimensions.x * unit - 10) < 1e-3, item.dimensions
    assert abs(site.known(scene).metre * unit - 1) < 1e-5 and site.known(scene).metres
    assert bpy.ops.curecon.measure(first=(0, 0, 0), second=(10 / unit, 0, 0)) == {"FINISHED"}
    assert measurements.in_words(scene, scene.curecon.measurements[0]).startswith("10"), (
        measurements.in_words(scene, scene.curecon.measurements[0]))
    assert bpy.ops.curecon.export_surface(filepath=str(FOLDER / "unit.glb"), form="GLB") == {"FINISHED"}
    node = node_of(FOLDER / "unit.glb", 0)
    assert np.allclose(node.get("scale", (1, 1, 1)), 1, atol=1e-4), node
    assert abs(item.dimensions.x * unit - 10) < 1e-3
    # A known distance is typed in metres.
    assert bpy.ops.curecon.frame_scale(first=(0, 0, 0), second=(10 / unit, 0, 0), length=20.0) == {"FINISHED"}
    bpy.context.view_layer.update()
    assert abs(item.dimensions.x * unit - 20) < 1e-3 and abs(site.known(scene).metre * unit - 1) < 1e-5
    bpy.ops.curecon.frame_reset()


def check_sheets_in_centimetres() -> None:
    scene = bring(FOLDER / "first", unit=0.01)
    scene.curecon.present.folder, scene.curecon.present.sheet_scale = str(FOLDER / "sheets"), "200"
    assert bpy.ops.curecon.render_elevations() == {"FINISHED"}
    image = bpy.data.images.load(str(FOLDER / "sheets" / "5_roof_plan.png"))
    pixels = np.array(image.pixels[:], np.float32).reshape(image.size[1], image.size[0], 4)[..., :3]
    found = np.ptp(pixels, axis=2) > 0.1
    width = (np.ptp(np.flatnonzero(found.any(axis=0))) + 1) / 4 * 200 / 1000
    assert abs(width - 10) < 0.12, width


def check_unknown_scale_beside_the_users_own() -> None:
    """Units of a new file become plain numbers when nobody knows the scale, but only where nothing else stands."""
    unknown = write("unknown", scale="unknown")
    assert bring(unknown).unit_settings.system == "NONE"
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.mesh.primitive_cube_add(size=2, location=(3, 0, 0))
    bpy.ops.curecon.import_workspace(directory=str(unknown))
    assert bpy.context.scene.unit_settings.system == "METRIC"
    assert not site.known(bpy.context.scene).metres


curecon_blender.register()
try:
    check_parts_by_gps()
    for unit, system in ((0.01, "METRIC"), (0.0254, "IMPERIAL"), (1000.0, "METRIC")):
        check_units(unit, system)
    check_sheets_in_centimetres()
    check_unknown_scale_beside_the_users_own()
finally:
    curecon_blender.unregister()
print("CHECKED")
