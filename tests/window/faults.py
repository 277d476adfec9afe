# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a user may do to Blender while a job runs, done in its window: save, undo, open another file, switch the add-on
off (and take a picture of the window), and lastly kill Blender: the caller looks whether the worker goes with it.

    blender --factory-startup --python tests/window/faults.py -- PHOTOS FOLDER WORKER_PYTHON

Prints a line starting with FAULT for every step, and at last RUNNING with the worker's process id.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path

import bpy

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))
import curecon_blender  # noqa: E402
from curecon_blender import preferences  # noqa: E402
from curecon_blender.operators import running  # noqa: E402

PHOTOS, FOLDER, PYTHON = sys.argv[sys.argv.index("--") + 1:][:3]
BEAT = 0.1
preferences.Settings.__init__.__kwdefaults__["worker_python"] = Path(PYTHON)


def window() -> object:
    """The context of a person before the 3D viewport."""
    manager = bpy.context.window_manager
    area = next(area for area in manager.windows[0].screen.areas if area.type == "VIEW_3D")
    region = next(region for region in area.regions if region.type == "WINDOW")
    return bpy.context.temp_override(window=manager.windows[0], area=area, region=region)


def until(done: Callable[[], bool], what: str) -> Iterator[None]:
    for _ in range(3000):
        if done():
            return
        yield
    raise AssertionError(f"waited in vain until {what}")


def start(until_stage: str) -> Iterator[None]:
    """Press Reconstruct and wait until the worker is at work in that stage."""
    bpy.context.scene.curecon.photos = PHOTOS
    bpy.context.scene.curecon.workspace = str(Path(FOLDER) / "workspace")
    bpy.context.scene.curecon.quality = "preview"
    bpy.context.scene.curecon.max_image_size = 192
    with window():
        assert bpy.ops.curecon.reconstruct("INVOKE_DEFAULT") == {"RUNNING_MODAL"}
    yield from until(lambda: any(s.stage == until_stage and s.total for s in running.status.stages)
                     or not running.status.running, f"the worker is at {until_stage}")
    assert running.status.running, running.status.failure


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def story() -> Iterator[None]:
    saved = str(Path(FOLDER) / "site.blend")

    yield from start("sparse")
    pid = running._job.pid
    with window():
        bpy.ops.wm.save_as_mainfile(filepath=saved)
    assert running.status.running and alive(pid)
    print("FAULT saved: the job runs on", flush=True)

    bpy.ops.wm.open_mainfile(filepath=saved)
    yield
    assert not running.status.running and not alive(pid)
    assert bpy.context.scene.curecon.photos == PHOTOS
    print("FAULT reopened: the job has ended", flush=True)

    yield from start("sparse")
    pid = running._job.pid
    curecon_blender.unregister()
    assert not alive(pid)
    for _ in range(10):
        yield
    subprocess.run(["import", "-window", "root", str(Path(FOLDER) / "switched_off.png")], check=False)
    curecon_blender.register()
    print("FAULT switched off and on: the job has ended", flush=True)

    yield from start("views")
    with window():
        bpy.ops.ed.undo_push(message="Something")
        bpy.context.scene.curecon.max_image_size = 193
        bpy.ops.ed.undo_push(message="Something else")
        bpy.ops.ed.undo()
    print("FAULT undone", flush=True)
    yield from until(lambda: not running.status.running, "the job is done")
    assert running.status.failure is None, running.status.failure
    clouds = [o for o in bpy.context.scene.objects if o.type == "POINTCLOUD"]
    assert len(clouds) == 1 and len(clouds[0].data.points) > 1000
    print("FAULT undone: the job ran to its end, and its cloud is there", flush=True)

    bpy.context.scene.curecon.quality = "standard"
    with window():
        bpy.ops.curecon.reconstruct("INVOKE_DEFAULT")
    yield from until(lambda: bool(running.status.stages and running.status.stages[-1].total), "the worker is at work")
    print(f"RUNNING {running._job.pid}", flush=True)
    os.kill(os.getpid(), signal.SIGKILL)


def tell(steps: Iterator[None]) -> float | None:
    try:
        next(steps)
        return BEAT
    except BaseException:
        traceback.print_exc()
        print("FAULT failed", flush=True)
        os._exit(1)


curecon_blender.register()
steps = story()
bpy.app.timers.register(lambda: tell(steps), first_interval=2.0, persistent=True)
