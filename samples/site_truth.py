# SPDX-License-Identifier: GPL-3.0-or-later
"""The truth beside the photos: exact poses as a COLMAP text model, and a cloud of the visible surfaces."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from site_flight import ALTITUDE, LATITUDE, LONGITUDE, Shot
from tulou_surroundings import POND_CENTRE, POND_LEVEL, POND_RADIUS

CROP_RADIUS = 30.0
VOXEL = 0.10
UNIT = 0.004
MIN_VIEWS = 3


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """Unit quaternion (w, x, y, z), w >= 0, of a rotation matrix, in double precision."""
    m = rotation
    k = np.array(
        [
            [m[0, 0] - m[1, 1] - m[2, 2], 0, 0, 0],
            [m[0, 1] + m[1, 0], m[1, 1] - m[0, 0] - m[2, 2], 0, 0],
            [m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], m[2, 2] - m[0, 0] - m[1, 1], 0],
            [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], m.trace()],
        ]
    )
    values, vectors = np.linalg.eigh(k / 3)
    q = vectors[[3, 0, 1, 2], np.argmax(values)]
    return q if q[0] >= 0 else -q


def write_model(shots: list[Shot], camera: str, folder: Path) -> None:
    """cameras.txt, images.txt and an empty points3D.txt as COLMAP writes them, and origin.json. `camera` is its line
    in cameras.txt, after the number."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cameras.txt").write_text(
        "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
        f"1 {camera}\n"
    )
    lines = [
        "# Image list with two lines of data per image:",
        "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME",
        "#   POINTS2D[] as (X, Y, POINT3D_ID)",
    ]
    for number, shot in enumerate(shots, 1):
        values = [*quaternion(shot.cam_from_world[:3, :3]), *shot.cam_from_world[:3, 3]]
        lines += [f"{number} {' '.join(f'{v:.12g}' for v in values)} 1 {shot.name}", ""]
    (folder / "images.txt").write_text("\n".join(lines) + "\n")
    (folder / "points3D.txt").write_text(
        "# 3D point list with one line of data per point:\n"
        "#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n"
    )
    origin = {"latitude": LATITUDE, "longitude": LONGITUDE, "altitude": ALTITUDE}
    (folder / "origin.json").write_text(json.dumps(origin, indent=2) + "\n")


def back_project(depth: np.ndarray, focal: float, cam_from_world: np.ndarray) -> np.ndarray:
    """Site-frame points (N, 3) of the pixels of a z-depth map (metres) that show a surface."""
    height, width = depth.shape
    y, x = np.nonzero(depth > 0)
    z = depth[y, x].astype(np.float64)
    camera = np.stack([(x + 0.5 - width / 2) / focal * z, (y + 0.5 - height / 2) / focal * z, z], 1)
    return (camera - cam_from_world[:3, 3]) @ cam_from_world[:3, :3]


def count_views(points: np.ndarray, shots: list[Shot], depths: list[np.ndarray], focal: float) -> np.ndarray:
    """How many photos see each point (N, 3): one of the 3x3 pixels about it has its depth within 5 cm."""
    views = np.zeros(len(points), np.uint8)
    for shot, depth in zip(shots, depths, strict=True):
        height, width = depth.shape
        camera = points @ shot.cam_from_world[:3, :3].T + shot.cam_from_world[:3, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            column = np.floor(camera[:, 0] / camera[:, 2] * focal + width / 2)
            row = np.floor(camera[:, 1] / camera[:, 2] * focal + height / 2)
        inside = (camera[:, 2] > 0) & (column >= 1) & (column < width - 1) & (row >= 1) & (row < height - 1)
        index = np.nonzero(inside)[0]
        c, r, z = column[index].astype(int), row[index].astype(int), camera[index, 2]
        nearest = np.full(len(index), np.inf)
        for dr in (-1, 0, 1):
            for dc in (-1, 0, 1):
                nearest = np.minimum(nearest, np.abs(depth[r + dr, c + dc] - z))
        views[index] += nearest < 0.05
    return views


def make_cloud(shots: list[Shot], depths: list[np.ndarray], focal: float) -> dict[str, np.ndarray]:
    """Surface points seen in at least MIN_VIEWS photos, one a voxel, within CROP_RADIUS, without the pond."""
    keys, points = np.zeros(0, np.int64), np.zeros((0, 3))
    for shot, depth in zip(shots, depths, strict=True):
        new = back_project(depth, focal, shot.cam_from_world)
        pond = (np.linalg.norm(new[:, :2] - POND_CENTRE, axis=1) < POND_RADIUS + 1) & (new[:, 2] < POND_LEVEL + 0.1)
        new = new[(np.hypot(new[:, 0], new[:, 1]) < CROP_RADIUS) & ~pond]
        cell = np.floor(new / VOXEL).astype(np.int64) + 1024
        keys = np.concatenate([keys, (cell[:, 0] * 2048 + cell[:, 1]) * 2048 + cell[:, 2]])
        points = np.concatenate([points, new])
        keys, first = np.unique(keys, return_index=True)
        points = points[first]
    views = count_views(points, shots, depths, focal)
    keep = views >= MIN_VIEWS
    return {
        "points": np.ascontiguousarray(np.round(points[keep] / UNIT).astype(np.int16).T),  # by axis it packs smaller
        "unit": np.float64(UNIT),
        "views": views[keep],
        "voxel": np.float64(VOXEL),
        "radius": np.float64(CROP_RADIUS),
    }
