# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Turn a finished reconstruction of real photos into a scene to train on, with the depth that many photos agree on.

    python -m training.real WORKSPACE --out SCENES/NAME.npz

Make the workspace with more sources and finer pictures than training shows the network (`reconstruct PHOTOS --quality
high --views 8 --until depth`): then the scene's depth knows more than the network is told. A pixel has depth where at
least FEWEST views agree within TOLERANCE and a pixel, and no sure view looks through; it is the mean of theirs. All
other pixels are unknown: training counts none of them, and confidence learns nothing from such a scene.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pycolmap

from curecon_blender.core.base.images import read_rgb
from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.base.options import Options
from curecon_blender.core.base.records import Component, View
from curecon_blender.core.cloud.agreement import Pixels, Sums, confirm
from curecon_blender.core.cloud.depth_maps import DepthMaps
from curecon_blender.core.views import record
from training.generator import Scene, save

FEWEST = 4  # views that agree, the photo itself among them
TOLERANCE = 0.003  # relative difference in depth
CONFIDENCE = 0.5  # of the photo's own depth
MOST_THROUGH = 0.1  # of the confidence of those that agree may look through
_CACHE = 1 << 30


def strict_depth(view: View, views: dict[str, View], depth_maps: DepthMaps, options: Options) -> np.ndarray:
    """z-depth (H,W) float32 of a view where many views agree on it within the options' limits, 0 elsewhere."""
    reporter = Reporter()
    found = depth_maps[view]
    sure = np.isfinite(found.inverse_depth) & (found.confidence > CONFIDENCE)
    pixels = Pixels(view, np.flatnonzero(sure), found.inverse_depth[sure])
    sums = Sums.of(pixels, found, reporter)
    for name in view.overlaps:
        confirm(pixels, views[name], depth_maps[views[name]], sums, options, reporter)
    kept = (sums.views >= FEWEST) & (sums.through <= MOST_THROUGH * sums.weight)
    depth = np.zeros(sure.shape, np.float32)
    depth.ravel()[pixels.index[kept]] = sums.points[2, kept] / sums.weight[kept]
    return depth


def real_scene(workspace: Path) -> Scene:
    """The largest component of a workspace with depth maps, as a scene. Raises WorkspaceError for one that has none,
    and ValueError where its pictures differ in size."""
    component = record.read(workspace)[0]
    if len({(view.width, view.height) for view in component.views}) > 1:
        raise ValueError(f"the pictures of {workspace} differ in size")
    views = {view.name: view for view in component.views}
    options = Options(photos=None, workspace=workspace, max_reprojection_error=1.0, max_depth_difference=TOLERANCE)
    points, visible = _sparse_points(workspace / component.sparse, component)
    with TemporaryDirectory() as scratch:
        depth_maps = DepthMaps(workspace, _CACHE, Path(scratch), z_up=component.frame.up != "given")
        depth = np.stack([strict_depth(view, views, depth_maps, options) for view in component.views])
    return Scene(
        np.stack([read_rgb(workspace / view.image) for view in component.views]), depth,
        np.stack([view.K for view in component.views]), np.stack([view.cam_from_world for view in component.views]),
        points.astype(np.float32), visible, kind=f"real {workspace.name}", complete=False,
    )


def _sparse_points(folder: Path, component: Component) -> tuple[np.ndarray, np.ndarray]:
    """Points (P,3) of a COLMAP model, and for each view whether it is in their track, (V,P)."""
    model = pycolmap.Reconstruction(folder)
    row = {point_id: number for number, point_id in enumerate(model.points3D)}
    images = {image.name: image for image in model.images.values()}
    visible = np.zeros((len(component.views), len(row)), bool)
    for view, seen in zip(component.views, visible, strict=True):
        seen[[*_rows(images[view.name], row)]] = True
    return np.array([point.xyz for point in model.points3D.values()]), visible


def _rows(image: pycolmap.Image, row: dict[int, int]) -> Iterator[int]:
    return (row[point.point3D_id] for point in image.get_observation_points2D())


def main() -> None:
    parser = argparse.ArgumentParser(description="A finished reconstruction of real photos as a scene to train on.")
    parser.add_argument("workspace", type=Path)
    parser.add_argument("--out", type=Path, required=True, help="the scene's file (.npz)")
    options = parser.parse_args()
    scene = real_scene(options.workspace)
    save(scene, options.out)
    print(f"{options.out}: {len(scene.images)} photos, depth on {100 * (scene.depth > 0).mean():.0f} % of their pixels")


if __name__ == "__main__":
    main()
