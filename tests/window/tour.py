# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""From the zip to a rendered picture, as a newcomer goes, inside Blender with its window.

scripts/window_tour.py starts it with a JSON of what to do; it writes tour.json and a picture of each step. Clicks and
keys go through Blender's own event queue. By operator are done: installing (its dialog is the system's file browser),
the drop (through the operator that Blender itself calls for a drop), typing into fields, and the file browser's own
button. What "full" adds: cancelling and going on, undo, the frame's tools, elevations, stills and film, and an export.
"one_press" is the short way instead: dropped photos, one button, a textured mesh and a picture of it.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
import traceback
from collections.abc import Iterator
from pathlib import Path

import bpy
from bpy_extras.view3d_utils import location_3d_to_region_2d
from mathutils import Vector

sys.path.insert(0, str(Path(__file__).parent))
from person import Person, Wait
from sights import find, libraries, one_press, own_workspace
from told import BEAT, MODULE, busy, failure, out, report, step, task, worked


def install(person: Person) -> Wait:
    step("install")
    assert bpy.ops.extensions.package_install_files(
        filepath=task["archive"], repo="user_default", enable_on_install=True,
    ) == {"FINISHED"}
    person.watch_panels()
    bpy.ops.preferences.addon_show("INVOKE_DEFAULT", module=MODULE)
    yield 1.5
    yield from person.picture("preferences")
    other = next(window for window in bpy.context.window_manager.windows if window != person.window)
    report["preferences"] = person.rectangle(other)
    with bpy.context.temp_override(window=other):
        bpy.ops.wm.window_close()
    preferences = bpy.context.preferences.addons[MODULE].preferences
    preferences.worker_python, preferences.indexes = task["worker_python"], task["index"]
    bpy.context.preferences.system.use_online_access = bool(task["index"])
    yield 0.5


def photos(person: Person) -> Wait:
    step("photos")
    yield from person.sidebar("CU-Recon")
    yield from person.picture("empty")
    names = sorted(path.name for path in Path(task["photos"]).iterdir())
    yield from person.move(*person.middle())
    report["dropped"] = time.monotonic()
    with person.override():
        bpy.ops.wm.drop_import_file(
            "INVOKE_DEFAULT", directory=task["photos"] + "/", files=[{"name": name} for name in names],
        )
    yield from person.picture("drop")  # Blender asks whether they are to become an image in the scene
    if task["language"]:  # which has another key for it
        yield from person.press("ESC", *person.middle())
        with person.override():
            bpy.ops.curecon.drop_photos(directory=task["photos"] + "/")
    else:
        yield from person.press("D", *person.middle())
    if task["index"]:
        yield from libraries(person)
    else:
        yield from worked(person, task["patience"], "the photo check")
    assert bpy.context.scene.curecon.check.photos == len(names)
    yield from person.open_only("CURECON_PT_photos")
    yield from person.picture("photos")


def choose(person: Person, what: str, key: str, picture: str) -> Wait:
    """An entry of a menu by its key, which another language does not have."""
    yield from person.choose(what, "ESC" if task["language"] else key, picture)


def reconstruct(person: Person) -> Wait:
    step("reconstruct")
    properties = bpy.context.scene.curecon
    yield from person.open_only("CURECON_PT_reconstruct")
    yield from choose(person, "curecon.quality", "P", "qualities")
    assert properties.quality == "preview", properties.quality
    yield from person.open("CURECON_PT_advanced")
    yield from person.picture("reconstruct")
    properties.max_image_size = task["max_image_size"]
    yield from person.push("curecon.reconstruct")
    step("reconstructing")
    running = sys.modules[f"{MODULE}.curecon_blender.operators.running"]
    patience = task["patience"]
    if task["full"] and not task["begun"]:  # there is nothing to cancel where all is done
        yield from person.until(lambda: running.status.overall > 0.1 or failure(), seconds=patience, what="a tenth")
        yield from person.push("curecon.cancel")
        yield from person.until(lambda: not busy(), seconds=60, what="the job is cancelled")
        assert running.status.failure.kind == "cancelled", failure()
        yield from person.picture("cancelled")
        yield from person.push("curecon.reconstruct")
        step("going on")
    yield from person.until(lambda: running.status.overall > 0.3 or not busy(), seconds=patience, what="a third of it")
    yield from person.picture("progress")
    yield from person.until(lambda: not busy(), seconds=patience, what="the reconstruction")
    assert not failure(), failure()
    step("first cloud")
    yield 1.0
    assert "Cube" not in bpy.context.scene.objects, "Blender's own cube stands in the site"
    report["points"], report["cameras"] = properties.result.points, properties.result.cameras
    yield from person.open_only("CURECON_PT_result")
    yield from person.picture("result")


def undo(person: Person) -> Wait:
    """Ctrl+Z takes all of the import back, and the cube returns; Ctrl+Shift+Z brings it again."""
    step("undo")

    def stands() -> bool:
        return any(item.type == "POINTCLOUD" for item in bpy.context.scene.objects)

    yield from person.press("Z", *person.middle(), ctrl=True)
    yield from person.until(lambda: not stands(), seconds=30, what="the import is undone")
    assert "Cube" in bpy.context.scene.objects
    yield from person.picture("undone")
    yield from person.press("Z", *person.middle(), ctrl=True, shift=True)
    yield from person.until(stands, seconds=30, what="the import is done again")
    yield 1.0


def cloud(person: Person) -> Wait:
    step("cloud")
    properties = bpy.context.scene.curecon
    yield from person.open("CURECON_PT_cloud")
    yield from choose(person, "cloud.colour_by", "H", "colours")
    if task["language"]:
        properties.cloud.colour_by = "HEIGHT"
    assert properties.cloud.colour_by == "HEIGHT", properties.cloud.colour_by
    yield from person.picture("cloud")
    properties.cloud.colour_by = "PHOTO"


def pick_two(person: Person) -> Iterator[float]:
    """Click two points of the cloud, far apart in the view; returns (of the generator) where the second is."""
    item = next(item for item in bpy.context.scene.objects if item.type == "POINTCLOUD")
    every = max(len(item.data.points) // 2000, 1)
    points = [item.matrix_world @ item.data.points[i].co for i in range(0, len(item.data.points), every)]
    region, right = person.region("WINDOW"), person.region("UI").x
    view = person.area.spaces.active.region_3d
    seen = [place for point in points if (place := location_3d_to_region_2d(region, view, point)) is not None
            and 100 < place.x < right - region.x - 250 and 150 < place.y < region.height - 150]
    for place in (min(seen, key=lambda place: place.x), max(seen, key=lambda place: place.x)):
        x, y = region.x + round(place.x), region.y + round(place.y)
        yield from person.move(x, y)
        yield 0.3
        yield from person.click(x, y)
        yield 0.3
    return x, y


def measure(person: Person) -> Wait:
    step("measure")
    yield from person.open_only("CURECON_PT_frame")
    yield from person.push("curecon.measure")
    yield from pick_two(person)
    yield from person.picture("measure")
    (distance,) = bpy.context.scene.curecon.measurements
    report["measured"] = (Vector(distance.second) - Vector(distance.first)).length


def frame(person: Person) -> Wait:
    """Scale by two picked points, as far apart as they are, and the ground to Z = 0."""
    step("frame")
    yield from person.push("curecon.frame_scale")
    place = yield from pick_two(person)
    yield from person.picture("scale")  # the dialog under the pointer asks for the known distance
    yield from person.press("RET", *place)
    yield from person.until(lambda: any("measured distance" in collection.get("scale_source", "")
                                        for collection in bpy.data.collections), seconds=20, what="the scale")
    yield from person.push("curecon.frame_ground")
    yield 0.5
    item = next(item for item in bpy.context.scene.objects if item.type == "POINTCLOUD")
    report["lifted"] = item.matrix_world.translation.z
    assert abs(report["lifted"]) < 1, report["lifted"]  # it came with its ground there
    yield from person.picture("ground")


def export(person: Person) -> Wait:
    step("export")
    yield from person.push("curecon.export_surface")
    yield 1.5
    windows = bpy.context.window_manager.windows
    window, browser = next((window, area) for window in windows for area in window.screen.areas
                           if area.type == "FILE_BROWSER")
    parameters = browser.spaces.active.params
    parameters.directory, parameters.filename = str(out).encode(), "tulou.glb"
    yield from person.picture("export")
    region = next(region for region in browser.regions if region.type == "WINDOW")
    left, top, width, height = person.rectangle(window)
    report["export"] = [left + region.x, top, width - region.x, height]  # without the user's own bookmarks
    with bpy.context.temp_override(window=window, area=browser, region=region):
        bpy.ops.file.execute()
    yield from person.until((out / "tulou.glb").is_file, seconds=task["patience"], what="the export")
    report["exported"] = (out / "tulou.glb").stat().st_size
    yield 1.0


def surface(person: Person) -> Wait:
    step("mesh")
    properties = bpy.context.scene.curecon
    yield from person.open_only("CURECON_PT_surface")
    yield from person.push("curecon.build_mesh")
    yield from worked(person, task["patience"], "the mesh")
    assert properties.result.faces and not properties.result.textured
    yield from person.picture("mesh")
    step("texture")
    yield from person.push("curecon.texture")
    yield from worked(person, task["patience"], "the texture")
    assert properties.result.textured
    assert person.area.spaces.active.shading.light == "FLAT", "the photos' colours are shaded a second time"
    report["faces"] = properties.result.faces
    yield from person.picture("texture")
    yield from person.open("CURECON_PT_surface_advanced")
    yield from person.picture("surface")


def present(person: Person) -> Wait:
    step("present")
    scene = bpy.context.scene
    yield from person.open_only("CURECON_PT_present")
    yield from person.open("CURECON_PT_present_sun")
    yield from person.push("curecon.set_sun")
    yield 0.5
    assert any(item.type == "LIGHT" and item.data.type == "SUN" for item in scene.objects)
    yield from person.open("CURECON_PT_present_moves")
    if task["full"]:
        scene.render.fps, scene.curecon.present.seconds = 2, 1.0  # a film of two pictures
    yield from person.push("curecon.move_camera")
    yield 0.5
    assert scene.camera.animation_data is not None, "the move's camera has no keys"
    for part in ("photos", "elevations", "output"):
        yield from person.open(f"CURECON_PT_present_{part}")
    yield from person.picture("present")


def papers(person: Person) -> Wait:
    """Elevations, stills, film and contact sheet, each with one click."""
    folder = out / "papers"
    properties = bpy.context.scene.curecon.present
    properties.folder, properties.sheet_scale = str(folder), "500"
    progress = sys.modules[f"{MODULE}.curecon_blender.operators.rendering"].progress
    for part in ("sun", "moves"):  # room for all buttons below
        yield from person.fold(f"CURECON_PT_present_{part}")
    for button, last in (
        ("curecon.render_elevations", "elevations.pdf"), ("curecon.render_showreel", "contact_sheet.pdf"),
    ):
        step(last)
        yield from person.push(button)
        yield from person.until(lambda: progress.done > 1, seconds=task["patience"], what="the second picture")
        yield from person.picture(button.partition("render_")[2])
        yield from person.until(lambda: not progress.running, seconds=task["patience"], what=last)
        yield 1.0
        yield from person.picture(f"{button.partition('render_')[2]}_finished")
        assert (folder / last).is_file(), sorted(folder.iterdir())
    report["papers"] = sorted(file.name for file in folder.iterdir())


def render(person: Person) -> Wait:
    """F12, as ever in Blender."""
    step("render")
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.samples = "CYCLES", task["samples"]
    scene.render.resolution_x, scene.render.resolution_y = 960, 540
    yield from person.press("F12", *person.middle())
    yield from person.until(lambda: bpy.app.is_job_running("RENDER"), seconds=20, what="the render has begun")
    yield from person.until(
        lambda: not bpy.app.is_job_running("RENDER"), seconds=task["patience"], what="the render",
    )
    yield from person.picture("render")
    bpy.data.images["Render Result"].save_render(str(out / "rendered.png"), scene=scene)


def tour() -> Wait:
    yield 1.0
    person = Person(out)
    yield from person.press("ESC", *person.middle())  # the splash screen
    bpy.context.preferences.system.use_region_overlap = False  # a click beside a panel must not reach the scene
    if task["language"]:
        bpy.context.preferences.view.language = task["language"]
    try:
        yield from install(person)
        yield from photos(person)
        if task["one_press"]:
            yield from one_press(person)
            yield from find(person)
            yield from own_workspace(person)
            step("end")
            return
        yield from reconstruct(person)
        report["sidebar"] = person.rectangle(person.region("UI"))
        if task["full"]:
            yield from undo(person)
        yield from cloud(person)
        yield from measure(person)
        if task["full"]:
            yield from frame(person)
        yield from surface(person)
        if task["full"]:
            yield from export(person)
        yield from present(person)
        yield from render(person)
        if task["full"]:
            yield from papers(person)
            yield from find(person)
            yield from own_workspace(person)
        step("end")
    except Exception:
        report["failed"] = traceback.format_exc()
        subprocess.run(["import", "-window", "root", str(out / "failed.png")], check=False)
    finally:
        report["pictures"] = person.taken


def main() -> None:
    going, due, last = tour(), 0.0, time.monotonic()

    def beat() -> float | None:
        """Note for how long Blender did not answer, and take the tour's next step when it is due."""
        nonlocal due, last
        now = time.monotonic()
        name = report["steps"][-1]["name"] if report["steps"] else "start"
        report["stall"][name] = round(max(report["stall"].get(name, 0.0), now - last - BEAT), 3)
        try:
            if now >= due:
                due = now + next(going)
        except StopIteration:
            (out / "tour.json").write_text(json.dumps(report, indent=1))
            bpy.ops.wm.quit_blender()
            return None
        last = time.monotonic()  # what the tour itself takes, pictures among it, is no stall
        return BEAT

    bpy.app.timers.register(beat, first_interval=1.0, persistent=True)


if __name__ == "__main__":
    main()
