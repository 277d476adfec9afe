# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""From marks in photos to places and back: lenses, triangulation, and in which photo a point is best marked next.

numpy alone: Blender predicts with it while the user marks. Rays (N,2) are x/z and y/z in camera coordinates.
"""

from __future__ import annotations

import numpy as np

from ..base.records import Lens

SMALLEST_ANGLE = 1.0  # degrees between the rays of two marks, below which they tell no distance
ALIKE = 4.0  # degrees; a photo from nearer to one that is earlier in the walk adds little
WAY, BLOCKING = 0.01, 3  # so many points within this share of the distance about a ray are in its way
MARGIN = 0.02  # of the photo's size: at its very edge nobody marks well


def to_pixels(lens: Lens, rays: np.ndarray) -> np.ndarray:
    """(N,2) rays to (N,2) pixels of the photo, pixel centres at .5."""
    x, y = rays[:, 0], rays[:, 1]
    squared = x * x + y * y
    radial = 1 + squared * (lens.k1 + squared * (lens.k2 + squared * lens.k3))
    along_x = x * radial + 2 * lens.p1 * x * y + lens.p2 * (squared + 2 * x * x)
    along_y = y * radial + lens.p1 * (squared + 2 * y * y) + 2 * lens.p2 * x * y
    return np.stack([lens.f * along_x + lens.cx, lens.f * lens.aspect * along_y + lens.cy], axis=1)


def to_rays(lens: Lens, pixels: np.ndarray) -> np.ndarray:
    """The inverse of `to_pixels`, by Newton's method; NaN where the lens has no ray for a pixel."""
    target = np.asarray(pixels, np.float64)
    size = np.array([lens.f, lens.f * lens.aspect])
    rays, step = (target - [lens.cx, lens.cy]) / size, 1e-6
    for _ in range(20):
        at = to_pixels(lens, rays)
        across, down = ((to_pixels(lens, rays + axis) - at) / step for axis in ([step, 0.0], [0.0, step]))
        off = target - at
        area = across[:, 0] * down[:, 1] - across[:, 1] * down[:, 0]
        with np.errstate(all="ignore"):
            rays = rays + np.stack([
                (off[:, 0] * down[:, 1] - off[:, 1] * down[:, 0]) / area,
                (across[:, 0] * off[:, 1] - across[:, 1] * off[:, 0]) / area,
            ], axis=1)
    with np.errstate(all="ignore"):
        missed = ~(np.abs(to_pixels(lens, rays) - target).max(axis=1) < 0.01)
    rays[missed] = np.nan
    return rays


def seen(cam_from_world: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rays (N,2) of a place (3,) in cameras (N,3,4), and its z-depths (N,); NaN rays behind a camera."""
    local = cam_from_world[:, :, :3] @ place + cam_from_world[:, :, 3]
    depth = local[:, 2]
    rays = np.full((len(local), 2), np.nan)
    front = depth > 1e-9
    rays[front] = local[front, :2] / depth[front, None]
    return rays, depth


def triangulate(cam_from_world: np.ndarray, rays: np.ndarray, sigmas: np.ndarray) -> np.ndarray | None:
    """The place (3,) that cameras (N,3,4) see along rays (N,2) with sigmas (N,) of a ray; None where fewer than two
    rays tell it, or all of them run side by side."""
    good = np.isfinite(rays).all(axis=1)
    cameras, rays, sigmas = cam_from_world[good], rays[good], sigmas[good]
    if len(rays) < 2:
        return None
    turns = cameras[:, :, :3]
    centres = -np.einsum("nji,nj->ni", turns, cameras[:, :, 3])
    directions = np.einsum("nji,nj->ni", turns, np.column_stack([rays, np.ones(len(rays))]))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    if (directions @ directions.T).min() > np.cos(np.radians(SMALLEST_ANGLE)):
        return None
    # Nearest to all rays in space; then, from there, where the marks fit best.
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    place = np.linalg.solve(across.sum(axis=0), (across @ centres[:, :, None]).sum(axis=0))[:, 0]
    for _ in range(10):
        found, depths = seen(cameras, place)
        if not np.isfinite(found).all():
            return None
        slopes = (turns[:, :2] - found[:, :, None] * turns[:, 2:]) / depths[:, None, None] / sigmas[:, None, None]
        off = (rays - found) / sigmas[:, None]
        step = np.linalg.lstsq(slopes.reshape(-1, 3), off.ravel(), rcond=None)[0]
        place = place + step
        if np.linalg.norm(step) < 1e-9 * np.linalg.norm(place - centres[0]):
            break
    return np.asarray(place)


def best_first(
    cam_from_world: np.ndarray, lenses: list[Lens], sizes: np.ndarray, place: np.ndarray,
    around: np.ndarray | None = None,
) -> np.ndarray:
    """Numbers of the cameras (N,3,4) in whose photos of sizes (N,2) a place (3,) can be marked, best first: seen large
    and near the middle. Those that look from almost where an earlier one does come later, and at the end those before
    which points of the site (M,3), evenly thinned, stand in the way."""
    rays, depths = seen(cam_from_world, place)
    pixels = np.array([to_pixels(lens, ray[None])[0] for lens, ray in zip(lenses, rays, strict=True)]).reshape(-1, 2)
    with np.errstate(invalid="ignore"):
        inside = ((pixels > MARGIN * sizes) & (pixels < (1 - MARGIN) * sizes)).all(axis=1)
    off_middle = np.linalg.norm(pixels / sizes - 0.5, axis=1)
    focal = np.array([lens.f for lens in lenses])
    worth = np.where(inside, depths / focal * (1 + off_middle**2), np.inf)  # world units a pixel
    centres = -np.einsum("nji,nj->ni", cam_from_world[:, :, :3], cam_from_world[:, :, 3])
    views = place - centres
    views /= np.maximum(np.linalg.norm(views, axis=1, keepdims=True), 1e-12)
    walks: tuple[list[int], list[int], list[int]] = [], [], []
    for number in np.argsort(worth)[: int(inside.sum())]:
        if around is not None and _is_hidden(centres[number], place, around):
            walks[2].append(int(number))
        elif walks[0] and (views[walks[0]] @ views[number]).max() > np.cos(np.radians(ALIKE)):
            walks[1].append(int(number))
        else:
            walks[0].append(int(number))
    return np.array([*walks[0], *walks[1], *walks[2]], int)


def _is_hidden(centre: np.ndarray, place: np.ndarray, around: np.ndarray) -> bool:
    """Whether points (M,3) stand between a camera's centre (3,) and a place (3,), well before it."""
    length = float(np.linalg.norm(place - centre))
    direction, offsets = (place - centre) / length, around - centre
    along = offsets @ direction
    between = offsets[(along > 0.05 * length) & (along < 0.93 * length)]
    if not len(between):
        return False
    aside = np.linalg.norm(np.cross(between, direction), axis=1)
    return bool((aside < WAY * length).sum() >= BLOCKING)


def stored_size(size: tuple[int, int], turn: int) -> np.ndarray:
    """The size (2,) of a file whose picture, turned as EXIF says, is of `size`."""
    return np.array(size[::-1] if turn >= 5 else size, float)


def stored(pixels: np.ndarray, size: tuple[int, int], turn: int) -> np.ndarray:
    """Pixels (N,2) of a photo as it is displayed, of `size`, to those of its file, by EXIF's orientation."""
    x, y = pixels[:, 0], pixels[:, 1]
    width, height = size
    columns, rows = {
        1: (x, y), 2: (width - x, y), 3: (width - x, height - y), 4: (x, height - y),
        5: (y, x), 6: (y, width - x), 7: (height - y, width - x), 8: (height - y, x),
    }[turn]
    return np.stack([columns, rows], axis=1)
