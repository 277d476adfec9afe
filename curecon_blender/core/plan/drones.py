# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Common drones and their cameras, as their makers' data sheets give them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Drone:
    """A drone with its main camera. Lengths of the sensor and the lens in millimetres, the picture in pixels.

    `pitch` is how far the gimbal turns, in degrees, -90 straight down. `interval` is the least time between two photos
    in seconds, `minutes` what the maker promises of one battery, `waypoints` how many the flight app takes at once.
    `wpml` is DJI's number of the drone in its mission files, 0 where none is known.
    """

    name: str
    sensor: tuple[float, float]
    focal: float
    picture: tuple[int, int]
    interval: float = 2.0
    pitch: tuple[float, float] = (-90.0, 30.0)
    minutes: float
    waypoints: int = 99
    wpml: int = 0

    @property
    def focal_px(self) -> float:
        """Focal length in pixels."""
        return self.focal / self.sensor[0] * self.picture[0]

    def pixel_at(self, distance: float) -> float:
        """Millimetres that a pixel covers on a surface `distance` metres away."""
        return distance * 1000 / self.focal_px

    def distance_for(self, pixel: float) -> float:
        """Metres at which a pixel covers `pixel` millimetres."""
        return pixel * self.focal_px / 1000

    def footprint(self, distance: float) -> tuple[float, float]:
        """Width and height in metres of what a photo shows of a surface that it faces."""
        return distance * self.picture[0] / self.focal_px, distance * self.picture[1] / self.focal_px


_HALF_INCH, _SMALL, _LARGE = (6.4, 4.8), (6.17, 4.55), (9.6, 7.2)
_INCH, _FOUR_THIRDS = (13.2, 8.8), (17.3, 13.0)
_12MP, _20MP, _M43 = (4000, 3000), (5472, 3648), (5280, 3956)

DRONES: dict[str, Drone] = {
    "mini2": Drone(name="DJI Mini 2", sensor=_SMALL, focal=4.49, picture=_12MP, pitch=(-90, 20), minutes=31),
    "mini3": Drone(name="DJI Mini 3", sensor=_LARGE, focal=6.72, picture=_12MP, pitch=(-90, 60), minutes=38),
    "mini3pro": Drone(name="DJI Mini 3 Pro", sensor=_LARGE, focal=6.72, picture=_12MP, pitch=(-90, 60), minutes=34,
                      wpml=97),
    "mini4pro": Drone(name="DJI Mini 4 Pro", sensor=_LARGE, focal=6.72, picture=_12MP, pitch=(-90, 60), minutes=34,
                      wpml=68),
    "spark": Drone(name="DJI Spark", sensor=_SMALL, focal=4.49, picture=(3968, 2976), pitch=(-85, 0), minutes=16),
    "mavicair2": Drone(name="DJI Mavic Air 2", sensor=_HALF_INCH, focal=4.5, picture=_12MP, pitch=(-90, 24),
                       minutes=34),
    "air2s": Drone(name="DJI Air 2S", sensor=_INCH, focal=8.38, picture=_20MP, pitch=(-90, 24), minutes=31),
    "air3": Drone(name="DJI Air 3", sensor=_LARGE, focal=6.72, picture=(4032, 3024), pitch=(-90, 60), minutes=46),
    "mavicpro": Drone(name="DJI Mavic Pro", sensor=_SMALL, focal=4.73, picture=_12MP, minutes=27),
    "mavic2pro": Drone(name="DJI Mavic 2 Pro", sensor=_INCH, focal=10.26, picture=_20MP, minutes=31),
    "mavic2zoom": Drone(name="DJI Mavic 2 Zoom, at its widest", sensor=_SMALL, focal=4.39, picture=_12MP, minutes=31),
    "mavic2ea": Drone(name="DJI Mavic 2 Enterprise Advanced", sensor=_HALF_INCH, focal=4.5, picture=(8000, 6000),
                      minutes=31),
    "mavic3": Drone(name="DJI Mavic 3, Mavic 3 Pro", sensor=_FOUR_THIRDS, focal=12.29, picture=_M43, pitch=(-90, 35),
                    minutes=43),
    "mavic3e": Drone(name="DJI Mavic 3 Enterprise", sensor=_FOUR_THIRDS, focal=12.29, picture=_M43, interval=0.7,
                     pitch=(-90, 35), minutes=45, waypoints=200, wpml=77),
    "phantom3": Drone(name="DJI Phantom 3", sensor=_SMALL, focal=3.61, picture=_12MP, minutes=23),
    "phantom4": Drone(name="DJI Phantom 4", sensor=_SMALL, focal=3.61, picture=_12MP, minutes=28),
    "phantom4pro": Drone(name="DJI Phantom 4 Pro", sensor=_INCH, focal=8.8, picture=_20MP, minutes=30),
    "phantom4rtk": Drone(name="DJI Phantom 4 RTK", sensor=_INCH, focal=8.8, picture=_20MP, interval=2.5, minutes=30),
    "inspire2x5s": Drone(name="DJI Inspire 2 with X5S, 15 mm", sensor=_FOUR_THIRDS, focal=15.0, picture=_M43,
                         minutes=27),
    "m30": Drone(name="DJI Matrice 30", sensor=_HALF_INCH, focal=4.5, picture=_12MP, pitch=(-90, 35), minutes=41,
                 waypoints=200, wpml=67),
    "m3d": Drone(name="DJI Matrice 3D", sensor=_FOUR_THIRDS, focal=12.29, picture=_M43, pitch=(-90, 35), minutes=50,
                 waypoints=200, wpml=91),
    "m350p1": Drone(name="DJI Matrice 350 with P1, 35 mm", sensor=(35.9, 24.0), focal=35.0, picture=(8192, 5460),
                    interval=0.7, minutes=55, waypoints=200, wpml=89),
    "evo2pro": Drone(name="Autel EVO II Pro", sensor=_INCH, focal=10.57, picture=_20MP, minutes=40),
    "evolite": Drone(name="Autel EVO Lite+", sensor=_INCH, focal=10.57, picture=_20MP, pitch=(-90, 10), minutes=40),
    "anafi": Drone(name="Parrot Anafi", sensor=(5.92, 4.45), focal=4.0, picture=(5344, 4016), pitch=(-90, 90),
                   minutes=25),
    "skydio2": Drone(name="Skydio 2+", sensor=_SMALL, focal=3.7, picture=(4056, 3040), pitch=(-90, 45), minutes=27),
}
