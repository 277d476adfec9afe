# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The finished site as web pages, notes on it, and a look at them in this computer's browser."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

import functools
import json
import threading
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from bpy.app.translations import pgettext_iface as iface_
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import BoolProperty, EnumProperty, StringProperty

from ..core.base.errors import CuReconError
from ..core.base.options import HIDDEN, LOCATIONS, PUBLISH
from ..core.publish import privacy
from ..languages import translated
from ..scene import frame, notes, site
from . import paths, running
from .picking import PickingOperator, place_property
from .running import WorkerOperator

_LOCATIONS = {
    "exact": ("Exact", "Everybody can read the coordinates"),
    "cell": ("1 km Square", "Everybody sees a fixed square of 1 km, and nobody where in it the site is"),
    "hidden": ("Hidden", "Nobody can read from the pages where the site is"),
}
LOCATION_ITEMS = [(name, *_LOCATIONS[name]) for name in LOCATIONS]


class CURECON_OT_publish(WorkerOperator, bpy.types.Operator):
    """Write the finished site as web pages for any web server: in 3D, on a map, with notes and measuring.

You choose what they tell of where it is"""

    bl_idname = "curecon.publish"
    bl_label = "Publish Web Pages"

    task = "Publishing"
    panel = "result"

    directory: StringProperty(
        name="Folder", description="An empty folder, or one that was published into: the site is added there",
        subtype="DIR_PATH", options={"SKIP_SAVE"},
    )
    filter_folder: BoolProperty(
        name="Folders", description="The file browser shows folders", default=True, options={"HIDDEN"},
    )
    location: EnumProperty(
        name="Place Shown", description="What the public is told of where the site is", default=HIDDEN,
        items=LOCATION_ITEMS,
    )
    title: StringProperty(name="Name", description="What the site is called; left empty, as its workspace")
    text: StringProperty(name="About", description="What the site is, in a few sentences")
    place: StringProperty(
        name="Place in Words", description="What may be said of where it is, such as the country; shown as it is",
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return running.idle(cls) and paths.cloud_finished(cls, context) and paths.site_stands(cls, context)

    def draw(self, context: bpy.types.Context) -> None:
        layout, properties = self.layout, context.scene.curecon
        layout.use_property_split = True
        layout.use_property_decorate = False
        for name in ("title", "text", "place"):
            layout.prop(self, name)
        layout.prop(properties, "licence")
        layout.prop(properties, "credit")
        layout.prop(self, "location")
        box = layout.box()
        box.label(text="What the public will see", icon="HIDE_OFF")
        for sentence, figure in self._shown(context).sentences:
            for line in iface_(sentence).format(figure).split(": "):
                _wrapped(box, line)
        if count := sum(map(notes.is_note, context.scene.objects)):
            box.label(text=iface_("Notes: {}").format(count), translate=False)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self.title = self.title or paths.site_name(context.scene).replace("_", " ")
        return self.browse(context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        if not self.directory:
            self.report({"ERROR"}, "Choose a folder for the pages.")
            return {"CANCELLED"}
        return WorkerOperator.execute(self, context)

    def _shown(self, context: bpy.types.Context) -> privacy.Shown:
        return privacy.shown(self._part(context).frame, self.location)

    def _part(self, context: bpy.types.Context) -> frame.Part:
        """The part of what is presented."""
        return site.part(context.scene) or frame.part_of(context)

    def workspace(self, context: bpy.types.Context) -> Path | None:
        return paths.absolute(site.workspace(context.scene))

    def arguments(self, context: bpy.types.Context) -> list[str]:
        properties, part = context.scene.curecon, self._part(context)
        given = [PUBLISH, str(self.workspace(context)), str(paths.absolute(self.directory)),
                 "--location", self.location, "--part", str(int(part.folder.name) + 1)]
        for flag, text in (("--title", self.title), ("--text", self.text), ("--place", self.place),
                           ("--licence", properties.licence), ("--credit", properties.credit)):
            given += [f"{flag}={text}"] if text else []
        if found := notes.records(context.scene, part):
            path = Path(bpy.app.tempdir) / "curecon_notes.json"
            path.write_text(json.dumps(found), encoding="utf-8")
            given += ["--notes", str(path)]
        return given

    def done(self, context: bpy.types.Context, scene: bpy.types.Scene, summary: dict[str, Any]) -> str:
        scene.curecon.result.published = summary["published"]
        for text in summary["warnings"]:
            self.report({"WARNING"}, translated(text))
        return rpt_("The pages are in {}: put that folder on any web server.").format(summary["published"])


class CURECON_OT_view_pages(bpy.types.Operator):
    """Open the published pages in the browser. They come from this computer, and only to it, while Blender runs"""

    bl_idname = "curecon.view_pages"
    bl_label = "View Pages"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.scene.curecon.result.published:
            return True
        cls.poll_message_set("Publish the site first")
        return False

    def execute(self, context: bpy.types.Context) -> set[str]:
        folder = paths.absolute(context.scene.curecon.result.published)
        if not (folder / "index.html").is_file():
            self.report({"ERROR"}, rpt_("The pages are no longer in {}: publish them again.").format(folder))
            return {"CANCELLED"}
        address = serve(folder)
        self.report({"INFO"}, rpt_("The pages are at {} on this computer.").format(address))
        if not bpy.app.background:
            bpy.ops.wm.url_open(url=address)
        return {"FINISHED"}


_servers: dict[Path, ThreadingHTTPServer] = {}


class _Quiet(SimpleHTTPRequestHandler):
    extensions_map = {**SimpleHTTPRequestHandler.extensions_map, ".js": "text/javascript"}  # Windows may know another

    def log_message(self, *_: object) -> None: ...


def serve(folder: Path) -> str:
    """Serve a folder on the computer's own loopback, as long as this process runs; its address."""
    if folder not in _servers:
        _servers[folder] = ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(_Quiet, directory=str(folder)))
        threading.Thread(target=_servers[folder].serve_forever, daemon=True).start()
    return f"http://127.0.0.1:{_servers[folder].server_port}/"


def close() -> None:
    """Serve nothing any more."""
    while _servers:
        _, server = _servers.popitem()
        server.shutdown()
        server.server_close()


class CURECON_OT_add_note(PickingOperator, bpy.types.Operator):
    """Pick a place and write a note on it, which the published pages show there, seen from where you look now"""

    bl_idname = "curecon.add_note"
    bl_label = "Add Note"
    bl_options = {"REGISTER", "UNDO"}

    at: place_property("Place")
    title: StringProperty(name="Title", description="In a few words", options={"SKIP_SAVE"})
    text: StringProperty(name="Text", description="What there is to be said", options={"SKIP_SAVE"})

    places = ("at",)
    prompts = ("Pick the place of the note",)
    asks = True

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.prop(self, "title")
        self.layout.prop(self, "text")

    def apply(self, context: bpy.types.Context, places: list[np.ndarray]) -> str:
        if not self.title.strip():
            raise CuReconError("A note needs a title.", remedy="Type what it is about, in a few words.")
        view = context.region_data
        eye = None if view is None else np.array(view.view_matrix.inverted().translation)
        part = frame.part_at(context.scene, places[0])
        item = notes.add(context, part, places[0], self.title.strip(), self.text, eye)
        return rpt_("{} will be on the published pages.").format(item.name)


def _wrapped(layout: bpy.types.UILayout, text: str) -> None:
    """A text in lines for the file browser's side, which is some 30 letters wide."""
    width, lines = 34, [""]
    for word in text.split(" ") if " " in text else [text[k : k + width // 2] for k in range(0, len(text), width // 2)]:
        if lines[-1] and len(lines[-1]) + len(word) >= width:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    column = layout.column(align=True)
    column.scale_y = 0.8
    for line in lines:
        column.label(text=line, translate=False)


CLASSES = (CURECON_OT_publish, CURECON_OT_view_pages, CURECON_OT_add_note)
