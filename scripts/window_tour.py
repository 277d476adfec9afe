# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Take a full Blender with its window from the built zip to a rendered picture, as a newcomer would, with a picture of
each step; and crop the manual's pictures out of those.

    CURECON_BLENDER="xvfb-run -a blender" python scripts/window_tour.py FOLDER [--photos N] [--manual docs/pictures]

CURECON_BLENDER is the command that starts Blender 5.2 with a window; Blender must find ImageMagick's `import` there,
which takes the pictures. FOLDER gets tour.json (times, stalls, counts), a PNG a step and the job's workspace.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parent.parent
# Neighbours of both orbits and from above, in an order in which any first few hang together; after the first ten comes
# the side that the view shows.
NUMBERS = (14, 15, 26, 27, 28, 33, 16, 25, 32, 13, 17, 18, 6, 5, 19, 7, 29, 4, 8, 30, 20, 31, 3, 9, 21, 22, 2, 10, 23,
           24, 1, 11, 12)
FEW = 10
VARIABLE = "CURECON_BLENDER"
# What the manual shows of the tour's pictures.
PANELS = ("photos", "reconstruct", "progress", "cloud", "measure", "surface", "present")
WINDOWS = {"result": "window", "scale": "window_scale", "texture": "window_surface"}
OWN_WINDOWS = ("preferences", "export")
WINDOW_WIDTH = 1100
TABS = 24  # pixels at the sidebar's right edge


def tour(
    folder: Path, *, photos: int = FEW, max_image_size: int = 0, samples: int = 16, patience: float = 1800,
    full: bool = True, one_press: bool = False, language: str = "",
    worker: Path = Path(sys.executable), index: str = "",
    begun: Path | None = None,
) -> dict[str, Any]:
    """Run the tour with so many photos of the sample site; returns its report.

    `max_image_size` in pixels, 0 for the quality's own; `patience` is what one job may take, in seconds. `full`
    adds what the short tour leaves out, `one_press` takes the short way (see tests/window/tour.py); `language` is
    one of Blender's, such as zh_HANS; `worker` is the Python that does the work, and with `index` one that first gets
    its libraries from that package index. `begun` is an earlier tour's workspace, from which it goes on. Raises
    KeyError without CURECON_BLENDER, RuntimeError with Blender's words when the tour did not come to its end.
    """
    command = shlex.split(os.environ[VARIABLE])
    folder = folder.resolve()
    site = folder / "tulou"
    shutil.rmtree(folder, ignore_errors=True)
    site.mkdir(parents=True)
    for number in NUMBERS[:photos]:
        shutil.copy2(ROOT / "samples" / "tulou" / "photos" / f"DJI_{number:04d}.JPG", site)
    if begun is not None:
        shutil.copytree(begun, folder / "tulou_curecon")
    subprocess.run(
        [sys.executable, ROOT / "scripts" / "build_extension.py", "--output", folder], check=True, capture_output=True,
    )
    (archive,) = folder.glob("curecon_blender-*.zip")
    task = folder / "task.json"
    task.write_text(json.dumps({
        "out": str(folder), "archive": str(archive), "photos": str(site), "worker_python": str(worker), "index": index,
        "max_image_size": max_image_size, "samples": samples, "patience": patience, "full": full,
        "one_press": one_press, "language": language, "begun": begun is not None,
    }))
    log = folder / "blender.log"
    with log.open("w") as said:
        ended = subprocess.run(
            [*command, "--factory-startup", "--enable-event-simulate",
             "--python", str(ROOT / "tests" / "window" / "tour.py"), "--", str(task)],
            cwd=ROOT, stdout=said, stderr=subprocess.STDOUT, check=False,
            env=os.environ | {"BLENDER_USER_RESOURCES": str(folder / "user"), "PYTHONUTF8": "1"},
        )
    if not (folder / "tour.json").is_file():
        raise RuntimeError(f"Blender ended before the tour did:\n{log.read_text()}")
    report = json.loads((folder / "tour.json").read_text())
    if "failed" in report:
        raise RuntimeError(f"{report['failed']}\nIts window: {folder / 'failed.png'}\n{log.read_text()}")
    if ended.returncode:
        raise RuntimeError(f"Blender crashed as it quit:\n{log.read_text()}")
    return report


def crop_manual(folder: Path, report: dict[str, Any], manual: Path) -> None:
    """Cut the manual's pictures out of the tour's, as JPEG: panels, and whole windows at half their size."""
    manual.mkdir(parents=True, exist_ok=True)
    left, top, width, height = report["sidebar"]
    cut = {name: _box(*report[name]) for name in OWN_WINDOWS}
    cut |= {name: _box(left, top, width - TABS, height) for name in PANELS}
    for name, box in cut.items():
        picture = _without_empty_end(Image.open(folder / f"{name}.png").convert("RGB").crop(box))
        picture.save(manual / f"{name}.jpg", quality=85, optimize=True)
    for name, file in WINDOWS.items():
        picture = Image.open(folder / f"{name}.png").convert("RGB")
        picture.thumbnail((WINDOW_WIDTH, WINDOW_WIDTH), Image.Resampling.LANCZOS)
        picture.save(manual / f"{file}.jpg", quality=80, optimize=True)


def _box(left: int, top: int, width: int, height: int) -> tuple[int, int, int, int]:
    return left, top, left + width, top + height


def _without_empty_end(picture: Image.Image) -> Image.Image:
    """Cut off what lies below the last row that holds anything."""
    pixels = np.asarray(picture.convert("L"), np.int16)[:, 4:-4]
    filled = np.flatnonzero(np.ptp(pixels, axis=1) > 12)
    return picture.crop((0, 0, picture.width, min(picture.height, int(filled[-1]) + 12))) if len(filled) else picture


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="is emptied first")
    parser.add_argument("--photos", type=int, default=FEW, help="how many of 33 (default: %(default)s)")
    parser.add_argument("--one-press", action="store_true", help="the short way: one button after the drop")
    parser.add_argument("--language", default="", help="of Blender's words, such as zh_HANS")
    parser.add_argument("--worker", type=Path, default=Path(sys.executable), help="the Python that does the work")
    parser.add_argument("--index", default="", help="package index from which that Python gets its libraries first")
    parser.add_argument("--begun", type=Path, help="an earlier tour's workspace, of as many photos, to go on from")
    parser.add_argument("--max-image-size", type=int, default=0, help="pixels; 0: the quality's own")
    parser.add_argument("--manual", type=Path, help="folder for the manual's pictures")
    arguments = parser.parse_args()
    if VARIABLE not in os.environ:
        parser.error(f"set {VARIABLE} to the command that starts Blender 5.2 with a window")
    report = tour(
        arguments.folder, photos=arguments.photos, one_press=arguments.one_press, language=arguments.language,
        worker=arguments.worker, index=arguments.index, begun=arguments.begun, max_image_size=arguments.max_image_size,
    )
    if arguments.manual is not None:
        crop_manual(arguments.folder.resolve(), report, arguments.manual)
    print(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()
