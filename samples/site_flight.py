# SPDX-License-Identifier: GPL-3.0-or-later
"""The drone's flight: poses, what its GPS said, and how its camera wrote a picture (noise, EXIF, XMP).

Poses are `cam_from_world` (4, 4) with x right, y down, z forward; the world is the site frame (east, north, up
in metres at ORIGIN).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

LATITUDE, LONGITUDE, ALTITUDE = 24.6583, 117.0521, 520.0
TAKE_OFF = datetime(2024, 9, 28, 10, 48, 0)
UTC_OFFSET = timedelta(hours=8)
SEED = 7
MODEL = "FC3582 (synthetic)"
DESCRIPTION = "Synthetic render of a fictional Hakka Tulou; not a photograph"
FOCAL_MM, FOCAL_35MM = 7.2, 26
JPEG_QUALITY = 85

_XMP = """<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>
<x:xmpmeta xmlns:x="adobe:ns:meta/">
 <rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
  <rdf:Description rdf:about="" xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/"
   {fields}/>
 </rdf:RDF>
</x:xmpmeta>
<?xpacket end="w"?>"""


@dataclass(frozen=True, kw_only=True)
class Shot:
    """One photo: its name, true pose, angles in degrees (yaw clockwise from north, pitch -90 = straight down),
    local time, the position its GPS recorded (degrees, degrees, metres), the lens's focal length as EXIF tells it, the
    height above the take-off that the drone tells (None: the altitude's), and further values of the XMP."""

    name: str
    cam_from_world: np.ndarray
    yaw: float
    pitch: float
    roll: float
    time: datetime
    latitude: float
    longitude: float
    altitude: float
    focal_mm: float = FOCAL_MM
    focal_35mm: int = FOCAL_35MM
    relative_altitude: float | None = None
    xmp: dict[str, str] = field(default_factory=dict)


def pose(eye: np.ndarray, yaw: float, pitch: float, roll: float) -> np.ndarray:
    """cam_from_world of a camera at `eye`; angles in degrees, DJI's way."""
    y, p, r = np.radians([yaw, pitch, roll])
    forward = np.array([np.sin(y) * np.cos(p), np.cos(y) * np.cos(p), np.sin(p)])
    right = np.array([np.cos(y), -np.sin(y), 0.0])
    down = np.cross(forward, right)
    level = np.stack([right, down, forward])
    rolled = np.array([[np.cos(r), np.sin(r), 0], [-np.sin(r), np.cos(r), 0], [0, 0, 1]]) @ level
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rolled, -rolled @ eye
    return matrix


def geodetic(enu: np.ndarray) -> np.ndarray:
    """Latitude, longitude (degrees) and height (metres, WGS 84) of points (N, 3) in the site frame."""
    a, e2 = 6378137.0, 6.69437999014e-3
    lat, lon = np.radians([LATITUDE, LONGITUDE])
    n = a / np.sqrt(1 - e2 * np.sin(lat) ** 2)
    origin = np.array(
        [
            (n + ALTITUDE) * np.cos(lat) * np.cos(lon),
            (n + ALTITUDE) * np.cos(lat) * np.sin(lon),
            (n * (1 - e2) + ALTITUDE) * np.sin(lat),
        ]
    )
    east = np.array([-np.sin(lon), np.cos(lon), 0])
    north = np.array([-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)])
    x, y, z = (origin + enu @ np.stack([east, north, np.cross(east, north)])).T
    phi = np.arctan2(z, np.hypot(x, y) * (1 - e2))
    for _ in range(6):
        n = a / np.sqrt(1 - e2 * np.sin(phi) ** 2)
        height = np.hypot(x, y) / np.cos(phi) - n
        phi = np.arctan2(z, np.hypot(x, y) * (1 - e2 * n / (n + height)))
    return np.stack([np.degrees(phi), np.degrees(np.arctan2(y, x)), height], 1)


def flight() -> list[Shot]:
    """Two orbits and a nadir block, flown in one go."""
    rng = np.random.default_rng(SEED)
    eyes, targets = [], []
    for count, first, radius, height, look in ((13, 8.0, 46.0, 24.0, 4.0), (12, 20.0, 34.0, 42.0, 2.5)):
        for azimuth in first + 360 * np.arange(count) / count + rng.normal(0, 1.2, count):
            a = np.radians(azimuth)
            eyes.append([radius * np.sin(a), radius * np.cos(a), height] + rng.normal(0, 0.9, 3))
            targets.append([0, 0, look] + rng.normal(0, 1.3, 3))
    straight_down = ((-15, 11), (0, 12), (15, 10), (15, -11), (0, -12), (-15, -10))
    for x, y in straight_down:
        eyes.append([x, y, 55.0] + rng.normal(0, 0.9, 3))
        targets.append(eyes[-1] - np.array([0, 0, 50.0]) + rng.normal(0, 0.35, 3))
    for x, y in ((-9, -13), (10, 12)):
        eyes.append([x, y, 48.0] + rng.normal(0, 0.9, 3))
        targets.append(np.array([0.0, 0.0, 1.0]) + rng.normal(0, 0.8, 3))
    eyes, looks = np.array(eyes), np.array(targets) - np.array(eyes)

    white = rng.normal(0, 0.2, eyes.shape)
    drift = np.zeros_like(eyes)
    for i in range(1, len(eyes)):
        drift[i] = 0.93 * drift[i - 1] + rng.normal(0, 0.1, 3)
    error = white + drift + rng.normal(0, 0.1, 3)
    error *= 0.4 / np.array([np.sqrt(np.mean((error[:, :2] ** 2).sum(1)))] * 2 + [np.sqrt(np.mean(error[:, 2] ** 2))])
    recorded = geodetic(eyes + error)

    shots, time = [], TAKE_OFF
    for i, (eye, look) in enumerate(zip(eyes, looks, strict=True)):
        nadir = 25 <= i < 25 + len(straight_down)
        yaw = 24.0 + rng.normal(0, 1.5) if nadir else float(np.degrees(np.arctan2(look[0], look[1])))
        pitch = (
            -90.0 + abs(rng.normal(0, 0.4)) if nadir else float(np.degrees(np.arctan2(look[2], np.hypot(*look[:2]))))
        )
        roll = rng.normal(0, 0.25)
        time += timedelta(seconds=float(rng.uniform(4, 7)) + (14 if i in (13, 25) else 0))
        shots.append(
            Shot(
                name=f"DJI_{i + 1:04d}.JPG",
                cam_from_world=pose(eye, yaw, pitch, roll),
                yaw=yaw,
                pitch=pitch,
                roll=roll,
                time=time,
                latitude=recorded[i, 0],
                longitude=recorded[i, 1],
                altitude=recorded[i, 2],
            )
        )
    return shots


def develop(render: np.ndarray, shot: Shot) -> np.ndarray:
    """A render (H, W, 3) uint8 as a small camera would give it: sharpened, vignetted, noisy, a little off."""
    rng = np.random.default_rng(SEED * 1000 + int(shot.name[4:8]))
    picture = render.astype(np.float64) / 255
    padded = np.pad(picture, ((1, 1), (1, 1), (0, 0)), mode="edge")
    blurred = (4 * picture + padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]) / 8
    picture = picture + 0.5 * (picture - blurred)
    height, width = picture.shape[:2]
    y, x = np.mgrid[:height, :width]
    radius2 = ((x + 0.5 - width / 2) ** 2 + (y + 0.5 - height / 2) ** 2) / (width**2 + height**2) * 4
    picture = picture * (1 - 0.13 * radius2 - 0.05 * radius2**2)[..., None]
    picture = picture * (1 + rng.normal(0, 0.02)) * (1 + rng.normal(0, 0.008, 3))
    sigma = np.sqrt(0.004**2 + 0.010**2 * np.clip(picture, 0, 1))
    picture = (
        picture + sigma * rng.normal(size=picture.shape[:2])[..., None] + 0.5 * sigma * rng.normal(size=picture.shape)
    )
    return np.clip(picture * 255 + 0.5, 0, 255).astype(np.uint8)


def _sexagesimal(degrees: float) -> tuple[IFDRational, IFDRational, IFDRational]:
    degrees = abs(degrees)
    minutes = degrees % 1 * 60
    return IFDRational(int(degrees)), IFDRational(int(minutes)), IFDRational(round(minutes % 1 * 60 * 10000), 10000)


def save_photo(picture: np.ndarray, shot: Shot, path: Path) -> None:
    """Write a JPEG with the EXIF and XMP that a DJI camera writes."""
    image = Image.fromarray(picture)
    exif = Image.Exif()
    exif.update(
        {
            270: DESCRIPTION,
            271: "DJI",
            272: MODEL,
            274: 1,
            305: "CU-Recon sample site",
            306: shot.time.strftime("%Y:%m:%d %H:%M:%S"),
            33432: "CC0 1.0",
        }
    )
    exif.get_ifd(0x8769).update(
        {
            33434: IFDRational(1, 500),
            33437: IFDRational(28, 10),
            34855: 100,
            36867: shot.time.strftime("%Y:%m:%d %H:%M:%S"),
            36868: shot.time.strftime("%Y:%m:%d %H:%M:%S"),
            36881: "+08:00",
            37386: IFDRational(round(shot.focal_mm * 100), 100),
            40962: image.width,
            40963: image.height,
            41989: shot.focal_35mm,
        }
    )
    exif.get_ifd(0x8825).update(
        {
            0: b"\x02\x03\x00\x00",
            1: "N",
            2: _sexagesimal(shot.latitude),
            3: "E",
            4: _sexagesimal(shot.longitude),
            5: b"\x00",
            6: IFDRational(round(shot.altitude * 1000), 1000),
            18: "WGS-84",
        }
    )
    above = shot.altitude - ALTITUDE if shot.relative_altitude is None else shot.relative_altitude
    fields = {
        "GpsLatitude": f"{shot.latitude:+.8f}",
        "GpsLongitude": f"{shot.longitude:+.8f}",
        "AbsoluteAltitude": f"{shot.altitude:+.2f}",
        "RelativeAltitude": f"{above:+.2f}",
        "GimbalRollDegree": f"{shot.roll:+.2f}",
        "GimbalYawDegree": f"{(shot.yaw + 180) % 360 - 180:+.2f}",
        "GimbalPitchDegree": f"{shot.pitch:+.2f}",
        "FlightRollDegree": "+0.40",
        "FlightYawDegree": f"{(shot.yaw + 180) % 360 - 180:+.2f}",
        "FlightPitchDegree": "-1.10",
    } | shot.xmp
    text = "\n   ".join(f'drone-dji:{key}="{value}"' for key, value in fields.items())
    image.save(
        path, quality=JPEG_QUALITY, subsampling="4:2:0", optimize=True, exif=exif, xmp=_XMP.format(fields=text).encode()
    )
