# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts of a tour that stand for themselves: the missing libraries, everything by one press, F3, the workspace."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import bpy
from person import Person, Wait
from told import MODULE, busy, failure, report, step, task, worked

WORDS = ("photogrammetry", "measure", "texture", "scan", "drone")
CHINESE = dict(zip(WORDS, ("摄影测量", "测量", "纹理", "扫描", "无人机"), strict=True))


def libraries(person: Person) -> Wait:
    """The worker has nothing to work with: one press, a question, and it has. What has come is kept over a cancel."""
    yield from person.until(lambda: bool(failure()), seconds=60, what="the check says that libraries are missing")
    yield 1.0
    yield from person.picture("lacking")
    step("libraries")
    running = sys.modules[f"{MODULE}.curecon_blender.operators.running"]
    for cancelled in (True, False):
        place = yield from person.button("curecon.get_libraries")
        yield from person.click(*place)
        yield 0.5
        if cancelled:
            yield from person.picture("question")
        yield from person.press("RET", *place)  # the question is under the pointer
        yield from person.until(busy, seconds=10, what="fetching has begun")
        if cancelled:
            yield from person.until(lambda: running.status.overall > 0.1, seconds=task["patience"], what="a tenth")
            yield from person.picture("fetching")
            yield from person.push("curecon.cancel")
            yield from person.until(lambda: not busy(), seconds=60, what="fetching is cancelled")
            yield 1.0
            yield from person.picture("fetching_cancelled")
    yield from worked(person, task["patience"], "the libraries")
    yield from person.picture("fetched")
    yield from person.push("curecon.check_photos")
    yield from worked(person, task["patience"], "the photo check")


def one_press(person: Person) -> Wait:
    """Everything by one button; the report says after how many seconds each came."""
    step("one press")
    bpy.context.scene.curecon.max_image_size = task["max_image_size"]
    yield from person.push("curecon.make_model")
    began = time.monotonic()
    yield from person.until(busy, seconds=10, what="the job has begun")
    running = sys.modules[f"{MODULE}.curecon_blender.operators.running"]
    yield from person.until(
        lambda: running.status.overall > 0.3 or not busy(), seconds=task["patience"], what="a third")
    yield from person.picture("progress")
    yield from person.until(lambda: not busy(), seconds=task["patience"], what="the model")
    assert not failure(), failure()
    report["model_after"] = round(time.monotonic() - began, 1)
    result = bpy.context.scene.curecon.result
    assert result.textured, "the mesh has no texture"
    report["points"], report["faces"], report["cameras"] = result.points, result.faces, result.cameras
    step("picture")
    picture = Path(result.workspace) / "presentation" / "still.png"
    progress = sys.modules[f"{MODULE}.curecon_blender.operators.rendering"].progress
    yield from person.until(
        lambda: picture.is_file() and not progress.running, seconds=task["patience"], what="the picture",
    )
    report["picture_after"] = round(time.monotonic() - began, 1)
    report["still"] = str(picture)
    report["from_drop"] = round(time.monotonic() - report["dropped"], 1)
    yield from person.picture("model")  # in a window of its own
    yield from person.alone()
    yield from person.picture("model_in_scene")


def find(person: Person) -> Wait:
    """F3 finds the tools by the words of people who do not know the add-on; as a picture, since no script reads it."""
    step("find")
    yield from person.alone()
    for word in WORDS:
        yield from person.press("F3", *person.middle())
        yield 0.5
        yield from person.write(CHINESE[word] if task["language"] else word)
        yield from person.picture(f"find_{word}")
        for _ in range(2):
            yield from person.press("ESC", *person.middle())
        yield 0.3


def own_workspace(person: Person) -> Wait:
    step("workspace")
    yield from person.alone()
    with person.override():
        bpy.ops.curecon.open_workspace()
    yield from person.until(lambda: person.window.workspace.name == "CU-Recon", seconds=20, what="the workspace")

    def opened() -> bool:
        area = max(person.window.screen.areas, key=lambda area: area.width * area.height)
        sidebar = next((region for region in area.regions if region.type == "UI"), None)
        return area.type == "VIEW_3D" and sidebar is not None and sidebar.active_panel_category == "CU-Recon"

    yield from person.until(opened, seconds=60, what="its tab is open")
    yield from person.picture("workspace")
