# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The finished site in surveyors' formats: point clouds, orthophotos, heights, contours and sections."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import BoolProperty, EnumProperty, FloatProperty, StringProperty

from ..core.base.files import DELIVERABLES
from ..core.base.options import EXPORT, FORMATS, LOCAL, PLACEMENTS
from . import paths, running
from .running import WorkerOperator

_FORMATS = {
    "laz": ("LAZ Cloud", "Point cloud for every survey program, with confidence, views and precision"),
    "copc": ("COPC Cloud", "Point cloud that viewers stream from a web server, LAZ as well"),
    "e57": ("E57 Cloud", "Point cloud for CAD and BIM; needs the library pye57 in the Worker Python"),
    "orthomosaic": ("Orthomosaic", "Picture from straight above without perspective, as GeoTIFF"),
    "dsm": ("Surface Model", "Heights of what is topmost (DSM), as GeoTIFF"),
    "facades": ("Façades", "Orthophoto of each façade, as GeoTIFF with a world file"),
    "contours": ("Contours", "Lines of equal height of the mesh, as DXF and SVG"),
    "sections": ("Sections", "A plan cut and two upright cuts of the mesh, as DXF and SVG"),
}
_FRAMES = {
    "local": ("Local", "Metres of the site. Nobody can read from any file where the site is, how high, or when it was "
                       "photographed"),
    "site": ("Site", "The same coordinates, and where their origin lies: a GIS puts them in their place"),
    "utm": ("UTM", "Easting, northing and altitude on WGS84"),
}
FORMAT_ITEMS = [(name, *_FORMATS[name], 1 << number) for number, name in enumerate(FORMATS)]
FRAME_ITEMS = [(name, *_FRAMES[name]) for name in PLACEMENTS]
CHOSEN = {"laz", "orthomosaic", "dsm"}


class CURECON_OT_export_deliverables(WorkerOperator, bpy.types.Operator):
    """Write the finished site in surveyors' formats: LAZ, COPC, E57, GeoTIFF, DXF, SVG.

What no photo measured stays empty"""

    bl_idname = "curecon.export_deliverables"
    bl_label = "Export Deliverables"

    task = "Writing deliverables"
    panel = "result"

    directory: StringProperty(
        name="Folder", description="An empty folder; left as it is, one in the workspace for each frame",
        subtype="DIR_PATH", options={"SKIP_SAVE"},
    )
    filter_folder: BoolProperty(
        name="Folders", description="The file browser shows folders", default=True, options={"HIDDEN"},
    )
    formats: EnumProperty(
        name="Formats", description="What to write", options={"ENUM_FLAG"}, default=CHOSEN,
        items=FORMAT_ITEMS,
    )
    frame: EnumProperty(
        name="Coordinates", description="What the files tell of where the site is", default=LOCAL,
        items=FRAME_ITEMS,
    )
    pixel: FloatProperty(
        name="Pixel", description="Side of a pixel of pictures and heights, in metres; 0: as fine as what was measured",
        default=0.0, min=0.0, precision=3,
    )
    interval: FloatProperty(
        name="Contours Every", description="Height between two contours, in metres; 0: what suits the site",
        default=0.0, min=0.0, precision=2,
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return running.idle(cls) and paths.cloud_finished(cls, context)

    def draw(self, context: bpy.types.Context) -> None:
        layout, properties = self.layout, context.scene.curecon
        layout.column(align=True).prop(self, "formats")
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(self, "frame")
        layout.prop(self, "pixel")
        layout.prop(self, "interval")
        layout.prop(properties, "licence")
        layout.prop(properties, "credit")

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self.directory = str(self._own_folder(context))
        return self.browse(context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        if not self.formats:
            self.report({"ERROR"}, "Choose at least one format.")
            return {"CANCELLED"}
        return WorkerOperator.execute(self, context)

    def _own_folder(self, context: bpy.types.Context) -> Path:
        return paths.absolute(context.scene.curecon.result.workspace) / DELIVERABLES

    def workspace(self, context: bpy.types.Context) -> Path | None:
        return paths.absolute(context.scene.curecon.result.workspace)

    def arguments(self, context: bpy.types.Context) -> list[str]:
        properties = context.scene.curecon
        given = [EXPORT, str(self.workspace(context)), "--frame", self.frame, "--format",
                 *(name for name in FORMATS if name in self.formats)]
        if self.directory and (folder := paths.absolute(self.directory)) != self._own_folder(context):
            given += ["--to", str(folder)]
        for flag, value in (("--pixel", self.pixel), ("--interval", self.interval)):
            given += [flag, f"{value:.6f}"] if value > 0 else []
        for flag, text in (("--licence", properties.licence), ("--credit", properties.credit)):
            given += [f"{flag}={text}"] if text else []
        return given

    def done(self, context: bpy.types.Context, scene: bpy.types.Scene, summary: dict[str, Any]) -> str:
        if not bpy.app.background:
            bpy.ops.wm.path_open(filepath=summary["folder"])
        files = len(summary["deliverables"])
        if summary["left_out"]:
            self.report({"WARNING"}, rpt_("Left out: {}.").format(
                ", ".join(sorted({_FORMATS[one["format"]][0] for one in summary["left_out"]}))))
        if summary["position"]:
            return rpt_("{} files are in {}; they carry the site's GPS position.").format(files, summary["folder"])
        return rpt_("{} files are in {}; they carry no GPS position.").format(files, summary["folder"])


CLASSES = (CURECON_OT_export_deliverables,)
