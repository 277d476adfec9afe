# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""From the zip to a rendered picture, as a newcomer goes, inside Blender with its window.

scripts/window_tour.py starts it with a JSON of what to do; it writes tour.json and a picture of each step. Clicks and
keys go through Blender's own event queue. By operator are done: installing (its dialog is the system's file browser),
the drop (through the operator that Blender itself calls for a drop), and typing into fields.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
import traceback
from pathlib import Path
from typing import Any

import bpy
from bpy_extras.view3d_utils import location_3d_to_region_2d
from mathutils import Vector

sys.path.insert(0, str(Path(__file__).parent))
from person import Person, Wait

MODULE = "bl_ext.user_default.curecon_blender"
BEAT = 0.02  # seconds between two looks at whether Blender still answers

task = json.loads(Path(sys.argv[sys.argv.index("--") + 1]).read_text())
out = Path(task["out"])
report: dict[str, Any] = {"steps": [], "stall": {}}
began = time.monotonic()


def step(name: str) -> None:
    """The next step of the tour begins: in the report, each has the second in which it began."""
    report["steps"].append({"name": name, "began": round(time.monotonic() - began, 1)})
    print(f"TOUR {report['steps'][-1]['began']:7.1f} s  {name}", flush=True)


def busy() -> bool:
    return sys.modules[f"{MODULE}.curecon_blender.operators.running"].status.running


def failure() -> str:
    failed = sys.modules[f"{MODULE}.curecon_blender.operators.running"].status.failure
    return f"{failed.message} {failed.remedy}" if failed is not None else ""


def worked(person: Person, seconds: float, what: str) -> Wait:
    yield from person.until(busy, seconds=10, what=f"{what} has begun")
    yield from person.until(lambda: not busy(), seconds=seconds, what=what)
    assert not failure(), failure()
    yield 1.0


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
    report["preferences"] = [other.x, person.window.height - other.y - other.height, other.width, other.height]
    with bpy.context.temp_override(window=other):
        bpy.ops.wm.window_close()
    bpy.context.preferences.addons[MODULE].preferences.worker_python = task["worker_python"]
    yield 0.5


def photos(person: Person) -> Wait:
    step("photos")
    yield from person.sidebar("CU-Recon")
    yield from person.picture("empty")
    names = sorted(path.name for path in Path(task["photos"]).iterdir())
    yield from person.move(*person.middle())
    with person.override():
        bpy.ops.wm.drop_import_file(
            "INVOKE_DEFAULT", directory=task["photos"] + "/", files=[{"name": name} for name in names],
        )
    yield from person.picture("drop")  # Blender asks whether they are to become an image in the scene
    yield from person.press("D", *person.middle())
    yield from worked(person, task["patience"], "the photo check")
    assert bpy.context.scene.curecon.check.photos == len(names)
    yield from person.open_only("CURECON_PT_photos")
    yield from person.picture("photos")


def reconstruct(person: Person) -> Wait:
    step("reconstruct")
    properties = bpy.context.scene.curecon
    yield from person.open_only("CURECON_PT_reconstruct")
    yield from person.choose("curecon.quality", "P", "qualities")
    assert properties.quality == "preview", properties.quality
    yield from person.open("CURECON_PT_advanced")
    yield from person.picture("reconstruct")
    properties.max_image_size = task["max_image_size"]
    yield from person.push("curecon.reconstruct")
    step("reconstructing")
    running = sys.modules[f"{MODULE}.curecon_blender.operators.running"]
    patience = task["patience"]
    yield from person.until(lambda: running.status.overall > 0.3 or failure(), seconds=patience, what="a third of it")
    yield from person.picture("progress")
    yield from person.until(lambda: not busy(), seconds=patience, what="the reconstruction")
    assert not failure(), failure()
    step("first cloud")
    yield 1.0
    assert "Cube" not in bpy.context.scene.objects, "Blender's own cube stands in the site"
    report["points"], report["cameras"] = properties.result.points, properties.result.cameras
    yield from person.open_only("CURECON_PT_result")
    yield from person.picture("result")


def cloud(person: Person) -> Wait:
    step("cloud")
    properties = bpy.context.scene.curecon
    yield from person.open("CURECON_PT_cloud")
    yield from person.choose("cloud.colour_by", "H", "colours")
    assert properties.cloud.colour_by == "HEIGHT", properties.cloud.colour_by
    yield from person.picture("cloud")
    properties.cloud.colour_by = "PHOTO"


def measure(person: Person) -> Wait:
    """Pick two points of the cloud, far apart in the view."""
    step("measure")
    yield from person.open_only("CURECON_PT_frame")
    yield from person.push("curecon.measure")
    item = next(item for item in bpy.context.scene.objects if item.type == "POINTCLOUD")
    every = max(len(item.data.points) // 2000, 1)
    points = [item.matrix_world @ item.data.points[i].co for i in range(0, len(item.data.points), every)]
    region, right = person.region("WINDOW"), person.sidebar_rectangle()[0]
    view = person.area.spaces.active.region_3d
    seen = [place for point in points if (place := location_3d_to_region_2d(region, view, point)) is not None
            and 100 < place.x < right - region.x - 250 and 150 < place.y < region.height - 150]
    for place in (min(seen, key=lambda place: place.x), max(seen, key=lambda place: place.x)):
        x, y = region.x + round(place.x), region.y + round(place.y)
        yield from person.move(x, y)
        yield 0.3
        yield from person.click(x, y)
        yield 0.3
    yield from person.picture("measure")
    (distance,) = bpy.context.scene.curecon.measurements
    report["measured"] = (Vector(distance.second) - Vector(distance.first)).length


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
    yield from person.push("curecon.move_camera")
    yield 0.5
    assert scene.camera.animation_data is not None, "the move's camera has no keys"
    for part in ("photos", "elevations", "output"):
        yield from person.open(f"CURECON_PT_present_{part}")
    yield from person.picture("present")


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
    try:
        yield from install(person)
        yield from photos(person)
        yield from reconstruct(person)
        report["sidebar"] = person.sidebar_rectangle()
        yield from cloud(person)
        yield from measure(person)
        yield from surface(person)
        yield from present(person)
        yield from render(person)
        step("end")
    except Exception:
        report["failed"] = traceback.format_exc()
        subprocess.run(["import", "-window", "root", str(out / "failed.png")], check=False)
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
