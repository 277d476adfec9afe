# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Publish Web Pages, with a note, and a look at the pages. Arguments: a folder, a Python with the worker's
libraries."""

from __future__ import annotations

import json
import sys
import urllib.request
from pathlib import Path

import bpy
import workspace_scene
from mathutils import Matrix

import curecon_blender
from curecon_blender import preferences
from curecon_blender.core.publish import privacy
from curecon_blender.operators import publish
from curecon_blender.scene import frame

FOLDER, WORKER = map(Path, sys.argv[1:3])
preferences.Settings.__init__.__kwdefaults__["worker_python"] = WORKER
curecon_blender.register()
try:
    bpy.ops.wm.read_homefile(use_empty=True)
    assert not bpy.ops.curecon.publish.poll() and not bpy.ops.curecon.view_pages.poll()
    workspace = FOLDER / "a \"quoted\" site"
    workspace_scene.imported(workspace)

    place = (1.0, 2.0, 0.5)
    assert bpy.ops.curecon.add_note(at=place, title="<i>Door</i>", text="Oak\n'1620'") == {"FINISHED"}
    try:
        bpy.ops.curecon.add_note(at=place, title=" ")
        raise AssertionError("a note without a title says nothing")
    except RuntimeError as error:
        assert "needs a title" in str(error), error
    # The site is moved in the scene, note and all: in the site's frame the note stays where it is.
    part = frame.parts_of(bpy.context.scene)[0]
    for item in part.collection.all_objects:
        if item.parent is None:
            item.matrix_basis = Matrix.Translation((7.0, 0.0, 0.0)) @ item.matrix_basis
    bpy.context.view_layer.update()
    bpy.context.scene.curecon.credit = "-- O'Neill \"& Sons\" <a@b>"

    # What the dialog says beforehand is what comes.
    sentences = privacy.shown(part.frame, "hidden").sentences
    assert "Nobody can read" in sentences[0][0], sentences
    pages = FOLDER / "pages"
    assert bpy.ops.curecon.publish(directory=str(pages), title="Gate", place="Fujian") == {"FINISHED"}
    (site,) = (pages / "sites").iterdir()
    record = json.loads((site / "site.json").read_text(encoding="utf-8"))
    assert (record["location"], record["geometry"], record["place"]) == ("hidden", None, "Fujian"), record
    (note,) = record["notes"]
    assert (note["title"], note["text"]) == ("<i>Door</i>", "Oak\n'1620'"), note
    assert all(abs(one - other) < 1e-4 for one, other in zip(note["place"], place, strict=True)), note
    assert record["credit"] == "-- O'Neill \"& Sons\" <a@b>" and record["cloud"]["points"] > 0

    assert bpy.ops.curecon.view_pages() == {"FINISHED"}
    with urllib.request.urlopen(publish.serve(pages) + "pages/viewer.js") as answer:
        assert answer.headers["Content-Type"] == "text/javascript"
        assert answer.read() == (pages / "pages" / "viewer.js").read_bytes()

    other = FOLDER / "elsewhere"
    other.mkdir()
    (other / "mine.txt").write_text("mine")
    try:
        bpy.ops.curecon.publish(directory=str(other), location="exact")
        raise AssertionError("a folder with others' files is not to be written into")
    except RuntimeError as error:
        assert "not empty" in str(error), error
finally:
    curecon_blender.unregister()
print("CHECKED")
