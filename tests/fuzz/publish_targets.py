# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What publishing reads: notes, the accuracy report, and items of sites that were published before; spoiled."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from .mutations import spoiled_bytes, spoiled_json

_NOTES = [{"title": "Door", "text": "Oak", "place": [1.0, 2.0, 3.0], "eye": [4.0, 5.0, 6.0]}]
_REPORT = {"parts": [{"index": 0, "points": 5, "faces": 7, "clearness": {"pixel": {"median": 0.05}},
                      "correctness": {"reprojection_error": 0.3, "check": {"rms": [0.1, 0.2, 0.3]},
                                      "sigmas": {"within": [0.01, 0.02]}}, "integrity": {"seen_well": 0.9}}]}
_ITEM = {"type": "Feature", "id": "gate", "geometry": None, "properties": {"title": "Gate"}, "links": [],
         "assets": {"page": {"href": "./index.html", "type": "text/html"}}}
_FILES: dict[str, Any] = {"notes.json": _NOTES, "report.json": _REPORT, "sites/gate/item.json": _ITEM}


def make(folder: Path) -> None:
    for name, content in _FILES.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(json.dumps(content))


def cases(name: str) -> Callable[[Path], st.SearchStrategy[tuple[str, bytes]]]:
    def of(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
        sound = json.dumps(_FILES[name]).encode()
        return st.tuples(st.just(name), st.one_of(spoiled_json(_FILES[name]), spoiled_bytes(sound)))

    return of


def check_notes(folder: Path) -> None:
    from curecon_blender.core.publish.records import read_notes

    assert all(math.isfinite(value) for note in read_notes(folder / "notes.json") for value in note.place)


def check_figures(folder: Path) -> None:
    from curecon_blender.core.base.messages import Reporter
    from curecon_blender.core.publish.page import figures

    found = figures(folder / "report.json", 0, 5, 7, Reporter())
    assert all(math.isfinite(value) for value in found.values())


def make_film(folder: Path) -> None:
    import cv2
    import numpy as np

    writer = cv2.VideoWriter(str(folder / "film.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), 5, (64, 48))
    for shade in (50, 200):
        writer.write(np.full((48, 64, 3), shade, np.uint8))
    writer.release()


def film_cases(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
    return st.tuples(st.just("film.mp4"), spoiled_bytes((folder / "film.mp4").read_bytes()))


def check_film(folder: Path) -> None:
    from curecon_blender.core.publish.film import without_metadata

    film = (folder / "film.mp4").read_bytes()
    try:
        assert len(without_metadata(film)) == len(film)
    except ValueError:  # told as a warning
        return


def check_catalogue(folder: Path) -> None:
    from curecon_blender.core.base.messages import Reporter
    from curecon_blender.core.publish.folder import write_catalogue

    listed = write_catalogue(folder, Reporter())
    assert len(json.loads((folder / "items.json").read_text())["features"]) == listed <= 1
