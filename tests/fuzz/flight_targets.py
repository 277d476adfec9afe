# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Outlines that people draw on maps and the subtitles of videos, spoiled."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

from ..mp4_boxes import box, with_track
from .mutations import spoiled_bytes, spoiled_json

_RING = [[117.05, 24.66], [117.051, 24.66], [117.051, 24.661], [117.05, 24.661], [117.05, 24.66]]
_DRAWN = {"type": "FeatureCollection",
          "features": [{"type": "Feature", "geometry": {"type": "Polygon", "coordinates": [_RING]}}]}
_KML = (
    '<kml xmlns="http://www.opengis.net/kml/2.2"><Placemark><Polygon><outerBoundaryIs><LinearRing><coordinates>'
    + " ".join(f"{x},{y},0" for x, y in _RING)
    + "</coordinates></LinearRing></outerBoundaryIs></Polygon></Placemark></kml>"
)
_TOLD = (
    "1\n00:00:00,000 --> 00:00:00,033\n2024-06-18 12:45:57.123\n[focal_len: 24.00] [latitude: 24.6581] "
    "[longitude: 117.0523] [rel_alt: 10.2 abs_alt: 350.1]\n\n2\n00:00:01,000 --> 00:00:01,033\n"
    "GPS(117.0523,24.6582,16) BAROMETER:10.3\n"
)


def make_outline(folder: Path) -> None:
    (folder / "outline.geojson").write_text(json.dumps(_DRAWN))
    (folder / "outline.kml").write_text(_KML)


def drawn_cases(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
    sound = json.dumps(_DRAWN).encode()
    return st.tuples(st.just("outline.geojson"), st.one_of(spoiled_json(_DRAWN), spoiled_bytes(sound)))


def kml_cases(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
    return st.tuples(st.just("outline.kml"), spoiled_bytes(_KML.encode()))


def outline_reader(form: str) -> Callable[[Path], None]:
    def check(folder: Path) -> None:
        from curecon_blender.core.plan.site import of_file

        building = of_file(folder / f"outline.{form}", 12.0)
        assert np.isfinite(building.outline).all() and np.isfinite(building.obstacles.tops).all()

    return check


def make_subtitles(folder: Path) -> None:
    (folder / "a.srt").write_text(_TOLD)


def subtitles_cases(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
    return st.tuples(st.just("a.srt"), spoiled_bytes(_TOLD.encode()))


def make_track(folder: Path) -> None:
    (folder / "a.mp4").write_bytes(box(b"ftyp", b"isom") + box(b"moov"))
    with_track(folder / "a.mp4", [_TOLD, _TOLD])


def track_cases(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
    return st.tuples(st.just("a.mp4"), spoiled_bytes((folder / "a.mp4").read_bytes()))


def check_track(folder: Path) -> None:
    from curecon_blender.core.photos.subtitle_track import read_track

    told = read_track(folder / "a.mp4")
    assert told is None or len(told) < 10_000


def check_subtitles(folder: Path) -> None:
    from curecon_blender.core.photos.subtitles import read_subtitles

    told = read_subtitles(folder / "a.srt")
    if told is not None:
        values, _ = told.at(0.5)
        assert np.isnan(values[:2]).all() or (abs(values[0]) <= 90 and abs(values[1]) <= 180)
