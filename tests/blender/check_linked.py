# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What is linked from another .blend is not changed, and nobody is told that it was. Argument: an empty folder."""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable
from pathlib import Path

import bpy
import surface_scene
import workspace_scene

import curecon_blender
from curecon_blender.scene import frame

FOLDER = Path(sys.argv[1])
SITE, BLEND, NAME = FOLDER / "one", FOLDER / "site.blend", "CU-Recon: one"


def tells_where(blend: Path) -> bool:
    """Save the file and look for the site's longitude, 117.25 degrees, in words or as a number."""
    bpy.ops.wm.save_as_mainfile(filepath=str(blend), compress=False)
    content = blend.read_bytes()
    return any(form in content for form in (b"117.25", struct.pack("<d", 117.25), struct.pack("<f", 117.25)))


def open_with(kind: str, name: str, *, link: bool) -> bpy.types.ID:
    """A new file that links or appends a collection or an object of the saved one."""
    bpy.ops.wm.read_homefile(use_empty=True)
    with bpy.data.libraries.load(str(BLEND), link=link) as (_, wanted):
        setattr(wanted, kind, [name])
    (found,) = getattr(wanted, kind)
    children = bpy.context.scene.collection
    (children.children if kind == "collections" else children.objects).link(found)
    bpy.context.view_layer.update()
    return found


def error_of(operator: Callable[..., set[str]], **arguments: object) -> str:
    try:
        operator(**arguments)
    except RuntimeError as error:
        return str(error)
    raise AssertionError("no error was reported")


def assert_refused(operator: Callable[..., set[str]], **arguments: object) -> None:
    said = error_of(operator, **arguments)
    assert "is linked from" in said and "site.blend" in said and "Make Local" in said, said


curecon_blender.register()
try:
    workspace_scene.write(SITE)
    surface_scene.write(SITE, textured=False)
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.curecon.import_workspace(directory=str(SITE))
    assert tells_where(BLEND)

    # A linked site: no writer reports a success, and neither scene nor workspace changes.
    open_with("collections", NAME, link=True)
    assert frame.has_position()
    assert_refused(bpy.ops.curecon.forget_position)
    assert frame.has_position()
    for operator, arguments in (
        (bpy.ops.curecon.frame_scale, {"first": (0, 0, 0), "second": (10, 0, 0), "length": 20.0}),
        (bpy.ops.curecon.frame_ground, {}), (bpy.ops.curecon.import_workspace, {"directory": str(SITE)}),
    ):
        assert_refused(operator, **arguments)
    bpy.ops.curecon.add_region()
    bpy.context.scene.curecon.region.scale *= 0.3
    bpy.context.view_layer.update()
    assert_refused(bpy.ops.curecon.cloud_crop)
    assert not (SITE / "sparse" / "0" / "adjustment.json").exists()
    assert not list(SITE.glob("*removed*"))
    assert len(bpy.data.collections[NAME].all_objects) == 6

    # An overridden one keeps its position in the other .blend all the same.
    linked = open_with("collections", NAME, link=True)
    linked.override_hierarchy_create(bpy.context.scene, bpy.context.view_layer)
    assert_refused(bpy.ops.curecon.forget_position)

    # Of the surface alone, linked or appended.
    open_with("objects", "one Surface", link=True)
    assert_refused(bpy.ops.curecon.forget_position)
    open_with("objects", "one Surface", link=False)
    assert tells_where(FOLDER / "appended.blend")
    assert bpy.ops.curecon.forget_position() == {"FINISHED"} and not frame.has_position()
    assert not tells_where(FOLDER / "appended.blend")

    # Every scene of a file forgets.
    open_with("collections", NAME, link=False)
    bpy.ops.scene.new(type="NEW")
    assert not bpy.context.scene.objects and frame.has_position()
    assert bpy.ops.curecon.forget_position() == {"FINISHED"}
    assert not tells_where(FOLDER / "scenes.blend")
finally:
    curecon_blender.unregister()
print("CHECKED")
