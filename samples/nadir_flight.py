# SPDX-License-Identifier: GPL-3.0-or-later
"""The second flight over the sample site: a grid straight down, through a lens with distortion.

Poses and frame are as in site_flight.py. What the receiver recorded comes in two kinds: `standard`, of a receiver that
is 1.5 m off in east and north each and 3 m in height, and `rtk`, 0.02 and 0.03 m.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import timedelta

import numpy as np
from scipy.ndimage import map_coordinates
from site_flight import TAKE_OFF, Shot, geodetic, pose

WIDTH, HEIGHT = 1200, 900
LINES, SHOTS_A_LINE = 4, 5
BETWEEN_LINES, BETWEEN_SHOTS, ABOVE = 18.0, 12.5, 50.0  # metres: overlaps of 75 and 76 % on the ground
SPEED = 1.6  # metres a second; slow, since the pictures have no rolling shutter
SIGMAS = {"standard": (1.5, 3.0), "rtk": (0.02, 0.03)}  # east and north each, and height, metres
FOCAL_MM, FOCAL_35MM = 6.7, 24  # as EXIF tells them; the latter is rounded, and 1.9 % short of the truth


@dataclass(frozen=True, kw_only=True)
class Lens:
    """OpenCV's lens: focal length and centre in pixels (pixel centres at .5), and distortion."""

    f: float
    cx: float
    cy: float
    k1: float
    k2: float
    p1: float
    p2: float

    def colmap(self) -> str:
        """The parameters of COLMAP's OPENCV model."""
        return f"{self.f} {self.f} {self.cx} {self.cy} {self.k1} {self.k2} {self.p1} {self.p2}"

    def scaled(self, scale: float) -> Lens:
        """The lens of pictures `scale` as large."""
        return replace(self, f=scale * self.f, cx=scale * self.cx, cy=scale * self.cy)

    def distort(self, uv: np.ndarray) -> np.ndarray:
        """Pixels (..., 2) of rays (..., 2), x / z and y / z."""
        u, v = uv[..., 0], uv[..., 1]
        r2 = u * u + v * v
        radial = 1 + r2 * (self.k1 + r2 * self.k2)
        x = u * radial + 2 * self.p1 * u * v + self.p2 * (r2 + 2 * u * u)
        y = v * radial + self.p1 * (r2 + 2 * v * v) + 2 * self.p2 * u * v
        return np.stack([self.f * x + self.cx, self.f * y + self.cy], -1)

    def undistort(self, pixels: np.ndarray) -> np.ndarray:
        """Rays (..., 2) of pixels (..., 2), to 1e-9 pixels."""
        plain = (pixels - [self.cx, self.cy]) / self.f
        uv = plain.copy()
        for _ in range(60):
            off = self.distort(uv) - pixels
            if np.abs(off).max() < 1e-9:
                return uv
            uv -= off / self.f
        raise ValueError("the lens folds within the picture")


# The pinhole picture that is warped into the photo: finer, so that it stays crisp, and just wide enough.
PINHOLE_FOCAL, PINHOLE_WIDTH, PINHOLE_HEIGHT = 932.8, 1338, 1004
# The distortion is that of a DJI Mini 3 Pro (FC3582) as its users published it, three radial terms brought to two over
# the picture.
LENS = Lens(f=848.0, cx=606.3, cy=445.8, k1=0.06625, k2=-0.04336, p1=-0.00460, p2=0.00263)


def nadir_flight() -> dict[str, list[Shot]]:
    """The shots of the flight as each kind of receiver recorded them; poses are the same."""
    rng = np.random.default_rng(19)
    count = LINES * SHOTS_A_LINE
    line, along = np.divmod(np.arange(count), SHOTS_A_LINE)
    back = line % 2 == 1
    x = (line - (LINES - 1) / 2) * BETWEEN_LINES
    y = np.where(back, -1, 1) * (along - (SHOTS_A_LINE - 1) / 2) * BETWEEN_SHOTS
    eyes = np.stack([x, y, np.full(count, ABOVE)], 1) + rng.normal(0, [0.5, 0.5, 0.15], (count, 3))
    yaws = np.where(back, 180.0, 0.0) + rng.normal(0, 0.8, count)
    pitches, rolls = -90 + np.abs(rng.normal(0, 0.4, count)), rng.normal(0, 0.25, count)
    times = np.cumsum(BETWEEN_SHOTS / SPEED + rng.normal(0, 0.2, count) + np.where((along == 0) & (line > 0), 9, 0))
    barometer = 0.06 * _unit_noise(rng, count)[:, 2]

    shots = []
    for i in range(count):
        heading = np.radians(yaws[i])
        shots.append(Shot(
            name=f"DJI_{i + 1:04d}.JPG", cam_from_world=pose(eyes[i], yaws[i], pitches[i], rolls[i]), yaw=yaws[i],
            pitch=pitches[i], roll=rolls[i], time=TAKE_OFF + timedelta(minutes=20, seconds=float(times[i])),
            latitude=0.0, longitude=0.0, altitude=0.0, focal_mm=FOCAL_MM, focal_35mm=FOCAL_35MM,
            relative_altitude=eyes[i, 2] + barometer[i],
            xmp={"FlightXSpeed": f"{SPEED * np.cos(heading):+.2f}", "FlightYSpeed": f"{SPEED * np.sin(heading):+.2f}",
                 "FlightZSpeed": "+0.00"},
        ))
    return {kind: _recorded(shots, eyes, kind, rng) for kind in SIGMAS}


def _recorded(shots: list[Shot], eyes: np.ndarray, kind: str, rng: np.random.Generator) -> list[Shot]:
    plan, height = SIGMAS[kind]
    xmp = {"GpsStatus": "Normal"}
    if kind == "rtk":
        noise = rng.normal(size=eyes.shape)
        xmp = {"GpsStatus": "RTK", "RtkFlag": "50", "RtkStdLon": f"{plan:.5f}", "RtkStdLat": f"{plan:.5f}",
               "RtkStdHgt": f"{height:.5f}"}
    else:
        noise = _unit_noise(rng, len(shots))
    places = geodetic(eyes + noise * [plan, plan, height])
    return [
        replace(shot, latitude=place[0], longitude=place[1], altitude=place[2], xmp=shot.xmp | xmp)
        for shot, place in zip(shots, places, strict=True)
    ]


def _unit_noise(rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, 3) errors of root mean square 1 on each axis: an offset that drifts over the flight, and white noise."""
    drift = np.empty((count, 3))
    drift[0] = rng.normal(size=3)
    for i in range(1, count):
        drift[i] = 0.93 * drift[i - 1] + np.sqrt(1 - 0.93**2) * rng.normal(size=3)
    error = drift + rng.normal(0, 0.35, (count, 3))
    return error / np.sqrt((error**2).mean(0))


def photograph(pinhole: np.ndarray) -> np.ndarray:
    """The pinhole picture (PINHOLE_HEIGHT, PINHOLE_WIDTH, 3) uint8 as LENS images it, (HEIGHT, WIDTH, 3) uint8."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    rays = LENS.undistort(np.stack([columns, rows], -1))
    height, width = pinhole.shape[:2]
    at = [rays[..., 1] * PINHOLE_FOCAL + height / 2 - 0.5, rays[..., 0] * PINHOLE_FOCAL + width / 2 - 0.5]
    if min(at[0].min(), at[1].min()) < 0 or at[0].max() > height - 1 or at[1].max() > width - 1:
        raise ValueError("the pinhole picture is not wide enough for the lens")
    channels = [map_coordinates(pinhole[..., c].astype(np.float64), at, order=3) for c in range(3)]
    return np.clip(np.stack(channels, -1) + 0.5, 0, 255).astype(np.uint8)
