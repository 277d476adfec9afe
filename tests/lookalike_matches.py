# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What matching finds of buildings whose sides look alike, without drawing them: a database of features and matches.

The wall of one side matches that of another as if it were the same; the ground before it does not. Of the ways in which
two photos match, verification takes the one with the most matches: where they look from far apart, that is a false one.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap

from curecon_blender.core.base.records import Gimbal, Photo

WIDTH, HEIGHT, FOCAL = 480, 360, 420.0
RADIUS, TALL, ORBIT = 10.0, 6.0, 22.0  # metres
IN_BAY = 100  # features of the wall
MOST_TURNED = 50.0  # degrees between the directions from which no feature matches any more


@dataclass(frozen=True, kw_only=True)
class Ring:
    """Photos once round a building of equal bays, and their true places (N,3)."""

    photos: tuple[Photo, ...]
    places: np.ndarray


def write_ring(database: Path, count: int, bays: int, *, gimbal: bool = False, alike: bool = True) -> Ring:
    """Write the features and verified matches of `count` photos of a round building with so many bays."""
    rng = np.random.default_rng(5)
    pattern = np.stack([rng.uniform(0, 1, IN_BAY), rng.uniform(0.3, TALL, IN_BAY)], axis=1)
    around = (np.arange(bays)[:, None] + pattern[:, 0]).ravel() * 2 * np.pi / bays
    wall = np.stack([RADIUS * np.cos(around), RADIUS * np.sin(around), np.tile(pattern[:, 1], bays)], axis=1)
    angle, far = rng.uniform(0, 2 * np.pi, 300), rng.uniform(RADIUS + 1, ORBIT - 2, 300)
    ground = np.stack([far * np.cos(angle), far * np.sin(angle), rng.uniform(0, 0.5, 300)], axis=1)
    points = np.concatenate([wall, ground])
    normals = np.concatenate([wall * [1, 1, 0] / RADIUS, np.tile([0.0, 0, 1], (len(ground), 1))])
    photos, places, seen = [], [], []
    with pycolmap.Database.open(database) as opened:
        camera = pycolmap.Camera.create_from_model_name(1, "SIMPLE_RADIAL", FOCAL, WIDTH, HEIGHT)
        camera.has_prior_focal_length = True
        camera_id = opened.write_camera(camera)
        rig = pycolmap.Rig()
        rig.add_ref_sensor(pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera_id))
        rig_id = opened.write_rig(rig)
        for i in range(count):
            turn = 2 * np.pi * i / count
            place = np.array([ORBIT * np.cos(turn), ORBIT * np.sin(turn), 6 + 0.5 * np.sin(2 * i)])
            forward = np.array([0, 0, 1.5]) - place
            forward /= np.linalg.norm(forward)
            right = np.cross(forward, [0, 0, 1]) / np.linalg.norm(np.cross(forward, [0, 0, 1]))
            local = (points - place) @ np.stack([right, np.cross(forward, right), forward]).T
            pixels = local[:, :2] / local[:, 2:] * FOCAL + [WIDTH / 2, HEIGHT / 2]
            pixels += rng.normal(0, 0.4, (len(points), 2))
            towards = place - points
            facing = (normals * towards).sum(1) > 0.3 * np.linalg.norm(towards, axis=1)
            facing[len(wall):] = (ground * [1, 1, 0] @ place) > 0.5 * ORBIT * RADIUS  # the rest is behind the building
            visible = facing & (local[:, 2] > 0) & (pixels > 0).all(1) & (pixels < [WIDTH, HEIGHT]).all(1)
            held = Gimbal(yaw=float(np.degrees(np.arctan2(forward[0], forward[1]))) + 3 * np.sin(i),
                          pitch=float(np.degrees(np.arcsin(forward[2]))), roll=0.0)
            name = f"photo_{i:02d}.jpg"
            photos.append(Photo(name=name, path=Path(name), width=WIDTH, height=HEIGHT, camera="drone",
                                focal_px=FOCAL, gimbal=held if gimbal else None))
            places.append(place)
            seen.append(np.flatnonzero(visible))
            image = pycolmap.Image(name=name, camera_id=camera_id)
            image.image_id = opened.write_image(image)
            frame = pycolmap.Frame()
            frame.rig_id = rig_id
            frame.add_data_id(image.data_id)
            opened.write_frame(frame)
            opened.write_keypoints(image.image_id, pixels[visible].astype(np.float32))
        for i in range(count):
            for j in range(i + 1, count):
                turn = (j - i) * 360 / count
                walls = np.where(seen[j] < len(wall), seen[j], -2)
                ways = [_common(seen[i], seen[j], turn, rng)]
                if alike:  # as if the second photo looked at the bays so many before
                    ways += [_common(_walls(seen[i], len(wall), bay * IN_BAY), walls, turn - bay * 360 / bays, rng)
                             for bay in range(1, bays)]
                matches = max(ways, key=len)
                if len(matches) >= 15:
                    geometry = pycolmap.TwoViewGeometry()
                    geometry.config = pycolmap.TwoViewGeometryConfiguration.CALIBRATED
                    geometry.inlier_matches = matches
                    opened.write_two_view_geometry(i + 1, j + 1, geometry)
    return Ring(photos=tuple(photos), places=np.array(places))


def _walls(seen: np.ndarray, wall: int, shift: int) -> np.ndarray:
    """What a photo sees of the wall, taken for what stands some bays on; -1 for the ground."""
    return np.where(seen < wall, (seen + shift) % wall, -1)


def _common(first: np.ndarray, second: np.ndarray, turn: float, rng: np.random.Generator) -> np.ndarray:
    """Matches (K,2) of what both photos see: the fewer, the more degrees apart they look at it from."""
    _, i, j = np.intersect1d(first, second, return_indices=True)
    known = (first[i] >= 0) & (rng.random(len(i)) < 1 - abs((turn + 180) % 360 - 180) / MOST_TURNED)
    return np.stack([i[known], j[known]], axis=1).astype(np.uint32)
