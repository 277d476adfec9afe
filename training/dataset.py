# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""From rendered scenes to training samples: a reference with its best sources, scored and cropped alike."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import torch

from curecon_blender.core.network.homographies import mean_disparity
from curecon_blender.core.views.scores import depth_range, matching_score, nearest_supported
from curecon_blender.core.views.sparse_points import points_in
from training.generator import Scene

MOST_PIXELS = 560  # a sweep over more asks for so many hypotheses that one sample would take the time of three


@dataclass(frozen=True)
class Sample:
    """One reference (view 0) with N sources. Arrays as the network takes them, without the batch dimension.

    `images` (V,H,W,3) uint8; `K` (V,3,3) and `cam_from_world` (V,3,4) float32, pixel centres at .5; `scores` (N,)
    matching scores; `depth` (H,W) float32 z-depth in metres, 0 where there is nothing (where it is not known, if the
    sample is not `complete`); `near`, `far` bound the sweep; `points` (P,4) float32: column, row and z-depth of the
    sparse points in the reference, and whether it has matched them.
    """

    images: np.ndarray
    K: np.ndarray
    cam_from_world: np.ndarray
    scores: np.ndarray
    depth: np.ndarray
    near: float
    far: float
    points: np.ndarray
    complete: bool = True


def source_scores(scene: Scene, reference: int) -> list[tuple[int, float]]:
    """The other views with their S_i (Algorithm 1), best first; views that share no sparse point are left out."""
    centres = [-pose[:, :3].T @ pose[:, 3] for pose in scene.cam_from_world]
    scored = []
    for view in range(len(centres)):
        shared = scene.points[scene.visible[reference] & scene.visible[view]]
        if view != reference and len(shared):
            scored.append((view, matching_score(centres[reference], centres[view], shared)))
    return sorted([s for s in scored if s[1] > 0], key=lambda s: -s[1])


def sparse_depth_range(scene: Scene, reference: int) -> tuple[float, float]:
    """(near, far) of a view from the sparse points, as in use."""
    pose, visible = scene.cam_from_world[reference], scene.visible[reference]
    depths = scene.points[visible] @ pose[2, :3] + pose[2, 3]
    height, width = scene.depth.shape[1:]
    inside = points_in(scene.points, visible, scene.K[reference], pose, (width, height))
    return depth_range(depths[depths > 0], nearest_supported(inside, width))


def _sweep_pixels(
    intrinsics: list[np.ndarray], cam_from_world: np.ndarray, near: float, far: float, size: tuple[int, int]
) -> float:
    """Pixels of a source that the sweep passes over, in the mean of the sources."""
    K, poses = (torch.from_numpy(np.asarray(a, np.float32))[None] for a in (np.stack(intrinsics), cam_from_world))
    return float(mean_disparity(K, poses, torch.tensor([near]), torch.tensor([far]), size))


def training_sample(scene: Scene, rng: np.random.Generator, sources: int, size: tuple[int, int]) -> Sample | None:
    """A random reference, its sources and a crop of `size` (W, H); None where too few sources see it.

    Every view is scaled by one random factor and cropped around one surface point, so that a small sample shows the
    detail and the disparities of a large photo.
    """
    reference = int(rng.integers(len(scene.images)))
    scored = source_scores(scene, reference)
    if len(scored) < sources:
        return None
    # Mostly the best sources; at times one of them is dropped for a worse one, as real overlaps have it.
    if len(scored) > sources and rng.random() < 0.3:
        del scored[int(rng.integers(sources))]
    scored = scored[:sources]
    near, far = sparse_depth_range(scene, reference)
    near, far = near * rng.uniform(0.85, 1.05), far * rng.uniform(0.95, 1.3)
    height, width = scene.depth.shape[1:]
    scale = rng.uniform(max(size[0] / width, size[1] / height), 1.0)
    scaled = (max(size[0], round(width * scale)), max(size[1], round(height * scale)))
    views = [reference, *(view for view, _ in scored)]
    depth = cv2.resize(scene.depth[reference], scaled, interpolation=cv2.INTER_NEAREST_EXACT)
    stretch = np.diag([scaled[0] / width, scaled[1] / height, 1.0])
    corner = np.array([rng.integers(scaled[0] - size[0] + 1), rng.integers(scaled[1] - size[1] + 1)])
    crop = depth[corner[1] : corner[1] + size[1], corner[0] : corner[0] + size[0]]
    rows, columns = np.nonzero(crop)
    if len(rows) < 0.3 * crop.size:
        return None
    middle = np.argmin((rows - size[1] / 2) ** 2 + (columns - size[0] / 2) ** 2)
    pixel = np.array([columns[middle] + corner[0] + 0.5, rows[middle] + corner[1] + 0.5, 1.0])
    K_ref, pose_ref = stretch @ scene.K[reference], scene.cam_from_world[reference]
    ray = np.linalg.inv(K_ref) @ pixel * crop[rows[middle], columns[middle]]
    anchor = pose_ref[:, :3].T @ (ray - pose_ref[:, 3])
    images, intrinsics = [], []
    for view in views:
        K = stretch @ scene.K[view]
        if view != reference:
            u, v, z = K @ (scene.cam_from_world[view] @ np.append(anchor, 1.0))
            target = np.array([u, v]) / z - np.array(size) / 2 if z > 0 else np.zeros(2)
            corner = np.clip(np.round(target), 0, np.array(scaled) - size).astype(int)
        image = cv2.resize(scene.images[view], scaled, interpolation=cv2.INTER_AREA)
        images.append(image[corner[1] : corner[1] + size[1], corner[0] : corner[0] + size[0]])
        K[:2, 2] -= corner
        intrinsics.append(K)
    for axis in (1, 2):  # mirror all views: a mirrored world, which a negative focal length describes
        if rng.random() < 0.5:
            images = [np.flip(image, axis - 1) for image in images]
            crop = np.flip(crop, axis - 1)
            mirror = np.eye(3)
            mirror[2 - axis, 2 - axis], mirror[2 - axis, 2] = -1, size[2 - axis]
            intrinsics = [mirror @ K for K in intrinsics]
    if _sweep_pixels(intrinsics, scene.cam_from_world[views], near, far, size) > MOST_PIXELS:
        return None
    return Sample(
        np.stack(images), np.stack(intrinsics).astype(np.float32), scene.cam_from_world[views].astype(np.float32),
        np.array([score for _, score in scored], np.float32), crop, near, far,
        points_in(scene.points, scene.visible[reference], intrinsics[0], pose_ref, size), scene.complete,
    )
