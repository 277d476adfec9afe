# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Other programs' results beside ours: measured on one sheet, brought in, and coloured by their distances."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

from collections.abc import Generator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import bpy
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import BoolProperty, CollectionProperty, EnumProperty, FloatProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from ..core.base.options import COMPARE, COMPARE_WAYS
from ..languages import translated
from ..scene import comparison
from . import paths, running
from .running import ModalOperator, Work, WorkerOperator

SUFFIX = ".compared.ply"
KINDS = "*.ply;*.las;*.laz;*.e57;*.obj;*.glb;*.xyz;*.txt;*.csv;*.pts;*.asc"
_WAYS = {
    "coordinates": ("Coordinates", "Both are in one coordinate system"),
    "pairs": ("Marked Pairs", "A text file says which places are the same"),
    "found": ("By Shape", "From any start, by their shapes and colours"),
}
WAY_ITEMS = [(name, *_WAYS[name]) for name in COMPARE_WAYS]


def _bring_in(context: bpy.types.Context, path: Path, session_uid: int) -> Generator[str | None, None, int]:
    """Link a compared cloud into the scene, selected; returns how many points it has."""
    yield "Reading the cloud"
    pool = ThreadPoolExecutor(1, thread_name_prefix="curecon-read")
    reading = pool.submit(comparison.read, path)
    pool.shutdown(wait=False)
    while not reading.done():
        yield None
    content = reading.result()
    name = path.name.removesuffix(SUFFIX).removesuffix(".ply")
    item = yield from comparison.build(content, name, running.scene_with(session_uid))
    for other in context.view_layer.objects:
        other.select_set(other == item)
    context.view_layer.objects.active = item
    return len(content.distance)


class CURECON_OT_compare(WorkerOperator, bpy.types.Operator):
    """Lay other programs' results of this building on ours, and measure them: a sheet as PNG and PDF, their figures,
and their clouds here, coloured by distance"""

    bl_idname = "curecon.compare"
    bl_label = "Compare Results"

    task = "Comparing"
    panel = "result"

    directory: StringProperty(name="Folder", subtype="DIR_PATH", options={"SKIP_SAVE"})
    files: CollectionProperty(
        type=bpy.types.OperatorFileListElement, name="Files", description="Up to five results of the same building",
        options={"SKIP_SAVE"},
    )
    filter_glob: StringProperty(default=KINDS, options={"HIDDEN"})
    by: EnumProperty(
        name="Lay On By", description="How the others come to lie on ours", default=COMPARE_WAYS[0],
        items=WAY_ITEMS,
    )
    pairs: StringProperty(
        name="Pairs", description="A text file with x y z in the other and x y z in ours on each line",
    )
    scaled: BoolProperty(name="Find Scale", description="Their unit is another one, or unknown", default=False)
    threshold: FloatProperty(
        name="Within", description="Points count as right within this distance, and within twice as much, in metres",
        default=0.05, min=0.001, soft_max=1.0, precision=3,
    )
    truth: StringProperty(
        name="Truth",
        description="A file in our coordinates that all are measured by, such as a laser scan; empty: ours",
    )
    later: BoolProperty(
        name="Later Dates", description="They show the same site on another day: what fell down, and what came",
        default=False,
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return running.idle(cls) and paths.cloud_finished(cls, context)

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(self, "by")
        if self.by == "pairs":
            layout.prop(self, "pairs")
        if self.by != "coordinates":
            layout.prop(self, "scaled")
        for name in ("threshold", "truth", "later"):
            layout.prop(self, name)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return self.browse(context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        if not any(file.name for file in self.files):
            self.report({"ERROR"}, "Choose the other results' files.")
            return {"CANCELLED"}
        return WorkerOperator.execute(self, context)

    def workspace(self, context: bpy.types.Context) -> Path | None:
        return paths.absolute(context.scene.curecon.result.workspace)

    def arguments(self, context: bpy.types.Context) -> list[str]:
        workspace, folder = self.workspace(context), paths.absolute(self.directory)
        given = [COMPARE, str(workspace), *(str(folder / file.name) for file in self.files if file.name),
                 "--out", f"{workspace}/{COMPARE}", "--names", "CU-Recon", "--by", self.by,
                 "--thresholds", f"{self.threshold:.6f}", f"{2 * self.threshold:.6f}"]
        given += ["--pairs", str(paths.absolute(self.pairs))] if self.by == "pairs" and self.pairs else []
        given += ["--scale"] if self.scaled and self.by != "coordinates" else []
        given += ["--truth", str(paths.absolute(self.truth))] if self.truth else []
        return given + (["--change"] if self.later else [])

    def done(self, context: bpy.types.Context, scene: bpy.types.Scene, summary: dict[str, Any]) -> Work:
        for text in summary["warnings"]:
            self.report({"WARNING"}, translated(text))
        for cloud in summary["clouds"]:
            yield from _bring_in(context, Path(cloud), scene.session_uid)
        if not bpy.app.background:
            bpy.ops.wm.path_open(filepath=summary["sheet"])
        return rpt_("The sheet is {}.").format(summary["sheet"])


class CURECON_OT_import_comparison(ModalOperator, bpy.types.Operator, ImportHelper):
    """Bring in a cloud that the command compare measured, coloured by its distance from the reference"""

    bl_idname = "curecon.import_comparison"
    bl_label = "Import Comparison"
    bl_options = {"UNDO"}

    filename_ext = SUFFIX
    filter_glob: StringProperty(default="*.ply", options={"HIDDEN"})

    task = "Importing"

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if self.filepath:  # a caller's own
            return ModalOperator.invoke(self, context, event)
        return self.browse(context)

    def work(self, context: bpy.types.Context) -> Work:
        count = yield from _bring_in(context, paths.absolute(self.filepath), context.scene.session_uid)
        return rpt_("{:,} compared points are in the scene.").format(count)


class CURECON_OT_colour_comparison(bpy.types.Operator):
    """Colour the compared cloud by its distances, or as it came"""

    bl_idname = "curecon.colour_comparison"
    bl_label = "Colour Comparison"
    bl_options = {"REGISTER", "UNDO"}

    by: EnumProperty(
        name="Colour", description="What the colours show", default=comparison.DISTANCE,
        items=((comparison.DISTANCE, "Distance", "From the reference; of a change, red is lost and blue has come"),
               (comparison.PHOTO, "Own", "The colours that it came with")),
    )
    most: FloatProperty(
        name="Up To", description="The distance that has the last colour, in metres", default=0.1, min=1e-6,
        soft_max=10,
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if comparison.is_compared(context.active_object):
            return True
        cls.poll_message_set("Select a compared cloud first")
        return False

    def execute(self, context: bpy.types.Context) -> set[str]:
        comparison.colour(context.active_object, self.by, self.most)
        return {"FINISHED"}


CLASSES = (CURECON_OT_compare, CURECON_OT_import_comparison, CURECON_OT_colour_comparison)
