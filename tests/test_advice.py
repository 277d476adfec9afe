# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The photo check says why a flight will be weak and what to do, in order, and says nothing of a sound one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from curecon_blender.core.base import images
from curecon_blender.core.base.geodesy import enu_to_geodetic
from curecon_blender.core.base.records import GeoPosition, Gimbal, Photo
from curecon_blender.core.photos import overlap
from curecon_blender.core.photos.advice import advise, sky_share

ORIGIN = GeoPosition(latitude=24.65, longitude=117.05, altitude=500.0)
START = datetime(2026, 5, 1, 10, 0)
SITE = Path(__file__).parent.parent / "samples" / "tulou" / "photos"


def photo(number: int, place: tuple[float, float, float], yaw: float, pitch: float, **changes: object) -> Photo:
    latitude, longitude, altitude = enu_to_geodetic(np.array([place], float), ORIGIN)[0]
    made = Photo(name=f"DJI_{number:04d}.JPG", path=Path(f"DJI_{number:04d}.JPG"), width=4000, height=3000,
                 camera="DJI FC3582 6.7 mm as 24 mm 4000x3000", focal_px=2800.0,
                 gps=GeoPosition(latitude=latitude, longitude=longitude, altitude=altitude),
                 gimbal=Gimbal(yaw=yaw, pitch=pitch, roll=0.0), relative_altitude=place[2],
                 time=(START + timedelta(seconds=8 * number)).isoformat())
    return replace(made, **changes)  # type: ignore[arg-type]


def grid(height: float = 50.0, step: float = 7.0, first: int = 0) -> list[Photo]:
    """Six lines of eight photos straight down."""
    return [photo(first + 8 * row + column, (step * (column if row % 2 == 0 else 7 - column), 1.3 * step * row, height),
                  0.0, -90.0) for row in range(6) for column in range(8)]


def orbit(height: float = 30.0, first: int = 100) -> list[Photo]:
    turns = np.radians(np.arange(0, 360, 10))
    return [photo(first + n, (25 + 45 * np.sin(turn), 23 + 45 * np.cos(turn), height), (np.degrees(turn) + 180) % 360,
                  -35.0) for n, turn in enumerate(turns)]


def said(photos: list[Photo]) -> list[str]:
    return [str(one.says) for one in advise(tuple(photos), overlap.estimate(tuple(photos)))]


def test_a_grid_with_an_orbit_gets_no_advice() -> None:
    assert said(grid() + orbit()) == []


WEAK: dict[str, tuple[Callable[[], list[Photo]], str]] = {
    "straight down": (lambda: grid() + grid(height=75, first=50), "straight down: walls"),
    "one height": (lambda: grid(height=40) + orbit(height=40), "one height, 40 m"),
    "zoom": (lambda: [replace(p, focal_px=2800.0 if n % 3 else 3600.0) for n, p in enumerate(grid() + orbit())],
             "DJI FC3582 was moved: focal lengths lie between 2800 and 3600"),
    "shadows": (lambda: grid() + [replace(p, time=(START + timedelta(hours=5)).isoformat()) for p in orbit()],
                "between 10:00 and 15:00"),
    "shutter": (lambda: [replace(p, speed=12.0) for p in grid() + orbit()], "rolling shutter"),
    "sky": (lambda: grid() + [replace(p, sky=0.5) for p in orbit()], "Sky fills half of 36 photos"),
    "overlap": (lambda: grid(step=32) + orbit(), "overlap less than 60 % with any other, most of them in the"),
}


@pytest.mark.parametrize("name", WEAK)
def test_each_weakness_is_told_alone_and_with_what_to_do(name: str) -> None:
    make, text = WEAK[name]
    photos = make()
    found = advise(tuple(photos), overlap.estimate(tuple(photos)))
    assert len(found) == 1 and text in found[0].says and found[0].remedy.endswith("."), found


def test_the_gravest_comes_first() -> None:
    photos = [replace(p, speed=12.0, sky=0.5) for p in grid(step=32)]
    texts = said(photos)
    wanted = ["overlap less", "one height", "straight down", "rolling shutter", "Sky fills"]
    assert len(texts) == len(wanted) and all(part in text for part, text in zip(wanted, texts, strict=True)), texts


def test_the_part_of_the_flight_that_lacks_photos_is_named() -> None:
    sparse = [photo(200 + n, (90 + 32 * (n % 4), 32 * (n // 4) - 25, 50), 0, -90) for n in range(16)]
    (first, *rest) = said(grid() + orbit() + sparse)
    assert "16 of 100 photos" in first and "in the east: DJI_0200.JPG" in first and not rest, first


@pytest.mark.parametrize("unknown", [
    {"gimbal": None}, {"relative_altitude": None}, {"gps": None}, {"focal_px": None}, {"time": None}])
def test_what_the_photos_do_not_tell_is_not_guessed(unknown: dict[str, None]) -> None:
    assert said([replace(p, **unknown) for p in grid() + orbit()]) == []  # type: ignore[arg-type]


def test_a_handful_of_photos_is_no_flight() -> None:
    assert said(grid()[:7]) == []


def test_sky_is_told_from_walls_and_roofs() -> None:
    assert sky_share(images.read_rgb(SITE / "DJI_0026.JPG", 1000)) < 0.02  # straight down
    picture = images.read_rgb(SITE / "DJI_0014.JPG", 1000)
    blue = np.clip(np.linspace(150, 200, picture.shape[0])[:, None, None] * [0.7, 0.9, 1.15], 0, 255)
    half = picture.shape[0] // 2
    sky = np.concatenate([np.broadcast_to(blue, picture.shape)[:half], picture[half:]]).astype(np.uint8)
    assert 0.45 < sky_share(sky) < 0.6
    assert sky_share(sky[::-1]) < 0.1  # water at the lower edge is none
