# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""From a sparse model to views ready for multi-view stereo: undistorted, with sources, scores and depth ranges."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import numpy as np
import pycolmap

from ..base import images
from ..base.errors import SparseError
from ..base.language import Text
from ..base.messages import Reporter
from ..base.options import Options
from ..base.records import Component, PhotoSet, View
from ..sparse.models import lens_of, read_model
from ..sparse.record import read_frame
from . import sparse_points
from .masks import write_mask
from .scores import depth_range, matching_score, nearest_supported
from .undistortion import undistort

OVERLAPS = 12  # views kept for fusion's confirmation, by shared sparse points
MIN_SHARED_POINTS = 5
MIN_POINTS = 12  # a photo with fewer sparse points has no trustworthy depth range


def prepare_views(photo_set: PhotoSet, options: Options, workspace: Path, reporter: Reporter) -> list[Component]:
    """Undistort every registered photo into `undistorted/` and describe it as a View, component by component.

    Raises SparseError when no photo has a source view.
    """
    photos = {photo.name: photo for photo in photo_set.photos}
    folders = sorted((p for p in (workspace / "sparse").iterdir() if p.name.isdigit()), key=lambda p: int(p.name))
    models = [read_model(folder) for folder in folders]
    total = sum(model.num_reg_images() for model in models)
    done = 0
    components = []
    for index, (folder, model) in enumerate(zip(folders, models, strict=True)):
        neighbours = _neighbours(model)
        points = np.array([point.xyz for point in model.points3D.values()]).reshape(-1, 3)
        number = {point_id: row for row, point_id in enumerate(model.points3D)}
        views = []
        for image_id in sorted(model.reg_image_ids(), key=lambda i: model.images[i].name):
            image = model.images[image_id]
            photo = photos[image.name]
            done += 1
            reporter.progress(done, total)
            depths = _sparse_depths(model, image)
            if len(depths) < MIN_POINTS:
                reporter.warning(
                    Text("{} shares too few points with other photos; it gets no depth.", photo.path.name), photo.name
                )
                continue
            picture = f"undistorted/{image.name}.jpg"
            camera = model.cameras[image.camera_id]
            rgb, K = undistort(images.read_rgb(photo.path), camera, options.image_size)
            images.write_jpeg(workspace / picture, rgb)
            mask = write_mask(workspace, photo, camera, options.image_size)
            pose = image.cam_from_world().matrix()
            matched = np.zeros(len(points), bool)
            matched[[number[p.point3D_id] for p in image.get_observation_points2D()]] = True
            inside = sparse_points.points_in(points, matched, K, pose, (rgb.shape[1], rgb.shape[0]))
            sparse_points.write(workspace, image.name, inside)
            near, far = depth_range(depths, nearest_supported(inside, rgb.shape[1]))
            scored = [(model.images[i].name, score) for i, score, _ in neighbours[image_id] if score > 0]
            shared = sorted(neighbours[image_id], key=lambda n: -n[2])[:OVERLAPS]
            views.append(View(
                name=image.name, image=picture, width=rgb.shape[1], height=rgb.shape[0], K=K,
                cam_from_world=pose, near=near, far=far,
                sources=tuple(sorted(scored, key=lambda s: -s[1])[: max(options.source_views, 1)]),
                overlaps=tuple(model.images[i].name for i, _, _ in shared), original=str(photo.path),
                points=len(inside), lens=lens_of(camera), photo_size=(camera.width, camera.height),
                photo_turn=images.orientation(photo.path), mask=mask,
            ))
        kept = {view.name for view in views}
        components.append(Component(
            index=index, sparse=f"sparse/{folder.name}", cloud="cloud.ply" if index == 0 else f"cloud_{index}.ply",
            frame=read_frame(folder), views=tuple(_only_known(view, kept) for view in views),
        ))
    if not any(view.sources for component in components for view in component.views):
        raise SparseError(
            "No two photos see enough of the same points for depth.",
            remedy="Take photos that overlap by at least 70 %, then run it again.",
        )
    return components


def _only_known(view: View, names: set[str]) -> View:
    """The view without sources and overlaps that have been left out."""
    fields = {**vars(view), "sources": tuple(s for s in view.sources if s[0] in names),
              "overlaps": tuple(o for o in view.overlaps if o in names)}
    return View(**fields)


def _sparse_depths(model: pycolmap.Reconstruction, image: pycolmap.Image) -> np.ndarray:
    """z-depths (P,) of the image's sparse points."""
    points = np.array([model.points3D[p.point3D_id].xyz for p in image.get_observation_points2D()]).reshape(-1, 3)
    pose = image.cam_from_world().matrix()
    depths = points @ pose[2, :3] + pose[2, 3]
    positive: np.ndarray = depths[depths > 0]
    return positive


def _neighbours(model: pycolmap.Reconstruction) -> dict[int, list[tuple[int, float, int]]]:
    """For each image (other image, S_i, shared points) of all that share at least MIN_SHARED_POINTS."""
    shared: dict[tuple[int, int], list[int]] = defaultdict(list)
    for point_id, point in model.points3D.items():
        seen_by = sorted({element.image_id for element in point.track.elements})
        for position, first in enumerate(seen_by):
            for second in seen_by[position + 1 :]:
                shared[first, second].append(point_id)
    centres = {i: model.images[i].projection_center() for i in model.reg_image_ids()}
    found: dict[int, list[tuple[int, float, int]]] = defaultdict(list)
    for (first, second), ids in shared.items():
        if len(ids) >= MIN_SHARED_POINTS:
            points = np.array([model.points3D[i].xyz for i in ids])
            score = matching_score(centres[first], centres[second], points)
            found[first].append((second, score, len(ids)))
            found[second].append((first, score, len(ids)))
    return found
