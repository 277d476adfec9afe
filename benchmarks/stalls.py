# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How long the add-on keeps Blender's window from answering: the longest stalls of the main thread, by what was done.

    blender --python benchmarks/stalls.py -- WORKSPACE --worker-python PYTHON [--photos FOLDER] [--preview]

Needs a window; WORKSPACE is a finished job's, with a cloud and at best a surface. A beat of ten milliseconds runs
inside Blender; what is missing between two beats is a stall. Beside its wall time stands the processor time that the
main thread spent in it, which does not grow where other programs use the processor too. Stalls count Blender's own
drawing, which without a graphics card is most of them; the call of the add-on's own code that worked longest stands
beside them with its name.
`--preview` moves the sliders in Material Preview too, whose shaders take a minute to compile without a
graphics card.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import bpy

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))
import curecon_blender  # noqa: E402

BEAT = 0.01  # seconds
LONG = 0.1  # a stall that a user notices
Wait = Iterator[float]


class Heart:
    """Beats for as long as Blender answers. `stalls` are (wall, main thread's processor) seconds of this phase, and
    `calls` those of the add-on's own code in it: (processor, wall, which)."""

    def __init__(self) -> None:
        self.phase, self.began, self.stalls, self.calls = "", 0.0, [(0.0, 0.0)], [(0.0, 0.0, "")]
        self.last = time.monotonic(), time.thread_time()

    def beat(self) -> float:
        now = time.monotonic(), time.thread_time()
        self.stalls.append((now[0] - self.last[0] - BEAT, now[1] - self.last[1]))
        self.last = now
        return BEAT

    def begin(self, phase: str) -> None:
        self.end()
        self.phase, self.began, self.stalls, self.calls = phase, time.monotonic(), [(0.0, 0.0)], [(0.0, 0.0, "")]
        self.last = time.monotonic(), time.thread_time()

    def end(self) -> None:
        if not self.phase:
            return
        self.beat()
        wall, cpu = max(self.stalls)
        over = sum(stall > LONG for stall, _ in self.stalls)
        ours_cpu, ours, which = max(self.calls)
        print(f"STALLS {self.phase:44s} {time.monotonic() - self.began:6.1f} s | longest {1000 * wall:6.0f} ms, "
              f"{1000 * cpu:5.0f} of them working; {over:3d} over 0.1 s | "
              f"our own {1000 * ours:5.0f}, {1000 * ours_cpu:5.0f} working {which}", flush=True)

    def listen(self, holder: object, name: str, doing: Callable[[], str] = str) -> None:
        """Time every call of a function of the add-on; `doing` says what it did."""
        function = getattr(holder, name)

        def timed(*arguments: object, **options: object) -> object:
            began = time.monotonic(), time.thread_time()
            try:
                return function(*arguments, **options)
            finally:
                wall, cpu = time.monotonic() - began[0], time.thread_time() - began[1]
                self.calls.append((cpu, wall, f"in {name} {doing()}"))

        setattr(holder, name, timed)

    def listen_to_operator(self, operator: type[bpy.types.Operator]) -> None:
        self.listen(operator, "execute", lambda: f"of {operator.bl_label}")
        timed = operator.execute
        operator.execute = lambda self, context: timed(self, context)  # Blender counts what a function takes


def area() -> bpy.types.Area:
    return next(area for area in bpy.context.window_manager.windows[0].screen.areas if area.type == "VIEW_3D")


def override() -> object:
    window = bpy.context.window_manager.windows[0]
    region = next(region for region in area().regions if region.type == "WINDOW")
    return bpy.context.temp_override(window=window, area=area(), region=region)


def job_ends() -> Wait:
    from curecon_blender.operators import running

    while running.status.running:
        yield 0.05
    if running.status.failure is not None:
        raise RuntimeError(running.status.failure.message)


def draw() -> Wait:
    """Nothing but Blender drawing the view anew."""
    for _ in range(5):
        area().tag_redraw()
        yield 0.05


def slide(group: object, name: str, low: float, high: float, steps: int = 6) -> Wait:
    """Move a slider to and fro, as fast as the window follows."""
    kept = getattr(group, name)
    for step in range(steps):
        share = 0.5 - 0.5 * math.cos(2 * math.pi * step / steps)
        setattr(group, name, type(kept)(low + share * (high - low)))
        yield 0.03
    setattr(group, name, kept)
    yield 0.5


def slide_all(heart: Heart, shading: str) -> Wait:
    properties = bpy.context.scene.curecon
    for group, name, low, high in (
        (properties, "point_size", 0.5, 3.0), (properties, "display_fraction", 100, 20),
        (properties.cloud, "min_confidence", 0.0, 0.8), (properties.cloud, "min_views", 0, 6),
    ):
        heart.begin(f"{shading}: {name}")
        yield from slide(group, name, low, high)


def press_all(heart: Heart) -> Wait:
    """The buttons that read the whole site."""
    ours, ends = bpy.ops.curecon, {"first": (0.0, 0.0, 0.0), "second": (10.0, 0.0, 0.0)}
    for words, press in (
        ("Frame All", ours.frame_cloud), ("Ground to Z = 0", ours.frame_ground), ("undo", bpy.ops.ed.undo),
        ("Measure Distance", partial(ours.measure, **ends)),
        ("Scale from Distance", partial(ours.frame_scale, **ends, length=11)), ("Reset Frame", ours.frame_reset),
        ("Orbit", partial(ours.move_camera, kind="ORBIT")), ("Fly-Through", partial(ours.move_camera, kind="FLIGHT")),
        ("Sun of the Photos", ours.set_sun), ("Remove Sun and Sky", ours.remove_sun),
        ("Add Region Box", ours.add_region), ("Crop to Region", ours.cloud_crop),
        ("Restore All Points", ours.cloud_restore),
    ):
        heart.begin(words)
        with override():
            press()
        yield 2.0


def story(heart: Heart, options: argparse.Namespace) -> Wait:
    properties = bpy.context.scene.curecon
    yield 3.0
    heart.begin("nothing")
    yield 2.0
    heart.begin("opening the sidebar")
    area().spaces.active.show_region_ui = True
    yield 0.2
    next(region for region in area().regions if region.type == "UI").active_panel_category = "CU-Recon"
    yield 2.0
    if options.photos:
        heart.begin("photo check with its thumbnails")
        properties.photos = str(options.photos)
        with override():
            bpy.ops.curecon.check_photos("INVOKE_DEFAULT")
        yield from job_ends()
        yield 2.0
    heart.begin("drawing the empty scene")
    yield from draw()
    for name in ("import", "import again, in place of the first"):
        heart.begin(name)
        with override():
            bpy.ops.curecon.import_workspace("INVOKE_DEFAULT", directory=str(options.workspace))
        yield from job_ends()
        heart.begin("  and its first drawings")
        yield 3.0
    heart.begin("drawing the surface")
    yield from draw()
    heart.begin("undo")
    with override():
        bpy.ops.ed.undo()
    yield 3.0
    heart.begin("redo")
    with override():
        bpy.ops.ed.redo()
    yield 3.0
    properties = bpy.context.scene.curecon
    heart.begin("the cloud in place of the surface")
    properties.show_surface, properties.show_cloud = False, True
    yield 4.0
    heart.begin("drawing the cloud")
    yield from draw()
    yield from slide_all(heart, "Solid")
    yield from press_all(heart)
    properties = bpy.context.scene.curecon
    heart.begin("Solid: colour by height")
    properties.cloud.colour_by = "HEIGHT"
    yield 1.0
    heart.begin("Solid: colour by views")
    properties.cloud.colour_by = "VIEWS"
    yield 1.0
    properties.cloud.colour_by = "PHOTO"
    blend = str(Path(tempfile.mkdtemp()) / "stalls.blend")
    heart.begin("saving the .blend")
    bpy.ops.wm.save_as_mainfile(filepath=blend)
    yield 2.0
    heart.begin("loading the .blend")
    bpy.ops.wm.open_mainfile(filepath=blend)
    heart.begin("  and its first drawings")
    yield 4.0
    if options.preview:
        heart.begin("to Material Preview (Blender's shaders)")
        area().spaces.active.shading.type = "MATERIAL"
        yield 20.0
        yield from slide_all(heart, "Material Preview")
    heart.end()


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("workspace", type=Path)
    parser.add_argument("--worker-python", required=True)
    parser.add_argument("--photos", type=Path)
    parser.add_argument("--preview", action="store_true")
    options = parser.parse_args(sys.argv[sys.argv.index("--") + 1:])
    from curecon_blender import operators, preferences
    from curecon_blender.operators import running
    from curecon_blender.scene import display, history, viewport

    heart = Heart()  # listens before Blender is given the functions
    heart.listen(running.ModalOperator, "_go_on", lambda: running.status.task)
    for holder, name in ((viewport._Upload, "go_on"), (viewport, "_let_nodes_show"), (display, "apply"),
                         (display, "measure_range"), (history, "_follow")):
        heart.listen(holder, name)
    for operator in operators.CLASSES:
        if hasattr(operator, "execute"):
            heart.listen_to_operator(operator)
    curecon_blender.register()
    bpy.context.preferences.view.show_splash = False
    addon = bpy.context.preferences.addons.new()  # what enabling it would do, so that it has preferences
    addon.module = preferences.ADDON
    addon.preferences.worker_python = options.worker_python
    steps = story(heart, options)

    def go_on() -> float | None:
        try:
            return next(steps)
        except StopIteration:
            pass
        except Exception:
            traceback.print_exc()
        bpy.ops.wm.quit_blender()
        return None

    bpy.app.timers.register(heart.beat, persistent=True)
    bpy.app.timers.register(go_on, first_interval=1.0, persistent=True)


main()
