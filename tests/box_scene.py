# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A textured box on a plane, ray-cast with numpy: photos, exact depth maps and views.json as the stages leave them.

Metres, Z up: ground at z = 0, the box over |x|, |y| <= 1 up to z = 1.5, cameras on a ring around it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from curecon_blender.core.base.records import Component, Frame, View
from curecon_blender.core.depth.maps import write_depth
from curecon_blender.core.views import record as components

BOX = np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.5]])
WIDTH, HEIGHT, FOCAL = 160, 120, 150.0


def make_view(index: int, count: int, *, radius: float = 6.0, elevation: float = 45.0, arc: float = 360.0) -> View:
    """The index-th of `count` cameras on a ring, looking at the box; the others, nearest first, are its neighbours."""
    K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    azimuth, rise = np.radians(arc * index / count), np.radians(elevation)
    centre = radius * np.array([np.cos(azimuth) * np.cos(rise), np.sin(azimuth) * np.cos(rise), np.sin(rise)])
    forward = (np.array([0, 0, 0.5]) - centre) / np.linalg.norm(np.array([0, 0, 0.5]) - centre)
    right = np.cross(forward, [0, 0, 1]) / np.linalg.norm(np.cross(forward, [0, 0, 1]))
    rotation = np.stack([right, np.cross(forward, right), forward])
    names = [f"photo_{i:02d}.png" for i in range(count)]
    gap = {i: min((i - index) % count, (index - i) % count) if arc == 360 else abs(i - index) for i in range(count)}
    others = sorted((i for i in range(count) if i != index), key=lambda i: (gap[i], i))
    return View(
        name=names[index], image=f"undistorted/{names[index]}", width=WIDTH, height=HEIGHT, K=K,
        cam_from_world=np.column_stack([rotation, -rotation @ centre]), near=0.5 * radius, far=2.5 * radius,
        sources=tuple((names[i], 1.0) for i in others[:4]), overlaps=tuple(names[i] for i in others),
    )


def cast(view: View) -> tuple[np.ndarray, np.ndarray]:
    """Exact z-depth (H,W) float32, 0 where a ray meets nothing within 30 m, and the picture (H,W,3) uint8 RGB."""
    u, v = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(view.K).T @ view.cam_from_world[:, :3]
    with np.errstate(divide="ignore", invalid="ignore"):
        to_planes = (BOX[:, None, None, :] - view.centre) / rays
        enter, leave = to_planes.min(axis=0).max(axis=-1), to_planes.max(axis=0).min(axis=-1)
        ground = -view.centre[2] / rays[..., 2]
    depth = np.where((enter < leave) & (enter > 0), np.minimum(enter, np.where(ground > 0, ground, np.inf)), ground)
    depth[~((depth > 0) & (depth < 30))] = 0
    return depth.astype(np.float32), texture(view.centre + rays * depth[..., None])


def texture(points: np.ndarray) -> np.ndarray:
    """Colour (...,3) uint8 of surface points (...,3): smooth noise that belongs to the place, not to the view."""
    waves = np.array([[[3.1, 1.7, 2.3], [7.9, 5.3, 9.1], [13.7, 17.1, 11.9]],
                      [[2.3, 3.9, 1.1], [9.7, 6.1, 5.9], [15.1, 12.3, 18.7]],
                      [[1.3, 2.9, 3.7], [5.1, 8.3, 7.7], [12.9, 16.3, 14.1]]])
    value = np.sin(points @ np.moveaxis(waves, -1, 0).reshape(3, -1) + np.arange(9)).reshape(*points.shape[:-1], 3, 3)
    colours: np.ndarray = np.clip(127.5 + 42 * value.sum(axis=-1), 0, 255).astype(np.uint8)
    return colours


def surface_distance(points: np.ndarray) -> np.ndarray:
    """Distance (n,) in metres of points (n,3) from the surface of box and ground."""
    outside = np.maximum(np.maximum(BOX[0] - points, points - BOX[1]), 0)
    inside = np.minimum(points - BOX[0], BOX[1] - points).min(axis=1)
    to_box = np.where(inside > 0, inside, np.linalg.norm(outside, axis=1))
    return np.minimum(to_box, np.abs(points[:, 2]))


def write_scene(workspace: Path, views: Sequence[View], *, confidence: float = 0.9) -> Component:
    """A workspace with the views' pictures, cameras and exact depth maps, ready for fusion."""
    write_model(workspace / "sparse" / "0", views)
    (workspace / "undistorted").mkdir(parents=True)
    (workspace / "depth").mkdir()
    names = {view.name for view in views}
    views = tuple(replace(
        view, sources=tuple(s for s in view.sources if s[0] in names),
        overlaps=tuple(name for name in view.overlaps if name in names),
    ) for view in views)
    component = Component(
        index=0, sparse="sparse/0", cloud="cloud.ply", frame=Frame(scale="metres", up="given"), views=views
    )
    for view in views:
        depth, picture = cast(view)
        cv2.imwrite(str(workspace / view.image), picture[..., ::-1])
        write_depth(workspace, view, depth, np.full(depth.shape, confidence, np.float32))
    components.write(workspace, [component])
    return component


def write_model(folder: Path, views: Sequence[View]) -> None:
    """The cameras as a COLMAP text model without points; they all share one."""
    folder.mkdir(parents=True)
    K = views[0].K
    (folder / "cameras.txt").write_text(f"1 PINHOLE {WIDTH} {HEIGHT} {K[0, 0]} {K[1, 1]} {K[0, 2]} {K[1, 2]}\n")
    lines = []
    for number, view in enumerate(views, 1):
        x, y, z, w = Rotation.from_matrix(view.cam_from_world[:, :3]).as_quat()
        numbers = (w, x, y, z, *view.cam_from_world[:, 3])
        lines += [f"{number} {' '.join(f'{n:.17g}' for n in numbers)} 1 {view.name}", ""]
    (folder / "images.txt").write_text("\n".join(lines) + "\n")
    (folder / "points3D.txt").write_text("")
