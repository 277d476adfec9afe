# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""An alternative surface to measure core/surface/ against: depth maps to a truncated signed distance field.

    python -m evaluation.tsdf WORKSPACE OUT.ply [--voxel 0.06] [--component 0]
    python -m evaluation.mesh WORKSPACE SITE --mesh OUT.ply

Curless and Levoy (1996): every voxel near the cloud takes the mean, over the photos that see it, of how far it lies
before their depth, cut off at three voxels; marching cubes draws the surface where that is zero and at least as many
photos saw it as fusion asks for. It closes nothing and keeps thin things apart by no less than a voxel or two.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from skimage.measure import marching_cubes

from curecon_blender.core.base.images import read_rgb
from curecon_blender.core.base.records import Component, View
from curecon_blender.core.cloud.ply import read_cloud
from curecon_blender.core.cloud.sky import sky_mask
from curecon_blender.core.depth.maps import read_depth
from curecon_blender.core.surface.mesh import Mesh, write_mesh
from curecon_blender.core.views import record as views_record

SIDE = 8  # voxels of a block
TRUNCATION = 3  # voxels
FEWEST_VIEWS = 3
LEAST_CONFIDENCE = 0.3
CHUNK = 1 << 12  # blocks worked on at once
CUBE = 16  # blocks of the cubes that marching cubes is given


@dataclass(frozen=True)
class Field:
    """`blocks` (B,3) int of SIDE^3 voxels of `voxel` world units from `origin` (3,); `distance` (B,SIDE,SIDE,SIDE)
    float32 in truncations, positive in front of the surface; `views` likewise uint8, how many photos tell it."""

    origin: np.ndarray
    voxel: float
    blocks: np.ndarray
    distance: np.ndarray
    views: np.ndarray


def integrate(component: Component, workspace: Path, voxel: float) -> Field:
    """The field around the component's cloud, from all its depth maps."""
    points = read_cloud(workspace / component.cloud).points
    origin = points.min(axis=0).astype(np.float64) - 2 * SIDE * voxel
    inside = np.unique(np.floor((points - origin) / (voxel * TRUNCATION)).astype(np.int64), axis=0) * TRUNCATION
    reach = np.array([-TRUNCATION, 2 * TRUNCATION])
    corners = np.stack(np.meshgrid(reach, reach, reach), axis=-1).reshape(-1, 3)
    blocks = np.unique(((inside[:, None] + corners) // SIDE).reshape(-1, 3), axis=0)
    shape = (len(blocks), SIDE, SIDE, SIDE)
    total, weight, views = np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.zeros(shape, np.uint8)
    local = np.stack(np.meshgrid(*[np.arange(SIDE)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) + 0.5
    centres = origin + (blocks * SIDE + SIDE / 2) * voxel
    for view in component.views:
        depth, confidence = _depth(view, workspace, component.frame.up != "given")
        near = _in_view(centres, view, SIDE * voxel)
        for start in range(0, len(near), CHUNK):
            which = near[start : start + CHUNK]
            places = origin + (blocks[which, None] * SIDE + local) * voxel
            z, found, sure = _look_up(places.reshape(-1, 3), view, depth, confidence)
            before = (found - z) / (TRUNCATION * voxel)
            told = ((found > 0) & (before > -1)).reshape(-1, *shape[1:])
            share = np.where(told, sure.reshape(told.shape), 0)
            total[which] += share * np.clip(before, -1, 1).reshape(told.shape)
            weight[which] += share
            views[which] += told & (np.abs(before) < 1).reshape(told.shape)
    return Field(origin, voxel, blocks, total / np.maximum(weight, 1e-6), views)


def _depth(view: View, workspace: Path, z_up: bool) -> tuple[np.ndarray, np.ndarray]:
    """z-depth (H,W) of what is sure enough and no sky, elsewhere 0, and confidence (H,W)."""
    depth, confidence = (values.astype(np.float32) for values in read_depth(workspace, view))
    depth[confidence < LEAST_CONFIDENCE] = 0
    if z_up:
        depth[sky_mask(read_rgb(workspace / view.image), confidence, view.K, view.cam_from_world)] = 0
    return depth, confidence


def _in_view(centres: np.ndarray, view: View, size: float) -> np.ndarray:
    """Blocks (n,) whose centre lies in the photo, or nearly."""
    camera = (centres - view.centre) @ view.cam_from_world[:, :3].T
    pixels = camera @ view.K.T
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = pixels[:, 0] / pixels[:, 2], pixels[:, 1] / pixels[:, 2]
        margin = size * view.K[0, 0] / pixels[:, 2]
    return np.flatnonzero((camera[:, 2] > size) & (u > -margin) & (v > -margin)
                          & (u < view.width + margin) & (v < view.height + margin))


def _look_up(
    places: np.ndarray, view: View, depth: np.ndarray, confidence: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """z-depth of places (n,3), the depth that the photo has there (0: none), and its confidence, each (n,)."""
    camera = (places - view.centre) @ view.cam_from_world[:, :3].T
    pixels = camera @ view.K.T
    z = camera[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = pixels[:, 0] / z, pixels[:, 1] / z
    inside = (z > 0) & (u >= 0) & (v >= 0) & (u < view.width) & (v < view.height)
    column, row = np.where(inside, u, 0).astype(int), np.where(inside, v, 0).astype(int)
    return z, np.where(inside, depth[row, column], 0), confidence[row, column]


def surface(field: Field) -> Mesh:
    """The zero of the field where enough photos tell it."""
    pieces, faces, count = [], [], 0
    number = {tuple(block): i for i, block in enumerate(field.blocks.tolist())}
    for cube in np.unique(field.blocks // CUBE, axis=0):
        side = CUBE * SIDE + 1  # one voxel of the next cube, so that the surface goes on there
        distance, told = np.ones((side,) * 3, np.float32), np.zeros((side,) * 3, bool)
        for offset in np.ndindex(*(CUBE + 1,) * 3):
            i = number.get(tuple((cube * CUBE + offset).tolist()))
            if i is None:
                continue
            low = np.array(offset) * SIDE
            high = np.minimum(low + SIDE, side)
            to, here = tuple(map(slice, low, high)), tuple(map(slice, high - low))
            distance[to], told[to] = field.distance[i][here], field.views[i][here] >= FEWEST_VIEWS
        if not told.any() or distance[told].min() > 0 or distance[told].max() < 0:
            continue
        try:
            vertices, triangles, _, _ = marching_cubes(distance, 0.0, mask=told, gradient_direction="ascent")
        except RuntimeError:  # its word for a cube without a surface
            continue
        pieces.append(field.origin + (vertices + cube * CUBE * SIDE + 0.5) * field.voxel)
        faces.append(triangles + count)
        count += len(vertices)
    together, index = np.unique(np.round(np.concatenate(pieces) / field.voxel, 3), axis=0, return_inverse=True)
    triangles = index.reshape(-1)[np.concatenate(faces)]
    triangles = triangles[(np.diff(np.sort(triangles, axis=1), axis=1) > 0).all(axis=1)].astype(np.int32)
    n = len(together)
    return Mesh(
        vertices=(together * field.voxel).astype(np.float32), faces=triangles, colours=np.full((n, 3), 128, np.uint8),
        distance=np.zeros(n, np.float32), views=np.full(n, FEWEST_VIEWS, np.uint8),
        filled=np.zeros(len(triangles), bool),
    )


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m evaluation.tsdf", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("workspace", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--voxel", type=float, default=0.06, help="side of a voxel in world units")
    parser.add_argument("--component", type=int, default=0)
    args = parser.parse_args(arguments)
    component = views_record.read(args.workspace)[args.component]
    mesh = surface(integrate(component, args.workspace, args.voxel))
    write_mesh(args.out, mesh)
    print(f"{args.out}: {len(mesh.faces)} faces")
    return 0


if __name__ == "__main__":
    sys.exit(main())
