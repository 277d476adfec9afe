# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Build Mesh and Texture say why they cannot run, and what they tell the worker it understands. Argument: a folder."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import surface_scene
import workspace_scene

import curecon_blender
from curecon_blender import preferences
from curecon_blender.core.base.options import RUN, SURFACE, Options, arguments, declared
from curecon_blender.core.run.command_line import options_of, parser
from curecon_blender.operators.accuracy_report import report_arguments
from curecon_blender.operators.job_options import job_options, surface_options
from curecon_blender.panels.preferences import CURECON_AP_preferences
from curecon_blender.properties import GOALS, CURECON_PG_scene

FOLDER = Path(sys.argv[1])


def rounded(options: Options) -> Options:
    """As the command line gives them: to a nanometre."""
    return replace(options, region=options.region and tuple(round(value, 9) for value in options.region))


def error_of(operator: Callable[..., object], **options: object) -> str:
    try:
        result = operator(**options)
    except RuntimeError as error:  # what Blender makes of an operator's error report
        return str(error)
    raise AssertionError(f"no error, but {result}")


curecon_blender.register()
try:
    bpy.ops.wm.read_homefile(use_empty=True)
    properties = bpy.context.scene.curecon
    for operator in (bpy.ops.curecon.build_mesh, bpy.ops.curecon.texture, bpy.ops.curecon.add_region,
                     bpy.ops.curecon.export_surface):
        assert not operator.poll()
    assert "import a workspace first" in error_of(bpy.ops.curecon.build_mesh)
    assert "no surface in the scene" in error_of(bpy.ops.curecon.export_surface)

    empty = FOLDER / "empty"
    workspace_scene.write(empty)
    (empty / "cloud.ply").unlink()
    bpy.ops.curecon.import_workspace(directory=str(empty))
    assert "no point cloud yet" in error_of(bpy.ops.curecon.texture)

    folder = FOLDER / "one"
    workspace_scene.write(folder)
    surface_scene.write(folder, textured=False)
    bpy.ops.wm.read_homefile(use_empty=True)
    properties = bpy.context.scene.curecon
    bpy.ops.curecon.import_workspace(directory=str(folder))
    assert bpy.ops.curecon.build_mesh.poll() and bpy.ops.curecon.texture.poll()

    # The region is the box's bounds in the site frame, wherever the user has moved the cloud.
    def asked(until: str = "mesh") -> Options:
        return surface_options(bpy.context.scene, folder, until=until)

    assert asked().region is None
    assert bpy.ops.curecon.add_region() == {"FINISHED"}
    box = properties.region
    bounds = np.array(asked().region)
    assert np.all(bounds[:3] < [1, 1, 0.2]) and np.all(bounds[3:] > [9, 9, 0.8]), bounds
    for name in [item.name for item in bpy.context.scene.objects if item is not box]:
        bpy.data.objects[name].location.x += 100
    box.location, box.scale = (102, 3, -0.00001), (1, 2, 0.5)
    bpy.context.view_layer.update()
    bounds = np.array(asked().region)
    assert np.allclose(bounds, [1, 1, -0.5, 3, 5, 0.5], atol=1e-4), bounds
    # Another workspace's frame, which stands elsewhere, is not asked.
    assert np.allclose(surface_options(bpy.context.scene, empty, until="mesh").region, bounds + [100, 0, 0] * 2)

    # The worker takes every choice, and understands just what was asked.
    def understood(options: Options, command: str) -> Options:
        return options_of(parser().parse_args(arguments(options, command)))

    properties.photos = str(FOLDER)
    for goal, *_ in GOALS:
        wanted = job_options(bpy.context, until=goal)
        assert wanted.until == goal and understood(wanted, RUN) == rounded(wanted)
    assert job_options(bpy.context, until="fusion").scheduler == ""
    preferences.Settings.__init__.__kwdefaults__["scheduler"] = "tcp://192.168.1.5:8786"
    assert understood(job_options(bpy.context, until="fusion"), RUN).scheduler == "tcp://192.168.1.5:8786"
    for quality, faces in (("preview", 250_000), ("standard", 1_000_000)):
        properties.quality = quality
        assert understood(asked(), SURFACE).max_faces == faces
    properties.fill_holes, properties.max_faces = False, 5000
    properties.texture_size, properties.texture_format = "8192", "jpeg"
    told = understood(asked(), SURFACE)
    assert (told.fill_holes, told.max_faces, told.texture_size, told.texture_format) == (False, 5000, 8192, "jpeg")
    assert told == rounded(asked())
    for kind in (CURECON_PG_scene, CURECON_AP_preferences):  # what can be chosen is what the worker knows
        for option, argument in declared(RUN):
            known = kind.bl_rna.properties.get(option.name)
            assert known is None or not argument.choices or tuple(known.enum_items.keys()) == argument.choices
    # So it does for a report: its site, whose it is, and letters for all of it.
    properties.present.title, properties.credit = "-Eryi Lou", "-A"
    told = parser().parse_args(report_arguments(bpy.context, folder, site="", by="", when=""))
    assert (told.workspace, told.name, told.by, told.language) == (folder, "-Eryi Lou", "-A", "")
    assert told.font.is_file()

    properties.region = None
    assert "no region box is chosen" in error_of(bpy.ops.curecon.build_mesh)
    properties.use_region = False

    # A worker that cannot: an error in words, and the surface in the scene stays.
    shutil.rmtree(folder / "stages", ignore_errors=True)
    said = error_of(bpy.ops.curecon.build_mesh)
    print(said)
    assert len(said.split()) > 6 and not any(word in said for word in ("Traceback", "usage", "unexpectedly"))
    assert properties.result.faces == 800 and any(item.name.endswith(" Surface") for item in bpy.data.objects)
finally:
    curecon_blender.unregister()
print("CHECKED")
