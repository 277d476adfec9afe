# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Sheets and panels state the scale, the north and the place of what is presented, in whatever order it was imported.
Argument: a folder."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import surface_scene
import workspace_scene

import curecon_blender
from curecon_blender.operators import rendering
from curecon_blender.panels.present import CURECON_PT_present_elevations, CURECON_PT_present_sun
from curecon_blender.panels.result import CURECON_PT_result
from curecon_blender.scene import elevations, lettering, render_scene

FOLDER = Path(sys.argv[1])
METRIC, UNKNOWN = FOLDER / "metric_curecon", FOLDER / "unknown_curecon"


class Layout:
    """Stands in for Blender's own, which there is only in a window: keeps what a panel writes and offers."""

    def __init__(self) -> None:
        self.shown: list[str] = []

    def label(self, *, text: str = "", **_: object) -> None:
        self.shown.append(text)

    def prop(self, _: object, name: str, **__: object) -> None:
        self.shown.append(name)

    def row(self, **_: object) -> Layout:
        return self

    column = box = row

    def operator(self, *_: object, **__: object) -> SimpleNamespace:
        return SimpleNamespace()


def said_by(panel: type[bpy.types.Panel]) -> str:
    context = SimpleNamespace(
        scene=bpy.context.scene, preferences=bpy.context.preferences, region=SimpleNamespace(width=10_000),
        active_object=None)
    layout = Layout()
    panel.draw(SimpleNamespace(  # type: ignore[arg-type]
        layout=layout, draw_part=lambda *given: panel.draw_part(SimpleNamespace(layout=layout), *given)), context)
    return "\n".join(layout.shown)


def on_the_sheets() -> set[str]:
    """Lay the elevations out, with blank paper in place of renders; returns all that is written on them."""
    scene, texts, letters = bpy.context.scene, set(), lettering.letters

    def keep(text: str) -> np.ndarray:
        texts.add(text)
        return letters(text)

    copy = render_scene.create(scene)
    lettering.letters = keep
    try:
        plan = elevations.plan(scene, copy, FOLDER)
        for elevation in plan.elevations:
            blank = bpy.data.images.new("blank", 8, 8, alpha=True)
            blank.filepath_raw, blank.file_format = str(elevation.shot.file), "PNG"
            blank.save()
        elevations.write_sheets(plan, FOLDER, rendering.title_of(scene), rendering.today())
    finally:
        lettering.letters = letters
        render_scene.remove(copy)
    return texts


def present(folder: Path) -> None:
    """Let renders show that workspace alone."""
    for collection in bpy.context.scene.collection.children:
        for item in list(collection.all_objects):
            item.hide_render = collection.get("curecon_workspace") != str(folder)


def check_unknown() -> None:
    texts = on_the_sheets()
    assert "Scale unknown" in texts and not any("1:" in text for text in texts), texts
    assert "Front elevation" in texts and any("North unknown" in text for text in texts), texts
    assert "unknown" in texts and "metric" not in texts, texts  # the title
    assert rendering.folder_of(bpy.context.scene) == UNKNOWN / "presentation"
    said = said_by(CURECON_PT_present_elevations)
    assert "Scale unknown" in said and "sheet_scale" not in said, said
    assert "type in where the site is" in said_by(CURECON_PT_present_sun)
    said = said_by(CURECON_PT_result)
    assert "Scale unknown: do not measure" in said and "True scale" not in said, said


def check_metric() -> None:
    texts = on_the_sheets()
    assert any("1:100" in text for text in texts) and "Scale unknown" not in texts, texts
    assert "South elevation" in texts and "metric" in texts, texts
    assert "sheet_scale" in said_by(CURECON_PT_present_elevations)
    assert "type in where the site is" not in said_by(CURECON_PT_present_sun)
    said = said_by(CURECON_PT_result)
    assert "True scale from the given model" in said and "Scale unknown" not in said, said


curecon_blender.register()
try:
    workspace_scene.write(METRIC)
    workspace_scene.write(UNKNOWN, scale="unknown", placed=False)
    for folder in (METRIC, UNKNOWN):
        surface_scene.write(folder, textured=False)
    for order in ((UNKNOWN, METRIC), (METRIC, UNKNOWN)):
        bpy.ops.wm.read_homefile(use_empty=True)
        for folder in order:
            bpy.ops.curecon.import_workspace(directory=str(folder))
        # Lengths read as metres only where all of them are.
        assert bpy.context.scene.unit_settings.system == "NONE", order
        present(UNKNOWN)
        check_unknown()
        present(METRIC)
        check_metric()

    # What is presented is what renders show and, of several, what the region box stands about.
    scene = bpy.context.scene
    for item in scene.objects:
        item.hide_render = False
    other = bpy.data.collections["CU-Recon: unknown"]
    for item in list(other.all_objects):
        item.location.x += 100
    bpy.context.view_layer.update()
    region = scene.curecon.region = bpy.data.objects.new("Region", bpy.data.meshes.new("Region"))
    region.data.from_pydata([(95, -5, -1), (115, 15, 3)], [], [])
    scene.collection.objects.link(region)
    check_unknown()
    region.location.x = -100
    bpy.context.view_layer.update()
    check_metric()
    scene.curecon.region = None
    bpy.data.collections["CU-Recon: metric"].hide_render = True
    check_unknown()
finally:
    curecon_blender.unregister()
print("CHECKED")
