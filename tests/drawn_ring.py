# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Photos drawn of a round building of equal bays: its wall repeats from bay to bay, the ground before it does not."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from lookalike_matches import Ring

from curecon_blender.core.base.records import Photo

WIDTH, HEIGHT, FOCAL = 320, 240, 280.0
RADIUS, TALL, ORBIT, UP = 10.0, 6.0, 21.0, 11.0  # metres
SIDE = 1024  # pixels of a texture


def draw_ring(folder: Path, count: int, bays: int, drawn: int) -> Ring:
    """Write the first `drawn` of `count` photos once round the building, without GPS or gimbal."""
    folder.mkdir(parents=True, exist_ok=True)
    wall, ground = _texture(1, 16), _texture(3, 32)
    photos, places = [], []
    for i in range(drawn):
        turn = 2 * np.pi * i / count + 0.05
        place = np.array([ORBIT * np.cos(turn), ORBIT * np.sin(turn), UP + 0.4 * (i % 2)])
        forward = np.array([0, 0, 1.0]) - place
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0, 0, 1]) / np.linalg.norm(np.cross(forward, [0, 0, 1]))
        grey = _draw(np.stack([right, np.cross(forward, right), forward]), place, bays, wall, ground)
        grey += np.random.default_rng(i).normal(0, 2, grey.shape)
        path = folder / f"photo_{i:02d}.png"
        cv2.imwrite(str(path), grey.clip(0, 255).astype(np.uint8))
        photos.append(Photo(name=path.name, path=path, width=WIDTH, height=HEIGHT, camera="drone", focal_px=FOCAL))
        places.append(place)
    return Ring(photos=tuple(photos), places=np.array(places))


def _texture(seed: int, coarsest: int) -> np.ndarray:
    """A texture (SIDE,SIDE) in 0..255 that repeats at its edges."""
    rng = np.random.default_rng(seed)
    total = np.zeros((SIDE, SIDE), np.float32)
    for side in (coarsest * 2**i for i in range(4)):
        coarse = np.pad(rng.random((side, side), np.float32), (0, 1), mode="wrap")
        total += cv2.resize(coarse, (SIDE + SIDE // side,) * 2)[:SIDE, :SIDE]
    return (total - total.min()) / np.ptp(total) * 255


def _draw(rotation: np.ndarray, place: np.ndarray, bays: int, wall: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """Grey (H,W) of a photo with this cam_from_world rotation (3,3), by casting rays."""
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    rays = np.stack([(x - WIDTH / 2) / FOCAL, (y - HEIGHT / 2) / FOCAL, np.ones_like(x)], -1) @ rotation
    a, b = (rays[..., :2] ** 2).sum(-1), rays[..., :2] @ place[:2]
    root = b**2 - a * (place[:2] @ place[:2] - RADIUS**2)
    depth = (-b - np.sqrt(np.maximum(root, 0))) / a
    hit = place + rays * depth[..., None]
    on_wall = (root > 0) & (hit[..., 2] > 0) & (hit[..., 2] < TALL)
    floor = place + rays * np.minimum(-place[2] / np.minimum(rays[..., 2], -1e-3), 200)[..., None]
    around = np.arctan2(hit[..., 1], hit[..., 0]) / (2 * np.pi)
    return np.where(on_wall, _sample(wall, around * bays * SIDE, hit[..., 2] * 90),
                    110 + 0.7 * (_sample(ground, floor[..., 0] * 60, floor[..., 1] * 60) - 128))


def _sample(texture: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return cv2.remap(texture, (u % SIDE).astype(np.float32), (v % SIDE).astype(np.float32), cv2.INTER_LINEAR,
                     borderMode=cv2.BORDER_WRAP)
